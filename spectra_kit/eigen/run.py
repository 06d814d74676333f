"""One call of `eigensolve`: the only caller of a backend, and where its answer is checked."""

from __future__ import annotations

import hashlib
import math
import time
import traceback
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from spectra_kit._core.types import Ints
from spectra_kit._core.validate import quantity
from spectra_kit._core.version import VERSION
from spectra_kit._sparse.orthonormal import RankError
from spectra_kit.eigen.accuracy import (
    counted_errors,
    with_bounds,
    with_excess,
)
from spectra_kit.eigen.answers import (
    NEGATIVE,
    ascending,
    component_indices,
    modes_wanted,
    none,
    of_checked_form,
    open_modes,
    with_exact_constant,
)
from spectra_kit.eigen.automatic import Automatic
from spectra_kit.eigen.base import Eigenpairs, Eigensolver, NotConvergedError
from spectra_kit.eigen.certificate import Certificate, Provenance
from spectra_kit.eigen.counting import count_modes, verify
from spectra_kit.eigen.dense import SPREAD, Dense
from spectra_kit.eigen.refined import Refined
from spectra_kit.eigen.small_parts import are_quick, small_components
from spectra_kit.eigen.spectrum import Spectrum, certificate_of
from spectra_kit.eigen.subspaces.base import GivenBasis, RandomBasis, Union, restricted
from spectra_kit.errors import (
    ConvergenceError,
    InvalidInputError,
    InvalidSpectrumError,
    OutOfMemoryError,
)
from spectra_kit.operators.laplacian import Laplacian

_ORTHONORMAL = 1e-6  # a spectrum further from M-orthonormal is refused
_ROUNDS = 8  # counts, with a search for what is missing between them; two are enough as a rule
_BEST = 1e-13  # relative residuals not to ask for less than
_ORDINARY = 30  # powers of two from one within which sizes and energies need no other unit
_NEAR = 10  # modes that complete an exact spectrum may have residuals so many times those it has


class Units(NamedTuple):
    """A length and an energy as powers of two: no digit changes with them."""

    length: int
    energy: int

    @classmethod
    def of(cls, laplacian: Laplacian) -> Units:
        """Return those of an operator; zeros where it is of ordinary size, within 1e9 of one."""
        d = laplacian.dimension
        length = round(float(np.log2(laplacian.mass.max()) + np.log2(laplacian.n)) / d)
        typical = float(np.median(laplacian.stiffness.diagonal()))  # needles may be far above it
        # Beyond what L grows with the length: not at all on a surface, as it does in a volume.
        energy = round(np.log2(typical)) - (d - 2) * length if typical > 0 else 0
        return cls(*(0 if abs(power) <= _ORDINARY else power for power in (length, energy)))

    def taken_from(self, laplacian: Laplacian) -> Laplacian:
        """Return the operator measured in these units."""
        L, M, d = laplacian.stiffness, laplacian.consistent_mass, laplacian.dimension
        data = np.ldexp(L.data, -self.energy - (d - 2) * self.length)
        return replace(
            laplacian,
            stiffness=sparse.csr_array((data, L.indices, L.indptr), shape=L.shape),
            mass=np.ldexp(laplacian.mass, -d * self.length),
            consistent_mass=None if M is None else M * 2.0 ** (-d * self.length),
            points=np.ldexp(laplacian.points, -self.length),
        )


def is_whole(laplacian: Laplacian) -> bool:
    """Whether this is solved as it is: lumped, one component, all of it free, of ordinary size."""
    if laplacian.consistent_mass is not None:
        return False
    return laplacian.n_components == 1 and not len(laplacian.fixed) and not any(Units.of(laplacian))


def solve(
    laplacian: Laplacian,
    k: int,
    solver: Eigensolver,
    begun: Callable[[], Eigenpairs] | None = None,
) -> Spectrum:
    """Solve and certify; what warns is left to the caller.

    Of a whole operator (`is_whole`) a function may be `begun` that does what is left to do.
    """
    if any(units := Units.of(laplacian)):
        return _in_units(units, laplacian, k, solver)
    try:
        return _Run(laplacian, k, solver, begun).solved()
    finally:
        laplacian._forget()


