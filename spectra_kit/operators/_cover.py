"""From triangles in space to a cover without boundary, flipped to Delaunay, and its Laplacian."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import sparse

from spectra_kit._core.threads import in_threads, ranges
from spectra_kit._core.types import Bools, Floats, Ints, Ints32
from spectra_kit._core.validate import quantity
from spectra_kit.errors import ConvergenceError, InvalidInputError
from spectra_kit.geometry.shapes import Geometry, PointCloud, TriangleMesh, distinct_rows
from spectra_kit.operators._assembly import cotangent_laplacian, mark_outsized
from spectra_kit.operators._edge_flips import (
    ROUNDING,
    both_faces,
    flip_in_order,
    flip_to_delaunay,
    glue,
    pair_sides,
    side_lengths,
    sides_by_corner,
)
from spectra_kit.operators._tufted import tufted_cover
from spectra_kit.operators.checks import check_cloud_usable, mean_edges, units_of
from spectra_kit.operators.local_delaunay import FirstStars, local_triangles

MOLLIFY, NEIGHBORS = 1e-5, 30  # by default
_BLOCK = 4096  # points of one task: fixed, so that nothing depends on the number of threads
# Of a half-edge, before giving up. Clouds need 0.14 at most, but n slivers that fan out from one
# point, as in flat parts of technical models, n / 32.
_FLIPS = 1000
_LIBRARY = 2e-6  # sums of cotangents so far below zero are zero to the library robust_laplacian
# Circles through the corners of a triangle are no larger, for the distance of the 30th neighbour,
# between random points on a sphere; along a boundary they are.
_WIDE = 1.5


class Cover(NamedTuple):
    """A cover on which each triangle is there `copies` times; the Laplacian is of one."""

    corners: Ints32
    lengths: Floats
    copies: int
    boundary: Ints
    stiffness: sparse.csr_array
    mass: Floats


def plain_cover(geometry: Geometry) -> Cover:
    """Return the cover of `delaunay_laplacian`, as it is by default and with less ado.

    Of a mesh whose faces are usable; and nothing is told of seams, or of parts near each other.
    """
    if isinstance(geometry, TriangleMesh):
        return mesh_cover(geometry, MOLLIFY)
    return cloud_cover(ordered_cloud(geometry, NEIGHBORS), MOLLIFY)


def mesh_cover(mesh: TriangleMesh, mollify_factor: float) -> Cover:
    unit = units_of(mesh)
    points = mesh.points / unit[:, None]
    corners = mesh.faces.astype(np.int32)
    lengths = side_lengths(points, corners, mollify_factor)
    corners, lengths, twins, copies = cover_of_faces(points, corners, lengths)
    make_delaunay(corners, lengths, twins)
    names = np.arange(mesh.n, dtype=np.int32)
    stiffness, mass = laplacian_of(corners, lengths, twins, names, copies)
    lengths *= unit[corners[:, :1]]
    boundary = np.empty(0, dtype=np.int64) if copies == 1 else mesh.boundary_vertices
    return Cover(corners, lengths, copies, boundary, stiffness, mass * unit**2)


def cover_of_faces(
    points: Floats, corners: Ints32, lengths: Floats
) -> tuple[Ints32, Floats, Ints32, int]:
    """Glue the faces of a mesh (f, 3) to a surface without boundary.

    Return corners, lengths and twins of its triangles, and how often each face is there: once, or
    as a front and a back in turn.
    """
    sides = sides_by_corner(corners, len(points))
    twins = np.empty(3 * len(corners), dtype=np.int32)
    if pair_sides(corners, *sides, twins):
        return corners, lengths, twins, 1
    return *_front_and_back(points, corners, lengths, sides, sharpest=2.0), 2


def tufted_delaunay(
    mesh: TriangleMesh, sides: Floats
) -> tuple[Ints32, Floats, Ints32, tuple[Ints32, Floats]]:
    """Find the triangles of the library robust_laplacian: a front and a back of each face, flipped.

    Return their corners, lengths and twins, and the flips as `undo_flips` takes them back.
    """
    faces: Ints32 = mesh.faces.astype(np.int32)
    edge = distinct_rows(mesh.edges)[1]
    starts = np.append(0, np.cumsum(np.bincount(edge)))
    twins, leads = np.empty(2 * len(edge), np.int32), np.empty(len(edge), np.int32)
    points = mesh.points / mean_edges(mesh)[:, None]
    tufted_cover(points, faces, starts, np.argsort(edge, kind="stable"), twins, leads)
    corners, lengths = both_faces(faces, sides)
    most = _FLIPS * len(twins)
    ended, flipped, before = flip_in_order(
        corners.reshape(-1), lengths.reshape(-1), twins, leads, most, _LIBRARY
    )
    _check_ended(ended, most)
    return corners, lengths, twins, (flipped, before)


def folded(slopes: Floats, copies: int) -> Floats:
    """Add up what belongs to the sides (f, 3) of each face, of those of its copies."""
    if copies == 1:
        return slopes
    front, back = slopes.reshape(-1, 2, 3).swapaxes(0, 1)
    return np.asarray(front + back[:, ::-1])  # whose sides run the other way: see `both_faces`


class OrderedCloud(NamedTuple):
    """A cloud as triangles are looked for: neighbours in space are neighbours in memory."""

    cloud: PointCloud
    n_neighbors: int
    order: Ints32
    unit: float
    points: Floats  # in this order and unit, in which any cloud is of a size about 1


def ordered_cloud(cloud: PointCloud, n_neighbors: int) -> OrderedCloud:
    from scipy.spatial import cKDTree  # slow to import

    n_neighbors, unit = check_cloud_usable(cloud, n_neighbors)
    order = cKDTree(cloud.points).indices.astype(np.int32)
    return OrderedCloud(cloud, n_neighbors, order, unit, cloud.points[order] / unit)


def cloud_cover(
    ordered: OrderedCloud, mollify_factor: float, first: FirstStars | None = None
) -> Cover:
    cloud, n_neighbors, order, unit, points = ordered
    triangles, closed, reach = local_triangles(points, n_neighbors, first)
    lengths = side_lengths(points, triangles, mollify_factor)
    at_boundary = order[_is_boundary(triangles, lengths, closed, reach)]
    corners, lengths, twins = _front_and_back(
        points, triangles, lengths, sides_by_corner(triangles, cloud.n), sharpest=0.0
    )
    make_delaunay(corners, lengths, twins)
    copies = 6  # three stars, a front and a back
    stiffness, mass = laplacian_of(corners, lengths, twins, order, copies)
    if not mass.all():
        raise InvalidInputError(
            "geometry",
            "have triangles at all points",
            f"{quantity((mass == 0).sum(), 'point')} in no triangle (such as"
            f" {int(np.argmin(mass))}), whose neighbours lie on one line",
            advice="remove such curves first",
        )
    boundary = np.sort(at_boundary).astype(np.int64)
    lengths *= unit
    return Cover(corners, lengths, copies, boundary, stiffness, mass * unit**2)


def _front_and_back(
    points: Floats,
    triangles: Ints32,
    lengths: Floats,
    sides: tuple[Ints32, Ints32, Ints32],
    *,
    sharpest: float,
) -> tuple[Ints32, Floats, Ints32]:
    """Return corners and lengths of both faces of each triangle, shape (2 t, 3), and the twins.

    Triangles continue each other only if the cosine of the angle between them is below `sharpest`.
    """
    twins = np.empty(6 * len(triangles), dtype=np.int32)
    shared = (points, triangles, *sides, sharpest, twins)
    in_threads(glue, ((*shared, *rows) for rows in ranges(len(points), _BLOCK)))
    return *both_faces(triangles, lengths), twins


def make_delaunay(
    corners: Ints32,
    lengths: Floats,
    twins: Ints32,
    *,
    recorded: bool = False,
) -> tuple[Ints32, Floats]:
    """Flip edges, in place, until the angles opposite each sum to at most pi.

    Return the flips, as `undo_flips` takes them back.
    """
    most = _FLIPS * len(twins)
    ended, flipped, before = flip_to_delaunay(
        corners.reshape(-1), lengths.reshape(-1), twins, most, ROUNDING, recorded
    )
    _check_ended(ended, most)
    return flipped, before


def _check_ended(ended: bool, most: int) -> None:
    if not ended:
        raise ConvergenceError(
            "the triangles of `geometry` must become Delaunay by edge flips, got no end to them"
            f" after {most}; raise `mollify_factor`, or drop points that nearly coincide"
        )


def laplacian_of(
    corners: Ints32, lengths: Floats, twins: Ints32, names: Ints32, copies: int
) -> tuple[sparse.csr_array, Floats]:
    """Return stiffness and lumped mass of one copy of the surface.

    With corner i at ``names[i]``, which `corners` are written over with.
    """
    n = len(names)
    ends, columns, entries, mass = cotangent_laplacian(
        corners.reshape(-1), lengths.reshape(-1), twins, names, copies
    )
    if not np.isfinite(entries).all():
        once = columns < np.repeat(np.arange(n), np.diff(ends))  # each edge
        broken = once & ~np.isfinite(entries)
        raise InvalidInputError(
            "mollify_factor",
            "lengthen the sides of degenerate triangles",
            f"{quantity(broken.sum(), 'weight')} of triangles of no area",
            advice="raise it",
        )
    return sparse.csr_array((entries, columns, ends), shape=(n, n)), mass


def _is_boundary(triangles: Ints32, lengths: Floats, closed: Bools, reach: Floats) -> Bools:
    """Mark points whose star is open, or has a triangle far too large for the points around it.

    Such triangles fill the bays of a sampled boundary.
    """
    marked = ~closed
    mark_outsized(triangles, lengths, _WIDE * reach, marked)
    return marked
