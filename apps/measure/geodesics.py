"""Distance solvers side by side: iterations, seconds from the arrays on, errors, agreement."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from measure.machine import machine_line
from measure.shapes import Shape
from measure.store import Record
from measure.study import Repeats, Result, Study, repeats_of
from measure.tables import NONE, number, ratio, table, write_json, write_markdown
from measure.worker import clocked
from spectra_kit._files import atomic_path
from spectra_kit._types import Floats, Ints
from spectra_kit.catalogue import SOLVERS, SUBSPACES
from spectra_kit.eigensolvers import Eigensolver, eigensolve
from spectra_kit.geodesics import Automatic, Direct, HeatGeodesics, Iterative, exact_distances
from spectra_kit.geodesics.solvers import Solver
from spectra_kit.geometry import PointCloud, TriangleMesh, sphere
from spectra_kit.operators import intrinsic_delaunay, robust_laplacian
from spectra_kit.spectra import Spectrum

#: Modes of the two-level solvers, as the paper takes them; that of `Iterative()` has its own.
MODES = 96
#: How modes are made.
EIGENSOLVERS: Mapping[str, Callable[[], Eigensolver]] = {
    "exact": lambda: SOLVERS["arpack"](),
    "neo": lambda: SOLVERS["neo"](),
    "neo-polished": lambda: SOLVERS["polished"](start=SUBSPACES["neo"]()),
}

_LARGE = 60_000  # vertices, above which errors are measured at two sources at most
_WARM_MODES = 8
_BALL_SOURCES = 4

# --- who ---


@dataclass(frozen=True, eq=False)
class Found:
    """Distances to one source, and what the solver tells of them.

    Attributes
    ----------
    distance : ndarray of shape (n,)
        In length.
    iterations : int or None
        Of the Poisson step; None where nothing is iterated, or nothing told.
    solver : str
        Which one was chosen, "" if there is no choice.
    stages : mapping of str to float
        Seconds, as the solver books them.
    """

    distance: Floats
    iterations: int | None = None
    solver: str = ""
    stages: Mapping[str, float] = field(default_factory=dict)


Measure = Callable[[Sequence[int]], list[Found]]
#: Make ready for sources, from points (n, 3), faces (f, 3) or None for a cloud, the modes, and
#: whether all sources come at once.
Build = Callable[[Floats, Ints | None, Spectrum | None, bool], Measure]


@dataclass(frozen=True, kw_only=True)
class Contender:
    """One way to distances.

    Attributes
    ----------
    build : callable
        Everything before the first source.
    options : str
        All that decides what it does.
    modes : str
        Which it is given: a name in `EIGENSOLVERS`, or "" for none.
    """

    build: Build
    options: str
    modes: str = ""


def _heat(
    points: Floats, faces: Ints | None, spectrum: Spectrum | None, many: bool, *, solver: Solver
) -> Measure:
    geometry = PointCloud(points) if faces is None else TriangleMesh(points, faces)
    geodesics = HeatGeodesics(geometry, spectrum, solver=solver)

    def measure(sources: Sequence[int]) -> list[Found]:
        # `distances` lets their number decide; one by one they are first fields each.
        fields = geodesics.distances(sources) if many else [geodesics.distance(s) for s in sources]
        return [
            Found(
                f.distance,
                None if f.solver.name == "direct" else f.poisson.iterations,
                f.solver.name,
                f.seconds,
            )
            for f in fields
        ]

    return measure


def _potpourri3d(
    points: Floats, faces: Ints | None, spectrum: Spectrum | None, many: bool, *, robust: bool
) -> Measure:
    import potpourri3d

    solver: Any
    if faces is None:
        solver = potpourri3d.PointCloudHeatSolver(points)
    else:
        solver = potpourri3d.MeshHeatMethodDistanceSolver(points, faces, use_robust=robust)
    return lambda sources: [Found(np.asarray(solver.compute_distance(s))) for s in sources]


def _libigl(points: Floats, faces: Ints | None, spectrum: Spectrum | None, many: bool) -> Measure:
    import igl

    data = igl.HeatGeodesicsData()
    igl.heat_geodesics_precompute(points, faces, data)
    return lambda sources: [
        Found(np.asarray(igl.heat_geodesics_solve(data, np.array([s], dtype=np.int64))))
        for s in sources
    ]


def _ours(solver: Solver, modes: str = "") -> Contender:
    return Contender(build=partial(_heat, solver=solver), options=repr(solver), modes=modes)


def _theirs(package: str, build: Build) -> Contender:
    return Contender(build=build, options=f"{package} {version(package)}")


# The paper's solvers have an incomplete factor of level 0, nothing of it relaxed.
_ICPCG = Iterative(coarse="none", drop=None, relaxation=0.0)
_ADDITIVE = Iterative(coarse="additive", drop=None, relaxation=0.0, modes=MODES)
_PROJECTED = Iterative(coarse="projected", drop=None, relaxation=0.0, modes=MODES)

ICPCG, DIRECT = "ICPCG", "direct"
AUTOMATIC, UNAIDED = "automatic, exact modes", "automatic, no modes"
ROBUST, PLAIN, LIBIGL = "potpourri3d, robust", "potpourri3d, not robust", "libigl"

#: By name, in the order of the tables.
CONTENDERS: Mapping[str, Contender] = {
    ICPCG: _ours(_ICPCG),
    f"additive, {MODES} exact modes": _ours(_ADDITIVE, "exact"),
    f"additive, {MODES} NEO modes": _ours(_ADDITIVE, "neo"),
    f"additive, {MODES} NEO modes, polished": _ours(_ADDITIVE, "neo-polished"),
    f"projected, {MODES} exact modes": _ours(_PROJECTED, "exact"),
    f"projected, {MODES} NEO modes": _ours(_PROJECTED, "neo"),
    "threshold IC": _ours(Iterative(coarse="none", drop=1e-2, relaxation=0.0)),
    "relaxed threshold IC": _ours(Iterative(coarse="none")),
    AUTOMATIC: _ours(Automatic(), "exact"),
    "automatic, NEO modes": _ours(Automatic(), "neo"),
    "automatic, NEO modes, polished": _ours(Automatic(), "neo-polished"),
    UNAIDED: _ours(Automatic()),
    DIRECT: _ours(Direct()),
    ROBUST: _theirs("potpourri3d", partial(_potpourri3d, robust=True)),
    PLAIN: _theirs("potpourri3d", partial(_potpourri3d, robust=False)),
    LIBIGL: _theirs("libigl", _libigl),
}
_OTHERS = (ROBUST, PLAIN, LIBIGL)
#: Contenders for many sources: none is given modes, so that none has time on the house.
MANY = (UNAIDED, DIRECT, *_OTHERS)


# --- what they are given, and compared with ---


@dataclass(frozen=True, eq=False, kw_only=True)
class Modes(Study[str, Shape]):
    """The modes that contenders are handed."""

    name = "modes"
    fresh = False
    contenders: Sequence[str] = tuple(EIGENSOLVERS)

    def facts(self, contender: str, problem: Shape) -> dict[str, object]:
        """See `Study`."""
        solver = EIGENSOLVERS[contender]()  # its representation holds the hash of the weights
        return {"shape": problem.digest, "solver": repr(solver), "modes": MODES}

    def measure(self, contender: str, problem: Shape) -> Record:
        """See `Study`."""
        laplacian = intrinsic_delaunay(problem.mesh).laplacian
        k = min(MODES + laplacian.kernel_dimension, laplacian.n - 1)
        spectrum = eigensolve(laplacian, k, EIGENSOLVERS[contender]())
        path = self.file(contender, problem, ".npz")
        spectrum.save(path)
        # The operator is what the distances need anyway.
        stages = spectrum.provenance.seconds.items()
        seconds = sum(time for stage, time in stages if stage != "assembly")
        return {"seconds": seconds, "files": [f"files/{path.name}"]}

    def spectrum(self, contender: str, shape: Shape) -> Spectrum:
        """Read what was solved."""
        return Spectrum.load(self.file(contender, shape, ".npz"))


@dataclass(frozen=True, eq=False, kw_only=True)
class Exact(Study[str, Shape]):
    """Exact distances: half of the sources drawn, the rest as far as possible from those before.

    Attributes
    ----------
    count : int
        Sources of a mesh.
    seed : int
        Of the draw.
    """

    name = "exact"
    sources = ("geodesics/*exact*.py",)  # they take longest, and nothing else decides them
    fresh = False
    contenders: Sequence[str] = ("exact",)
    count: int = 4
    seed: int = 0

    def facts(self, contender: str, problem: Shape) -> dict[str, object]:
        """See `Study`."""
        return {"shape": problem.digest, "count": self._count(problem.mesh.n), "seed": self.seed}

    def measure(self, contender: str, problem: Shape) -> Record:
        """See `Study`."""
        n = problem.mesh.n
        count = self._count(n)
        drawn = np.random.default_rng(self.seed).choice(n, (count + 1) // 2, replace=False)
        sources: list[int] = drawn.tolist()
        found: list[Floats] = []
        with clocked() as clock:
            while len(found) < count:
                if len(found) == len(sources):
                    nearest = np.min(found, axis=0)
                    nearest[np.isinf(nearest)] = -1.0  # other components have no errors to measure
                    sources.append(int(nearest.argmax()))
                found.append(exact_distances(problem.mesh, sources[len(found)]))
        path = self.file(contender, problem, ".npz")
        with atomic_path(path) as part:
            np.savez(part, sources=sources, distances=found)
        return {"seconds": clock.seconds, "sources": sources, "files": [f"files/{path.name}"]}

    def distances(self, shape: Shape) -> tuple[list[int], Floats]:
        """Read sources and distances, shape (s, n)."""
        with np.load(self.file("exact", shape, ".npz")) as file:
            return file["sources"].tolist(), file["distances"]

    def _count(self, n: int) -> int:
        return min(self.count, 2 if n > _LARGE else n)


# --- what is measured ---


@dataclass(frozen=True, eq=False, kw_only=True)
class Distances(Study[str, Shape]):
    """Contenders on meshes, at sources.

    Attributes
    ----------
    modes : Modes
        Solved for the same meshes.
    exact : Exact
        On the same meshes.
    warm : int
        Subdivisions of the sphere to warm up on; 5 have 10,242 points.
    """

    contenders: Sequence[str] = tuple(CONTENDERS)
    modes: Modes
    exact: Exact
    warm: int = 5

    def facts(self, contender: str, problem: Shape) -> dict[str, object]:
        """See `Study`."""
        given = CONTENDERS[contender].modes
        return {
            "contender": contender,
            "options": CONTENDERS[contender].options,
            "shape": problem.digest,
            "modes": self.modes.key(given, problem) if given else "",
            "exact": self.exact.key("exact", problem),
        }

    def excuse(self, contender: str, problem: Shape, before: Sequence[Result[str, Shape]]) -> str:
        """Leave out what lacks what it needs."""
        given = CONTENDERS[contender].modes
        if given and not self.modes.file(given, problem, ".npz").exists():
            return f"there are no {given} modes"
        if not self.exact.file("exact", problem, ".npz").exists():
            return "there are no exact distances"
        return ""

    def solved(
        self, contender: str, shape: Shape, sources: Sequence[int], *, many: bool = False
    ) -> tuple[list[Found], Record]:
        """Solve with a contender that is warm; return its fields, and what they took."""
        who = CONTENDERS[contender]
        spectrum = self.modes.spectrum(who.modes, shape) if who.modes else None
        points, faces = np.array(shape.mesh.points), np.array(shape.mesh.faces)
        # Loads libraries, and compiled code from the disk.
        ball = sphere(subdivisions=self.warm).geometry
        modes = None if spectrum is None else eigensolve(robust_laplacian(ball), _WARM_MODES)
        who.build(np.array(ball.points), np.array(ball.faces), modes, many)([0] * len(sources))
        with clocked() as clock:
            found = who.build(points, faces, spectrum, many)(sources)
        return found, {
            "seconds": clock.seconds,
            "waiting": clock.waited_seconds / clock.seconds,
            "iterations": [one.iterations for one in found],
            "solver": found[0].solver,
            "stages": dict(found[0].stages),
        }


@dataclass(frozen=True, eq=False, kw_only=True)
class Accuracy(Distances):
    """Errors against exact distances, and differences from the direct solver."""

    name = "accuracy"
    # The direct solver comes first: the others are compared with it.
    contenders: Sequence[str] = tuple(sorted(CONTENDERS, key=lambda name: name != DIRECT))

    def measure(self, contender: str, problem: Shape) -> Record:
        """See `Study`."""
        sources, exact = self.exact.distances(problem)
        found, record = self.solved(contender, problem, sources)
        fields = np.array([one.distance for one in found])
        path = self.file(contender, problem, ".npy")
        with atomic_path(path) as part:
            np.save(part, fields)
        mass = intrinsic_delaunay(problem.mesh).laplacian.mass
        errors = [relative_errors(d, e, mass) for d, e in zip(fields, exact, strict=True)]
        record |= {"errors": errors, "files": [f"files/{path.name}"]}
        direct = self.file(DIRECT, problem, ".npy")
        if contender not in _OTHERS and direct.exists():
            reference = np.load(direct)
            known = np.isfinite(reference)
            span = np.max(reference, where=known, initial=0.0, axis=1)
            difference = np.max(np.abs(fields - reference), where=known, initial=0.0, axis=1)
            record["difference"] = float(np.max(difference / span))
        return record


@dataclass(frozen=True, eq=False, kw_only=True)
class Times(Distances):
    """Seconds from the arrays to the field of one source, or of many.

    Attributes
    ----------
    many : int
        Sources that are asked for at once; 0 for the first field, of one source.
    seed : int
        Of the many.
    threads : int
        For all alike.
    machine : str
        Whose seconds they are.
    """

    name = "times"
    many: int = 0
    seed: int = 0
    threads: int = 1
    machine: str = ""

    def facts(self, contender: str, problem: Shape) -> dict[str, object]:
        """See `Study`."""
        mine = {"many": self.many, "seed": self.seed, "warm": self.warm}
        where = {"threads": self.threads, "machine": self.machine}
        return {**super().facts(contender, problem), **mine, **where}

    def measure(self, contender: str, problem: Shape) -> Record:
        """See `Study`."""
        sources = self.exact.distances(problem)[0][:1]
        if self.many:
            n = problem.mesh.n
            rng = np.random.default_rng(self.seed)
            sources = rng.choice(n, min(self.many, n), replace=False).tolist()
        _, record = self.solved(contender, problem, sources, many=bool(self.many))
        return record


@dataclass(frozen=True)
class Ball:
    """The unit sphere as a mesh, or points drawn on it, as many."""

    kind: str
    subdivisions: int

    def __str__(self) -> str:
        return f"{self.kind}, {self.subdivisions} subdivisions"


@dataclass(frozen=True, eq=False, kw_only=True)
class Balls(Study[str, Ball]):
    """Errors on the unit sphere, where distances are arcs.

    Attributes
    ----------
    seed : int
        Of clouds and sources.
    """

    name = "balls"
    fresh = False
    contenders: Sequence[str] = (DIRECT, ROBUST, PLAIN)
    seed: int = 0

    def facts(self, contender: str, problem: Ball) -> dict[str, object]:
        """See `Study`."""
        options = CONTENDERS[contender].options
        return {"ball": str(problem), "seed": self.seed, "who": [contender, options]}

    def tasks(self) -> list[tuple[str, Ball, int]]:
        """See `Study`; the surface that is not robust knows no clouds."""
        pairs = ((name, ball) for ball in self.problems for name in self.contenders)
        return [(name, ball, 0) for name, ball in pairs if (name, ball.kind) != (PLAIN, "cloud")]

    def measure(self, contender: str, problem: Ball) -> Record:
        """See `Study`."""
        ball = sphere(subdivisions=problem.subdivisions).geometry
        rng = np.random.default_rng(self.seed)
        points, faces = np.array(ball.points), np.array(ball.faces)
        sources = rng.choice(ball.n, _BALL_SOURCES, replace=False).tolist()
        if problem.kind == "cloud":
            directions = rng.standard_normal((ball.n, 3))
            points = directions / np.linalg.norm(directions, axis=1)[:, None]
        given = None if problem.kind == "cloud" else faces
        found = CONTENDERS[contender].build(points, given, None, False)(sources)
        arcs = np.arccos(np.clip(points[sources] @ points.T, -1, 1))
        errors = [
            relative_errors(one.distance, arc, np.ones(ball.n))
            for one, arc in zip(found, arcs, strict=True)
        ]
        return {
            "points": ball.n,
            **{name: _mean_error(errors, name) for name in ("mean", "largest")},
        }


def relative_errors(distance: Floats, exact: Floats, mass: Floats) -> Record:
    """Compare distances with exact ones; sources, and what is out of reach, do not count.

    Returns
    -------
    dict
        ``mean`` over the vertices, ``weighted`` over the surface and ``largest`` of
        ``|d - d*| / d*``.
    """
    counted = (exact > 0) & np.isfinite(exact)
    error = np.abs(distance[counted] - exact[counted]) / exact[counted]
    weights = mass[counted]
    return {
        "mean": float(error.mean()),
        "weighted": float(error @ weights / weights.sum()),
        "largest": float(error.max()),
    }


def _mean_error(errors: Iterable[Record], which: str) -> float:
    return statistics.fmean(error[which] for error in errors)


# --- what follows ---

Rows = Mapping[str, Repeats[str, Shape]]


@dataclass(frozen=True, eq=False, kw_only=True)
class Mesh:
    """All that was measured on one mesh, by contender.

    Attributes
    ----------
    name : str
        Of the mesh.
    n : int
        Vertices.
    modes : mapping of str to float
        Seconds, by eigensolver.
    accuracy, first, many : mapping
        Of each contender.
    """

    name: str
    n: int
    modes: Mapping[str, float]
    accuracy: Rows
    first: Rows
    many: Rows

    @property
    def title(self) -> str:
        """Name and size."""
        return f"{self.name} ({self.n:,})"

    def iterations(self, name: str) -> float | None:
        """Return the median iterations; None where nothing is iterated."""
        counts = [c for c in self.accuracy[name].first("iterations") or [] if c is not None]
        return statistics.median(counts) if counts else None

    def error(self, name: str, which: str = "mean") -> float | None:
        """Return an error, averaged over sources; None where it failed."""
        errors = self.accuracy[name].first("errors")
        return _mean_error(errors, which) if errors else None

    def seconds(self, name: str, *, many: bool = False) -> float | None:
        """Return the seconds, modes at hand; None where it failed."""
        return (self.many if many else self.first)[name].median("seconds")

    def modes_seconds(self, name: str) -> float:
        """Return what the modes took that a contender used for its first field."""
        # A solver that has chosen to do without them has not used their time.
        if self.first[name].first("solver") == "direct":
            return 0.0
        return self.modes.get(CONTENDERS[name].modes, 0.0)

    def seconds_in_all(self, name: str) -> float | None:
        """Return the seconds to the first field, those of the modes with them."""
        own = self.seconds(name)
        return None if own is None else own + self.modes_seconds(name)


def meshes(
    modes: Iterable[Result[str, Shape]],
    accuracy: Iterable[Result[str, Shape]],
    first: Iterable[Result[str, Shape]],
    many: Iterable[Result[str, Shape]],
) -> list[Mesh]:
    """Gather what was measured, mesh by mesh."""
    solved = [result for result in modes if result.ok]
    studies = [repeats_of(results) for results in (accuracy, first, many)]
    shapes = {row.problem.name: row.problem for row in studies[0]}
    found = []
    for name, shape in shapes.items():
        rows = [{r.contender: r for r in study if str(r.problem) == name} for study in studies]
        seconds = {r.contender: r.record["seconds"] for r in solved if str(r.problem) == name}
        found.append(
            Mesh(
                name=name,
                n=shape.mesh.n,
                modes=seconds,
                accuracy=rows[0],
                first=rows[1],
                many=rows[2],
            )
        )
    return found


def write_report(
    folder: Path,
    found: Sequence[Mesh],
    balls: Sequence[Result[str, Ball]],
    machine: Record,
    *,
    repeats: int,
    sources: int,
    quick: bool = False,
) -> str:
    """Write ``report.json`` and ``report.md``, and return the latter.

    Parameters
    ----------
    folder : Path
        Must exist.
    found : sequence of Mesh
        At least one.
    balls : sequence of Result
        Of `Balls`.
    machine : dict
        Of `describe_machine`.
    repeats, sources : int
        Of the times.
    quick : bool
        Whether everything ran in one process.
    """
    write_json(
        folder / "report.json",
        {
            "machine": machine,
            "meshes": [_as_json(mesh) for mesh in found],
            "balls": [{**result.record, "ball": str(result.problem)} for result in balls],
        },
    )
    parts = [
        "# Geodesic distances",
        machine_line(machine) + " All in one process: the seconds are not comparable." * quick,
        "## In short",
        _summary(found),
        "## Iterations of the Poisson step",
        "To a relative residual of 1e-8; the median of the sources, and how many times fewer"
        f" than {ICPCG}. What the modes took is not in these counts.",
        _iterations(found),
        "## Seconds to the first field",
        "From the arrays of vertices and faces to the distances from one source: checks,"
        " triangulation, factors or preconditioner, heat and Poisson step; of other packages,"
        f" building the solver and its first solve. Medians of {repeats} runs, each in"
        " a process of its own, all contenders by turns. Importing and compiling are not counted:"
        " compiled code is kept on disk, and each process solves on a small sphere first."
        " A solver with modes is handed them: *seconds* does not hold what they took. That is"
        f" in *spectrum*, for all {MODES} of them, though automatic takes fewer; the operator is"
        " not counted twice. *In all* is the sum, what someone pays who wants the distance and"
        " nothing else of the spectrum. *Faster* is the time of potpourri3d, robust (its default),"
        " over either.",
        *map(_first, found),
        "## Seconds for many sources",
        f"{sources} single sources, asked for at once; the same clock. No solver here is handed"
        f" modes. In brackets: over *{DIRECT}*.",
        _many(found, sources),
        "## Errors against exact distances",
        "Relative errors |d - d*| / d* in per cent, the sources aside: mean over vertices / mean"
        " over the surface / largest; averaged over sources, half of them drawn at random, half"
        " far from those before. *Ratio* is the mean over vertices of the direct solver over that"
        " of potpourri3d, robust.",
        _errors(found),
        "## Agreement of the solvers",
        "Largest difference from the fields of the direct solver, over the largest distance.",
        _agreement(found),
        "## The unit sphere",
        "Mean (largest) relative errors against arcs in per cent, and the rate: the power of"
        " 1/sqrt(n) with which the mean error falls from the first to the last.",
        _balls(balls),
    ]
    return write_markdown(folder / "report.md", parts)


def _as_json(mesh: Mesh) -> Record:
    rows = {"accuracy": mesh.accuracy, "first": mesh.first, "many": mesh.many}
    return {
        "name": mesh.name,
        "n": mesh.n,
        "modes_seconds": mesh.modes,
        **{
            what: {name: [result.record for result in row.results] for name, row in some.items()}
            for what, some in rows.items()
        },
    }


def _summary(found: Sequence[Mesh]) -> str:
    """What matters, as the worst over the meshes."""
    rows = [
        _worst(
            f"{ICPCG} iterations over those of *{name}*",
            [(ratio(m.iterations(ICPCG), m.iterations(name)), m.name) for m in found],
        )
        for name in CONTENDERS
        if name.startswith(("additive", "projected"))
    ]
    clocks: dict[str, Callable[[Mesh], float | None]] = {
        f"*{UNAIDED}*": lambda m: m.seconds(UNAIDED),
        f"*{AUTOMATIC}*, spectrum at hand": lambda m: m.seconds(AUTOMATIC),
        f"*{AUTOMATIC}*, its spectrum counted": lambda m: m.seconds_in_all(AUTOMATIC),
    }
    for note, least in (("", 0), (f", {_HUGE:,} vertices or more", _HUGE)):
        for words, clock in clocks.items():
            faster = [(ratio(m.seconds(ROBUST), clock(m)), m.name) for m in found if m.n >= least]
            rows.append(_worst(f"seconds of potpourri3d over {words}: first field{note}", faster))
    slower = [
        (ratio(m.seconds(UNAIDED, many=True), m.seconds(DIRECT, many=True)), m.name) for m in found
    ]
    rows.append(_worst(f"seconds of *{UNAIDED}* over *{DIRECT}*: many sources", slower, max))
    errors = [(ratio(m.error(DIRECT), m.error(ROBUST)), m.name) for m in found]
    rows.append(_worst("mean error over that of potpourri3d", errors, max, ".3f"))
    apart = [
        (row.first("difference"), mesh.name) for mesh in found for row in mesh.accuracy.values()
    ]
    rows.append(_worst("difference between solvers", apart, max, ".1e"))
    return table(["measured", "worst", "on"], rows)


_HUGE = 100_000  # vertices
Worst = Callable[[list[tuple[float, str]]], tuple[float, str]]


def _worst(
    label: str, values: Iterable[tuple[float | None, str]], pick: Worst = min, form: str = ".2f"
) -> list[str]:
    """Return a row: what was measured, the worst, and on which mesh."""
    there = [(value, name) for value, name in values if value is not None]
    if not there:
        return [label, NONE, NONE]
    value, name = pick(there)
    return [label, format(value, form), name]


def _iterations(found: Sequence[Mesh]) -> str:
    rows = []
    for name in CONTENDERS:
        counts = [mesh.iterations(name) for mesh in found]
        fewer = [ratio(m.iterations(ICPCG), c) for m, c in zip(found, counts, strict=True)]
        if any(count is not None for count in counts):
            cells = (
                NONE if c is None else f"{c:.0f} ({number(f, '.2f')})"
                for c, f in zip(counts, fewer, strict=True)
            )
            rows.append([name, *cells])
    return table(["solver", *(mesh.title for mesh in found)], rows)


_STAGES = ("triangulation", "setup", "heat", "poisson")


def _first(mesh: Mesh) -> str:
    rows = []
    robust = mesh.seconds(ROBUST)
    for name, row in mesh.first.items():
        own, whole, middle = mesh.seconds(name), mesh.seconds_in_all(name), _middle(row)
        stages = middle.get("stages", {})
        rows.append(
            [
                name,
                number(own, ".2f"),
                number(ratio(robust, own), ".2f"),
                number(mesh.modes_seconds(name) or None, ".2f"),
                number(whole, ".2f"),
                number(ratio(robust, whole), ".2f"),
                number((middle.get("iterations") or [None])[0], "d"),
                *(number(stages.get(stage), ".2f") for stage in _STAGES),
                middle.get("solver", "") if row.ok else "failed",
            ]
        )
    header = ["solver", "seconds", "faster", "spectrum", "in all", "faster", "iterations"]
    header += ["triangulation", "setup", "heat", "Poisson", "chosen"]
    return f"### {mesh.title}\n\n{table(header, rows)}"


def _middle(row: Repeats[str, Shape]) -> Record:
    """Return the record of the median run, the faster one of two."""
    good = sorted(
        (result.record for result in row.results if result.ok), key=lambda record: record["seconds"]
    )
    return good[(len(good) - 1) // 2] if good else {}


def _many(found: Sequence[Mesh], sources: int) -> str:
    rows = []
    for name in MANY:
        cells = []
        for mesh in found:
            own, count = mesh.seconds(name, many=True), min(sources, mesh.n)
            against = number(ratio(own, mesh.seconds(DIRECT, many=True)), ".2f")
            told = "failed" if own is None else f"{own:.2f}, {1e3 * own / count:.0f} ms each"
            cells.append(told + f" ({against})" * (own is not None))
        rows.append([name, *cells])
    return table(["solver", *(mesh.title for mesh in found)], rows)


def _errors(found: Sequence[Mesh]) -> str:
    names = [DIRECT, AUTOMATIC, ROBUST, PLAIN, LIBIGL]
    rows = []
    for mesh in found:
        cells = []
        for name in names:
            errors = (mesh.error(name, which) for which in ("mean", "weighted", "largest"))
            cells.append(" / ".join(NONE if e is None else f"{100 * e:.3g}" for e in errors))
        against = ratio(mesh.error(DIRECT), mesh.error(ROBUST))
        rows.append([mesh.title, *cells, number(against, ".3f")])
    return table(["mesh", *names, "ratio"], rows)


def _agreement(found: Sequence[Mesh]) -> str:
    rows = [
        [name, *(number(mesh.accuracy[name].first("difference"), ".1e") for mesh in found)]
        for name in CONTENDERS
        if name not in _OTHERS
    ]
    return table(["solver", *(mesh.title for mesh in found)], rows)


def _balls(results: Sequence[Result[str, Ball]]) -> str:
    lines: dict[tuple[str, str], list[Record]] = {}
    for result in results:
        lines.setdefault((result.problem.kind, result.contender), []).append(result.record)
    rows = []
    for (kind, name), records in lines.items():
        cells = [f"{100 * r['mean']:.3g} ({100 * r['largest']:.3g})" for r in records]
        ends = np.log([(r["mean"], r["points"] ** 0.5) for r in (records[0], records[-1])])
        fall = ends[0] - ends[1]
        rows.append([f"{kind}: {name}", *cells, number(ratio(-fall[0], fall[1]), ".2f")])
    sizes = dict.fromkeys(result.record["points"] for result in results)
    return table(["geometry: solver", *(f"{n:,}" for n in sizes), "rate"], rows)
