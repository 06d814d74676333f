"""`geodesic_distance`: exact where that costs little, else by the heat method."""

from __future__ import annotations

from numpy.typing import ArrayLike

from spectra_kit._core.checked import checked
from spectra_kit._core.clock import Clock
from spectra_kit.eigen import Spectrum
from spectra_kit.geodesics.exact import EXACT, exact_or_none
from spectra_kit.geodesics.heat import Boundary, HeatGeodesics
from spectra_kit.geodesics.result import DistanceField
from spectra_kit.geodesics.solvers import Exact, Solver, WithinMemory
from spectra_kit.geodesics.sources import Sources, SourcesLike, check_sources
from spectra_kit.geometry import Geometry, GeometryLike, TriangleMesh
from spectra_kit.geometry.seams import warn_of_seams
from spectra_kit.operators.intrinsic import IntrinsicTriangulation


@checked
def geodesic_distance(
    geometry: GeometryLike | IntrinsicTriangulation,
    sources: SourcesLike,
    *,
    spectrum: Spectrum | None = None,
    weights: ArrayLike | None = None,
    solver: Solver = WithinMemory(),  # noqa: B008
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
    solver : Direct, Iterative or WithinMemory, default WithinMemory()
        How linear systems are solved. With the default, none is on a mesh of at most 2,000
        vertices: they take `exact_distances`, unless another of the options below is given.
    time_coefficient, boundary
        As of `HeatGeodesics`.

    Returns
    -------
    DistanceField
        The distances, and how they were found.

    See Also
    --------
    exact_distances : Of the polyhedron, exactly.
    spectral_distance : Roughly, from modes alone.
    spectra_kit.geodesics.pair_distances : Between pairs of vertices, along edges or exact.
    spectra_kit.geodesics.distance_matrix : From many sources, or all points.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> sk.geodesic_distance(sk.geometry.rectangle(n=1000).geometry, 0).choice
    'exact: at most 2000 vertices'
    >>> sk.geodesic_distance(sk.geometry.rectangle(n=3000).geometry, 0).choice
    'direct: factors of 3... points fit into 4 GiB'
    """
    plain = isinstance(solver, WithinMemory) and time_coefficient == 1 and boundary == "neumann"
    if plain and spectrum is None and weights is None:
        found = exact_field(geometry, sources)
        if found is not None and isinstance(geometry, TriangleMesh):
            warn_of_seams(geometry)  # as operators do, of which there is none here
            return found
    geodesics = HeatGeodesics(
        geometry, spectrum, solver=solver, time_coefficient=time_coefficient, boundary=boundary
    )
    return geodesics.distance(sources, weights=weights)


def exact_field(
    geometry: Geometry | IntrinsicTriangulation, sources: SourcesLike
) -> DistanceField | None:
    """Measure exact distances where they cost little and can be had, None elsewhere."""
    if not isinstance(geometry, TriangleMesh) or geometry.n > EXACT:
        return None
    if isinstance(sources, Sources) and sources.offsets.any():  # which points is not known
        return None
    clock, checked = Clock(), check_sources(sources, geometry)
    exact = exact_or_none(geometry, sources)
    if exact is None:
        return None
    return DistanceField(
        distance=exact,
        sources=checked,
        solver=Exact(),
        reason=f"at most {EXACT} vertices",
        seconds={"exact": clock.total},
    )
