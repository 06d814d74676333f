"""Meshes at their own vertices: one connected part, at a resolution drawn from coarse to fine."""

from __future__ import annotations

import igl
import numpy as np

from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.components import largest_component
from spectra_kit.geometry.shapes import TriangleMesh
from spectra_kit.training import surfaces as s


def at_resolution(
    mesh: TriangleMesh, rng: np.random.Generator, *, fewest: int, most: int
) -> TriangleMesh:
    """Return the largest part of a mesh, with `fewest` to `most` vertices, or somewhat fewer.

    Vertices and triangles stay as uneven as they are where their number fits. Finer meshes are
    decimated to a number drawn at random, of all scales alike: by shortest edges, which evens them,
    or by quadrics, which keeps sharp edges and leaves long triangles beside them. Coarser ones are
    subdivided: each triangle into four alike, or the longest edges first.

    Raises
    ------
    InvalidInputError
        If an edge of a mesh that is to be decimated has more than two faces.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.geometry import sphere
    >>> from spectra_kit.training.meshes import at_resolution
    >>> fine, coarse = sphere(subdivisions=4).geometry, sphere(subdivisions=1).geometry
    >>> rng = np.random.default_rng(0)
    >>> [bool(200 <= at_resolution(m, rng, fewest=200, most=600).n <= 600) for m in (fine, coarse)]
    [True, True]
    """
    wanted = round(float(np.exp(rng.uniform(np.log(fewest), np.log(most)))))
    evenly = rng.random() < 0.5
    part = connected(mesh)
    if part.n < fewest:
        part = _subdivided(part, fewest, evenly)
    return part if part.n <= most else _decimated(part, wanted, most, evenly)


def connected(mesh: TriangleMesh) -> TriangleMesh:
    """Return the largest part of a mesh without doubled vertices and faces, or faces of no area."""
    merged = mesh.with_merged_vertices()
    proper = (merged.faces != np.roll(merged.faces, 1, axis=1)).all(axis=1)
    if not proper.any():
        raise InvalidInputError("mesh", "have a face of three vertices", "none")
    sound = TriangleMesh(merged.points, merged.faces[proper]).without_degenerate_faces()
    return largest_component(sound.without_duplicate_faces()).mesh


def _subdivided(mesh: TriangleMesh, fewest: int, evenly: bool) -> TriangleMesh:
    longest = float(np.linalg.norm(np.ptp(mesh.points, axis=0)))
    while mesh.n < fewest:
        if evenly:
            mesh = s.quartered(mesh)
        else:
            longest *= 0.8
            mesh = s.bisected(mesh, longest).with_merged_vertices()
    return mesh


def _decimated(mesh: TriangleMesh, wanted: int, most: int, evenly: bool) -> TriangleMesh:
    """Return about `wanted` vertices, and `most` at most."""
    if mesh.unique_edges[1].max() > 2:  # which libigl cannot decimate, and may crash on
        raise InvalidInputError("mesh", "be manifold, to be decimated", "edges of several faces")
    decimate = igl.decimate if evenly else igl.qslim
    for share in (1.0, 0.8, 0.6):
        # As many faces for each vertex as there are now: two where the mesh is closed.
        goal = max(4, round(share * wanted * len(mesh.faces) / mesh.n))
        points, faces = decimate(mesh.points, mesh.faces.astype(np.int64), goal)[:2]
        if len(faces) > 0 and len(points) <= most:
            return connected(TriangleMesh(points, faces))
    raise InvalidInputError("mesh", f"have {most} vertices when it is decimated", "more")
