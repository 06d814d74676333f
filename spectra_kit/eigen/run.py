"""One call of `eigensolve`: the only caller of a backend, and where its answer is checked."""

from __future__ import annotations

import hashlib
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy import sparse

from spectra_kit._core.validate import quantity
from spectra_kit._core.version import VERSION
from spectra_kit.eigen.accuracy import counted_errors, with_bounds, with_excess
from spectra_kit.eigen.answers import ascending, open_modes
from spectra_kit.eigen.automatic import Automatic
from spectra_kit.eigen.base import Eigenpairs, Eigensolver, NotConvergedError
from spectra_kit.eigen.certificate import Certificate, Provenance
from spectra_kit.eigen.components import Components, name_of
from spectra_kit.eigen.counting import count_modes, verify
from spectra_kit.eigen.dense import Dense
from spectra_kit.eigen.lanczos import Lanczos
from spectra_kit.eigen.refined import Refined
from spectra_kit.eigen.spectrum import Spectrum, certificate_of
from spectra_kit.eigen.subspaces.base import GivenBasis, RandomBasis, Union
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
        held = np.sort(laplacian.stiffness.diagonal())
        typical = float(held[laplacian.n // 2])  # needles may be far above it
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
    lumped = laplacian.consistent_mass is None
    return lumped and laplacian._in_one_piece and not any(Units.of(laplacian))


def solve(
    laplacian: Laplacian,
    k: int,
    solver: Eigensolver,
    begun: Callable[[], Eigenpairs] | None = None,
) -> Spectrum:
    """Solve and certify; what warns is left to the caller.

    Of a whole operator (`is_whole`) a function may be `begun` that does what is left to do.
    """
    if begun is None and any(units := Units.of(laplacian)):
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


@dataclass
class _Run:
    """One call of `eigensolve`: what is asked for, and what was found so far."""

    laplacian: Laplacian
    k: int
    solver: Eigensolver
    begun: Callable[[], Eigenpairs] | None = None  # in place of the solver, of a whole operator
    start: float = field(default_factory=time.perf_counter)

    def __post_init__(self) -> None:
        self.name = repr(self.solver)  # before the work: what can't be told must not cost it
        self.components = Components(self.laplacian, self.solver, self.begun)

    def solved(self) -> Spectrum:
        """Solve, certify, and complete what is to be exact."""
        _ = self.laplacian._least_weight  # refused where M is not positive definite
        try:
            pairs = self.components.solved(self.k, self.solver)
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
        try:
            spectrum, certificate = self.certified(pairs)
        except InvalidSpectrumError as error:  # blocks may lose themselves in many equal modes
            few = max(map(len, self.components.parts)) <= Dense.few
            if not (few and isinstance(self.solver, Automatic | Lanczos)):
                raise
            spectrum, certificate = self.certified(self.components.densely(self.k, str(error)))
        if self.components.promise in ("exact", "to tolerance"):
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
            count = count_modes(spectrum, certificate, laplacian, self.components.blocks())
            count = replace(count, added=added)
            self.components.book("count", time.perf_counter() - begin)
            certificate = replace(certificate, count=count)
            if not count.missing:
                bounded = with_bounds(certificate, spectrum, laplacian)
                return self.packed(spectrum, self.estimated(bounded, spectrum))
            counted = self.packed(spectrum, certificate)
            room = _NEAR if self.components.promise == "exact" else 1
            rtol = float(room * certificate.relative_residuals.max())
            basis = Union(
                GivenBasis(spectrum.eigenvectors), RandomBasis(m=count.missing, seed=seed)
            )
            refined = Refined(start=basis, rtol=min(max(rtol, _BEST), 0.1), seed=seed)
            # More than wanted: what is missing may first come up just above the last one found.
            wider = min(k + 2 * count.missing, len(laplacian.free))
            try:
                pairs = self.components.solved(wider, refined)
            except (NotConvergedError, MemoryError, InvalidInputError, InvalidSpectrumError) as e:
                why = str(e) or "out of memory"
                # The last of them may cut a cluster: enough if those wanted have converged.
                good = getattr(e, "converged", None)
                if good is not None and len(self.components.parts) == 1 and good[:k].all():
                    pairs = self.components.merged(k)
                elif (
                    counted.provenance.name != "dense"
                    and max(map(len, self.components.parts)) <= Dense.few
                ):
                    pairs = self.components.densely(
                        k, f"{added or count.missing} passed over, and {why}"
                    )
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
        if certificate.n_verified or certificate.errors is None or len(self.components.parts) > 1:
            return certificate
        unit = np.maximum(spectrum.eigenvalues, self.laplacian.eigenvalue_spacing)
        errors = counted_errors(self.laplacian, spectrum.eigenvalues, certificate.errors * unit)
        return replace(certificate, errors=errors / unit)

    def rescued(self) -> Spectrum | None:
        """Certify what was solved before a failure, if anything was."""
        pairs = self.components.merged(self.k)
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
        certificate = certificate_of(spectrum, laplacian, pairs.errors)
        if (error := certificate.orthonormality_error) > _ORTHONORMAL:
            raise InvalidSpectrumError(
                f"{self.name} returned modes that are not M-orthonormal: |U^T M U - I| is"
                f" {error:.2e}"
            )
        certificate = with_excess(certificate, spectrum, laplacian)
        self.components.book("certify", time.perf_counter() - begin)
        return spectrum, certificate

    def packed(self, spectrum: Spectrum, certificate: Certificate) -> Spectrum:
        """Return the spectrum with what is known of it, and where it comes from."""
        solver, reason = self.components.solver_of_most()
        fingerprint = _fingerprint(self.laplacian)
        other = time.perf_counter() - self.start - sum(self.components.stages.values())
        provenance = Provenance(
            solver=self.name if solver is self.solver else repr(solver),
            operator=self.laplacian.operator,
            seed=None if (seed := getattr(solver, "seed", None)) is None else int(seed),
            seconds={
                "assembly": self.laplacian.seconds,
                **self.components.stages,
                "other": max(other, 0.0),  # what is in none of them
            },
            input_hash=fingerprint,
            version=VERSION,
            iterations=self.components.iterations,
            accuracy=self.components.promise,
            name=name_of(solver),
            reason=reason,
        )
        return spectrum.described(certificate, provenance)


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
