"""The wave kernel signature: its energies, and itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_count, check_positive
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import InvalidInputError
from spectra_kit.features._spectra import (
    Isometric,
    Solvable,
    check_grid,
    outside_kernel,
    seen_from_landmarks,
    shares,
    solved,
    squares,
    weyl,
)
from spectra_kit.features.embedding import Pooled, Surface

_WIDTH = 0.07  # of the range of log eigenvalues: 7 of the 100 steps of Aubry et al.
_REST = 1e-3  # of the mean: added to wave signatures, whose logarithms say nothing below it


@checked
def wave_energies(
    surface: Solvable, count: int = 100, *, width: float | None = None
) -> tuple[Floats, float]:
    """Energies, and the width of the band around each, for the wave kernel signature.

    Parameters
    ----------
    surface : Spectrum, TriangleMesh, PointCloud, path or Laplacian
        With at least two different eigenvalues outside its kernel; see `wave_kernel_signature`.
    count : int, default 100
        Number of energies, at least 2.
    width : float, optional
        Standard deviation of a band, in units of log eigenvalue (dimensionless); by default 0.07
        of the range ``log(lambda_max / lambda_1)``, of which four widths must leave something.

    Returns
    -------
    energies : ndarray of shape (count,)
        Evenly from ``log lambda_1 + 2 width`` to ``log lambda_max - 2 width``. Logarithms of
        eigenvalues: multiplying lengths by s shifts them by -2 log s.
    width : float
        As given, or the default.

    Notes
    -----
    For 100 energies, the choice of Aubry et al. (see `wave_kernel_signature`): seven steps wide,
    two widths away from either end. Here the width does not depend on the number of energies, which
    only decides how finely the bands are sampled.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> spectrum = sk.Spectrum(np.exp([0.0, 1.0, 2.0]), np.eye(3), np.ones(3))
    >>> sk.features.wave_energies(spectrum, 3)
    (array([0.28, 1.  , 1.72]), 0.14)
    """
    return _energies(solved(surface), count, width)


@checked
def wave_kernel_signature(
    surface: Solvable,
    energies: Annotated[ArrayLike | None, tuple] = None,
    *,
    count: int = 100,
    width: float | None = None,
    landmarks: ArrayLike | None = None,
    logarithm: bool = False,
) -> Floats:
    """Probability of finding a quantum particle of some energy at each point (WKS).

    Aubry, Schlickewei and Cremers, *The Wave Kernel Signature: A Quantum Mechanical Approach to
    Shape Analysis*, ICCV Workshops 2011.

    Parameters
    ----------
    surface : Spectrum, TriangleMesh, PointCloud, path or Laplacian
        As of `heat_kernel_signature`; zero modes, whose logarithm is no energy, are left out.
    energies : array_like of shape (e,), optional
        Logarithms of eigenvalues in the unit of `surface`; by default those of
        ``wave_energies(surface, count, width=width)``. One far outside the spectrum shows the
        nearest mode.
    count : int, default 100
        Number of energies where none are given.
    width : float, optional
        Standard deviation of the band around each energy, dimensionless; by default the one of
        `wave_energies`.
    landmarks : array_like of shape (l,), optional
        Indices of points: the correlation of each point with these, in place of its own
        probability; see `heat_kernel_signature`.
    logarithm : bool, default False
        Return logarithms of what the signature is in units of its mean 1/area, with a thousandth
        added, below which they would say nothing: without a unit. Not from landmarks.

    Returns
    -------
    ndarray of shape (n, e), or (n, l * e) from landmarks
        ``sum_i w_i u_i(x)^2 / sum_i w_i`` with ``w_i = exp(-(energy - log lambda_i)^2 / (2
        width^2))``, in 1/length^2; each column has the integral 1 over the surface. Multiplying
        lengths by s divides the signature at the default energies by s^2. From landmarks ``sum_i
        w_i u_i(landmark) u_i(x) / sum_i w_i``: all energies of the first, then of the second.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> laplacian = sk.robust_laplacian(sk.geometry.creature(1000))
    >>> spectrum = sk.eigensolve(laplacian, 50)
    >>> wks = sk.features.wave_kernel_signature(spectrum)
    >>> wks.shape, float((spectrum.mass @ wks).min())
    ((1000, 100), 1.0)
    """
    spectrum = solved(surface)
    modes, weights = _bands(spectrum, energies, count, width)
    if landmarks is not None:
        return seen_from_landmarks(modes, landmarks, weights, logarithm)
    signature = squares(modes, weights)
    return _logarithms(signature, spectrum.area) if logarithm else signature


@checked
@dataclass(frozen=True, kw_only=True)
class WaveKernelSignature(Isometric, Pooled):
    """Logarithms of `wave_kernel_signature`, at energies that all shapes share.

    Parameters
    ----------
    count : int, default 64
        Energies, evenly spaced.
    width : float, default 7
        Standard deviation of the band around each, in distances between energies.
    first : float, default 0.1
        The lowest energy is that which Weyl's law expects of the mode of this number, which is
        less than k; the highest that of the last mode.

    Notes
    -----
    The lowest modes tell the parts of a surface apart; they are also those that change the most
    where parts of a cloud touch. To tell whole shapes apart, and clouds above all, narrow bands
    without them do better: ``WaveKernelSignature(count=32, width=1.5, first=3)``.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> ball = sk.geometry.sphere(subdivisions=3).geometry
    >>> even = sk.features.embed(ball, sk.features.WaveKernelSignature(count=8), k=36)
    >>> bool((even.std(axis=0) < 0.1).all())
    True
    """

    count: int = 64
    width: float = 7.0
    first: float = 0.1

    def __post_init__(self) -> None:
        check_count("count", self.count, low=2)
        check_positive("width", self.width)
        check_positive("first", self.first)

    def of_points(self, surface: Surface) -> Floats:
        """Return (n, count), zero where a band has its mean over the area."""
        if surface.k <= self.first:
            raise InvalidInputError("k", f"be more than first = {self.first:g}", surface.k)
        spectrum = surface.spectrum
        low, high = (np.log(weyl(i, spectrum.dimension)) for i in (self.first, surface.k))
        energies = np.linspace(low, high, self.count)
        width = self.width * (energies[1] - energies[0])
        return _logarithms(squares(*_bands(spectrum, energies, width=width)), area=1.0)


def _energies(spectrum: Spectrum, count: int, width: float | None) -> tuple[Floats, float]:
    check_count("count", count, low=2)
    low, high, default = _range(spectrum)
    width = default if width is None else check_positive("width", width)
    if 4 * width >= high - low:
        raise InvalidInputError(
            "width",
            f"be below a quarter of the range {high - low:.3g} of log eigenvalues",
            f"{width:.3g}",
            advice=f"the default is {default:.3g}",
        )
    return np.linspace(low + 2 * width, high - 2 * width, count), width


def _range(spectrum: Spectrum) -> tuple[float, float, float]:
    """Return the logarithms of the first and last eigenvalue outside the kernel, and a width."""
    values = outside_kernel(spectrum).eigenvalues
    if values[0] == values[-1]:
        raise InvalidInputError(
            "surface",
            "have two different eigenvalues outside its kernel",
            f"{len(values)} times {values[0]:.3g}",
            advice="compute more modes, or give `width`",
        )
    low, high = float(np.log(values[0])), float(np.log(values[-1]))
    return low, high, _WIDTH * (high - low)


def _bands(
    spectrum: Spectrum,
    energies: Annotated[ArrayLike | None, tuple],
    count: int = 100,
    width: float | None = None,
) -> tuple[Spectrum, Floats]:
    """Return the modes outside the kernel and the weight of each in every band, (e, k)."""
    if energies is None:
        grid, width = _energies(spectrum, count, width)
    else:
        if isinstance(energies, tuple) and [np.ndim(e) > 0 for e in energies] == [True, False]:
            raise InvalidInputError(
                "energies",
                "be a vector",
                "a tuple of two as `wave_energies` returns it",
                advice="write `energies, width = wave_energies(spectrum)` and pass both",
            )
        grid = check_grid("energies", energies)
        width = _range(spectrum)[2] if width is None else check_positive("width", width)
    modes = outside_kernel(spectrum)
    away = (grid[:, None] - np.log(modes.eigenvalues)) / width
    return modes, shares(-0.5 * away**2)


def _logarithms(signature: Floats, area: float) -> Floats:
    return np.asarray(np.log(signature * area + _REST))
