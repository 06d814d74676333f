"""ZoomOut with soft correspondences that give every part of both surfaces its due mass."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_triangular

from spectra_kit._validate import check_count, check_positive
from spectra_kit.functional_maps._checks import checked_pair, checked_samples, starting_map
from spectra_kit.functional_maps.nearest import nearest
from spectra_kit.functional_maps.zoomout import schedule
from spectra_kit.spectrum import Spectrum

Floats = NDArray[np.float64]
Reals = NDArray[np.floating[Any]]  # float32 where the work is
Ints = NDArray[np.int64]

_FLOOR = np.float32(1e-6)  # of the kernel: no point may need a scaling beyond single precision
_NEAR = 60  # modes that say which sample a point belongs to


def sinkhorn_zoomout(
    source: Spectrum,
    target: Spectrum,
    initial: ArrayLike,
    *,
    k_final: int,
    k_start: int | None = None,
    step: int = 10,
    samples: int | tuple[ArrayLike, ArrayLike] = 1500,
    temperature: float = 0.3,
    sweeps: int = 5,
    seed: int = 0,
) -> Floats:
    """Refine a functional map by mass-preserving soft maps between samples.

    Pass the result to `bijective_zoomout`, which ends the refinement on all points.

    Parameters
    ----------
    source, target : Spectrum
        Of the two surfaces, in any units, with at least `k_final` modes each.
    initial : array_like of shape (k2, k1) or (n2,)
        A functional map of source to target, or the source point of each target point.
    k_final : int
        Number of modes to end with; at most a tenth of the samples is prudent.
    k_start : int, optional
        Number of modes to start with; see `zoomout`.
    step : int, default 10
        Modes to add in each iteration.
    samples : int or (indices, indices), default 1500
        How many points to choose at random on each surface, or the source and the target points
        to work on: more of the target than `k_final`. Couplings are dense, 9 MB for 1500.
    temperature : float, default 0.3
        Width of the kernel, relative to the mean squared distance to the nearest row.
    sweeps : int, default 5
        Sinkhorn sweeps in each iteration.
    seed : int, default 0
        Of the choice of samples.

    Returns
    -------
    ndarray of shape (k_final, k_final)
        The functional map.

    Raises
    ------
    InvalidInputError
        As `zoomout`; if `temperature` is not positive or `sweeps` is below 1.

    Notes
    -----
    In place of the nearest neighbours of `zoomout` stands the coupling
    ``diag(u) exp(-|U2 - U1 C^T|^2 / (2 s)) diag(v)`` whose marginals are the masses of the
    samples' cells: entropic optimal transport in the spectral domain (Pai et al. 2021, Fast
    Sinkhorn filters). It cannot leave a limb of either surface empty, and its averages lie
    between the samples. The functional map is its weighted least-squares fit.

    Examples
    --------
    >>> from spectra_kit.eigensolvers import eigensolve
    >>> from spectra_kit.geometry import creature
    >>> from spectra_kit.operators import robust_laplacian
    >>> s = eigensolve(robust_laplacian(creature(500)), 20)
    >>> C = sinkhorn_zoomout(s, s, np.eye(8), k_final=20)
    >>> bool(np.abs(C - np.eye(20)).max() < 0.1)
    True
    """
    a, b = checked_pair(source, target, k_final)
    check_count("step", step, low=1)
    check_count("sweeps", sweeps, low=1)
    check_positive("temperature", temperature)
    C = starting_map(a, b, initial, k_start)
    first, second = checked_samples(samples, a.n, b.n, k_final, seed)
    mass1, mass2 = sample_mass(a, first), sample_mass(b, second)
    root = np.sqrt(mass2)[:, None]
    Q, R = np.linalg.qr(root * b.eigenvectors[second])
    A, B = (s.eigenvectors[i].astype(np.float32) for s, i in ((a, first), (b, second)))
    masses = mass1.astype(np.float32), mass2.astype(np.float32)
    for k1, k2 in schedule(C.shape, k_final, step):
        images = A[:, : C.shape[1]] @ C.T.astype(np.float32)
        averages = _soft_map(images, B[:, : len(C)], masses, A[:, :k1], temperature, sweeps)
        C = solve_triangular(R[:k2, :k2], Q[:, :k2].T @ (root * averages))
    return np.asarray(C, dtype=np.float64)


def _soft_map(
    images: Reals,
    rows: Reals,
    masses: tuple[Reals, Reals],
    values: Reals,
    temperature: float,
    sweeps: int,
) -> Reals:
    """Average `values` (s1, k) over the coupling of `rows` (s2, d) with `images` (s1, d)."""
    mass1, mass2 = masses
    kernel = rows @ images.T
    kernel -= 0.5 * np.einsum("nd,nd->n", images, images)
    best = kernel.max(axis=1)
    # Half the mean squared distance to the nearest image.
    width = np.mean(0.5 * np.einsum("nd,nd->n", rows, rows) - best)
    kernel -= best[:, None]
    kernel *= np.float32(1 / max(temperature * width, 1e-6))
    np.exp(kernel, out=kernel)
    np.maximum(kernel, _FLOOR, out=kernel)
    v: Reals = mass1
    for _ in range(sweeps):
        u = mass2 / (kernel @ v)
        v = mass1 / (u @ kernel)
    return (kernel @ (v[:, None] * values)) / (kernel @ v)[:, None]


def sample_mass(spectrum: Spectrum, samples: Ints) -> Floats:
    """Return the mass of each sample's cell, on a surface of unit area: (s,).

    A cell holds the points nearer to its sample than to the others, in the kernel of
    ``1 / (lambda + 4 pi)^2``: 4 pi is the mean spacing of eigenvalues at unit area (Weyl).
    """
    low = slice(0, _NEAR)
    rows = spectrum.eigenvectors[:, low] / (spectrum.eigenvalues[low] + 4 * np.pi)
    cells = nearest(rows, rows[samples], exact=True)
    mass = np.bincount(cells, weights=spectrum.mass, minlength=len(samples))
    return np.asarray(mass, dtype=np.float64)
