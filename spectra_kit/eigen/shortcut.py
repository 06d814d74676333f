"""From a geometry to its spectrum in one call."""

from __future__ import annotations

from spectra_kit._core.checked import checked
from spectra_kit.eigen.automatic import Automatic
from spectra_kit.eigen.base import Eigensolver
from spectra_kit.eigen.solve import eigensolve
from spectra_kit.eigen.spectrum import Spectrum
from spectra_kit.geometry import Geometry
from spectra_kit.operators import laplacian


@checked
def spectrum(geometry: Geometry, k: int, solver: Eigensolver = Automatic()) -> Spectrum:  # noqa: B008
    """Compute the k lowest modes of a surface, by `laplacian` and `eigensolve`.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        With n points.
    k : int
        Number of modes, zero modes included.
    solver : Eigensolver, default Automatic()
        As in `eigensolve`.

    Returns
    -------
    Spectrum
        Certified.

    Raises
    ------
    InvalidInputError, ConvergenceError, InvalidSpectrumError, OutOfMemoryError
        As of `laplacian` and `eigensolve`.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> sk.spectrum(sk.geometry.sphere(subdivisions=3).geometry, 4).eigenvalues.round(1)
    array([0., 2., 2., 2.])
    """
    return eigensolve(laplacian(geometry), k, solver)
