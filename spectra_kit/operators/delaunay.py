"""`delaunay_laplacian`: the Laplacian of an intrinsic Delaunay triangulation."""

from __future__ import annotations

from spectra_kit._checked import checked
from spectra_kit.geometry.shapes import Geometry
from spectra_kit.operators.intrinsic import intrinsic_delaunay
from spectra_kit.operators.laplacian import Laplacian


@checked
def delaunay_laplacian(
    geometry: Geometry, *, mollify_factor: float = 1e-5, n_neighbors: int = 30
) -> Laplacian:
    """Build the intrinsic Delaunay Laplacian of a mesh or a point cloud.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        With n points.
    mollify_factor : float, default 1e-5
        Intrinsic mollification of (near) degenerate triangles, relative to their mean side.
    n_neighbors : int, default 30
        Of a cloud: candidates for the triangles of a point; see `intrinsic_delaunay`.

    Returns
    -------
    Laplacian
        Neumann; edge weights are not negative beyond rounding; mass in the squared length unit
        of `geometry`. The same bits whatever the number of threads.

    Raises
    ------
    InvalidInputError, ConvergenceError
        As `intrinsic_delaunay`, whose Laplacian this is.

    Examples
    --------
    >>> from spectra_kit import delaunay_laplacian
    >>> from spectra_kit.geometry import sphere
    >>> mesh = sphere(subdivisions=3).geometry
    >>> round(delaunay_laplacian(mesh).area, 2), round(delaunay_laplacian(mesh.as_cloud()).area, 2)
    (12.51, 12.51)
    """
    return intrinsic_delaunay(
        geometry, mollify_factor=mollify_factor, n_neighbors=n_neighbors
    ).laplacian
