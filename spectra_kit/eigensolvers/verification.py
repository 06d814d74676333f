"""Prove that no mode was missed, by counting the eigenvalues below a shift."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from spectra_kit.errors import InvalidInputError
from spectra_kit.linalg import SparseLDL
from spectra_kit.operators.laplacian import Laplacian
from spectra_kit.spectrum import ModeCount, Spectrum

Floats = NDArray[np.float64]

_EPS = float(np.finfo(np.float64).eps)
# How far above a mode to put a shift, in units of `Laplacian.eigenvalue_spacing`: as close as the
# rounding of the factor allows, for what is missing may be close as well.
_ABOVE = (1e-3, 1e-2, 1e-1)
_APART = 1e-2  # modes whose radius exceeds this many spacings need a wider gap above them
_INSIDE = 0.1  # that gap must be wider than the radius by 1 / this


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
        mode was missed, k cuts a cluster of eigenvalues, or the residuals are too wide (as those
        of a prediction are) to tell one eigenvalue from the next.

        Zero modes belong to the lowest: verify first, then drop them by `Spectrum.nonzero`.

    Raises
    ------
    InvalidInputError
        If `laplacian` cannot be the operator of `spectrum`.
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
    >>> from spectra_kit import eigensolve, robust_laplacian
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
    start = time.perf_counter()
    certified = spectrum.certify(laplacian)
    assert certified.certificate is not None
    count = _Prover.of(spectrum, laplacian).prove()
    lacking = min(laplacian.kernel_dimension, spectrum.k) - certified.certificate.n_zero_modes
    if count.reason and lacking > 0:
        reason = (
            f"{lacking} of {laplacian.kernel_dimension} zero modes are not in this spectrum (if"
            f" `nonzero` dropped them: verify first, then drop them); {count.reason}"
        )
        count = replace(count, reason=reason)
    seconds = {**spectrum.provenance.seconds, "verify": time.perf_counter() - start}
    return replace(
        certified,
        certificate=replace(certified.certificate, count=count),
        provenance=replace(spectrum.provenance, seconds=seconds),
    )


class _Below(NamedTuple):
    """At most `number` eigenvalues lie below `floor`."""

    number: int
    floor: float


@dataclass(frozen=True, eq=False)
class _Prover:
    """The operator on its free points, the eigenvalues found, and how far these may be off.

    Attributes
    ----------
    stiffness : sparse array of shape (n_free, n_free)
        L without the rows and columns of fixed points.
    mass : ndarray of shape (n_free,)
        The diagonal of M, in length^2.
    spacing : float
        `Laplacian.eigenvalue_spacing`, in 1/length^2.
    values : ndarray of shape (k,)
        The eigenvalues found, ascending, in 1/length^2.
    radii : ndarray of shape (k,)
        The first j + 1 of them are within ``radii[j]`` of as many true ones, in 1/length^2.
    """

    stiffness: sparse.csr_array
    mass: Floats
    spacing: float
    values: Floats
    radii: Floats

    @classmethod
    def of(cls, spectrum: Spectrum, laplacian: Laplacian) -> _Prover:
        free = laplacian.free
        if len(laplacian.fixed):
            vectors = spectrum.eigenvectors[free]
            spectrum = Spectrum(spectrum.eigenvalues, vectors, spectrum.mass[free])
            laplacian = replace(laplacian.restricted(free), seconds=0.0)
        return cls(
            laplacian.stiffness,
            laplacian.mass,
            laplacian.eigenvalue_spacing,
            spectrum.eigenvalues,
            _radii(spectrum, laplacian),
        )

    def prove(self) -> ModeCount:
        """Find the largest number of leading modes that a count confirms."""
        candidates = self._candidates()
        proved, radius, floor = 0, 0.0, 0.0
        refuted: _Below | None = None
        refuted_at = 0
        # What was missed below a shift was missed below every higher one: bisect, but look at the
        # last two first. They are all there is to do where nothing, or only a cluster cut by k,
        # is missing.
        low, high = -1, len(candidates)
        while low < high - 1:
            probe = high - 1 if high > len(candidates) - 2 else (low + high) // 2
            j = candidates[probe]
            below = self._count(j)
            if below is not None and below.number == j:
                low, proved, radius, floor = probe, j, float(self.radii[j - 1]), below.floor
            else:
                high = probe
                if below is not None:
                    refuted, refuted_at = below, j
        reason = "" if proved == len(self.values) else self._reason(proved, refuted, refuted_at)
        return ModeCount(verified=proved, radius=radius, floor=floor, reason=reason)

    def _candidates(self) -> list[int]:
        """Return all j so that the first j modes are well apart from the next; k, if it may be."""
        gap = np.append(np.diff(self.values), _APART / _INSIDE * self.spacing)
        apart = (gap > 2 * _ABOVE[0] * self.spacing) & (self.radii < _INSIDE * gap)
        return [int(j) for j in np.flatnonzero(apart) + 1]

    def _count(self, j: int) -> _Below | None:
        """Count the eigenvalues below the first shift that rounding leaves above j modes."""
        mode, radius = self.values[j - 1], self.radii[j - 1]
        ceiling = self.values[j] if j < len(self.values) else np.inf
        for above in _ABOVE:
            sigma = float(mode + max(above * self.spacing, 2 * radius))
            if sigma >= ceiling:
                break
            try:
                shifted = sparse.csr_array(self.stiffness - sigma * sparse.diags_array(self.mass))
                factor = SparseLDL(shifted, definite=False)
            except InvalidInputError:  # a zero pivot: this shift is as good as an eigenvalue
                continue
            floor = float(sigma - factor.backward_error(self.mass) - _rounding(self, sigma))
            if floor > mode + radius:
                # What counts as zero may be negative: no more than both lie below.
                return _Below(factor.inertia.negative + factor.inertia.zero, floor)
        return None

    def _reason(self, proved: int, refuted: _Below | None, at: int) -> str:
        """Say why no more than `proved` modes are verified."""
        k = len(self.values)
        if refuted is not None and refuted.number > at:
            cut = ", or k cuts a cluster (ask for a few more)" if at == k else ""
            return (
                f"{refuted.number} eigenvalues were counted below {refuted.floor:.6g}, where the"
                f" spectrum has {at} modes: some beyond the first {proved} are missing{cut}"
            )
        wide = np.flatnonzero(self.radii > _APART * self.spacing)
        if np.isinf(self.radii).any():
            return (
                f"mode {int(np.isinf(self.radii).argmax())} is far from M-orthonormal to those"
                " before it"
            )
        if len(wide):
            return (
                f"from mode {wide[0]} on, the residuals and the error of orthonormality add up to"
                f" {self.radii[wide[0]]:.3g}, too wide to tell an eigenvalue from the next;"
                " refine the modes (if they are exact, degenerate faces make rounding this large)"
            )
        return "rounding in the factor of L - sigma M was too large for every shift tried"


def _rounding(prover: _Prover, sigma: float) -> float:
    """Bound the rounding of the diagonal of ``L - sigma M``."""
    return float(_EPS * (sigma + np.abs(prover.stiffness.diagonal() / prover.mass).max()))


def _radii(spectrum: Spectrum, laplacian: Laplacian) -> Floats:
    """Return, for each j, how far the first j + 1 eigenvalues can be from true ones; (k,).

    Infinite from the first mode on that is not orthonormal to those before it.
    """
    U, mass = spectrum.eigenvectors, laplacian.mass
    k = spectrum.k
    squared = (U.T @ (mass[:, None] * U) - np.eye(k)) ** 2
    # Of each leading block of U^T M U - I, the Frobenius norm; with the rounding of the sums of
    # n products: at most (n + 1) eps in each entry, and j + 1 times that in the norm of a block.
    rounded = (len(mass) + 1) * _EPS * np.arange(1, k + 1)
    skew = np.sqrt(np.diag(squared.cumsum(axis=0).cumsum(axis=1))) + rounded
    # The norms of |L| and of L - L^T bound the rounding of residuals, and what one triangle hides.
    scale = sparse.diags_array(1 / np.sqrt(mass))
    magnitude = scale @ abs(laplacian.stiffness) @ scale
    asymmetry = scale @ abs(laplacian.stiffness - laplacian.stiffness.T) @ scale
    longest = int(np.diff(laplacian.stiffness.indptr).max())
    rounding = (longest + 4) * _EPS * magnitude.sum(axis=1).max() + asymmetry.sum(axis=1).max()
    residual = np.sqrt(np.cumsum((spectrum.residuals(laplacian) + rounding) ** 2))
    # With Q = U (U^T M U)^-1/2 in place of U, commuting with Lambda costs at most lambda * skew.
    radii = (1 + skew) ** 2 * (residual + spectrum.eigenvalues * skew)
    return np.where(skew < 0.5, radii, np.inf)
