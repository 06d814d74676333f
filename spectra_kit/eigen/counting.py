"""Prove that no mode was missed, by counting the eigenvalues below a shift."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from spectra_kit._core.checked import checked
from spectra_kit._core.clock import Clock
from spectra_kit._core.types import Floats
from spectra_kit._sparse.pencil import Pencil
from spectra_kit.eigen.accuracy import with_bounds, with_excess
from spectra_kit.eigen.certificate import Certificate, ModeCount
from spectra_kit.eigen.spectrum import Spectrum, certificate_of
from spectra_kit.operators.laplacian import Laplacian

_EPS = float(np.finfo(np.float64).eps)
# How far from a mode to put a shift, in units of the eigenvalue or the spacing, whatever is less:
# as close as the rounding of the factor allows, for what is missing may be close as well.
_ABOVE = (1e-3, 1e-2, 1e-1)
_APART = 1e-2  # modes whose radius exceeds this many spacings need a wider gap above them
_INSIDE = 0.1  # that gap must be wider than the radius by 1 / this
_ZERO = 1e-6  # in spacings: modes that are as good as zero
_CLUSTER = 1e-2  # modes within this share of them are as good as one eigenvalue, which k may cut


@checked
def verify(spectrum: Spectrum, laplacian: Laplacian) -> Spectrum:
    """Return `spectrum` with a certificate of which modes are the lowest, none missed.

    Costs a few sparse factorisations: one where all is well, up to ten to find the place where a
    mode is missing.

    Parameters
    ----------
    spectrum : Spectrum
        Of `laplacian`, whoever computed it.
    laplacian : Laplacian
        The operator.

    Returns
    -------
    Spectrum
        With ``certificate.level == "verified"`` if every mode is proved to be the one it is taken
        for. Otherwise ``certificate.count`` tells how many leading modes are, and why not more: a
        mode was missed, or the residuals are too wide (as those of a prediction are) to tell one
        eigenvalue from the next. A cluster that k cuts counts as verified, to within its width.

        Zero modes belong to the lowest: verify first, then drop them by `Spectrum.nonzero`.

    Raises
    ------
    OutOfMemoryError
        If a factor of ``L - sigma M`` does not fit into memory.

    Notes
    -----
    *From below*: of M-orthonormal modes with residuals R = L U - M U Lambda, each lambda_i has an
    eigenvalue of its own within ``radius = ||R||_F`` (in the M^-1 norm; Kahan's theorem, see
    Parlett, *The Symmetric Eigenvalue Problem*, 1998, ch. 11): at least as many eigenvalues as
    modes lie below any sigma > lambda_j + radius. *From above*: the number of negative pivots of
    an LDL^T factor of L - sigma M is the number of eigenvalues below sigma (Sylvester). Where the
    two agree, nothing was missed. Nothing is pivoted in the factor, so its rounding is bounded
    after the fact (`SparseLDL.backward_error`) and taken off sigma; the rounding of residuals
    and of orthonormality is part of the radius.

    Examples
    --------
    >>> from spectra_kit import eigensolve, robust_laplacian, verify
    >>> from spectra_kit.geometry import sphere
    >>> laplacian = robust_laplacian(sphere(subdivisions=3).geometry)
    >>> verified = verify(eigensolve(laplacian, 9), laplacian)
    >>> verified.certificate.level, verified.certificate.n_verified
    ('verified', 9)

    With one of the three modes of eigenvalue 2 left out, only the constant is certain:

    >>> from spectra_kit import Spectrum
    >>> keep = [0, 1, 3, 4, 5, 6]
    >>> gap = Spectrum(
    ...     verified.eigenvalues[keep], verified.eigenvectors[:, keep], verified.mass
    ... )
    >>> verify(gap, laplacian).certificate.n_verified
    1
    """
    clock = Clock()
    certificate = with_excess(certificate_of(spectrum, laplacian), spectrum, laplacian)
    try:
        count = _counted(spectrum, certificate, laplacian, thorough=True)
    finally:
        laplacian._forget()
    before = spectrum.certificate
    if before is not None and before.count is not None:
        count = replace(count, added=before.count.added)
    seconds = {**spectrum.provenance.seconds, "verify": clock.total}
    # Estimates know nothing of a mode that was passed over.
    errors = None if before is None or count.missing or before.bounded.any() else before.errors
    certificate = replace(certificate, count=count, errors=errors)
    provenance = replace(spectrum.provenance, seconds=seconds)
    return spectrum.described(with_bounds(certificate, spectrum, laplacian), provenance)


def count_modes(
    spectrum: Spectrum,
    certificate: Certificate,
    laplacian: Laplacian,
    blocks: Sequence[Laplacian] = (),
) -> ModeCount:
    """Return what one or two counts prove, as `eigensolve` makes them of what is to be exact.

    The operator may be known in `blocks` that nothing joins, of which each has been ordered before.
    Where a factor does not fit into memory nothing is proved, and the reason says so.
    """
    try:
        return _counted(spectrum, certificate, laplacian, blocks, thorough=False)
    except MemoryError as error:  # the modes are there, and must not be lost for it
        reason = f"not counted: {str(error) or 'out of memory'}"
        return ModeCount(verified=0, radius=0.0, floor=0.0, reason=reason)


def _counted(
    spectrum: Spectrum,
    certificate: Certificate,
    laplacian: Laplacian,
    blocks: Sequence[Laplacian] = (),
    *,
    thorough: bool,
) -> ModeCount:
    """Return what counts prove of a spectrum, zero modes included."""
    prover = _Prover.of(spectrum, certificate, laplacian, blocks)
    count = prover.prove(thorough=thorough)
    lacking = min(certificate.kernel_dimension, spectrum.k) - certificate.n_zero_modes
    if lacking <= 0 or count.verified == spectrum.k:
        return count
    reason = (
        f"{lacking} of {certificate.kernel_dimension} zero modes are not in this spectrum (if"
        " `nonzero` dropped them: verify first, then drop them)"
    )
    return replace(count, reason=f"{reason}; {count.reason}")


class _Below(NamedTuple):
    """At most `number` eigenvalues lie below `floor`, and `certain` ones below `ceiling`."""

    number: int
    floor: float
    certain: int
    ceiling: float


class _Proof(NamedTuple):
    """The first `verified` modes are the lowest to within `radius`, the others above `floor`."""

    verified: int = 0
    radius: float = 0.0
    floor: float = 0.0


class _Refuted(NamedTuple):
    """More than `at` eigenvalues may lie `below`; of the lowest, so many are certainly missing."""

    at: int = 0
    below: _Below | None = None
    missing: int = 0


@dataclass(eq=False)
class _Prover:
    """The operator on its free points, the eigenvalues found, and how far these may be off.

    The first j + 1 of the `values` are within ``radii[j]`` of as many true ones. What counts have
    proved and refuted so far is kept.
    """

    laplacian: Laplacian
    spacing: float
    values: Floats
    radii: Floats
    blocks: Sequence[Laplacian]
    proof: _Proof = field(default_factory=_Proof)
    refuted: _Refuted = field(default_factory=_Refuted)

    @classmethod
    def of(
        cls,
        spectrum: Spectrum,
        certificate: Certificate,
        laplacian: Laplacian,
        blocks: Sequence[Laplacian],
    ) -> _Prover:
        """Of a spectrum and what is known of it."""
        free = laplacian.free
        if len(laplacian.fixed):
            vectors = spectrum.eigenvectors[free]
            laplacian = replace(laplacian.restricted(free), seconds=0.0)
            spectrum = Spectrum(spectrum.eigenvalues, vectors, laplacian._weights)
        return cls(
            laplacian,
            laplacian.eigenvalue_spacing,
            spectrum.eigenvalues,
            _radii(spectrum, laplacian, certificate.residuals),
            blocks or [laplacian],
        )

    @cached_property
    def _pencils(self) -> list[Pencil]:
        return [Pencil(one.stiffness, one._weights, one._elimination) for one in self.blocks]

    def _inertia(self, sigma: float) -> tuple[int, int, float] | None:
        """Return how many pivots are negative and zero, and the backward error of the factors."""
        negative, zero, error = 0, 0, 0.0
        for block, pencil in zip(self.blocks, self._pencils, strict=True):
            if (factor := pencil.factor(sigma)) is None:
                return None
            negative += factor.inertia.negative
            zero += factor.inertia.zero
            error = max(error, factor.backward_error(block._diagonal))
        return negative, zero, error

    def prove(self, *, thorough: bool = True) -> ModeCount:
        """Find the largest number of leading modes that a count confirms.

        Without `thorough`, stop after the counts that settle it where nothing is missing: above
        the last mode and, where k cuts a cluster, below this cluster.
        """
        k = len(self.values)
        if k and self.values[-1] <= self.radii[-1] <= _ZERO * self.spacing:
            # As many are as good as zero, and no eigenvalue is lower: nothing is there to count.
            radius = float(self.values[-1] + self.radii[-1])
            return ModeCount(verified=k, radius=radius, floor=0.0)
        candidates = self._candidates()
        if candidates and candidates[-1] == k:
            self._settle(candidates.pop())
        if self.proof.verified < k:
            # Where nothing is missing, only the last cluster may be cut by k: look below it, and
            # close to it, for what is missing lies lower.
            self._settle(candidates[-1] if candidates else 0, below_next=True)
        # What was missed below a shift was missed below every higher one.
        low, high = -1, len(candidates) if thorough and self.proof.verified < k else 0
        while low < high - 1:
            probe = (low + high) // 2
            j = candidates[probe]
            if self.proof.verified < j:
                self._settle(j)
            low, high = (probe, high) if self.proof.verified >= j else (low, probe)
        reason = "" if self.proof.verified == k else self._reason()
        return ModeCount(**self.proof._asdict(), missing=self.refuted.missing, reason=reason)

    def _settle(self, j: int, *, below_next: bool = False) -> None:
        """Count the eigenvalues between mode j and the next, and draw the conclusion."""
        k = len(self.values)
        below = self._count(j, below_next=below_next)
        if below is None:
            return
        if below.number == j:
            radius = float(self.radii[j - 1]) if j else 0.0
            # All that come later are at least the floor, and at most what was found: where that
            # leaves no room to speak of, they are the next ones too, whatever else is up there.
            width = float(self.values[-1] + self.radii[-1] - below.floor)
            if j < k and width <= _CLUSTER * self.values[-1]:
                self.proof = _Proof(k, max(radius, width), below.floor)
            else:
                self.proof = max(self.proof, _Proof(j, radius, below.floor))
            return
        surplus = below.certain - j if j < k and below.ceiling < self.values[j] else 0
        self.refuted = _Refuted(j, below, max(surplus, self.refuted.missing))

    def _candidates(self) -> list[int]:
        """Return all j so that the first j modes are well apart from the next; k, if it may be."""
        units = np.array([self._unit(j) for j in range(1, len(self.values) + 1)])
        gap = np.append(np.diff(self.values), _APART / _INSIDE * units[-1:])
        apart = (gap > 2 * _ABOVE[0] * units) & (self.radii < _INSIDE * gap)
        return [int(j) for j in np.flatnonzero(apart) + 1]

    def _count(self, j: int, *, below_next: bool = False) -> _Below | None:
        """Count the eigenvalues below the first shift that rounding leaves between j modes."""
        lowest = float(self.values[j - 1] + self.radii[j - 1]) if j else -np.inf
        highest = float(self.values[j]) if j < len(self.values) else np.inf
        found, laplacian = None, self.laplacian
        for sigma in self._shifts(j, below_next):
            if not lowest < sigma < highest:
                continue
            if (inertia := self._inertia(sigma)) is None:
                continue
            negative, zero, error = inertia
            # And what rounds the diagonal of L - sigma M.
            largest = np.abs(laplacian.stiffness.diagonal() / laplacian._diagonal).max()
            error = (error + float(_EPS * (sigma + largest))) / laplacian._least_weight
            if sigma - error > lowest:
                # What counts as zero may be negative: no more than both lie below.
                found = _Below(negative + zero, sigma - error, negative, sigma + error)
                # More of them are certainly missing only if rounding keeps clear of the next mode.
                if not below_next or found.number == j or found.ceiling < highest:
                    break
        return found

    def _shifts(self, j: int, below_next: bool) -> list[float]:
        """Return where to count, close above the first j modes or close below the next."""
        i, sign = (j, -1) if below_next else (j - 1, 1)
        steps = np.maximum(self._unit(j) * np.array(_ABOVE), 2 * self.radii[i])
        return list(dict.fromkeys((self.values[i] + sign * steps).tolist()))

    def _unit(self, j: int) -> float:
        """Return what is small between mode j - 1 and mode j, in 1/length^2.

        Low eigenvalues of long shapes, of parts that hardly touch and beside steep potentials lie
        far below the spacing, which the operator has as a whole.
        """
        value = float(self.values[min(j, len(self.values) - 1)])
        return min(self.spacing, value) if value > 0 else self.spacing

    def _reason(self) -> str:
        """Say why no more modes are verified."""
        proved, at, below = self.proof.verified, self.refuted.at, self.refuted.below
        if below is not None:
            cut = ", or k cuts a cluster (ask for a few more)" if at == len(self.values) else ""
            return (
                f"{below.number} eigenvalues were counted where the spectrum has {at} modes: some"
                f" beyond the first {proved} are missing{cut}"
            )
        wide = proved + np.flatnonzero(self.radii[proved:] > _APART * self.spacing)
        if np.isinf(self.radii).any():
            return (
                f"mode {int(np.isinf(self.radii).argmax())} is far from M-orthonormal to those"
                " before it"
            )
        if len(wide):
            return (
                f"from mode {wide[0]} on, the residuals and the error of orthonormality add up to"
                f" {self.radii[wide[0]] / self.spacing:.3g} times the typical gap between"
                " eigenvalues, too wide to tell one from the next;"
                " refine the modes (if they are exact, degenerate faces make rounding this large)"
            )
        return "rounding in the factor of L - sigma M was too large for every shift tried"


def _radii(spectrum: Spectrum, laplacian: Laplacian, residuals: Floats) -> Floats:
    """Return, for each j, how far the first j + 1 eigenvalues can be from true ones; (k,).

    Infinite from the first mode on that is not orthonormal to those before it.
    """
    k = spectrum.k
    squared = (spectrum._products - np.eye(k)) ** 2
    # Of each leading block of U^T M U - I, the Frobenius norm; with the rounding of the sums of
    # n products: at most (n + 1) eps in each entry, and j + 1 times that in the norm of a block.
    rounded = (laplacian.n + 1) * _EPS * np.arange(1, k + 1)
    skew = np.sqrt(np.diag(squared.cumsum(axis=0).cumsum(axis=1))) + rounded
    residual = np.sqrt(np.cumsum((residuals + laplacian._rounding) ** 2))
    # With Q = U (U^T M U)^-1/2 in place of U, commuting with Lambda costs at most lambda * skew.
    radii = (1 + skew) ** 2 * (residual + spectrum.eigenvalues * skew)
    return np.where(skew < 0.5, radii, np.inf)
