"""Meshes at their own vertices: one connected part, at a resolution drawn from coarse to fine."""

from __future__ import annotations

import numpy as np

from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.components import largest_component
from spectra_kit.geometry.shapes import TriangleMesh
from spectra_kit.neo.train import surfaces as s


def at_resolution(
    mesh: TriangleMesh, rng: np.random.Generator, *, fewest: int, most: int
) -> TriangleMesh:
    """Return the largest part of a mesh, with `fewest` to `most` vertices, or somewhat fewer.

    Vertices and triangles stay as uneven as they are where their number fits. Of finer meshes, the
    vertices in the cells of a grid are joined, down to a number drawn at random, of all scales
    alike. Coarser ones are subdivided: each triangle into four alike, or the longest edges first.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.geometry import sphere
    >>> from spectra_kit.neo.train.meshes import at_resolution
    >>> fine, coarse = sphere(subdivisions=4).geometry, sphere(subdivisions=1).geometry
    >>> rng = np.random.default_rng(0)
    >>> [at_resolution(mesh, rng, fewest=200, most=600).n for mesh in (fine, coarse)]
    [384, 180]
    """
    wanted = round(float(np.exp(rng.uniform(np.log(fewest), np.log(most)))))
    evenly = rng.random() < 0.5
    part = connected(mesh)
    if part.n < fewest:
        part = _subdivided(part, fewest, evenly)
    return part if part.n <= most else _clustered(part, wanted)


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


def _clustered(mesh: TriangleMesh, wanted: int) -> TriangleMesh:
    """Join the vertices in each cell of a grid that leaves `wanted` at most.

    Any mesh can be so decimated; libigl's edge collapses never end on some.
    """
    size = 0.5 * float(np.sqrt(mesh.area / wanted))
    while True:
        cells = np.floor(mesh.points / size).astype(np.int64)
        which = np.unique(cells, axis=0, return_inverse=True)[1].ravel()
        counts = np.bincount(which)
        if len(counts) <= wanted:
            break
        size *= 1.05
    sums = np.column_stack([np.bincount(which, axis) for axis in mesh.points.T])
    return connected(TriangleMesh(sums / counts[:, None], which[mesh.faces]))
