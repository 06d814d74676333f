"""The heat kernel: its times, its columns, and its signature."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_count, positive_array
from spectra_kit.eigen import Spectrum
from spectra_kit.features._spectra import (
    DAMPED,
    Isometric,
    Solvable,
    check_grid,
    check_sources,
    outside_kernel,
    seen_from,
    seen_from_landmarks,
    shares,
    solved,
    squares,
    weyl,
)
from spectra_kit.features.embedding import Pooled, Surface

_LONGEST = 1.0  # time in units of the area, by when heat has spread over all of most surfaces


@checked
def heat_times(surface: Solvable, count: int = 16) -> Floats:
    """Times over which the heat kernel signature changes, as far as k modes can tell.

    Parameters
    ----------
    surface : Spectrum, TriangleMesh, PointCloud, path or Laplacian
        With at least one mode outside its kernel; see `heat_kernel_signature`.
    count : int, default 16
        Number of times, at least 2.

    Returns
    -------
    ndarray of shape (count,)
        ``geomspace(4 ln 10 / lambda_max, 4 ln 10 / lambda_1)``, in length^2, where lambda_1 is
        the smallest eigenvalue outside the kernel: the second for one component, the third for
        two.

    Notes
    -----
    The interval of Sun et al. (see `heat_kernel_signature`): the shortest time damps the last mode
    to 1e-4, so that truncation does not show; at the longest, so is every mode but the constants.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> spectrum = sk.Spectrum(np.array([0.0, 1.0, 100.0]), np.eye(3), np.ones(3))
    >>> sk.features.heat_times(spectrum, 3) / np.log(10)
    array([0.04, 0.4 , 4.  ])
    """
    return _times(solved(surface), count)


@checked
def heat_kernel(surface: Solvable, sources: ArrayLike, times: ArrayLike) -> Floats:
    """Heat at every point, some times after a unit of it was put on a source.

    Parameters
    ----------
    surface : Spectrum, TriangleMesh, PointCloud, path or Laplacian
        As of `heat_kernel_signature`; zero modes take part.
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
    spectrum = solved(surface)
    sources = check_sources("sources", sources, spectrum)
    weights = np.exp(-np.outer(_check_times(times), spectrum.eigenvalues))
    return np.moveaxis(seen_from(spectrum, sources, weights), 0, 1)


@checked
def heat_kernel_signature(
    surface: Solvable,
    times: ArrayLike | None = None,
    *,
    count: int = 16,
    landmarks: ArrayLike | None = None,
    scaled: bool = False,
    logarithm: bool = False,
) -> Floats:
    """Heat that stays where it was put, for each point: the heat kernel signature (HKS).

    Sun, Ovsjanikov and Guibas, *A Concise and Provably Informative Multi-Scale Signature Based on
    Heat Diffusion*, SGP 2009.

    Parameters
    ----------
    surface : Spectrum, TriangleMesh, PointCloud, path or Laplacian
        A spectrum of k modes; of anything else the 96 lowest modes are computed, by the default
        operator and solver. Zero modes take part: they are the limit 1/area (of the component)
        for long times. Pass ``spectrum.nonzero()`` to leave this constant out.
    times : array_like of shape (t,), optional
        In length^2, positive; by default ``heat_times(surface, count)``.
    count : int, default 16
        Number of times where none are given.
    landmarks : array_like of shape (l,), optional
        Indices of points: the heat that reaches each point from these, `heat_kernel` as a
        descriptor. Unlike that which stays, it tells apart the two sides of a symmetric surface,
        unless all landmarks lie on its plane of symmetry, from where mirror images look alike. On a
        second surface, give those of the same places in the same order.
    scaled : bool, default False
        Divide each column by its heat trace ``sum_i exp(-lambda_i t)``, as Sun et al. compare them:
        every time has the integral 1 over the surface and similar weight in a comparison.
    logarithm : bool, default False
        Return logarithms of what the signature is in units of 1/area: without a unit, and zero
        where all heat has spread evenly. Not from landmarks, where short times have both signs.

    Returns
    -------
    ndarray of shape (n, t), or (n, l * t) from landmarks
        ``sum_i exp(-lambda_i t) u_i(x)^2``, in 1/length^2: multiplying lengths by s divides the
        signature at the default times by s^2. About 1/(4 pi t) for short times. From landmarks
        ``sum_i exp(-lambda_i t) u_i(landmark) u_i(x)``: all times of the first, then of the second.

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
    spectrum = solved(surface)
    weights = _weights(spectrum, times, count, scaled)
    if landmarks is not None:
        return seen_from_landmarks(spectrum, landmarks, weights, logarithm)
    signature = squares(spectrum, weights)
    return np.log(signature * spectrum.area) if logarithm else signature


@checked
@dataclass(frozen=True, kw_only=True)
class HeatKernelSignature(Isometric, Pooled):
    """Logarithms of `heat_kernel_signature`, at times that all shapes share.

    Parameters
    ----------
    count : int, default 16
        Times, evenly spaced in their logarithms, from that in which the last mode of Weyl's law has
        died down to 1e-4 to the area of the surface.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> ball = sk.geometry.sphere(subdivisions=3).geometry
    >>> even = sk.features.embed(ball, sk.features.HeatKernelSignature(count=4), k=36)
    >>> bool((even.std(axis=0) < 0.1).all())
    True
    """

    count: int = 16

    def __post_init__(self) -> None:
        check_count("count", self.count, low=2)

    def of_points(self, surface: Surface) -> Floats:
        """Return (n, count), zero where all heat has spread evenly."""
        spectrum = surface.spectrum
        shortest = DAMPED / weyl(surface.k, spectrum.dimension)
        times = np.geomspace(shortest, _LONGEST, self.count)
        return np.log(squares(spectrum, _weights(spectrum, times)))


def _times(spectrum: Spectrum, count: int) -> Floats:
    check_count("count", count, low=2)
    values = outside_kernel(spectrum).eigenvalues
    return np.geomspace(DAMPED / values[-1], DAMPED / values[0], count)


def _check_times(values: ArrayLike) -> Floats:
    advice = "times are in length^2, `heat_times` suggests some"
    return positive_array("times", check_grid("times", values), advice=advice)


def _weights(
    spectrum: Spectrum, times: ArrayLike | None, count: int = 16, scaled: bool = False
) -> Floats:
    """Return exp(-lambda t) of shape (t, k), over its sum over the modes where `scaled`."""
    times = _times(spectrum, count) if times is None else _check_times(times)
    exponents = -np.outer(times, spectrum.eigenvalues)
    return shares(exponents) if scaled else np.asarray(np.exp(exponents))
