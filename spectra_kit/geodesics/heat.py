"""`HeatGeodesics`: distances by the heat method, on meshes and point clouds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial, reduce
from operator import call
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.checked import checked
from spectra_kit._core.clock import Clock
from spectra_kit._core.records import frozen
from spectra_kit._core.threads import in_threads, ranges, thread_count
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_positive
from spectra_kit._core.warn import warn
from spectra_kit._sparse.constant_kernel import ConstantKernel
from spectra_kit._sparse.grounded import GroundedCholesky
from spectra_kit._sparse.solution import LinearSolution
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import ConvergenceError, DoubtfulDistanceWarning, InvalidInputError
from spectra_kit.geodesics.exact import EXACT, exact_or_none
from spectra_kit.geodesics.heat_step import Heat, HeatStep
from spectra_kit.geodesics.result import DistanceField
from spectra_kit.geodesics.solvers import (
    Direct,
    Iterative,
    IterativePoisson,
    Solver,
    WithinMemory,
)
from spectra_kit.geodesics.sources import Sources, SourcesLike, check_sources
from spectra_kit.geodesics.system import COARSER, System
from spectra_kit.geometry.components import component_of
from spectra_kit.geometry.shapes import GeometryLike, TriangleMesh
from spectra_kit.operators.intrinsic import IntrinsicTriangulation, intrinsic_delaunay

Boundary = Literal["neumann", "dirichlet", "average"]

# Share of the points nearer to a source than sqrt(t) that deserves a warning, and how many of them
# are few for each source.
_BLURRED, _NEAR = 0.25, 20
# Mean relative error that deserves a warning: between 2.5 %, as of well resolved models, and 5 %.
_OFF = 0.0375
_TOGETHER = 8  # sources that a thread solves for at once, as `SparseLDL` does best
_LONGEST = 1e30  # coefficient of a time with which one can calculate


class _Ready(NamedTuple):
    """What takes part before any source is known, and the time it took."""

    system: System
    steps: Mapping[int, Mapping[Boundary, HeatStep]]  # by `System.sizes`
    poisson: GroundedCholesky | IterativePoisson
    reason: str
    gigabytes: float  # of complete factors
    seconds: float


@checked
class HeatGeodesics:
    """Distances to any sources on one geometry; what they have in common is computed once.

    Parameters
    ----------
    geometry : TriangleMesh, PointCloud or IntrinsicTriangulation
        Of n points. A mesh or cloud becomes its `intrinsic_delaunay` triangulation.
    spectrum : Spectrum, optional
        Modes of the geometry, by whatever solver: they make an iterative solver quicker, and do
        not change the distances.
    solver : Direct, Iterative or WithinMemory, default WithinMemory()
        How linear systems are solved.
    time_coefficient : float, default 1.0
        The time of the heat step is this times the square of the typical edge of each component
        (`IntrinsicTriangulation.spacings`). Larger ones give smoother, less exact distances.
    boundary : {"neumann", "dirichlet", "average"}, default "neumann"
        Of the heat step: no heat leaves through the boundary, the boundary is kept at zero, or
        the mean of both heats. Isolines meet the boundary at right angles, run along it, or
        heed it least.

    Attributes
    ----------
    geometry : TriangleMesh, PointCloud or IntrinsicTriangulation
        As it was given; sources are named by its points and faces.
    triangulation : IntrinsicTriangulation
        What the distances are measured on.
    time_steps : ndarray of shape (n_components,)
        Of each component of `triangulation`, in length^2.

    Warns
    -----
    DoubtfulDistanceWarning
        If distances are blurred (see below), or a mesh of at most 2,000 vertices has such large
        triangles that exact distances from the first source differ by more than 3.75 % in the mean.

    Notes
    -----
    Crane, Weischedel and Wardetzky, *The heat method for distance computation*, Communications of
    the ACM 60(11), 2017.

    Heat u spreads from the sources for a short time t, ``(M + t L) u = b``; unit vectors X point
    down its gradient; the distance is the function whose gradient is nearest to X,
    ``L phi = div X``, and zero at the sources. Where both systems are solved iteratively, the
    modes serve the second one; the first has no slow modes. Not an upper bound of the true
    distance, nor a lower one.

    Where triangles are much larger than ``sqrt(t)``, heat does not tell the direction: it falls
    too steeply along their short sides. Those with a side of more than 8 typical edges take X from
    the heat of 64 t, those of more than 64 edges from that of 64^2 t, and so on. A mesh without
    such triangles needs one step. Details much smaller than a typical edge are blurred, and a
    warning says so if there are many: cut them out, or lower `time_coefficient`.

    Examples
    --------
    From pole to pole of the unit sphere:

    >>> import spectra_kit as sk
    >>> mesh = sk.geometry.sphere(subdivisions=4).geometry
    >>> north, south = mesh.points[:, 2].argmax(), mesh.points[:, 2].argmin()
    >>> field = sk.HeatGeodesics(mesh).distance(north)
    >>> field.distance[[north, south]]
    array([0.  , 3.1...])
    """

    def __init__(
        self,
        geometry: GeometryLike | IntrinsicTriangulation,
        spectrum: Spectrum | None = None,
        *,
        solver: Solver = WithinMemory(),  # noqa: B008
        time_coefficient: float = 1.0,
        boundary: Boundary = "neumann",
    ) -> None:
        if not 1 / _LONGEST <= check_positive("time_coefficient", time_coefficient) <= _LONGEST:
            raise InvalidInputError(
                "time_coefficient",
                f"be in [{1 / _LONGEST:g}, {_LONGEST:g}]",
                f"{time_coefficient:g}",
                advice="1 is the default",
            )
        if isinstance(geometry, IntrinsicTriangulation):
            self.triangulation = geometry
        else:
            self.triangulation = intrinsic_delaunay(geometry)
        if spectrum is not None and spectrum.n != self.triangulation.n:
            raise InvalidInputError(
                "spectrum",
                f"have the {self.triangulation.n} points of `geometry`",
                f"one of {spectrum.n}",
            )
        self.geometry, self._spectrum, self._solver = geometry, spectrum, solver
        self._boundary: Boundary = boundary
        self.time_steps = frozen(time_coefficient * self.triangulation.spacings**2)
        self._time_coefficient = time_coefficient
        self._chosen: tuple[Direct | Iterative, str] = (
            solver.choose(self.triangulation.n)
            if isinstance(solver, WithinMemory)
            else (solver, "as asked")
        )
        self._prepared: dict[int | None, _Ready] = {}  # by component; None for all
        self._errors: dict[int, tuple[int, float]] = {}  # by component: from which vertex, how much

    def __repr__(self) -> str:
        return (
            f"HeatGeodesics(n={self.triangulation.n}, time_coefficient={self._time_coefficient:g},"
            f" boundary={self._boundary!r}, solver={self._solver!r})"
        )

    def distance(self, sources: SourcesLike, *, weights: ArrayLike | None = None) -> DistanceField:
        """Measure the distance of every point to the nearest of several sources.

        Sources are what `check_sources` takes. `weights` (s,) is the heat that each emits, 1 by
        default: w lets its isolines run ahead by about ``sqrt(t) log w``.

        The field is zero on average over the sources of a component, by what the heat method says
        there (a source on a face counts by its corners); then set to zero at sources that are
        vertices, and where it is below. Infinite where no source can be reached. The minimum of the
        fields of single sources has less error than one field of several.

        An iterative solver that stops short raises `ConvergenceError`: its `partial` is the
        `DistanceField` of what it had, or the `Heat` if that was the heat step.
        """
        return self._fields([check_sources(sources, self.geometry, weights)])[0]

    def distances(self, sources: Sequence[SourcesLike]) -> list[DistanceField]:
        """Measure a distance field for each of many sources, or sets of sources.

        Bit by bit those of `distance`, but sooner where the solver is direct: several are solved
        for at once, and their seconds are an even share of what that took. All sources are checked
        first.
        """
        return self._fields([check_sources(one, self.geometry) for one in sources])

    def _fields(self, sources: Sequence[Sources]) -> list[DistanceField]:
        """Measure one field for each, a component at a time and in blocks."""
        members: dict[int | None, list[int]] = {}
        for i, one in enumerate(sources):
            members.setdefault(self._component(one), []).append(i)
        found: dict[int, DistanceField] = {}
        for component, places in members.items():
            ready = self._ready(component)
            iterative = isinstance(ready.poisson, IterativePoisson)
            for left, right in ranges(len(places), 1 if iterative else solved_together()):
                block = places[left:right]
                found |= zip(block, self._block(ready, [sources[i] for i in block]), strict=True)
        fields = [found[i] for i in range(len(sources))]
        for field in fields:
            if not self._warn_of_blur(field):
                self._warn_of_size(field)
        return fields

    def _block(self, ready: _Ready, sources: Sequence[Sources]) -> list[DistanceField]:
        """Measure the fields of sources that need the same factors, together."""
        system = ready.system
        heated = [one.right_hand_side()[system.order] for one in sources]
        heats = {size: self._heats(system, steps, heated) for size, steps in ready.steps.items()}
        flows, seconds = [], []
        for i, one in enumerate(sources):
            clock = Clock()
            at_zero = np.zeros(self.triangulation.n, dtype=bool)
            at_zero[one.vertices[one.offsets == 0]] = True
            own = {size: found[i] for size, found in heats.items()}
            flows.append(system.flow(own, at_zero[system.order]))
            seconds.append(
                {"heat": sum(heat.seconds for heat in own.values()), "directions": clock.total}
            )
        try:
            solutions = ready.poisson.solutions(flows)
        except ConvergenceError as error:  # of one alone: only iterations do not converge
            if not isinstance(error.partial, LinearSolution):
                raise
            partly = self._field(ready, sources[0], heats[0][0], seconds[0], error.partial)
            raise ConvergenceError(str(error), partial=partly) from error
        parts = zip(sources, heats[0], seconds, solutions, strict=True)
        return [self._field(ready, *one) for one in parts]

    def _field(
        self,
        ready: _Ready,
        sources: Sources,
        heat: Heat,
        seconds: Mapping[str, float],
        solution: LinearSolution,
    ) -> DistanceField:
        """Gather what was found."""
        system, poisson = ready.system, ready.poisson
        labels = self.triangulation.laplacian.component_labels
        potential = system.outwards(system.unit * solution.x)
        return DistanceField(
            distance=_from_sources(potential, sources, labels),
            sources=sources,
            time_step=float(self.time_steps[labels[sources.vertices[0]]]),
            solver=poisson.options if isinstance(poisson, IterativePoisson) else Direct(),
            reason=ready.reason,
            heat=heat.moved(system.outwards),
            poisson=replace(solution, x=potential),
            seconds={
                "triangulation": self.triangulation.seconds,
                "setup": ready.seconds,
                **seconds,
                "poisson": solution.seconds,
            },
        )

    def _warn_of_blur(self, field: DistanceField) -> bool:
        """Say so where many points are as near to a source as the heat step cannot see."""
        labels = self.triangulation.laplacian.component_labels
        blurred = int((field.distance < np.sqrt(self.time_steps)[labels]).sum())
        few = max(_BLURRED * field.reached.sum(), _NEAR * len(field.sources.vertices))
        if blurred > few:
            spacing = self.triangulation.spacings[labels[field.sources.vertices[0]]]
            warn(
                f"{blurred} of {field.reached.sum()} points are nearer to a source than the typical"
                f" edge (of {spacing:.3g}) that sets the time of the heat step, so their distances"
                " are blurred",
                DoubtfulDistanceWarning,
                advice="separate parts of very different size, or lower `time_coefficient`",
            )
        return bool(blurred > few)

    def _warn_of_size(self, field: DistanceField) -> None:
        """Say so where triangles are too large for the heat method: measured once for each part.

        On so few points that exact distances cost little, of the first parts that are asked for; on
        larger ones it does not happen, but for triangles of very different size. Other options
        change distances on purpose.
        """
        labels = self.triangulation.laplacian.component_labels
        part = int(labels[field.sources.vertices[0]])
        usual = self._time_coefficient <= 1 and self._boundary == "neumann"
        if not (usual and isinstance(self.geometry, TriangleMesh)):
            return
        if part not in self._errors:
            measured = np.isin(labels, [part, *self._errors])
            if (labels == part).sum() < 3 or measured.sum() > EXACT:
                return
            first = int(field.sources.vertices[0])
            of_part = labels[self.geometry.faces[:, 0]] == part
            piece = component_of(self.geometry, np.flatnonzero(of_part))
            some = piece.vertex_index
            exact = exact_or_none(piece.mesh, int(np.searchsorted(some, first)))
            if exact is None:
                return
            alone = check_sources(first, self.geometry)
            heat = self._block(self._ready(self._component(alone)), [alone])[0].distance
            self._errors[part] = first, _mean_error(heat[some], exact)
        first, error = self._errors[part]
        if error > _OFF:
            warn(
                f"distances from vertex {first} are off by {error:.0%} in the mean: triangles are"
                " too large beside the surface for the heat method",
                DoubtfulDistanceWarning,
                advice="take {}, or cut triangles into smaller ones",
                remedies=("exact_distances",),
            )

    def _component(self, sources: Sources) -> int | None:
        """Return the component that suffices for these sources, None for all of them."""
        labels = self.triangulation.laplacian.component_labels[sources.vertices]
        alone = isinstance(self._chosen[0], Direct) and len(np.unique(labels)) == 1
        return int(labels[0]) if alone and len(self.time_steps) > 1 else None

    def _ready(self, component: int | None) -> _Ready:
        """Return what sources on a component need: no heat comes to others."""
        if component not in self._prepared:
            self._prepared[component] = self._prepare(component)
        return self._prepared[component]

    def _prepare(self, component: int | None) -> _Ready:
        """Choose how to solve, and prepare it."""
        clock, (options, reason) = Clock(), self._chosen
        system, gigabytes = System.of(self.triangulation, component), 0.0
        if isinstance(options, Direct):
            gigabytes = (1 + len(self._kinds(system))) * system.elimination.gigabytes
            if isinstance(self._solver, WithinMemory):
                options, reason = self._solver.choose(len(system.order), gigabytes)
        if isinstance(options, Iterative):  # with modes of all points
            if None in self._prepared:
                return self._prepared[None]
            gigabytes = 0.0
            if component is not None:
                system = System.of(self.triangulation)
        elif isinstance(self._solver, WithinMemory):
            held = sum(ready.gigabytes for ready in self._prepared.values())
            for other, ready in list(self._prepared.items()):  # those asked first go first
                if held + gigabytes <= self._solver.memory:
                    break
                held -= ready.gigabytes
                if ready.gigabytes:
                    del self._prepared[other]
        steps, poisson = self._factorised(system, options)
        return _Ready(system, steps, poisson, reason, gigabytes, clock.total)

    def _factorised(
        self, system: System, options: Direct | Iterative
    ) -> tuple[dict[int, dict[Boundary, HeatStep]], GroundedCholesky | IterativePoisson]:
        """Factorise what both steps need, side by side."""
        kinds, stiffness = self._kinds(system), system.stiffness
        kernel = ConstantKernel(system.labels - system.labels.min())
        elimination = None
        second: Callable[[], GroundedCholesky | IterativePoisson]
        if isinstance(options, Direct):
            elimination = system.elimination
            second = partial(GroundedCholesky, stiffness, kernel, elimination=elimination)
        else:
            arguments = stiffness, kernel, options, self._spectrum, system.order
            second = partial(IterativePoisson, *arguments)
        first = [
            partial(
                HeatStep,
                stiffness,
                system.mass,
                system.points,
                duration=self._time_coefficient * float(COARSER) ** (2 * size),
                inside=system.inside if condition == "dirichlet" else None,
                direct=isinstance(options, Direct),
                elimination=elimination,
            )
            for size, condition in kinds
        ]
        poisson, *made = in_threads(call, [(task,) for task in (second, *first)])
        steps: dict[int, dict[Boundary, HeatStep]] = {}
        for (size, condition), step in zip(kinds, made, strict=True):
            steps.setdefault(size, {})[condition] = step
        return steps, poisson

    def _kinds(self, system: System) -> list[tuple[int, Boundary]]:
        """Return the sizes of heat steps, each with the boundary conditions that take part."""
        conditions: list[Boundary] = [self._boundary]
        if system.inside.all():
            conditions = ["neumann"]
        elif self._boundary == "average":
            conditions = ["neumann", "dirichlet"] if system.inside.any() else ["neumann"]
        elif self._boundary == "dirichlet" and not system.inside.any():
            raise _cold()
        return [(int(k), one) for k in np.union1d(0, system.sizes) for one in conditions]

    def _heats(
        self, system: System, steps: Mapping[Boundary, HeatStep], heated: Sequence[Floats]
    ) -> list[Heat]:
        """Return the heat of all steps together; a cold boundary takes what is put on it."""
        sourced = [np.unique(system.labels[one > 0]) for one in heated]
        # Heat of about 1, whatever the unit.
        heated = [one / (one / system.mass).max() for one in heated]
        found: list[list[Heat]] = [[] for _ in heated]
        for condition, step in steps.items():
            warm = [
                one if condition == "neumann" else np.where(system.inside, one, 0.0)
                for one in heated
            ]
            if self._boundary == "dirichlet":
                for labels, one in zip(sourced, warm, strict=True):
                    if len(np.setdiff1d(labels, system.labels[one > 0])):
                        raise _cold()
            some = [i for i, one in enumerate(warm) if one.any()]
            for i, heat in zip(some, step.solve([warm[i] for i in some]), strict=True):
                found[i].append(heat)
        if not all(found):
            raise _cold()
        whole = [reduce(Heat.plus, parts) for parts in found]
        for labels, heat in zip(sourced, whole, strict=True):
            cold = np.flatnonzero((heat.values == 0) & system.inside)
            if (cut := int(np.isin(system.labels[cold], labels).sum())) > 0:
                raise InvalidInputError(
                    "boundary",
                    "be 'neumann' or 'average' here",
                    f"'dirichlet', which cuts {cut} points off from the sources, as at a strip one"
                    " triangle wide",
                )
        return whole


def solved_together() -> int:
    """Return how many sources a direct solver solves for at once: some for each thread."""
    return _TOGETHER * thread_count()


def _from_sources(potential: Floats, sources: Sources, labels: Ints) -> Floats:
    """Shift a potential to zero at the sources of each component."""
    at = labels[sources.vertices]
    most = np.zeros(labels.max() + 1)
    np.maximum.at(most, at, sources.heat)
    share = sources.heat / most[at]
    heat = np.bincount(at, share, minlength=len(most))
    ahead = share * (potential[sources.vertices] - sources.offsets)
    level = np.full(len(heat), -np.inf)  # nothing reached is infinitely far
    level[heat > 0] = np.bincount(at, ahead, minlength=len(heat))[heat > 0] / heat[heat > 0]
    distance: Floats = np.maximum(potential - level[labels], 0.0)
    distance[sources.vertices[sources.offsets == 0]] = 0.0
    return distance


def _mean_error(heat: Floats, exact: Floats) -> float:
    """Return the mean relative error over points that are reached, sources aside."""
    there = np.isfinite(exact) & (exact > 0)
    truth = exact[there]
    return float(np.mean(np.abs(heat[there] - truth) / truth)) if len(truth) else 0.0


def _cold() -> InvalidInputError:
    return InvalidInputError(
        "sources",
        "not all lie on the boundary of their component, which boundary='dirichlet' keeps cold",
        advice="use 'neumann' or 'average'",
    )
