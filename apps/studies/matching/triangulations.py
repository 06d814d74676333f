"""One body in six triangulations, with its landmarks: a match should not depend on which it is.

All but marching cubes are fine where the body's mesh is: with edges of one length it has no
fingers. Each is a function of the mesh of the body and a generator, a line of `TRIANGULATIONS`.
Landmarks go to the nearest vertex, so that each has an error of its own: `rounding` says how large
it is.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

import igl
import numpy as np
from scipy.spatial import cKDTree

from spectra_kit._core.types import Floats, Ints
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import Geometry, PointCloud, TriangleMesh, largest_component
from spectra_kit.geometry.implicit import polygonize
from spectra_kit.interop import to_pyvista
from spectra_kit.maps.surface import outward_normals
from spectra_kit.operators.oriented import oriented_triangles
from studies.matching.subjects import LACKING, Subject
from studies.shapes import loop_subdivided, mean_edge

#: Makes something of the mesh of a body, with a generator.
Maker = Callable[[TriangleMesh, np.random.Generator], Geometry]

_TURN = 0.1  # of the root of the area: what a turn by one radian counts like, anisotropic
_CUBES = 2  # vertices of marching cubes for one of the body: fewer lose the fingers
_CUT = 1.5  # vertices of marching cubes for each face of a cube that the area would fill


def isotropic(mesh: TriangleMesh, rng: np.random.Generator) -> TriangleMesh:
    """Return the mesh as it is: the sets are remeshed so."""
    return mesh


def anisotropic(mesh: TriangleMesh, rng: np.random.Generator) -> TriangleMesh:
    """Make triangles that are long where the surface bends little, and short across.

    The shortest edges of the dense mesh are collapsed in the space of positions and normals, where
    they are all alike in the end (Lévy and Bonneel, *Variational Anisotropic Surface Meshing with
    Voronoi Parallel Linear Enumeration*, IMR 2012); what is left lies on the dense mesh again.
    """
    fine = dense(mesh, rng)
    normals = outward_normals(fine.points, oriented_triangles(fine))
    rows = np.hstack([fine.points, _TURN * np.sqrt(fine.area) * normals])
    moved, faces, *_ = igl.decimate(*columns(rows, fine.faces), 2 * mesh.n)
    back = np.ascontiguousarray(moved[:, :3])
    _, _, placed = igl.point_mesh_squared_distance(back, fine.points, fine.faces)
    return TriangleMesh(placed, faces)


def quadric(mesh: TriangleMesh, rng: np.random.Generator) -> TriangleMesh:
    """Simplify the dense mesh by quadrics: large triangles where it is flat."""
    fine = dense(mesh, rng)
    points, faces, *_ = igl.qslim(*columns(fine.points, fine.faces), 2 * mesh.n)
    return TriangleMesh(points, faces)


def dense(mesh: TriangleMesh, rng: np.random.Generator) -> TriangleMesh:
    """Split every triangle in four and smooth, after Loop."""
    return loop_subdivided(mesh)


def finer(mesh: TriangleMesh, n: int) -> TriangleMesh:
    """Split edges at their middles, the longest ones, until there are at least `n` vertices.

    Vertices of `mesh` keep their numbers, and the surface is the same.
    """
    made = surface = to_pyvista(mesh)
    length = 2 * np.sqrt(mesh.area / n)  # twice the edges of squares of a vertex each
    while made.n_points < n:
        made = surface.subdivide_adaptive(max_edge_len=length)
        length *= 0.95
    return TriangleMesh(made.points, made.regular_faces)


def marching_cubes(mesh: TriangleMesh, rng: np.random.Generator) -> TriangleMesh:
    """Polygonize the inside of the dense mesh, with twice the vertices, slivers and all.

    Raises InvalidInputError if the largest component has another topology: bodies that touch
    themselves grow together, and are another surface then.
    """
    fine = dense(mesh, rng)
    cell = np.sqrt(_CUT * fine.area / (_CUBES * mesh.n))
    low, high = fine.points.min(axis=0) - 2 * cell, fine.points.max(axis=0) + 2 * cell
    inside = igl.SIGNED_DISTANCE_TYPE_FAST_WINDING_NUMBER

    def field(points: Floats) -> Floats:
        distances: Floats = igl.signed_distance(points, fine.points, fine.faces, inside)[0]
        return distances

    cells = int(np.prod((high - low) / cell))
    cubes = TriangleMesh(*polygonize(field, low, high, n_cells=cells, stride=2))
    found = largest_component(cubes).mesh
    if _euler(found) != _euler(mesh):
        raise InvalidInputError(
            "mesh",
            "keep its topology in marching cubes",
            f"Euler characteristic {_euler(found)} for {_euler(mesh)}",
            advice="take a body that does not touch itself",
        )
    return found


def cloud(mesh: TriangleMesh, rng: np.random.Generator) -> PointCloud:
    """Draw as many points, at random in triangles drawn at random: as dense as the mesh is."""
    drawn = mesh.faces[rng.choice(len(mesh.faces), mesh.n, replace=False)]
    weights = rng.dirichlet(np.ones(3), mesh.n)
    return PointCloud(np.einsum("nc,ncr->nr", weights, mesh.points[drawn]))


#: Name -> what it makes of a closed mesh with a generator.
TRIANGULATIONS: dict[str, Maker] = {
    "isotropic": isotropic,
    "anisotropic": anisotropic,
    "quadric": quadric,
    "dense": dense,
    "marching cubes": marching_cubes,
    "cloud": cloud,
}


#: Of all makers, those that may refuse a body: they are asked first.
REFUSE = ("marching cubes", "merged")


def remade(subject: Subject, kind: str, makers: Mapping[str, Maker], *, seed: int = 0) -> Subject:
    """Return a subject as one of the makers makes it, each landmark at the point nearest to it.

    ``NAME-KIND`` is its name. A landmark that is farther from the surface than half an edge of the
    subject, of a cloud a whole one from its points, is lacking: marching cubes lose fingers.
    """
    mesh = subject.mesh
    made = makers[kind](mesh, np.random.default_rng(seed))
    apart, nearest = cKDTree(made.points).query(mesh.points)
    if isinstance(made, TriangleMesh):
        squares, *_ = igl.point_mesh_squared_distance(mesh.points, made.points, made.faces)
        apart = 2 * np.sqrt(squares)
    nearest = np.where(apart > mean_edge(mesh), LACKING, nearest)
    mirrored = subject.mirrored
    return Subject(
        named(subject.name, kind),
        made,
        nearest[subject.landmarks],
        None if mirrored is None else nearest[mirrored],
    )


def named(name: str, kind: str) -> str:
    """Return the name of what is made of a subject, or of a set, for files."""
    return f"{name}-{re.sub('[^a-z0-9.]+', '_', kind).strip('_')}"


def rounding(subject: Subject, made: Subject) -> float:
    """Return the mean distance of landmarks from where they were, in 100 / root of the area."""
    there = made.landmarks != LACKING
    before = subject.geometry.points[subject.landmarks[there]]
    apart = np.linalg.norm(before - made.geometry.points[made.landmarks[there]], axis=1)
    return float(100 * apart.mean() / np.sqrt(subject.mesh.area))


def _euler(mesh: TriangleMesh) -> int:
    return mesh.n - len(mesh.unique_edges[0]) + len(mesh.faces)


def columns(points: Floats, faces: Ints) -> tuple[Floats, Ints]:
    """Return the arrays as libigl wants them where it changes them."""
    return np.asfortranarray(points), np.asfortranarray(faces.astype(np.int32))
