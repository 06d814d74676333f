"""From a geometry to its spectrum in one call."""

from __future__ import annotations

from spectra_kit._checked import checked
from spectra_kit.eigensolvers.automatic import Automatic
from spectra_kit.eigensolvers.base import Eigensolver
from spectra_kit.eigensolvers.solve import eigensolve
from spectra_kit.geometry import Geometry
from spectra_kit.operators import laplacian
from spectra_kit.spectra import Spectrum


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
