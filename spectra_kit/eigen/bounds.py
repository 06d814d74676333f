"""How far eigenvalues are off, from residuals and the gaps of the spectrum itself."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy import sparse

from spectra_kit._core.threads import blas_threads_for
from spectra_kit._core.types import Floats
from spectra_kit._sparse.products import spmm
from spectra_kit.eigen.doubts import DOUBTFUL
from spectra_kit.eigen.multigrid.estimates import in_order
from spectra_kit.eigen.spectrum import Spectrum
from spectra_kit.operators.laplacian import Laplacian

_EPS = float(np.finfo(np.float64).eps)
_TOGETHER = 4  # times their residuals: eigenvalues that are closer are one cluster
_COLUMNS = 64  # of L @ U at once, about


def with_bounds(spectrum: Spectrum, laplacian: Laplacian) -> Spectrum:
    """Return a certified spectrum with `Certificate.errors`, unless it knows them better.

    Parameters
    ----------
    spectrum : Spectrum
        Certified; of modes that a count has verified, the errors are bounds.
    laplacian : Laplacian
        Its operator.

    Returns
    -------
    Spectrum
        As it was where residuals are as large as those of predictions, which tell nothing.

    Notes
    -----
    Of eigenvalues in a cluster with residuals R of Frobenius norm ``|R|`` and Rayleigh quotients in
    the matrix G, none is off by more than ``|G - diag(theta)| + |R|^2 / gap``, with the gap to
    all eigenvalues of the operator outside of the cluster (Kato and Temple; for clusters, Mathias,
    *Quadratic residual bounds for the Hermitian eigenvalue problem*, 1998). Those that were found
    are within ``radius`` of true ones, and these within ``|R|`` of those of the complement: both
    are taken off the gap. Where none is left, the bound is the linear one.
    """
    certificate = spectrum.certificate
    assert certificate is not None
    if not spectrum.k or certificate.relative_residuals.max() > DOUBTFUL:
        return spectrum
    relative, spacing = certificate.relative_residuals, laplacian.eigenvalue_spacing
    some = np.where(relative > 0, relative, 1.0)
    least = np.where(
        relative > 0, certificate.residuals / some, np.maximum(spectrum.eigenvalues, spacing)
    )
    bounded, errors = np.arange(spectrum.k) < certificate.n_verified, certificate.errors
    if errors is None or bounded.any():
        with blas_threads_for(spectrum.eigenvectors.size):
            own = _absolute(spectrum, laplacian) / least
        bounded &= True if errors is None else own < errors
        errors = own if errors is None else np.where(bounded, own, errors)
    mixed = in_order(spectrum.eigenvalues, errors * least) / least
    errors = np.where(bounded, errors, mixed)
    certificate = replace(certificate, errors=errors, bounded=bounded)
    return spectrum.described(certificate, spectrum.provenance)


def _absolute(spectrum: Spectrum, laplacian: Laplacian) -> Floats:
    """Return how far the eigenvalues are off, in 1/length^2."""
    certificate, values, k = spectrum.certificate, spectrum.eigenvalues, spectrum.k
    assert certificate is not None
    count, residuals = certificate.count, certificate.residuals
    verified = certificate.n_verified
    radius = count.radius if count else 0.0
    least = rounding(laplacian)
    off = np.empty(k)
    for (first, last), quotients, gram in _clusters(spectrum, laplacian):
        theta = values[first:last]
        apart = float(np.linalg.norm(gram - np.eye(last - first)))  # from orthonormal
        size = (1 + apart) * float(np.linalg.norm(residuals[first:last]))
        below = values[first] - values[first - 1] if first else np.inf
        # What no count has told is taken to be no nearer than it is on average, here or in all.
        room = min(laplacian.eigenvalue_spacing, (values[-1] - values[0]) / max(k - 1, 1))
        floor = count.floor if count and verified else values[-1] + room
        higher = values[last] if last < (verified or k) else floor
        gap = min(below, higher - values[last - 1]) - radius - size
        skew = float(np.linalg.norm(quotients - np.diag(theta)))
        skew += (1 + apart) ** 2 * apart * float(theta[-1])
        sure = np.arange(first, last) < verified
        linear = np.where(sure, radius, residuals[first:last])
        quadratic = skew + size**2 / gap if gap > 0 else np.inf
        # Of a cluster that was counted in part, nothing quadratic is proved.
        quadratics = np.where(sure & (last > verified), np.inf, quadratic)
        off[first:last] = np.minimum(linear, quadratics) + least * sure
    return off


def _clusters(
    spectrum: Spectrum, laplacian: Laplacian
) -> Iterator[tuple[tuple[int, int], Floats, Floats]]:
    """Find first and last of modes that belong together, with their ``U^T L U`` and ``U^T M U``."""
    certificate = spectrum.certificate
    assert certificate is not None
    U, residuals = spectrum.eigenvectors, certificate.residuals
    apart = np.diff(spectrum.eigenvalues) > _TOGETHER * (residuals[1:] + residuals[:-1])
    ends = [*(np.flatnonzero(apart) + 1).tolist(), spectrum.k]
    first = start = 0
    for i, end in enumerate(ends):
        if end - start < _COLUMNS and i < len(ends) - 1:
            continue
        some = np.ascontiguousarray(U[:, start:end])
        quotients = some.T @ spmm(laplacian.stiffness, some)
        gram = some.T @ (laplacian.mass[:, None] * some)
        inside = [e for e in ends if start < e <= end]
        for last in inside:
            block = slice(first - start, last - start)
            yield (first, last), quotients[block, block], gram[block, block]
            first = last
        start = end


def rounding(laplacian: Laplacian) -> float:
    """Bound the rounding of ``M^-1/2 L M^-1/2 u``, and what one triangle hides of an asymmetry."""
    stiffness = laplacian.stiffness
    scale = sparse.diags_array(1 / np.sqrt(laplacian.mass))
    magnitude = scale @ abs(stiffness) @ scale
    asymmetry = scale @ abs(stiffness - stiffness.T) @ scale
    longest = int(np.diff(stiffness.indptr).max())
    return float((longest + 4) * _EPS * magnitude.sum(axis=1).max() + asymmetry.sum(axis=1).max())
