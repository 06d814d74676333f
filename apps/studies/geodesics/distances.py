"""What is measured of the contenders, and what they are given and compared with."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from spectra_kit._core.files import atomic_path
from spectra_kit._core.types import Floats
from spectra_kit.catalogue import SOLVERS
from spectra_kit.eigen import Eigensolver, Spectrum, eigensolve
from spectra_kit.geodesics import exact_distances
from spectra_kit.geometry import sphere
from spectra_kit.operators import intrinsic_delaunay, robust_laplacian
from studies.geodesics.contenders import (
    CONTENDERS,
    DIRECT,
    MODES,
    OTHERS,
    Found,
)
from studies.shapes import Shape
from studies.store import Record
from studies.study import Result, Study
from studies.worker import clocked

#: How modes are made.
EIGENSOLVERS: Mapping[str, Callable[[], Eigensolver]] = {
    "exact": lambda: SOLVERS["automatic"](),
    "neo": lambda: SOLVERS["neo"](),
}

_LARGE = 60_000  # vertices, above which errors are measured at two sources at most
_WARM_MODES = 8


@dataclass(frozen=True, eq=False, kw_only=True)
class Modes(Study[str, Shape]):
    """The modes that contenders are handed."""

    name = "modes"
    fresh = False
    contenders: Sequence[str] = tuple(EIGENSOLVERS)

    def facts(self, contender: str, problem: Shape) -> dict[str, object]:
        solver = EIGENSOLVERS[contender]()  # its representation holds the hash of the weights
        return {"shape": problem.digest, "solver": repr(solver), "modes": MODES}

    def measure(self, contender: str, problem: Shape) -> Record:
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
    """Exact distances: half of the sources drawn, the rest as far as possible from those before."""

    name = "exact"
    sources = ("geodesics/*exact*.py",)  # they take longest, and nothing else decides them
    fresh = False
    contenders: Sequence[str] = ("exact",)
    count: int = 4  #: Sources of a mesh.
    seed: int = 0  #: Of the draw.

    def facts(self, contender: str, problem: Shape) -> dict[str, object]:
        return {"shape": problem.digest, "count": self._count(problem.mesh.n), "seed": self.seed}

    def measure(self, contender: str, problem: Shape) -> Record:
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


@dataclass(frozen=True, eq=False, kw_only=True)
class Distances(Study[str, Shape]):
    """Contenders on meshes, at sources."""

    contenders: Sequence[str] = tuple(CONTENDERS)
    modes: Modes  #: Solved for the same meshes.
    exact: Exact  #: On the same meshes.
    warm: int = 5  #: Subdivisions of the sphere to warm up on; 5 have 10,242 points.

    def facts(self, contender: str, problem: Shape) -> dict[str, object]:
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
        self, contender: str, shape: Shape, sources: Sequence[int]
    ) -> tuple[list[Found], Record]:
        """Solve with a contender that is warm; return its fields, and what they took."""
        who = CONTENDERS[contender]
        spectrum = self.modes.spectrum(who.modes, shape) if who.modes else None
        points, faces = np.array(shape.mesh.points), np.array(shape.mesh.faces)
        # Loads libraries, and compiled code from the disk.
        ball = sphere(subdivisions=self.warm).geometry
        modes = None if spectrum is None else _warm_modes(self.warm)
        who.build(np.array(ball.points), np.array(ball.faces), modes)([0] * len(sources))
        with clocked() as clock:
            found = who.build(points, faces, spectrum)(sources)
        return found, {
            "seconds": clock.seconds,
            "processor_seconds": clock.processor_seconds,
            "waiting": clock.waited_seconds / clock.seconds,
            "iterations": [one.iterations for one in found],
            "solver": found[0].solver,
            "stages": dict(found[0].stages),
        }


@cache
def _warm_modes(subdivisions: int) -> Spectrum:
    """Solve for a few modes of a sphere, once in a process."""
    return eigensolve(robust_laplacian(sphere(subdivisions=subdivisions).geometry), _WARM_MODES)


@dataclass(frozen=True, eq=False, kw_only=True)
class Accuracy(Distances):
    """Errors against exact distances, and differences from the direct solver."""

    name = "accuracy"
    # The direct solver comes first: the others are compared with it.
    contenders: Sequence[str] = tuple(sorted(CONTENDERS, key=lambda name: name != DIRECT))

    def excuse(self, contender: str, problem: Shape, before: Sequence[Result[str, Shape]]) -> str:
        """Leave out too what lacks the direct solver's fields."""
        if missing := super().excuse(contender, problem, before):
            return missing
        compared = contender not in (DIRECT, *OTHERS)
        lost = compared and not self.file(DIRECT, problem, ".npy").exists()
        return "the direct solver has failed" if lost else ""

    def measure(self, contender: str, problem: Shape) -> Record:
        sources, exact = self.exact.distances(problem)
        found, record = self.solved(contender, problem, sources)
        fields = np.array([one.distance for one in found])
        path = self.file(contender, problem, ".npy")
        with atomic_path(path) as part:
            np.save(part, fields)
        mass = intrinsic_delaunay(problem.mesh).laplacian.mass
        errors = [relative_errors(d, e, mass) for d, e in zip(fields, exact, strict=True)]
        record |= {"errors": errors, "files": [f"files/{path.name}"]}
        if contender not in OTHERS:
            reference = np.load(self.file(DIRECT, problem, ".npy"))
            known = np.isfinite(reference)
            span = np.max(reference, where=known, initial=0.0, axis=1)
            difference = np.max(np.abs(fields - reference), where=known, initial=0.0, axis=1)
            record["difference"] = float(np.max(difference / span))
        return record


@dataclass(frozen=True, eq=False, kw_only=True)
class Times(Distances):
    """Seconds from the arrays to the field of one source, or of many."""

    name = "times"
    many: int = 0  #: Sources that are asked for at once; 0 for the first field, of one source.
    seed: int = 0  #: Of the many.
    threads: int = 1  #: For all alike.
    machine: str = ""  #: Whose seconds they are.

    def facts(self, contender: str, problem: Shape) -> dict[str, object]:
        mine = {"many": self.many, "seed": self.seed, "warm": self.warm}
        where = {"threads": self.threads, "machine": self.machine}
        return {**super().facts(contender, problem), **mine, **where}

    def measure(self, contender: str, problem: Shape) -> Record:
        sources = self.exact.distances(problem)[0][:1]
        if self.many:
            n = problem.mesh.n
            rng = np.random.default_rng(self.seed)
            sources = rng.choice(n, min(self.many, n), replace=False).tolist()
        _, record = self.solved(contender, problem, sources)
        return record


def relative_errors(distance: Floats, exact: Floats, mass: Floats) -> Record:
    """Return ``|d - d*| / d*``: the mean over vertices, over the surface, and the largest.

    Sources, and what is out of reach, do not count.
    """
    counted = (exact > 0) & np.isfinite(exact)
    error = np.abs(distance[counted] - exact[counted]) / exact[counted]
    weights = mass[counted]
    return {
        "mean": float(error.mean()),
        "weighted": float(error @ weights / weights.sum()),
        "largest": float(error.max()),
    }
