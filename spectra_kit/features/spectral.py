"""Embeddings by a spectrum, exact or predicted: they do not see how a surface lies in space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_count, check_positive
from spectra_kit.errors import InvalidInputError
from spectra_kit.features.base import Change, Pooled, Surface
from spectra_kit.features.distances import global_point_signature
from spectra_kit.features.heat import heat_kernel_signature
from spectra_kit.features.shape_dna import shape_dna
from spectra_kit.features.wave import wave_kernel_signature

_LONGEST = 1.0  # time in units of the area, by when heat has spread over all of most surfaces
_REST = 1e-3  # of the mean: added to wave signatures, whose logarithms say nothing below it


class _Isometric:
    @property
    def invariant_to(self) -> frozenset[Change]:
        """Rotation, scale, isometry and sampling."""
        return frozenset({"rotation", "scale", "isometry", "sampling"})


def _weyl(k: float) -> float:
    """Return what Weyl's law expects of eigenvalue number k of a surface of area one."""
    return 4 * np.pi * k


@checked
@dataclass(frozen=True, kw_only=True)
class HeatSignature(_Isometric, Pooled):
    """Logarithms of the heat kernel signature, at times that all shapes share.

    Parameters
    ----------
    count : int, default 16
        Times, evenly spaced in their logarithms, from that in which the last mode of Weyl's law has
        died down to 1e-4 to the area of the surface.

    Raises
    ------
    InvalidInputError
        If `count` is less than 2.

    References
    ----------
    J. Sun, M. Ovsjanikov, L. Guibas, "A concise and provably informative multi-scale signature
    based on heat diffusion", Computer Graphics Forum 28(5), 2009.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> ball = sk.geometry.sphere(subdivisions=3).geometry
    >>> even = sk.features.embed(ball, sk.features.HeatSignature(count=4), k=36)
    >>> bool((even.std(axis=0) < 0.1).all())
    True
    """

    count: int = 16

    def __post_init__(self) -> None:
        check_count("count", self.count, low=2)

    def of_points(self, surface: Surface) -> Floats:
        """Return (n, count), zero where all heat has spread evenly."""
        shortest = 4 * np.log(10) / _weyl(surface.k)
        times = np.geomspace(shortest, _LONGEST, self.count)
        return np.log(heat_kernel_signature(surface.spectrum, times))


@checked
@dataclass(frozen=True, kw_only=True)
class WaveSignature(_Isometric, Pooled):
    """Logarithms of the wave kernel signature, at energies that all shapes share.

    Parameters
    ----------
    count : int, default 64
        Energies, evenly spaced in their logarithms.
    width : float, default 7
        Standard deviation of the band around each, in distances between energies.
    first : float, default 0.1
        The lowest energy is that which Weyl's law expects of the mode of this number, the highest
        that of the last mode.

    Raises
    ------
    InvalidInputError
        If `count` is less than 2, `width` or `first` not positive; of points, if the spectrum has
        no more than `first` modes.

    Notes
    -----
    The lowest modes tell the parts of a surface apart; they are also those that change the most
    where parts of a cloud touch. To tell whole shapes apart, and clouds above all, narrow bands
    without them do better: ``WaveSignature(count=32, width=1.5, first=3)``.

    References
    ----------
    M. Aubry, U. Schlickewei, D. Cremers, "The wave kernel signature: a quantum mechanical approach
    to shape analysis", ICCV Workshops, 2011.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> ball = sk.geometry.sphere(subdivisions=3).geometry
    >>> even = sk.features.embed(ball, sk.features.WaveSignature(count=8), k=36)
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
        energies = np.linspace(np.log(_weyl(self.first)), np.log(_weyl(surface.k)), self.count)
        width = self.width * (energies[1] - energies[0])
        return np.log(wave_kernel_signature(surface.spectrum, energies, width=width) + _REST)


@checked
@dataclass(frozen=True, kw_only=True)
class GlobalPoints(_Isometric, Pooled):
    """Magnitudes of the global point signature: each point by the modes, over their frequencies.

    Parameters
    ----------
    count : int, default 32
        Modes outside the kernel.

    Raises
    ------
    InvalidInputError
        If `count` is less than 1.

    Notes
    -----
    Signs do not count, but modes whose eigenvalues are near each other mix under small
    deformations, and these columns with them; those of `HeatSignature` and `WaveSignature` do not.

    References
    ----------
    R. M. Rustamov, "Laplace-Beltrami eigenfunctions for deformation invariant shape
    representation", Symposium on Geometry Processing, 2007.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> cloud = sk.geometry.creature(800)
    >>> sk.features.embed(cloud, sk.features.GlobalPoints(count=8), k=32).shape
    (800, 8)
    """

    count: int = 32

    def __post_init__(self) -> None:
        check_count("count", self.count, low=1)

    def of_points(self, surface: Surface) -> Floats:
        """Return (n, count)."""
        return np.abs(global_point_signature(surface.spectrum, self.count))


@checked
@dataclass(frozen=True, kw_only=True)
class ShapeDNA(_Isometric):
    """The eigenvalues outside the kernel over those of Weyl's law, in logarithms.

    Parameters
    ----------
    count : int, default 30
        Eigenvalues.

    Raises
    ------
    InvalidInputError
        If `count` is less than 1.

    References
    ----------
    M. Reuter, F.-E. Wolter, N. Peinecke, "Laplace-Beltrami spectra as 'Shape-DNA' of surfaces and
    solids", Computer-Aided Design 38(4), 2006.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> ball = sk.geometry.sphere(subdivisions=4).geometry
    >>> sk.features.embed_shape(ball, sk.features.ShapeDNA(count=3), k=4)
    array([ 0.69...,  0.00..., -0.4...])
    """

    count: int = 30

    def __post_init__(self) -> None:
        check_count("count", self.count, low=1)

    def of_points(self, surface: Surface) -> Floats:
        """Refuse: eigenvalues are of the whole surface."""
        raise InvalidInputError(
            "embedding",
            "be one of points",
            "ShapeDNA, which is one of whole surfaces",
            advice="call `embed_shape`",
        )

    def of_all(self, surface: Surface) -> Floats:
        """Return (count,): ``log(lambda_i area / (4 pi i))``."""
        dna = shape_dna(surface.spectrum, self.count)
        return np.log(dna / _weyl(1) / np.arange(1, self.count + 1))
