"""The heat kernel, its diagonal as a signature, and its columns as seen from landmarks."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spectra_kit._core.checked import checked
from spectra_kit._core.threads import blas_threads_for
from spectra_kit._core.types import Floats
from spectra_kit.eigen import Spectrum
from spectra_kit.features._checks import check_sources, check_times
from spectra_kit.features.grids import heat_times


@checked
def heat_kernel(spectrum: Spectrum, sources: ArrayLike, times: ArrayLike) -> Floats:
    """Heat at every point, some times after a unit of it was put on a source.

    Parameters
    ----------
    spectrum : Spectrum
        k modes; zero modes take part.
    sources : array_like of shape (s,)
        Indices of points.
    times : array_like of shape (t,)
        In length^2, positive.

    Returns
    -------
    ndarray of shape (s, n, t)
        ``k_t(x, y) = sum_i exp(-lambda_i t) u_i(x) u_i(y)``, in 1/length^2. Each column has the
        integral 1, and 0 beyond the component of its source. For short times the truncated sum
        oscillates around zero.

    Raises
    ------
    InvalidInputError
        If there is no source, an index is out of range, or a time is not positive.

    Notes
    -----
    Averaged over pairs of points, truncation leaves out ``exp(-2 lambda_k t) / (8 pi t area)`` of
    the squared kernel (Weyl's law for the modes beyond k).

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> spectrum = sk.Spectrum(np.array([0.0, 1.0]), np.eye(2), np.ones(2))
    >>> sk.features.heat_kernel(spectrum, [1], [1.0])[0, :, 0]
    array([0.   , 0.367...])
    """
    sources = check_sources("sources", sources, spectrum)
    times = check_times(times)
    columns = seen_from(spectrum, sources, np.exp(-np.outer(times, spectrum.eigenvalues)))
    return np.moveaxis(columns, 0, 1)


@checked
def heat_kernel_signature(
    spectrum: Spectrum, times: ArrayLike | None = None, *, count: int = 16, scaled: bool = False
) -> Floats:
    """Heat that stays where it was put, for each point: the heat kernel signature (HKS).

    Parameters
    ----------
    spectrum : Spectrum
        k modes. Zero modes take part: they are the limit 1/area (of the component) for long
        times. Pass ``spectrum.nonzero()`` to leave this constant out.
    times : array_like of shape (t,), optional
        In length^2, positive; by default ``heat_times(spectrum, count)``.
    count : int, default 16
        Number of times where none are given.
    scaled : bool, default False
        Divide each column by its heat trace ``sum_i exp(-lambda_i t)``, so that every time has
        the integral 1 over the surface and similar weight in a comparison.

    Returns
    -------
    ndarray of shape (n, t)
        ``sum_i exp(-lambda_i t) u_i(x)^2``, in 1/length^2: multiplying lengths by s divides the
        signature at the default times by s^2. About 1/(4 pi t) for short times.

    Raises
    ------
    InvalidInputError
        If a time is not positive, or there is no default for want of modes outside the kernel.

    Notes
    -----
    Sun, Ovsjanikov and Guibas also scale by the heat trace to compare signatures.

    References
    ----------
    J. Sun, M. Ovsjanikov, L. Guibas, "A concise and provably informative multi-scale signature
    based on heat diffusion", Computer Graphics Forum 28(5), 2009.

    Examples
    --------
    On the unit sphere all points are alike, and all heat is spread over 4 pi in the end:

    >>> import spectra_kit as sk
    >>> laplacian = sk.robust_laplacian(sk.geometry.sphere(subdivisions=3).geometry)
    >>> spectrum = sk.eigensolve(laplacian, 25)
    >>> hks = sk.features.heat_kernel_signature(spectrum, [0.25, 10.0])
    >>> hks[0] * 4 * 3.14159
    array([4.366..., 1.005...])
    """
    weights = _heat_weights(spectrum, times, count, scaled)
    with blas_threads_for(spectrum.eigenvectors.size):
        return np.asarray(spectrum.eigenvectors**2 @ weights.T)


@checked
def landmark_heat_kernel_signature(
    spectrum: Spectrum,
    landmarks: ArrayLike,
    times: ArrayLike | None = None,
    *,
    count: int = 16,
    scaled: bool = False,
) -> Floats:
    """Heat that reaches each point from some landmarks: `heat_kernel` as a descriptor.

    Unlike `heat_kernel_signature`, it tells apart the two sides of a symmetric surface, unless all
    landmarks lie on its plane of symmetry, from where mirror images look alike.

    Parameters
    ----------
    spectrum : Spectrum
        k modes; zero modes take part.
    landmarks : array_like of shape (l,)
        Indices of points. On a second surface, give those of the same places in the same order.
    times : array_like of shape (t,), optional
        In length^2, positive; by default ``heat_times(spectrum, count)``.
    count : int, default 16
        Number of times where none are given.
    scaled : bool, default False
        Divide by the heat trace of each time, as in `heat_kernel_signature`.

    Returns
    -------
    ndarray of shape (n, l * t)
        ``sum_i exp(-lambda_i t) u_i(landmark) u_i(x)`` in 1/length^2: all times of the first
        landmark, then those of the second.

    Raises
    ------
    InvalidInputError
        If there is no landmark, an index is out of range, or a time is not positive.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> spectrum = sk.Spectrum(np.array([0.0, 1.0]), np.eye(2), np.ones(2))
    >>> sk.features.landmark_heat_kernel_signature(spectrum, [0, 1], [1.0])
    array([[1.   , 0.   ],
           [0.   , 0.367...]])
    """
    landmarks = check_sources("landmarks", landmarks, spectrum)
    weights = _heat_weights(spectrum, times, count, scaled)
    return seen_from(spectrum, landmarks, weights).reshape(spectrum.n, -1)


def _heat_weights(spectrum: Spectrum, times: ArrayLike | None, count: int, scaled: bool) -> Floats:
    """Return exp(-lambda t) of shape (t, k), over its sum over the modes where `scaled`."""
    times = heat_times(spectrum, count) if times is None else check_times(times)
    exponents = -np.outer(times, spectrum.eigenvalues)
    return shares(exponents) if scaled else np.asarray(np.exp(exponents))


def shares(exponents: Floats) -> Floats:
    """Return ``exp(e) / sum exp(e)`` along the rows, where all of them may underflow."""
    weights = np.exp(exponents - exponents.max(axis=1, keepdims=True))
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def seen_from(spectrum: Spectrum, points: NDArray[np.int64], weights: Floats) -> Floats:
    """Return ``sum_i w_i u_i(x) u_i(p)``, shape (n, points, w), for weights of shape (w, k)."""
    U = spectrum.eigenvectors
    filtered = (U[points, None, :] * weights).reshape(-1, spectrum.k)
    with blas_threads_for(U.size):
        seen = U @ filtered.T
    return np.asarray(seen).reshape(spectrum.n, len(points), len(weights))
