"""What distances are compared with, in the tests of this folder."""

import igl
import numpy as np


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
