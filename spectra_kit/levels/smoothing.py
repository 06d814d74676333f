"""A few sparse products that take the roughness out of carried modes."""

from __future__ import annotations

import numpy as np

from spectra_kit._types import Floats
from spectra_kit._validate import frozen
from spectra_kit.linalg.residuals import residuals
from spectra_kit.linalg.threads import in_threads, shares
from spectra_kit.operators.laplacian import Laplacian

_FLOOR = 1e-3  # of the median diagonal entry: smaller ones would take steps of any length


def smoothed(laplacian: Laplacian, values: Floats, vectors: Floats, *, degree: int = 6) -> Floats:
    """Return approximate modes without the high frequencies of their residuals.

    Parameters
    ----------
    laplacian : Laplacian
        On n points.
    values : ndarray of shape (k,)
        Their approximate eigenvalues.
    vectors : ndarray of shape (n, k)
        Modes carried up from a coarse level.
    degree : int, default 6
        Products with L. The frequencies damped reach down with its square.

    Returns
    -------
    ndarray of shape (n, k)
        Not orthonormal: Rayleigh-Ritz comes next. Exact modes stay as they are.

    Notes
    -----
    `degree` Chebyshev steps, preconditioned by the diagonal of L, for ``(L - lambda M) c = -r``
    with the residual r of each column, aimed at the upper part of the spectrum (Saad, *Iterative
    Methods for Sparse Linear Systems*, 2003, Algorithm 12.1). Only the correction c is float32.

    Examples
    --------
    >>> from spectra_kit import eigensolve, robust_laplacian
    >>> from spectra_kit.geometry import sphere
    >>> from spectra_kit.levels import smoothed
    >>> laplacian = robust_laplacian(sphere(subdivisions=3).geometry)
    >>> exact = eigensolve(laplacian, 4)
    >>> u = smoothed(laplacian, exact.eigenvalues, exact.eigenvectors)
    >>> bool(abs(u - exact.eigenvectors).max() < 1e-6)
    True
    """
    from spectra_kit.levels._kernels import smoothing_step

    L = laplacian.stiffness
    diagonal = L.diagonal()
    diagonal = np.maximum(diagonal, _FLOOR * np.median(diagonal))
    highest = float((np.asarray(abs(L).sum(axis=1)) / diagonal).max())  # by Gershgorin
    lowest = highest / (1 + 0.6 * degree**2)
    centre, radius = (highest + lowest) / 2, (highest - lowest) / 2

    residual, _ = residuals(L, laplacian.mass, np.asarray(values), vectors)
    old, direction, new = (np.zeros(vectors.shape, np.float32) for _ in range(3))
    # Read-only, and one kind of indices: numba compiles anew for others.
    graph = tuple(frozen(np.asarray(a, dtype=np.int32)) for a in (L.indptr, L.indices))
    singles = (
        a.astype(np.float32) for a in (L.data, laplacian.mass, 1 / diagonal, np.asarray(values))
    )
    fixed = (*graph, *singles, residual)
    ratio = 1.0
    for i in range(degree):
        before, ratio = ratio, radius / centre if i == 0 else 1 / (2 * centre / radius - ratio)
        keep = 0.0 if i == 0 else ratio * before
        step = 1 / centre if i == 0 else 2 * ratio / radius
        state = (old, direction, new, keep, step)
        in_threads(smoothing_step, ((*fixed, *state, *rows) for rows in shares(laplacian.n)))
        old, new = new, old
    # Of a mode far above the frequencies that are damped, steps may grow until they overflow.
    old[:, ~np.isfinite(old).all(axis=0)] = 0.0
    return np.asarray(vectors + old)
