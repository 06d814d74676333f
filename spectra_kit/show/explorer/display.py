"""What is drawn in the browser: modes, on the whole geometry or on fewer points in its place."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from spectra_kit._core.types import Floats, Ints
from spectra_kit.eigen import Spectrum
from spectra_kit.eigen.metrics import Comparison, align_modes
from spectra_kit.geometry.normals import estimate_normals, orient_normals
from spectra_kit.geometry.shapes import Geometry, PointCloud, TriangleMesh
from spectra_kit.show.modes import display_signs

_TRIES = 6


def functions_of(
    exact: Spectrum, predicted: Spectrum | None, comparison: Comparison | None
) -> list[Floats]:
    """Modes (n, k) as they are shown: exact, then those of `predicted` aligned to them, if any.

    In the scale and with the signs of `plot_modes`.
    """
    vectors = exact.eigenvectors[:, : exact.k if comparison is None else comparison.k]
    factor = np.sqrt(exact.area) * display_signs(vectors)
    functions = [factor * vectors]
    if predicted is not None:
        functions.append(factor * align_modes(exact, predicted, comparison))
    return functions


def for_display(geometry: Geometry, max_points: int) -> tuple[Geometry, sparse.csr_array]:
    """Return a geometry of at most about `max_points` points s, and how values get there, (s, n).

    A mesh loses edges by quadric decimation (Garland and Heckbert, 1997), and functions are
    interpolated linearly at the closest points of the full mesh. Of a cloud, one point in each cell
    of a grid is kept. Rows of the matrix sum to one.
    """
    n = geometry.n
    if n <= max_points:
        return geometry, sparse.eye_array(n, format="csr")
    if isinstance(geometry, TriangleMesh):
        coarse = _decimated(geometry, max_points)
        return coarse, _closest(coarse.points, geometry)
    kept = _thinned(geometry.points, max_points)
    return PointCloud(geometry.points[kept]), sparse.eye_array(n, format="csr")[kept]


def _decimated(mesh: TriangleMesh, max_points: int) -> TriangleMesh:
    """A mesh with about as many vertices as asked for, or fewer."""
    import pyvista as pv

    # In a unit box: VTK's tolerances, and single precision in places, do not know the scale.
    low, size = mesh.points.min(axis=0), float(np.ptp(mesh.points, axis=0).max()) or 1.0
    faces = np.column_stack([np.full(len(mesh.faces), 3), mesh.faces])
    coarse = pv.PolyData((mesh.points - low) / size, faces=faces.ravel())
    for _ in range(_TRIES):  # what is asked for is a share of the triangles, not of the vertices
        if coarse.n_points <= max_points:
            break
        coarse = coarse.decimate(1.0 - 0.99 * max_points / coarse.n_points)
    points = np.asarray(coarse.points, dtype=np.float64) * size + low
    return TriangleMesh(points, np.asarray(coarse.regular_faces)).without_unreferenced()


def _closest(points: Floats, mesh: TriangleMesh) -> sparse.csr_array:
    """Linear interpolation on the triangles of `mesh` at the points closest to `points`."""
    import igl

    _, face, at = igl.point_mesh_squared_distance(points, mesh.points, mesh.faces)
    corners = mesh.faces[face]
    a, b, c = (np.ascontiguousarray(mesh.points[corners[:, i]]) for i in range(3))
    weights = np.asarray(igl.barycentric_coordinates(at, a, b, c))
    # A triangle without area has no such coordinates: its nearest corner will do.
    distances = np.stack([np.linalg.norm(at - corner, axis=1) for corner in (a, b, c)], axis=1)
    flat = ~np.isfinite(weights).all(axis=1) | (np.abs(weights).max(axis=1) > 2)
    weights = np.clip(weights, 0.0, 1.0)
    weights[flat] = np.eye(3)[np.argmin(distances[flat], axis=1)]
    weights /= weights.sum(axis=1, keepdims=True)
    rows = np.repeat(np.arange(len(points)), 3)
    return sparse.csr_array((weights.ravel(), (rows, corners.ravel())), shape=(len(points), mesh.n))


def _thinned(points: Floats, max_points: int) -> Ints:
    """Indices of points that lie in different cells of the finest grid with few enough cells."""
    low, size = points.min(axis=0), float(np.ptp(points, axis=0).max()) or 1.0
    coarse, fine = 1.0, 1e6  # cells along the longest side
    kept = np.zeros(1, dtype=np.int64)
    for _ in range(30):
        cells = np.sqrt(coarse * fine)
        grid = np.floor((points - low) * (cells / size)).astype(np.int64)
        first = _first_of_each(grid)
        if len(first) <= max_points:
            kept, coarse = first, cells
            if len(first) > 0.98 * max_points:
                break
        else:
            fine = cells
    return kept


def _first_of_each(rows: Ints) -> Ints:
    """Index of the first of each distinct row, ascending."""
    side = int(rows.max()) + 1  # at most 1e6: three digits of that base fit 64 bits
    keys = (rows[:, 0] * side + rows[:, 1]) * side + rows[:, 2]
    return np.sort(np.unique(keys, return_index=True)[1]).astype(np.int64)


def normal_steps(cloud: PointCloud) -> NDArray[np.int64]:
    """Unit normals (n, 3) in steps of 1/127; zero where there are too few points for any."""
    if cloud.n < 4:
        return np.zeros((cloud.n, 3), dtype=np.int64)
    return np.round(127 * orient_normals(cloud, estimate_normals(cloud))).astype(np.int64)
