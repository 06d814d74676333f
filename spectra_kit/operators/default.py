"""The operator that fits a geometry, where none is asked for."""

from __future__ import annotations

from spectra_kit._checked import checked
from spectra_kit.geometry.shapes import Geometry, TriangleMesh
from spectra_kit.operators.assemble import robust_laplacian
from spectra_kit.operators.delaunay import delaunay_laplacian
from spectra_kit.operators.laplacian import Laplacian


@checked
def laplacian(geometry: Geometry) -> Laplacian:
    """Build the Laplacian that fits: `robust_laplacian` of a mesh, `delaunay_laplacian` of a cloud.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        With n points.

    Returns
    -------
    Laplacian
        Neumann; mass in the squared length unit of `geometry`.

    Raises
    ------
    InvalidInputError
        As of the two.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> sk.laplacian(sk.geometry.sphere(subdivisions=2).geometry).n
    162
    """
    if isinstance(geometry, TriangleMesh):
        return robust_laplacian(geometry)
    return delaunay_laplacian(geometry)
