"""One body spoiled as scans are: a match should be as good, or be doubted.

Each is a function of the body's mesh and a generator, a line of `SPOILINGS`. Merges are those of
TOPKIDS (Lähner et al., *Matching of Deformable Shapes with Topological Noise*, 3DOR 2016): what
touches is one. Holes and cuts are those of SHREC'16 (Cosmo et al., *Partial Matching of Deformable
Shapes*, 3DOR 2016): around points, and by a plane; the largest piece is left.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import igl
import numpy as np
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from spectra_kit._core.types import Bools, Floats
from spectra_kit.errors import InvalidInputError
from spectra_kit.geodesics import edge_graph
from spectra_kit.geometry import Geometry, PointCloud, TriangleMesh, largest_component
from spectra_kit.geometry.implicit import polygonize
from spectra_kit.maps.surface import outward_normals
from spectra_kit.operators.oriented import oriented_triangles
from studies.matching.triangulations import columns, dense
from studies.shapes import mean_edge, vertex_areas

_SEEDS = 10  # holes, some of which meet
_FAR = 0.5  # along the surface, in roots of the area: parts that do not belong together
_TOUCH = 0.06  # in space: how near such parts come where they are said to touch
_MERGED = 0.02  # beyond the nearest pair: what grows together with it
_SOFT = 0.05  # roots of the area over which a dense half becomes a coarse one
_GRAZING = 0.2  # cosine of the angle below which a scanner sees nothing
_PITCH = 0.9  # edges of the body between rays


def clean(mesh: TriangleMesh, rng: np.random.Generator) -> TriangleMesh:
    """Return the mesh as it is."""
    return mesh


def merged(mesh: TriangleMesh, rng: np.random.Generator) -> TriangleMesh:
    """Fuse what nearly touches, as a hand and the thigh: balls fill the gaps, voxels tell the rest.

    As many vertices as before are left by quadrics. Raises InvalidInputError of a body no parts of
    which come near each other.
    """
    unit = np.sqrt(mesh.area)
    ways = dijkstra(edge_graph(mesh), directed=False)
    i, j = cKDTree(mesh.points).query_pairs(_TOUCH * unit, output_type="ndarray").T
    away = ways[i, j] > _FAR * unit
    i, j = i[away], j[away]
    if not len(i):
        raise InvalidInputError("mesh", "have parts that touch", "none", advice="take another pose")
    gaps = np.linalg.norm(mesh.points[i] - mesh.points[j], axis=1)
    near = gaps < gaps.min() + _MERGED * unit
    middles = cKDTree((mesh.points[i] + mesh.points[j])[near] / 2)
    radius = gaps[near].max() / 2 + mean_edge(mesh)
    fine, cell = dense(mesh, rng), 0.5 * mean_edge(mesh)

    def field(points: Floats) -> Floats:
        kind = igl.SIGNED_DISTANCE_TYPE_FAST_WINDING_NUMBER
        body = igl.signed_distance(points, fine.points, fine.faces, kind)[0]
        return np.asarray(np.minimum(body, middles.query(points)[0] - radius))

    low, high = mesh.points.min(axis=0) - 4 * cell, mesh.points.max(axis=0) + 4 * cell
    cells = int(np.prod((high - low) / cell))
    made = largest_component(
        TriangleMesh(*polygonize(field, low, high, n_cells=cells, stride=2))
    ).mesh
    points, faces, *_ = igl.qslim(*columns(made.points, made.faces), 2 * mesh.n)
    return TriangleMesh(points, faces).without_unreferenced()


def holes(mesh: TriangleMesh, rng: np.random.Generator, *, share: float) -> TriangleMesh:
    """Take so much of the area away around ten points."""
    seeds = rng.choice(mesh.n, _SEEDS, replace=False)
    sizes = rng.uniform(0.5, 1.5, _SEEDS)
    far = dijkstra(edge_graph(mesh), directed=False, indices=seeds) / sizes[:, None]
    return _left(mesh, _beyond(mesh, far.min(axis=0), share))


def ragged(mesh: TriangleMesh, rng: np.random.Generator) -> TriangleMesh:
    """Make holes of 2 % of the area and gnaw at their rims: a third of the triangles, twice."""
    left = holes(mesh, rng, share=0.02)
    for _ in range(2):
        at_rim = np.isin(left.faces, left.boundary_vertices).any(axis=1)
        kept = ~at_rim | (rng.random(len(left.faces)) > 1 / 3)
        left = largest_component(TriangleMesh(left.points, left.faces[kept])).mesh
    return left


def cut(mesh: TriangleMesh, rng: np.random.Generator, *, share: float) -> TriangleMesh:
    """Take so much of the area away beyond a plane that stands anywhere."""
    return _left(mesh, _beyond(mesh, mesh.points @ rng.normal(size=3), share))


def noisy(mesh: TriangleMesh, rng: np.random.Generator, *, edges: float) -> TriangleMesh:
    """Move vertices along their normals, by so many edges: the standard deviation."""
    normals = outward_normals(mesh.points, oriented_triangles(mesh))
    steps = edges * mean_edge(mesh) * rng.normal(size=(mesh.n, 1))
    return mesh.with_points(mesh.points + steps * normals)


def uneven(mesh: TriangleMesh, rng: np.random.Generator) -> TriangleMesh:
    """Make one half, beyond a plane that stands anywhere, four times as coarse as the other.

    The shortest edges of the dense mesh are collapsed as if one half were twice as large.
    """
    fine, way = dense(mesh, rng), rng.normal(size=3)
    heights = fine.points @ way / (np.linalg.norm(way) * np.sqrt(mesh.area))
    middle = fine.points[np.abs(heights - np.median(heights)).argmin()]
    sizes = 1 + 1 / (1 + np.exp(-(heights - np.median(heights)) / _SOFT))
    rows = np.hstack([(fine.points - middle) * sizes[:, None], 1e-3 * fine.points])
    moved, faces, *_ = igl.decimate(*columns(rows, fine.faces), 2 * mesh.n)
    back = np.ascontiguousarray(moved[:, 3:]) * 1e3
    _, _, placed = igl.point_mesh_squared_distance(back, fine.points, fine.faces)
    return TriangleMesh(placed, faces)


def turned(mesh: TriangleMesh, rng: np.random.Generator) -> TriangleMesh:
    """Turn one face in a hundred over."""
    faces = mesh.faces.copy()
    some = rng.choice(len(faces), len(faces) // 100, replace=False)
    faces[some] = faces[some][:, ::-1]
    return TriangleMesh(mesh.points, faces)


def scanned(mesh: TriangleMesh, rng: np.random.Generator, *, views: int) -> PointCloud:
    """Look at the mesh from so many sides around it, each with rays about an edge apart.

    Of each ray the nearest point counts, unless the surface is grazed; it is off along the ray by a
    tenth of an edge. What no view sees is missing.
    """
    edge = mean_edge(mesh)
    fine = dense(dense(mesh, rng), rng)
    normals = outward_normals(fine.points, oriented_triangles(fine))
    first, second, axis = np.linalg.svd(fine.points - fine.points.mean(axis=0), False)[2][[1, 2, 0]]
    seen, start = [], rng.uniform(0, 2 * np.pi)
    for angle in start + 2 * np.pi * np.arange(views) / views:
        ray = np.cos(angle) * first + np.sin(angle) * second  # towards the viewer
        across = np.column_stack([np.cross(axis, ray), axis])
        pixels = np.floor(fine.points @ across / (_PITCH * edge)).astype(np.int64)
        order = np.lexsort([-(fine.points @ ray), *pixels.T])
        _, nearest = np.unique(pixels[order], axis=0, return_index=True)
        hit = order[nearest]
        hit = hit[normals[hit] @ ray > _GRAZING]
        seen.append(fine.points[hit] + 0.1 * edge * rng.normal(size=(len(hit), 1)) * ray)
    return PointCloud(np.vstack(seen)).without_duplicates()


def _beyond(mesh: TriangleMesh, far: Floats, share: float) -> Bools:
    """Tell which vertices are left where so much of the area goes, what is nearest first."""
    order = np.argsort(far, kind="stable")
    left = np.empty(mesh.n, dtype=bool)
    left[order] = np.cumsum(vertex_areas(mesh)[order]) > share * mesh.area
    return left


def _left(mesh: TriangleMesh, left: Bools) -> TriangleMesh:
    """Return the largest piece of the faces most corners of which are left."""
    faces = mesh.faces[left[mesh.faces].sum(axis=1) >= 2]
    return largest_component(TriangleMesh(mesh.points, faces)).mesh


#: Name -> what it makes of a closed mesh with a generator; merges first, as they may refuse.
SPOILINGS: dict[str, Callable[[TriangleMesh, np.random.Generator], Geometry]] = {
    "clean": clean,
    "merged": merged,
    "holes 5 %": partial(holes, share=0.05),
    "holes 15 %": partial(holes, share=0.15),
    "holes 30 %": partial(holes, share=0.3),
    "ragged rims": ragged,
    "cut 10 %": partial(cut, share=0.1),
    "cut 30 %": partial(cut, share=0.3),
    "noise": partial(noisy, edges=0.5),
    "uneven": uneven,
    "turned faces": turned,
    "scan, 4 views": partial(scanned, views=4),
    "scan, 2 views": partial(scanned, views=2),
}
