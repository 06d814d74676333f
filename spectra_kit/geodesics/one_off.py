"""`geodesic_distance`: one call, one field."""

from __future__ import annotations

from numpy.typing import ArrayLike

from spectra_kit._checked import checked
from spectra_kit.geodesics.heat import Boundary, HeatGeodesics
from spectra_kit.geodesics.result import DistanceField
from spectra_kit.geodesics.solvers import Automatic, Solver
from spectra_kit.geodesics.sources import SourcesLike
from spectra_kit.geometry.shapes import Geometry
from spectra_kit.operators.intrinsic import IntrinsicTriangulation
from spectra_kit.spectra import Spectrum


@checked
def geodesic_distance(
    geometry: Geometry | IntrinsicTriangulation,
    sources: SourcesLike,
    *,
    spectrum: Spectrum | None = None,
    weights: ArrayLike | None = None,
    solver: Solver = Automatic(),  # noqa: B008
    time_coefficient: float = 1.0,
    boundary: Boundary = "neumann",
) -> DistanceField:
    """Measure distances to one set of sources; for several sets keep a `HeatGeodesics`.

    Parameters
    ----------
    geometry : TriangleMesh, PointCloud or IntrinsicTriangulation
        Of n points.
    sources : int, FacePoint, sequence or array of these, mask, or Sources
        See `check_sources`.
    spectrum : Spectrum, optional
        Modes of the geometry, to be quicker.
    weights : array_like of shape (s,), optional
        Heat that each source emits, 1 by default.
    solver : Direct, Iterative or Automatic, default Automatic()
        How linear systems are solved.
    time_coefficient : float, default 1.0
        Time of the heat step over the square of the typical edge.
    boundary : {"neumann", "dirichlet", "average"}, default "neumann"
        Of the heat step; all as in `HeatGeodesics`.

    Returns
    -------
    DistanceField
        The distances, and how they were found.

    Raises
    ------
    InvalidInputError, ConvergenceError
        As those do.

    See Also
    --------
    exact_distances : Of the polyhedron, exactly.
    spectral_distance : Roughly, from modes alone.
    spectra_kit.correspondence.geodesic_distances : Between pairs of vertices, along edges.

    Examples
    --------
    >>> from spectra_kit import geodesic_distance
    >>> from spectra_kit.geometry import rectangle
    >>> field = geodesic_distance(rectangle(n=1000).geometry, 0)
    >>> field.choice
    'direct: 1... points are few'
    """
    geodesics = HeatGeodesics(
        geometry, spectrum, solver=solver, time_coefficient=time_coefficient, boundary=boundary
    )
    return geodesics.distance(sources, weights=weights)
