"""The wave kernel signature, and its form as seen from landmarks."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.checked import checked
from spectra_kit._core.threads import blas_threads_for
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_positive
from spectra_kit.eigen import Spectrum
from spectra_kit.features._checks import check_energies, check_sources, outside_kernel
from spectra_kit.features.grids import default_width, wave_energies
from spectra_kit.features.heat import seen_from, shares


@checked
def wave_kernel_signature(
    spectrum: Spectrum,
    energies: Annotated[ArrayLike | None, tuple] = None,
    *,
    count: int = 100,
    width: float | None = None,
) -> Floats:
    """Probability of finding a quantum particle of some energy at each point (WKS).

    Parameters
    ----------
    spectrum : Spectrum
        k modes; zero modes, whose logarithm is no energy, are left out.
    energies : array_like of shape (e,), optional
        Logarithms of eigenvalues in the unit of `spectrum`; by default those of
        ``wave_energies(spectrum, count, width=width)``.
    count : int, default 100
        Number of energies where none are given.
    width : float, optional
        Standard deviation of the band around each energy, dimensionless; by default the one of
        `wave_energies`.

    Returns
    -------
    ndarray of shape (n, e)
        ``sum_i w_i u_i(x)^2 / sum_i w_i`` with ``w_i = exp(-(energy - log lambda_i)^2 / (2
        width^2))``, in 1/length^2; each column has the integral 1 over the surface. Multiplying
        lengths by s divides the signature at the default energies by s^2.

    Raises
    ------
    InvalidInputError
        If there are fewer than two different eigenvalues outside the kernel, an energy is not
        finite, or `width` is not positive.

    Notes
    -----
    An energy far outside the spectrum shows its nearest mode.

    References
    ----------
    M. Aubry, U. Schlickewei, D. Cremers, "The wave kernel signature: a quantum mechanical approach
    to shape analysis", ICCV Workshops, 2011.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> laplacian = sk.robust_laplacian(sk.geometry.creature(1000))
    >>> spectrum = sk.eigensolve(laplacian, 50)
    >>> wks = sk.features.wave_kernel_signature(spectrum)
    >>> wks.shape, float((spectrum.mass @ wks).min())
    ((1000, 100), 1.0)
    """
    modes, weights = _bands(spectrum, energies, count, width)
    with blas_threads_for(modes.eigenvectors.size):
        return np.asarray(modes.eigenvectors**2 @ weights.T)


@checked
def landmark_wave_kernel_signature(
    spectrum: Spectrum,
    landmarks: ArrayLike,
    energies: Annotated[ArrayLike | None, tuple] = None,
    *,
    count: int = 100,
    width: float | None = None,
) -> Floats:
    """Correlation of each point with some landmarks, in bands of energy.

    Unlike `wave_kernel_signature`, it tells apart the two sides of a symmetric surface, unless all
    landmarks lie on its plane of symmetry, from where mirror images look alike.

    Parameters
    ----------
    spectrum : Spectrum
        k modes; zero modes are left out.
    landmarks : array_like of shape (l,)
        Indices of points. On a second surface, give those of the same places in the same order.
    energies, count, width
        As of `wave_kernel_signature`.

    Returns
    -------
    ndarray of shape (n, l * e)
        ``sum_i w_i u_i(landmark) u_i(x) / sum_i w_i`` with the weights of
        `wave_kernel_signature`, in 1/length^2: all energies of the first landmark, then those of
        the second.

    Raises
    ------
    InvalidInputError
        If there is no landmark, an index is out of range, there are fewer than two different
        eigenvalues outside the kernel, an energy is not finite, or `width` is not positive.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> spectrum = sk.Spectrum(np.array([1.0, 2.0]), np.eye(2), np.ones(2))
    >>> sk.features.landmark_wave_kernel_signature(spectrum, [0, 1], [0.0, 0.7]).shape
    (2, 4)
    """
    landmarks = check_sources("landmarks", landmarks, spectrum)
    modes, weights = _bands(spectrum, energies, count, width)
    return seen_from(modes, landmarks, weights).reshape(spectrum.n, -1)


def _bands(
    spectrum: Spectrum,
    energies: Annotated[ArrayLike | None, tuple],
    count: int,
    width: float | None,
) -> tuple[Spectrum, Floats]:
    """Return the modes outside the kernel and the weight of each in every band, (e, k)."""
    if energies is None:
        grid, width = wave_energies(spectrum, count, width=width)
    else:
        grid = check_energies(energies)
        width = default_width(spectrum) if width is None else check_positive("width", width)
    modes = outside_kernel(spectrum)
    away = (grid[:, None] - np.log(modes.eigenvalues)) / width
    return modes, shares(-0.5 * away**2)
