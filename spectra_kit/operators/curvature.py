"""`curvature` at the points of a surface, by quadrics fitted to their neighbours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import sparse

from spectra_kit._core.checked import checked
from spectra_kit._core.records import Rebuilt, frozen
from spectra_kit._core.threads import in_threads, shares
from spectra_kit._core.types import Bools, Bytes, Floats, Ints, Ints32
from spectra_kit._core.validate import as_array, check_positive, quantity
from spectra_kit._core.warn import warn
from spectra_kit.errors import DoubtfulCurvatureWarning, InvalidInputError
from spectra_kit.geometry.seams import warn_of_seams
from spectra_kit.geometry.shapes import GeometryLike, PointCloud, TriangleMesh
from spectra_kit.operators.checks import check_faces_usable, unit_of, units_of
from spectra_kit.operators.oriented import is_inside_out, oriented_triangles

REACH = 3.0  # spacings of the points: some 30 neighbours where they are even
# Area vectors around a point sum to at least that share of their lengths: where they all but
# cancel, as at the tip of a needle or the rim of a foil, no plane is tangent.
_CANCELLED = 0.1
# Curvature times scale at which it is off by a third, as on a sphere or a torus: squared.
_COARSE = 2.0
_AGREE = 0.9  # share of the triangles of a cloud that agree on the side, below which it is in doubt
_WHY = (  # there is none, by the codes of failures from 1 on
    "with fewer than five neighbours, or all on a curve",
    "at which the normals of faces cancel",
    "whose faces are no single fan of one winding",
)


@checked
@dataclass(frozen=True, eq=False)
class Curvature(Rebuilt):
    """How a surface bends at each of n points; NaN where that is not known.

    Curvatures are positive where the surface bends away from its normals: on a ball whose normals
    point outwards.

    Parameters
    ----------
    principal : array_like of shape (n, 2)
        Principal curvatures, in 1/length, the larger first.
    directions : array_like of shape (n, 2, 3)
        Their directions, unit vectors that are right-handed with the normal. Where both
        curvatures are equal, which they are says nothing; nor do their signs.
    normals : array_like of shape (n, 3)
        Unit normals of the fitted quadrics.
    scale : array_like of shape (n,)
        How far the neighbours reach from which it was found, in length.

    Examples
    --------
    >>> from spectra_kit.operators import Curvature
    >>> bent = Curvature([[2.0, 0.5]], [[[1, 0, 0], [0, 1, 0]]], [[0, 0, 1]], [0.1])
    >>> print(bent.mean, bent.gaussian)
    [1.25] [1.]
    """

    principal: Floats
    directions: Floats
    normals: Floats
    scale: Floats

    def __post_init__(self) -> None:
        n = len(self.principal) if np.ndim(self.principal) else 0
        shapes = {"principal": (n, 2), "directions": (n, 2, 3), "normals": (n, 3), "scale": (n,)}
        for name, shape in shapes.items():
            array = as_array(name, getattr(self, name)).astype(np.float64)
            if array.shape != shape:
                raise InvalidInputError(name, f"have shape {shape}", array.shape)
            object.__setattr__(self, name, frozen(array))

    @property
    def n(self) -> int:
        """Number of points."""
        return len(self.principal)

    @property
    def mean(self) -> Floats:
        """Mean curvature, half the sum of both, shape (n,), in 1/length."""
        return np.asarray(self.principal.mean(axis=1))

    @property
    def gaussian(self) -> Floats:
        """Gaussian curvature, the product of both, shape (n,), in 1/length^2."""
        return np.asarray(self.principal.prod(axis=1))


@checked
def curvature(geometry: GeometryLike, *, scale: float | None = None) -> Curvature:
    """Fit a quadric to the neighbours of each point, and tell how it bends.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        With n points; windings of faces do not matter where `oriented_triangles` tells which side
        is out. Each vertex of a mesh has a face.
    scale : float, optional
        Distance within which neighbours count, in length; the nearer, the more. More smooths noise
        and details. By default three times the spacing of the points around each; more where that
        is too few for a fit.

    Returns
    -------
    Curvature
        Principal, mean and Gaussian curvatures, principal directions and normals.

    Raises
    ------
    InvalidInputError
        If the scale is larger than the shape, or no point has neighbours enough.

    Warns
    -----
    DoubtfulCurvatureWarning
        If it is not known at some points, and NaN there: at non-manifold vertices, where normals of
        faces cancel, or with fewer than five neighbours, or all on a curve. If most points bend so
        much within the scale that it is off by a third or more. If triangles of a cloud do not
        agree on the side that is out.

    Notes
    -----
    Cazals and Pouget, *Estimating Differential Quantities Using Polynomial Fitting of Osculating
    Jets*, CAGD 2005, of degree two, with weights ``(1 - (d / scale)^2)^2``. Neighbours are found
    along edges, of a cloud those of its local Delaunay triangles, and on the same side of the
    shape: never across a gap. The error falls with the square of the scale where neighbours lie
    evenly around a point, with its first power elsewhere, as at a boundary; at an edge or a corner
    what is found grows as the scale falls.

    Examples
    --------
    >>> from spectra_kit.geometry import sphere
    >>> from spectra_kit.operators import curvature
    >>> ball = sphere(subdivisions=4, radius=2.0).geometry
    >>> for one in (ball, ball.as_cloud()):
    ...     bent = curvature(one)
    ...     print(round(bent.mean.mean(), 2), round(bent.gaussian.mean(), 2))
    0.50 0.25
    0.50 0.25
    """
    from spectra_kit.operators._curvature_kernels import NO_PLANE, NO_SURFACE, fit_quadrics

    unit = unit_of(geometry)
    longest = float(np.ptp(geometry.points, axis=0).max())
    if scale is not None and check_positive("scale", scale) > longest:
        raise InvalidInputError(
            "scale", "be smaller than the shape", f"{scale:g} beside an extent of {longest:g}"
        )
    n = geometry.n
    if isinstance(geometry, TriangleMesh):
        check_faces_usable(geometry)
        units = units_of(geometry)
        points = geometry.points / units[:, None]
        around = _around_mesh(geometry, points)
    else:
        units, points = np.full(n, unit), geometry.points / unit
        around = _around_cloud(geometry, points)
    failures = np.where(around.normals.any(axis=1), 0, NO_PLANE).astype(np.uint8)
    failures[~around.whole] = NO_SURFACE
    reach = REACH * around.spacings if scale is None else scale / units
    principal, directions = np.full((n, 2), np.nan), np.full((n, 2, 3), np.nan)
    normals = np.full((n, 3), np.nan)
    given = (points, *around[:5], scale is None)
    out = (reach, principal, directions, normals, failures)
    in_threads(fit_quadrics, ((*given, *out, *cut) for cut in shares(n)))
    if failures.any():
        _tell_of(failures, scale)
    largest = np.abs(principal).max(axis=1)
    coarse = float(np.mean((reach * largest)[failures == 0] > _COARSE))
    if coarse > 1 / 2:
        warn(
            f"at {coarse:.0%} of the points the surface bends so much within the scale that"
            " curvature is off by about a third or more",
            DoubtfulCurvatureWarning,
            advice="take a finer geometry" if scale is None else "lower `scale`",
        )
    return Curvature(principal / units[:, None], directions, normals, reach * units)


class Surroundings(NamedTuple):
    """What surrounds each point; the first six as `fit_quadrics` takes them."""

    normals: Floats  # zero where no plane is tangent
    starts: Ints32
    rings: Ints32
    sizes: Ints32
    whole: Bools
    spacings: Floats
    vectors: Floats  # the sums of the area vectors of faces, twice as long as these are large
    areas: Floats  # the sums of their lengths
    rim: Bools


def _around_mesh(mesh: TriangleMesh, points: Floats) -> Surroundings:
    found = surroundings_of(points, mesh.faces)
    if found.rim.any():
        warn_of_seams(mesh)
    if not found.whole.all():
        return surroundings_of(points, oriented_triangles(mesh).faces)
    # As a rule all faces agree. Then it takes less to tell which side of each part is out: the
    # volume under a face is the mean of those under its corners.
    part, degrees = mesh.component_labels, np.diff(found.starts)
    middles = [np.bincount(part, degrees * x) / np.bincount(part, degrees) for x in points.T]
    offsets = points - np.column_stack(middles)[part]
    volumes = np.bincount(part, np.einsum("nr,nr->n", offsets, found.vectors)) / 18
    closed = np.bincount(part, found.rim) == 0
    turned = is_inside_out(volumes, np.bincount(part, found.areas) / 6, closed)
    found.normals[turned[part]] *= -1
    return found


def _around_cloud(cloud: PointCloud, points: Floats) -> Surroundings:
    oriented = oriented_triangles(cloud)
    if oriented.consistent < _AGREE:
        warn(
            "which side of the cloud is out is in doubt, and so are signs of curvature: only"
            f" {oriented.consistent:.0%} of its triangles agree",
            DoubtfulCurvatureWarning,
            advice="sheets that are as near as points of one need more points",
        )
    found = surroundings_of(points, oriented.faces)
    found.whole[:] = True  # each triangle is there for three points
    return found


def surroundings_of(points: Floats, faces: Ints) -> Surroundings:
    """Return what surrounds the points of triangles."""
    from spectra_kit.operators._curvature_kernels import surroundings

    n, corners = len(points), faces.astype(np.int32)
    three = np.arange(0, corners.size + 1, 3, dtype=np.int32)
    ones = np.ones(corners.size, bool)
    of_points = sparse.csr_array((ones, corners.ravel(), three), (len(faces), n)).tocsc()
    starts, around = of_points.indptr, of_points.indices
    rings, sizes = np.empty(2 * len(around), np.int32), np.empty(n, np.int32)
    vectors, areas, spacings = np.empty((n, 3)), np.empty(n), np.empty(n)
    whole, rim = np.empty(n, bool), np.empty(n, bool)
    given = (points, corners, starts, around, rings, sizes, vectors, areas, spacings, whole, rim)
    in_threads(surroundings, ((*given, *cut) for cut in shares(n)))
    lengths = np.linalg.norm(vectors, axis=1)
    plane = lengths > _CANCELLED * areas
    normals = np.divide(vectors, lengths[:, None], np.zeros((n, 3)), where=plane[:, None])
    return Surroundings(normals, starts, rings, sizes, whole, spacings, vectors, areas, rim)


def _tell_of(failures: Bytes, scale: float | None) -> None:
    """Warn of points without curvature; refuse a shape, or a scale, that leaves no others."""
    counts = np.bincount(failures, minlength=len(_WHY) + 1)[1:]
    found = "; ".join(f"{n:,} {why}" for n, why in zip(counts, _WHY, strict=True) if n)
    if failures.all():
        if scale is not None and counts[0]:
            advice = "two to five times the length of edges is usual"
            raise InvalidInputError("scale", "reach neighbours enough", f"{scale:g}", advice=advice)
        raise InvalidInputError("geometry", "have a point of known curvature", found)
    warn(
        f"curvature is not known at {quantity(int(counts.sum()), 'point')}, where it is NaN (the"
        f" first is {int(np.argmax(failures > 0))}): {found}",
        DoubtfulCurvatureWarning,
        advice="raise `scale`" if scale is not None and counts[0] else "",
    )
