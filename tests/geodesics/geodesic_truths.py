"""What distances are compared with, in the tests of this folder."""

import igl
import numpy as np
import pytest

from spectra_kit.errors import DoubtfulDistanceWarning
from spectra_kit.geometry import TriangleMesh

# Of a cube, in the order of (x, y, z).
CORNERS = [[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]
QUADS = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]


too_large = pytest.warns(DoubtfulDistanceWarning, match="triangles are too large")


def cube():
    """With two triangles to a face."""
    return TriangleMesh(CORNERS, [[q[0], q[i], q[i + 1]] for q in QUADS for i in (1, 2)])


def flat_square(scale=1.0):
    """Of two triangles."""
    corners = scale * np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    return TriangleMesh(corners, [[0, 1, 2], [0, 2, 3]])


def middle_of(mesh):
    """The vertex nearest to the mean of all."""
    return int(np.argmin(np.linalg.norm(mesh.points - mesh.points.mean(axis=0), axis=1)))


def soup(mesh):
    """The same triangles, each a part of its own."""
    faces = np.arange(3 * len(mesh.faces)).reshape(-1, 3)
    return TriangleMesh(mesh.points[mesh.faces].reshape(-1, 3), faces)


def straight(points, source):
    """Distances in space from one of the points."""
    return np.linalg.norm(points - points[source], axis=1)


def angles(points, source):
    """Distances on the unit sphere from one of its points."""
    return np.arccos(np.clip(points @ points[source], -1, 1))


def by_libigl(mesh, *sources):
    """Exact distances to the nearest of some vertices."""
    every, none = np.arange(mesh.n), np.empty(0, dtype=np.int64)
    points, faces = np.array(mesh.points), np.array(mesh.faces)
    return igl.exact_geodesic(points, faces, np.array(sources), none, every, none)


def relative_error(distance, truth):
    """Mean over all points but the sources; the same points must be out of reach."""
    distance = np.asarray(distance)
    np.testing.assert_array_equal(np.isfinite(distance), np.isfinite(truth))
    away = (truth > 0) & np.isfinite(truth)
    return float((np.abs(distance[away] - truth[away]) / truth[away]).mean())