def _in_units(units: Units, laplacian: Laplacian, k: int, solver: Eigensolver) -> Spectrum:
    """Solve in units of the shape's own: beyond 1e9 and below 1e-9, squares leave float32."""

    def given(found: Spectrum) -> Spectrum:
        provenance = replace(found.provenance, input_hash=_fingerprint(laplacian))
        spectrum = found._rescaled(2.0**units.length, 2.0**units.energy)
        return spectrum.described(spectrum.certificate, provenance)

    try:
        return given(solve(units.taken_from(laplacian), k, solver))
    except (ConvergenceError, OutOfMemoryError) as error:
        error.partial = error.partial and given(error.partial)
        raise


class Chosen(NamedTuple):
    """What solved a component, where a solver chose it."""

    solver: Eigensolver
    reason: str
    n: int  #: Points of the component.


@dataclass
class _Run:
    """One call of `eigensolve`: what is asked for, and what was found so far."""

    laplacian: Laplacian
    k: int
    solver: Eigensolver
    begun: Callable[[], Eigenpairs] | None = None  # in place of the solver, of a whole operator
    start: float = field(default_factory=time.perf_counter)
    parts: list[Ints] = field(default_factory=list)  # the points of each component
    pieces: dict[int, Laplacian] = field(default_factory=dict)  # of those solved by themselves
    chosen: dict[int, Chosen] = field(default_factory=dict)  # by component, where a solver chose
    found: dict[int, Eigenpairs] = field(default_factory=dict)  # by component
    stages: dict[str, float] = field(default_factory=dict)  # wall times, over the components
    iterations: int | None = None

    def __post_init__(self) -> None:
        self.name = repr(self.solver)  # before the work: what can't be told must not cost it

    def solved(self) -> Spectrum:
        """Solve, certify, and complete what is to be exact."""
        _ = self.laplacian._least_weight  # refused where M is not positive definite
        try:
            pairs = self.components(self.k, self.solver)
        except NotConvergedError as error:
            partial = self.rescued()
            n_converged = 0 if partial is None else partial.k - open_modes(error, partial)
            raise ConvergenceError(
                f"{self.name}: {error}", partial=partial, n_converged=n_converged, **error.advised
            ) from error
        except MemoryError as error:
            traceback.clear_frames(error.__traceback__)  # its arrays make room for what is rescued
            try:
                partial = self.rescued()
            except MemoryError:
                partial = None
            raise OutOfMemoryError(
                f"{self.name}: {self.k} modes on {self.laplacian.n} points do not fit into memory"
                f" ({error})",
                advice="ask for fewer, sample fewer points, or take a backend that needs less, such"
                " as Cascade()",
                partial=partial,
            ) from error
        spectrum, certificate = self.certified(pairs)
        if self.promise in ("exact", "to tolerance"):
            return self.completed(spectrum, certificate)
        return self.packed(spectrum, with_bounds(certificate, spectrum, self.laplacian))

    def completed(self, spectrum: Spectrum, certificate: Certificate) -> Spectrum:
        """Count the eigenvalues, and go on from what was found until none is missing.

        Lanczos from one vector and blocks from a start that lacks something converge to true modes
        and may pass over others: copies of an eigenvalue, odd modes of a start that is even.
        """
        laplacian, k, added, why = self.laplacian, self.k, 0, "use another solver"
        for seed in range(_ROUNDS):
            begin = time.perf_counter()
            count = count_modes(spectrum, certificate, laplacian, self.blocks())
            count = replace(count, added=added)
            self.book("count", time.perf_counter() - begin)
            certificate = replace(certificate, count=count)
            if not count.missing:
                bounded = with_bounds(certificate, spectrum, laplacian)
                return self.packed(spectrum, self.estimated(bounded, spectrum))
            counted = self.packed(spectrum, certificate)
            room = _NEAR if self.promise == "exact" else 1
            rtol = float(room * certificate.relative_residuals.max())
            basis = Union(
                GivenBasis(spectrum.eigenvectors), RandomBasis(m=count.missing, seed=seed)
            )
            refined = Refined(start=basis, rtol=min(max(rtol, _BEST), 0.1), seed=seed)
            # More than wanted: what is missing may first come up just above the last one found.
            wider = min(k + 2 * count.missing, len(laplacian.free))
            try:
                pairs = self.components(wider, refined)
            except (NotConvergedError, MemoryError, InvalidInputError, InvalidSpectrumError) as e:
                why = str(e) or "out of memory"
                # The last of them may cut a cluster: enough if those wanted have converged.
                good = getattr(e, "converged", None)
                if good is not None and len(self.parts) == 1 and good[:k].all():
                    pairs = self.merged(k)
                elif counted.provenance.name != "dense" and max(map(len, self.parts)) <= Dense.few:
                    pairs = self.densely(k, f"{added or count.missing} passed over, and {why}")
                else:
                    break
            added = max(added, count.missing)
            lowest = Eigenpairs(pairs.eigenvalues[:k], pairs.eigenvectors[:, :k])
            spectrum, certificate = self.certified(lowest)
        raise ConvergenceError(
            f"{self.name}: at least {quantity(min(count.missing, k), 'mode')} of the lowest {k}"
            f" were passed over ({count.reason}), and could not be found: {why}",
            partial=verify(counted, laplacian),
            n_converged=k,
        )

    def estimated(self, certificate: Certificate, spectrum: Spectrum) -> Certificate:
        """Hold estimates against counts, where the residuals are too large for a count of all."""
        if certificate.n_verified or certificate.errors is None or len(self.parts) > 1:
            return certificate
        unit = np.maximum(spectrum.eigenvalues, self.laplacian.eigenvalue_spacing)
        errors = counted_errors(self.laplacian, spectrum.eigenvalues, certificate.errors * unit)
        return replace(certificate, errors=errors / unit)

    def densely(self, k: int, why: str) -> Eigenpairs:
        """Solve small components by LAPACK, where all else gave up."""
        dense = Dense()
        pairs = self.components(k, dense)
        self.chosen = {i: Chosen(dense, why, len(part)) for i, part in enumerate(self.parts)}
        return pairs

    def components(self, k: int, solver: Eigensolver) -> Eigenpairs:
        """Solve each component, merge the k lowest pairs of all, eigenvectors padded with zeros."""
        laplacian = self.laplacian
        whole = laplacian.n_components == 1 and not len(laplacian.fixed)
        parts = self.parts = [laplacian.free] if whole else component_indices(laplacian)
        areas = np.array([laplacian.mass[part].sum() for part in parts])
        # Columns of all parts may have few on one, and need the others.
        given = getattr(solver, "subspace", None) or getattr(solver, "start", None)
        most = [k]
        at_once = isinstance(solver, Automatic | Dense) and not whole
        if not whole:
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
            if isinstance(solver, Automatic | Dense) and at_once:
                # At the cost of some modes these have all: nobody asks for more of them.
                solved = self.together(due, most, solver)
                alone -= solved
                wanted = [most[i] if i in solved else own for i, own in enumerate(wanted)]
            for i in sorted(alone):
                part = laplacian if whole else self.piece(i)
                own = solver if whole else restricted(solver, parts[i])
                try:
                    self.keep(i, self.connected(part, wanted[i], own))
                except NotConvergedError as error:
                    if error.pairs is not None:
                        self.keep(i, error.pairs)
                    raise
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
        merged = self.found[0] if whole else self.merged(k)
        self.found.clear()  # gigabytes, while the merged ones are certified
        return merged

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

    def piece(self, i: int) -> Laplacian:
        """Return the operator on a component."""
        if i not in self.pieces:
            self.pieces[i] = self.laplacian.restricted(self.parts[i])
        return self.pieces[i]

    def blocks(self) -> list[Laplacian]:
        """Return the operators on the components solved by themselves, and on all the others."""
        rest = [part for i, part in enumerate(self.parts) if i not in self.pieces]
        if not self.pieces or not rest:
            return [*self.pieces.values()]
        return [*self.pieces.values(), self.laplacian.restricted(np.sort(np.concatenate(rest)))]

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
        vectors = np.zeros((n, len(lowest)))
        for j, source in enumerate(lowest):
            part = owner[source]
            vectors[parts[part], j] = pairs[part].eigenvectors[:, column[source]]
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

    def rescued(self) -> Spectrum | None:
        """Certify what was solved before a failure, if anything was."""
        pairs = self.merged(self.k)
        return self.packed(*self.certified(pairs)) if len(pairs.eigenvalues) else None

    def certified(self, pairs: Eigenpairs) -> tuple[Spectrum, Certificate]:
        """Check `pairs`, and return what is known of them."""
        begin, laplacian = time.perf_counter(), self.laplacian
        pairs = ascending(pairs)
        spectrum = Spectrum(
            pairs.eigenvalues,
            pairs.eigenvectors,
            laplacian._weights,
            dimension=laplacian.dimension,
        )
        certificate = certificate_of(spectrum, laplacian)
        if (error := certificate.orthonormality_error) > _ORTHONORMAL:
            raise InvalidSpectrumError(
                f"{self.name} returned modes that are not M-orthonormal: |U^T M U - I| is"
                f" {error:.2e}"
            )
        certificate = with_excess(replace(certificate, errors=pairs.errors), spectrum, laplacian)
        self.book("certify", time.perf_counter() - begin)
        return spectrum, certificate

    def packed(self, spectrum: Spectrum, certificate: Certificate) -> Spectrum:
        """Return the spectrum with what is known of it, and where it comes from."""
        solver, reason = self.solver_of_most()
        fingerprint = _fingerprint(self.laplacian)
        other = time.perf_counter() - self.start - sum(self.stages.values())
        provenance = Provenance(
            solver=self.name if solver is self.solver else repr(solver),
            operator=self.laplacian.operator,
            seed=None if (seed := getattr(solver, "seed", None)) is None else int(seed),
            seconds={
                "assembly": self.laplacian.seconds,
                **self.stages,
                "other": max(other, 0.0),  # what is in none of them
            },
            input_hash=fingerprint,
            version=VERSION,
            iterations=self.iterations,
            accuracy=self.promise,
            name=_name_of(solver),
            reason=reason,
        )
        return spectrum.described(certificate, provenance)

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
        names = Counter(_name_of(one.solver) for one in self.chosen.values())
        others = [f"{m} by {name}" for name, m in names.items() if name != _name_of(solver)]
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


def promise_of(solver: Eigensolver) -> str:
    """Return what a solver goes on for; nothing where it does not say."""
    return str(getattr(solver, "promise", ""))


def _name_of(solver: Eigensolver) -> str:
    return str(getattr(solver, "name", type(solver).__name__.lower()))


def _fingerprint(laplacian: Laplacian) -> str:
    """Return a hash of all that defines the eigenproblem."""
    digest = hashlib.blake2b(digest_size=16)
    L = laplacian.stiffness
    M = laplacian.consistent_mass
    patterns = [L.indptr, L.indices, laplacian.fixed]
    numbers = [L.data, laplacian.mass, laplacian.points]
    if M is not None:
        patterns, numbers = [*patterns, M.indptr, M.indices], [*numbers, M.data]
    for integers in patterns:  # whatever width scipy chose for them
        digest.update(np.ascontiguousarray(integers, dtype=np.int64).data)
    for floats in numbers:
        digest.update(np.ascontiguousarray(floats).data)
    if laplacian.dimension != 2:
        digest.update(bytes([laplacian.dimension]))
    return digest.hexdigest()
