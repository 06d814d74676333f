"""Times and energies that fit a spectrum, whatever its unit of length."""

from __future__ import annotations

import numpy as np

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_count, check_positive
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import InvalidInputError
from spectra_kit.features._checks import outside_kernel

_DAMPED = 4 * np.log(10)  # exp(-_DAMPED) = 1e-4
_WIDTH = 0.07  # of the range of log eigenvalues: 7 of the 100 steps of Aubry et al.


@checked
def heat_times(spectrum: Spectrum, count: int = 16) -> Floats:
    """Times over which the heat kernel signature changes, as far as k modes can tell.

    Parameters
    ----------
    spectrum : Spectrum
        With at least one mode outside its kernel.
    count : int, default 16
        Number of times, at least 2.

    Returns
    -------
    ndarray of shape (count,)
        ``geomspace(4 ln 10 / lambda_max, 4 ln 10 / lambda_1)``, in length^2, where lambda_1 is
        the smallest eigenvalue outside the kernel: the second for one component, the third for
        two.

    Raises
    ------
    InvalidInputError
        If all modes are zero modes, or `count` is below 2.

    Notes
    -----
    The interval of Sun et al.: the shortest time damps the last mode to 1e-4, so that truncation
    does not show; at the longest, so is every mode but the constants.

    References
    ----------
    J. Sun, M. Ovsjanikov, L. Guibas, "A concise and provably informative multi-scale signature
    based on heat diffusion", Computer Graphics Forum 28(5), 2009.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> spectrum = sk.Spectrum(np.array([0.0, 1.0, 100.0]), np.eye(3), np.ones(3))
    >>> sk.features.heat_times(spectrum, 3) / np.log(10)
    array([0.04, 0.4 , 4.  ])
    """
    check_count("count", count, low=2)
    values = outside_kernel(spectrum).eigenvalues
    return np.geomspace(_DAMPED / values[-1], _DAMPED / values[0], count)


@checked
def wave_energies(
    spectrum: Spectrum, count: int = 100, *, width: float | None = None
) -> tuple[Floats, float]:
    """Energies, and the width of the band around each, for the wave kernel signature.

    Parameters
    ----------
    spectrum : Spectrum
        With at least two different eigenvalues outside its kernel.
    count : int, default 100
        Number of energies, at least 2.
    width : float, optional
        Standard deviation of a band, in units of log eigenvalue (dimensionless); by default 0.07
        of the range ``log(lambda_max / lambda_1)``.

    Returns
    -------
    energies : ndarray of shape (count,)
        Evenly from ``log lambda_1 + 2 width`` to ``log lambda_max - 2 width``. Logarithms of
        eigenvalues: multiplying lengths by s shifts them by -2 log s.
    width : float
        As given, or the default.

    Raises
    ------
    InvalidInputError
        If there are fewer than two different eigenvalues outside the kernel, `count` is below 2,
        or `width` is not positive or so large that no energy is left.

    Notes
    -----
    For 100 energies, the choice of Aubry et al. (2011, see `wave_kernel_signature`): seven steps
    wide, two widths away from either end. Here the width does not depend on the number of energies,
    which only decides how finely the bands are sampled.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> spectrum = sk.Spectrum(np.exp([0.0, 1.0, 2.0]), np.eye(3), np.ones(3))
    >>> sk.features.wave_energies(spectrum, 3)
    (array([0.28, 1.  , 1.72]), 0.14)
    """
    check_count("count", count, low=2)
    low, high = log_range(spectrum)
    width = _WIDTH * (high - low) if width is None else check_positive("width", width)
    if 4 * width >= high - low:
        raise InvalidInputError(
            "width",
            f"be below a quarter of the range {high - low:.3g} of log eigenvalues",
            f"{width:.3g}",
            advice=f"the default is {_WIDTH * (high - low):.3g}",
        )
    return np.linspace(low + 2 * width, high - 2 * width, count), width


def default_width(spectrum: Spectrum) -> float:
    """Return the width of `wave_energies`, for energies from elsewhere."""
    low, high = log_range(spectrum)
    return _WIDTH * (high - low)


def log_range(spectrum: Spectrum) -> tuple[float, float]:
    """Return the logarithms of the first and last eigenvalue outside the kernel."""
    values = outside_kernel(spectrum).eigenvalues
    if values[0] == values[-1]:
        raise InvalidInputError(
            "spectrum",
            "have two different eigenvalues outside its kernel",
            f"{len(values)} times {values[0]:.3g}",
            advice="compute more modes, or give `width`",
        )
    return float(np.log(values[0])), float(np.log(values[-1]))
