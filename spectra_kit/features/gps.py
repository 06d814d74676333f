"""The global point signature: each point by its values in the modes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_count
from spectra_kit.eigen import Spectrum
from spectra_kit.features._spectra import Isometric, Solvable, outside_kernel, solved
from spectra_kit.features.embedding import Pooled, Surface


@checked
def global_point_signature(surface: Solvable, count: int | None = None) -> Floats:
    """Each point as its values in the first modes, over the roots of their eigenvalues (GPS).

    Rustamov, *Laplace-Beltrami Eigenfunctions for Deformation Invariant Shape Representation*, SGP
    2007.

    Parameters
    ----------
    surface : Spectrum, TriangleMesh, PointCloud, path or Laplacian
        As of `wave_kernel_signature`.
    count : int, optional
        Number of modes; by default all outside the kernel.

    Returns
    -------
    ndarray of shape (n, count)
        ``u_i(x) / sqrt(lambda_i)``, dimensionless. Signs, and bases inside eigenspaces, are those
        of the spectrum: compare two surfaces by what does not see them, as the distances
        within each (`commute_time_distances` are the square root of the area times these).

    Notes
    -----
    Inner products of rows are Green's function of the Laplacian, which on a surface has no finite
    value on the diagonal: norms grow as the root of log k.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> spectrum = sk.Spectrum(np.array([0.0, 4.0, 25.0]), np.eye(3), np.ones(3))
    >>> sk.features.global_point_signature(spectrum)
    array([[0. , 0. ],
           [0.5, 0. ],
           [0. , 0.2]])
    """
    return _gps(solved(surface), count)


@checked
@dataclass(frozen=True, kw_only=True)
class GlobalPointSignature(Isometric, Pooled):
    """Magnitudes of `global_point_signature`: each point by the modes, over their frequencies.

    Parameters
    ----------
    count : int, default 32
        Modes outside the kernel.

    Notes
    -----
    Signs do not count, but modes whose eigenvalues are near each other mix under small
    deformations, and these columns with them; those of `HeatKernelSignature` and
    `WaveKernelSignature` do not.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> cloud = sk.geometry.creature(800)
    >>> sk.features.embed(cloud, sk.features.GlobalPointSignature(count=8), k=32).shape
    (800, 8)
    """

    count: int = 32

    def __post_init__(self) -> None:
        check_count("count", self.count, low=1)

    def of_points(self, surface: Surface) -> Floats:
        """Return (n, count)."""
        return np.abs(_gps(surface.spectrum, self.count))


def _gps(spectrum: Spectrum, count: int | None) -> Floats:
    modes = outside_kernel(spectrum)
    if count is not None:
        modes = modes.truncate(check_count("count", count, low=1, high=modes.k))
    return np.asarray(modes.eigenvectors / np.sqrt(modes.eigenvalues))
