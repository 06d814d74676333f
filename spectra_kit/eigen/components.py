"""The components of an operator: each solved by itself, small ones together, and merged."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable
from contextvars import copy_context
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from spectra_kit._core.threads import in_threads, single_threaded
from spectra_kit._core.types import Ints
from spectra_kit._core.validate import quantity
from spectra_kit._sparse.orthonormal import RankError
from spectra_kit.eigen.answers import (
    NEGATIVE,
    ascending,
    component_indices,
    modes_wanted,
    none,
    of_checked_form,
    with_exact_constant,
)
from spectra_kit.eigen.automatic import Automatic
from spectra_kit.eigen.base import Eigenpairs, Eigensolver, NotConvergedError
from spectra_kit.eigen.dense import SPREAD, Dense
from spectra_kit.eigen.lanczos import Lanczos
from spectra_kit.eigen.small_parts import are_quick, small_components
from spectra_kit.eigen.subspaces.base import restricted
from spectra_kit.errors import InvalidInputError, InvalidSpectrumError
from spectra_kit.operators.laplacian import Laplacian

_BESIDE = 2**14  # points: larger components are worth all threads, one after the other


class Chosen(NamedTuple):
    """What solved a component, where a solver chose it."""

    solver: Eigensolver
    reason: str
    n: int  #: Points of the component.


@dataclass
class Components:
    """What is found of each component, by whom, and what it took."""

    laplacian: Laplacian
    solver: Eigensolver  # that is asked for
    begun: Callable[[], Eigenpairs] | None = None  # in its place, of a whole operator
    parts: list[Ints] = field(default_factory=list)  # the points of each component
    pieces: dict[int, Laplacian] = field(default_factory=dict)  # of those solved by themselves
    chosen: dict[int, Chosen] = field(default_factory=dict)  # by component, where a solver chose
    found: dict[int, Eigenpairs] = field(default_factory=dict)  # by component
    stages: dict[str, float] = field(default_factory=dict)  # wall times, over the components
    iterations: int | None = None

    def solved(self, k: int, solver: Eigensolver) -> Eigenpairs:
        """Solve each component, merge the k lowest pairs of all, eigenvectors padded with zeros."""
        laplacian = self.laplacian
        if laplacian._in_one_piece:
            self.parts = [laplacian.free]
            self.alone(0, laplacian, k, solver)
            return self.found.pop(0)
        parts = self.parts = component_indices(laplacian)
        areas = np.array([laplacian.mass[part].sum() for part in parts])
        # Columns of all parts may have few on one, and need the others.
        given = getattr(solver, "subspace", None) or getattr(solver, "start", None)
        at_once = isinstance(solver, Automatic | Dense)
        every = given is not None or (at_once and are_quick(parts))
        most = modes_wanted(laplacian, parts, k, all_parts=every).tolist()
        # Weyl: a component's share of the low modes is about its share of the area.
        wanted = [
            min(room, math.ceil(1.1 * k * share) + 6)
            for room, share in zip(most, areas / areas.sum(), strict=True)
        ]
        due = [i for i, room in enumerate(most) if room]
        lacking: RankError | None = None
        while due:
            alone = set(due)
            if isinstance(solver, Automatic | Dense):
                # At the cost of some modes these have all: nobody asks for more of them.
                solved = self.together(due, most, solver)
                alone -= solved
                wanted = [most[i] if i in solved else own for i, own in enumerate(wanted)]
            alone -= self.side_by_side(sorted(alone), wanted, solver)
            for i in sorted(alone):
                part, own = self.piece(i), restricted(solver, parts[i])
                try:
                    self.alone(i, part, wanted[i], own)
                except RankError as error:
                    if len(parts) == 1 or given is None or promise_of(solver) != "approximate":
                        raise
                    lacking, most[i] = error, min(error.rank, wanted[i] - 1)
                    wanted[i] = most[i]
                    self.found[i] = self.connected(part, wanted[i], own)
            values = {i: pairs.eigenvalues for i, pairs in self.found.items()}
            cut = np.sort(np.concatenate([*values.values()]))[k - 1 : k]
            # A component whose last mode is below the cut may hold more below it: ask for more.
            due = [
                i
                for i, own_values in values.items()
                if wanted[i] < most[i] and (not len(cut) or own_values.max() < cut[0])
            ]
            for i in due:
                wanted[i] = min(most[i], 2 * wanted[i])
        if lacking is not None and not len(cut):
            raise InvalidInputError(
                f"the basis of {solver!r} must span at least k = {k} dimensions on all"
                f" {quantity(len(parts), 'component')} together, got"
                f" {sum(map(len, values.values()))}",
                advice="ask for fewer modes or use a larger basis",
            ) from lacking
        merged = self.merged(k)
        self.found.clear()  # gigabytes, while the merged ones are certified
        return merged

    def densely(self, k: int, why: str) -> Eigenpairs:
        """Solve small components by LAPACK, where all else gave up."""
        dense = Dense()
        pairs = self.solved(k, dense)
        self.chosen = {i: Chosen(dense, why, len(part)) for i, part in enumerate(self.parts)}
        return pairs

    def together(self, due: list[int], wanted: list[int], solver: Automatic | Dense) -> set[int]:
        """Solve the small components among those due, all of one size at once; return which.

        Not those where rounding, which is relative to the largest eigenvalue, tells in the lowest,
        nor those that have negative ones: what refuses them does so one by one.
        """
        laplacian, begin, solved = self.laplacian, time.perf_counter(), set[int]()
        if laplacian.consistent_mass is not None:
            return solved
        few = solver.max_points if isinstance(solver, Dense) else laplacian.n
        for alike in small_components(laplacian, [self.parts[i] for i in due], few):
            n = alike.points.shape[1]
            norms, second = alike.norms, laplacian.constant_components[alike.which] & (n > 1)
            values, vectors = alike.eigenpairs(laplacian)
            lowest = np.where(second, values[:, min(1, n - 1)], values[:, 0])
            unit = np.minimum(lowest, laplacian.component_spacings[alike.which])
            for j in np.flatnonzero(norms <= SPREAD * unit):
                i = int(alike.which[j])
                k = wanted[i]
                told: dict[str, Any] = {"errors": np.zeros(1)} if n == 1 else {}
                if isinstance(solver, Automatic):
                    chosen, reason = solver.choose(n, k, laplacian.dimension)
                    if promise_of(chosen) != "exact":
                        continue
                    told = told or {"solver": Dense(), "reason": reason}
                own = np.maximum(values[j, :k], 0.0), vectors[j, :, :k].copy()
                self.keep(i, Eigenpairs(*own, **told))
                solved.add(i)
        self.book("dense", time.perf_counter() - begin)
        return solved

    def side_by_side(self, due: list[int], wanted: list[int], solver: Eigensolver) -> set[int]:
        """Solve the components of few points among those due, a thread each; return which.

        By what works on the host in loops that release the interpreter lock; behind SciPy's own
        lock, which ARPACK waits for, there is nothing to gain, and what users made stays with the
        caller. What one component fails of does not cost what others found.
        """
        hosted = type(solver) in (Lanczos, Automatic) and device_of(solver) == "cpu"
        few = [i for i in due if len(self.parts[i]) <= _BESIDE] if hosted else []
        if len(few) < 2:
            return set()

        def one(i: int) -> tuple[Components, NotConvergedError | MemoryError | None]:
            own = replace(self, pieces={}, chosen={}, found={}, stages={}, iterations=None)
            with single_threaded():
                try:
                    own.alone(i, own.piece(i), wanted[i], solver)
                except (NotConvergedError, MemoryError) as error:
                    return own, error
            return own, None

        begin, stages = time.perf_counter(), Counter[str]()
        largest_first = sorted(few, key=lambda i: -len(self.parts[i]))
        solved = in_threads(
            lambda i, here: here.run(one, i), ((i, copy_context()) for i in largest_first)
        )
        for own, _ in solved:
            self.pieces |= own.pieces
            self.chosen |= own.chosen
            self.found |= own.found
            stages.update(own.stages)
            if own.iterations is not None:
                self.iterations = (self.iterations or 0) + own.iterations
        share = (time.perf_counter() - begin) / max(sum(stages.values()), 1e-9)
        for stage, seconds in stages.items():  # of several threads: what each takes of the wait
            self.book(stage, min(share, 1.0) * seconds)
        for _, error in solved:
            if error is not None:
                raise error
        return set(few)

    def piece(self, i: int) -> Laplacian:
        """Return the operator on a component."""
        if i not in self.pieces:
            self.pieces[i] = self.laplacian._component(i, self.parts[i])
        return self.pieces[i]

    def blocks(self) -> list[Laplacian]:
        """Return the operators on the components solved by themselves, and on all the others."""
        rest = [part for i, part in enumerate(self.parts) if i not in self.pieces]
        if not self.pieces or not rest:
            return [*self.pieces.values()]
        return [*self.pieces.values(), self.laplacian.restricted(np.sort(np.concatenate(rest)))]

    def alone(self, i: int, part: Laplacian, k: int, solver: Eigensolver) -> None:
        """Solve a component by itself, and keep what is found, of a solver that gives up, too."""
        try:
            self.keep(i, self.connected(part, k, solver))
        except NotConvergedError as error:
            if error.pairs is not None:
                self.keep(i, error.pairs)
            raise

    def keep(self, i: int, pairs: Eigenpairs) -> None:
        """Remember what was found of a component, and what was chosen for it."""
        self.found[i] = pairs
        if pairs.solver is not None:
            self.chosen[i] = Chosen(pairs.solver, pairs.reason, len(self.parts[i]))

    def connected(self, laplacian: Laplacian, k: int, solver: Eigensolver) -> Eigenpairs:
        """Call the backend on one component, check the form of its answer, and sort it."""
        start = time.perf_counter()
        if k == 0:
            return none(laplacian.n)
        if laplacian.n == 1:  # an isolated point: nothing to solve
            M = laplacian.consistent_mass
            mass = laplacian.mass if M is None else M.diagonal()
            value, vector = laplacian.stiffness.diagonal() / mass, 1 / np.sqrt(mass)[:, None]
            return Eigenpairs(value, vector, errors=np.zeros(1))
        try:
            if self.begun is not None and solver is self.solver:
                pairs = self.begun()
            else:
                pairs = Eigenpairs(*solver.eigenpairs(laplacian, k))
        except NotConvergedError as error:
            self.count(error.pairs or none(laplacian.n), time.perf_counter() - start)
            raise
        pairs = of_checked_form(pairs, solver, (laplacian.n, k))
        self.count(pairs, time.perf_counter() - start)
        lowest = pairs.eigenvalues.min()
        if lowest < -NEGATIVE * laplacian.eigenvalue_spacing and lowest < -laplacian._rounding:
            raise InvalidSpectrumError(
                f"{solver!r} returned a negative eigenvalue ({pairs.eigenvalues.min():.3e})",
                advice="is the stiffness positive semi-definite? (Where entries spread over many"
                " decades, so does rounding.)",
            )
        return ascending(with_exact_constant(laplacian, ascending(pairs)))

    def merged(self, k: int) -> Eigenpairs:
        """Return the k lowest pairs (or all there are) of the components solved, on all points."""
        n, found = self.laplacian.n, sorted(self.found)  # of equal modes, those of the first
        pairs, parts = [self.found[i] for i in found], [self.parts[i] for i in found]
        if not pairs:
            return none(n)
        values = np.concatenate([p.eigenvalues for p in pairs])
        owner = np.repeat(np.arange(len(pairs)), [len(p.eigenvalues) for p in pairs])
        column = np.concatenate([np.arange(len(p.eigenvalues)) for p in pairs])
        lowest = np.lexsort((column, values))[:k]  # where values are equal, constants come first
        vectors, owner = np.zeros((n, len(lowest))), owner[lowest]
        for part in np.unique(owner):
            places = np.flatnonzero(owner == part)
            own = pairs[part].eigenvectors[:, column[lowest[places]]]
            vectors[parts[part][:, None], places] = own
        told = [p.errors for p in pairs]
        if self.promise == "approximate":  # beside such components, those chosen to be exact
            told = [
                np.zeros(len(p.eigenvalues))
                if own is None and p.solver is not None and promise_of(p.solver) != "approximate"
                else own
                for p, own in zip(pairs, told, strict=True)
            ]
        known = [own for own in told if own is not None]
        errors = np.concatenate(known)[lowest] if len(known) == len(pairs) else None
        return Eigenpairs(values[lowest], vectors, errors=errors)

    @property
    def promise(self) -> str:
        """What holds of all components."""
        promises = {promise_of(one.solver) for one in self.chosen.values()}
        weakest = [p for p in ("approximate", "to tolerance", "exact") if p in promises]
        return weakest[0] if weakest else promise_of(self.solver)

    def solver_of_most(self) -> tuple[Eigensolver, str]:
        """Return what solved the largest component, and why it was chosen."""
        if not self.chosen:
            return self.solver, ""
        solver, reason, _ = max(self.chosen.values(), key=lambda one: one.n)
        names = Counter(name_of(one.solver) for one in self.chosen.values())
        others = [f"{m} by {name}" for name, m in names.items() if name != name_of(solver)]
        if others:
            told = f"of {len(self.chosen)} components, {' and '.join(others)}"
            reason = f"{reason}; {told}" if reason else told
        return solver, reason

    def book(self, stage: str, seconds: float) -> None:
        """Add wall time to a stage."""
        self.stages[stage] = self.stages.get(stage, 0.0) + seconds

    def count(self, pairs: Eigenpairs, seconds: float) -> None:
        """Count one component, which took so many `seconds` where its solver does not say."""
        for stage, spent in (pairs.seconds or {"solve": seconds}).items():
            self.book(stage, spent)
        if pairs.iterations is not None:
            self.iterations = (self.iterations or 0) + pairs.iterations


def device_of(solver: Eigensolver) -> str:
    """Return where a solver works."""
    return str(getattr(solver, "device", "cpu"))


def promise_of(solver: Eigensolver) -> str:
    """Return what a solver goes on for; nothing where it does not say."""
    return str(getattr(solver, "promise", ""))


def name_of(solver: Eigensolver) -> str:
    """Return what a solver calls itself."""
    return str(getattr(solver, "name", type(solver).__name__.lower()))
