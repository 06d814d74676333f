"""`exact_distances`: lengths of shortest paths on a polyhedron, without any discretisation."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_indices
from spectra_kit.errors import ConvergenceError, InvalidInputError
from spectra_kit.geodesics.sources import SourcesLike, points_named
from spectra_kit.geodesics.splits import split_at
from spectra_kit.geometry import MeshLike, TriangleMesh
from spectra_kit.geometry.shapes import component_units
from spectra_kit.operators.checks import check_three_corners

if TYPE_CHECKING:
    from spectra_kit.geodesics._exact_kernels import Front, Soup


# Vertices up to which exact distances cost no more than is noticed. One field takes 0.013, 0.030
# and 0.067 s of one core at 500, 1,000 and 2,000 vertices (geometric means of four models; at most
# 0.076), while the heat method takes 0.008, 0.009 and 0.014 s before the first source.
EXACT = 2_000
# A vertex is a saddle where its angles exceed a full turn by more than their rounding.
_SADDLE = 1e-9
# Least side, as a share of the mean one of its component, and least height over a side.
_FLAT = 1e-12
# Windows for each face and vertex before giving up; the bunny needs 38.
_WINDOWS = 3000
# Rays part at a vertex; beside a face whose height is a smaller share of its sides than this, they
# leave a gap at the next vertex in line, which paths that bend here then fill.
_NEEDLE = 1e-8


@checked
def exact_distances(
    mesh: MeshLike, sources: SourcesLike, *, targets: ArrayLike | None = None
) -> Floats:
    """Measure the exact distance along the triangles from the nearest source to each vertex.

    Parameters
    ----------
    mesh : TriangleMesh
        With n vertices. Any topology: where more than two faces meet in an edge, or fans of faces
        in a vertex, paths lead across to each of them. The winding does not matter.
    sources : int, FacePoint, sequence or array of these, or mask of shape (n,)
        See `check_sources`.
    targets : array_like of shape (t,), integers, optional
        Only the distances of these vertices (default: all). It stops as soon as they are known:
        near ones cost less.

    Returns
    -------
    ndarray of shape (n,) or (t,)
        In the length unit of `mesh`, to a relative accuracy of about 1e-9; infinite where no path
        leads, so at vertices that no face uses.

    Raises
    ------
    ConvergenceError
        If paths would go round and round triangles that are extremely thin; `partial` then holds
        distances that may be too long.

    Notes
    -----
    Windows of straight paths are continued from face to face, nearest first, and dropped where a
    vertex is known to offer shorter ways (Chen and Han, *Shortest paths on a polyhedron*, SoCG
    1990, as improved by Xin and Wang, ACM Transactions on Graphics 28 (4), 2009). Paths bend only
    at vertices with more than a full turn of faces around, or on the boundary. At an edge of more
    than two faces a window keeps the part that no other reaches as soon.

    A face without area counts as one whose heights are 1e-12 of its sides.

    libigl has the same distances, to which the tests hold these; but not where more than two faces
    meet in an edge, and it does not stop at `targets`.

    Examples
    --------
    Over the faces of a cube to the opposite corner, a path crosses two unfolded squares:

    >>> import spectra_kit as sk
    >>> points = [[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    >>> faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
    >>> faces += [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    >>> sk.geodesics.exact_distances(sk.TriangleMesh(points, faces), 0)[[1, 3, 7]]
    array([1.    , 1.4142, 2.2360])
    """
    named = points_named("sources", sources, mesh)
    ends = np.arange(mesh.n) if targets is None else check_indices("targets", targets, mesh.n)
    split = split_at(mesh, named)
    return propagated(split.mesh, np.unique(split.vertices), ends).distances[ends]


class Propagated(NamedTuple):
    """What is known of the shortest paths from some vertices."""

    distances: Floats
    """Of all vertices, in length; infinite where no path leads, or none was asked for."""
    soup: Soup
    front: Front


def propagated(mesh: TriangleMesh, sources: Ints, targets: Ints) -> Propagated:
    """Measure distances, as `exact_distances`, until those of `targets` are known."""
    from spectra_kit.geodesics._exact_kernels import propagate  # numba is slow to import

    distances = np.full(mesh.n, np.inf)
    # Targets that no path reaches would keep it searching everywhere, in vain.
    label = mesh.component_labels
    reachable = targets[np.isin(label[targets], label[sources])]
    soup, unit = soup_of(mesh)
    most = _WINDOWS * (len(mesh.faces) + mesh.n)
    front = propagate(soup, sources, np.unique(reachable), distances, most)
    with np.errstate(over="ignore", invalid="ignore"):  # unreached and of no size: inf * 0
        found = np.where(np.isfinite(distances), distances * unit, np.inf)
    if (np.isfinite(distances) & ~np.isfinite(found)).any():
        raise InvalidInputError(
            "mesh",
            "have distances that are numbers",
            f"some above {np.finfo(float).max:.1e}",
            advice="choose another unit of length",
        )
    if front.size[5] > most:
        raise ConvergenceError(
            f"exact paths need more than {most} windows; `mesh` has triangles so thin that they"
            " go round and round: remesh, or take geodesic_distance(mesh, sources)",
            partial=found,
        )
    return Propagated(found, soup, front)


def soup_of(mesh: TriangleMesh) -> tuple[Soup, Floats]:
    """Return what `propagate` needs to know of the triangles, and what counts as 1 (n,)."""
    from spectra_kit.geodesics._exact_kernels import Soup

    check_three_corners(mesh)
    faces = mesh.faces
    tails, heads = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    # In units of each component, no power of a length overflows.
    unit, label = component_units(mesh), mesh.component_labels[faces[:, 0]]
    points = mesh.points / np.where(unit > 0, unit, 1.0)[:, None]
    lengths = np.linalg.norm(points[heads] - points[tails], axis=1).reshape(-1, 3)
    lengths[unit[faces[:, 0]] == 0] = 1.0  # times 0: all points coincide
    mean = np.bincount(label, lengths.sum(axis=1)) / np.maximum(3 * np.bincount(label), 1)
    lengths = np.maximum(lengths, _FLAT * mean[label, None])
    x, y, angles = _triangles(lengths)

    # Sides on one edge, linked in a ring.
    edge = np.minimum(tails, heads) * mesh.n + np.maximum(tails, heads)
    order = np.argsort(edge, kind="stable")
    starts = np.flatnonzero(np.diff(edge[order], prepend=-1))
    counts = np.diff(starts, append=len(edge))
    following = np.roll(order, -1)
    following[starts + counts - 1] = order[starts]
    around = np.empty_like(order)
    around[order] = following

    # Where the faces around a vertex are no single fan that closes, or a saddle, paths may bend.
    bends = np.bincount(tails, weights=angles.ravel(), minlength=mesh.n) > 2 * np.pi + _SADDLE
    odd = np.isin(edge, edge[order][starts[counts != 2]])
    bends[tails[odd]] = bends[heads[odd]] = True
    bends |= _fans(tails, around, mesh.n) > 1
    bends[faces[y.min(axis=1) <= _NEEDLE * lengths.max(axis=1)]] = True

    corners = np.argsort(tails, kind="stable")
    first = np.searchsorted(tails[corners], np.arange(mesh.n + 1))
    lengths, x, y = (values.ravel() for values in (lengths, x, y))
    return Soup(np.array(tails), lengths, x, y, around, first, corners, bends), unit


def _triangles(lengths: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the apex over each side, x and y, and the angle at its tail; each of shape (f, 3)."""
    a, b, c = np.sort(lengths, axis=1).T[::-1]
    # Heron's formula as Kahan writes it, accurate for needles too.
    square = (a + (b + c)) * (c - (a - b)) * (c + (a - b)) * (a + (b - c))
    twice_area = 0.5 * np.sqrt(np.maximum(square, 0.0))[:, None]
    following, before = np.roll(lengths, -1, axis=1), np.roll(lengths, 1, axis=1)
    # (l^2 + p^2 - q^2) / 2 l, with the difference of squares as a product.
    x = 0.5 * (lengths + (before - following) / lengths * (before + following))
    y = np.maximum(twice_area / lengths, _FLAT * lengths)
    return x, y, np.arctan2(y, x)


def _fans(tails: Ints, around: Ints, n: int) -> Ints:
    """Count the fans of faces at each vertex: faces that share a side there are in one."""
    sides = np.arange(len(tails))
    same = tails[around] == tails
    # The corner at the head of a side is the tail of the next side of its face.
    head = sides - sides % 3 + (sides + 1) % 3
    i = np.concatenate([sides, head])
    j = np.concatenate([np.where(same, around, head[around]), np.where(same, head[around], around)])
    graph = sparse.coo_array((np.ones(len(i), dtype=bool), (i, j)), shape=(len(sides),) * 2)
    count, label = connected_components(graph, directed=False)
    vertex = np.empty(count, dtype=np.int64)
    vertex[label] = tails
    return np.bincount(vertex, minlength=n)


def exact_or_none(mesh: TriangleMesh, sources: SourcesLike) -> Floats | None:
    """Return exact distances from vertices; None where triangles are too thin for them."""
    try:
        return exact_distances(mesh, sources)
    except ConvergenceError:
        return None
