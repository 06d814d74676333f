"""`shortened_path`: the shortest path that winds around a surface as a given one does."""

from __future__ import annotations

import igl
import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.checked import checked
from spectra_kit._core.validate import check_indices
from spectra_kit.errors import InvalidInputError
from spectra_kit.geodesics.paths import SurfacePath
from spectra_kit.geodesics.sources import points_named
from spectra_kit.geometry import MeshLike
from spectra_kit.geometry.shapes import box_unit
from spectra_kit.geometry.winding import turn, wound_against


@checked
def shortened_path(mesh: MeshLike, vertices: ArrayLike, *, closed: bool = False) -> SurfacePath:
    """Pull a path along edges tight, without lifting it over what it winds around.

    Sharp and Crane, *You can find geodesic paths in triangle meshes by just flipping edges*, ACM
    Transactions on Graphics 39 (6), 2020; by potpourri3d, whose points are located on faces here.

    Parameters
    ----------
    mesh : TriangleMesh
        Manifold, and orientable.
    vertices : array_like of shape (m,), integers
        What the path passes, one after the other, by the shortest ways along edges. Two or more;
        three or more if it is closed.
    closed : bool, default False
        Go on from the last to the first, which may be named again: a loop, with no ends.

    Returns
    -------
    SurfacePath
        Locally shortest: no small change makes it shorter. Of a loop, the first point is its last
        again; one that winds around nothing becomes an edge, walked there and back.

    Examples
    --------
    Around a torus through its hole, which no shortest path between two points does:

    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> torus = sk.geometry.torus(n=2000, minor=0.3).geometry
    >>> inner = [[0.7 * np.cos(a), 0.7 * np.sin(a), 0] for a in (-2, 0, 2)]
    >>> stops = [int(np.argmin(np.linalg.norm(torus.points - p, axis=1))) for p in inner]
    >>> loop = sk.geodesics.shortened_path(torus, stops, closed=True)
    >>> bool(abs(loop.length / (2 * np.pi * 0.7) - 1) < 0.02)  # on the inner equator
    True
    """
    import potpourri3d as pp3d

    chain = check_indices("vertices", vertices, mesh.n)
    least = 3 if closed else 2
    if closed and chain.ndim == 1 and len(chain) > least and chain[0] == chain[-1]:
        chain = chain[:-1]  # said twice
    if chain.ndim != 1 or len(chain) < least or (np.diff(chain) == 0).any():
        expected = f"name {least} or more vertices, none twice in a row"
        raise InvalidInputError("vertices", expected, f"{chain.ravel()[:9].tolist()}")
    points_named("vertices", chain, mesh)
    labels = mesh.component_labels[chain]
    if (labels != labels[0]).any():
        raise InvalidInputError("vertices", "lie on one component", "vertices of several")
    turned, clashes = wound_against(mesh)
    faces = turn(mesh.faces, turned)
    two_faces = not clashes and mesh.unique_edges[1].max() <= 2
    if not two_faces or not igl.is_vertex_manifold(faces)[mesh.referenced_vertices].all():
        raise InvalidInputError(
            "mesh",
            "be an orientable manifold",
            "edges of several faces, vertices with several fans, or one side only",
            advice="geodesic_path takes any mesh",
        )
    unit = box_unit(mesh.points)
    points = mesh.points / unit
    solver = pp3d.EdgeFlipGeodesicSolver(points, faces)
    find = solver.find_geodesic_loop if closed else solver.find_geodesic_path_poly
    line = np.asarray(find(chain.tolist()))
    middles = (line[1:] + line[:-1]) / 2
    part = np.flatnonzero(mesh.component_labels[faces[:, 0]] == labels[0])
    _, face, _ = igl.point_mesh_squared_distance(middles, points, faces[part])
    held = part[np.append(face, face[-1])]
    corners = [np.ascontiguousarray(points[faces[held, c]]) for c in range(3)]
    weights = np.maximum(igl.barycentric_coordinates(line, *corners), 0.0)
    return SurfacePath(line * unit, held, weights / weights.sum(axis=1, keepdims=True))
