"""Points of faces made vertices, and the way back to the faces that were there."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from spectra_kit._core.types import Floats, Ints
from spectra_kit.geodesics.sources import FacePoint
from spectra_kit.geometry import TriangleMesh

# Barycentric: this near to a corner or a side, a point is put on it. Thinner triangles than that
# would bend paths.
_AT = 1e-6


class Split(NamedTuple):
    """A mesh whose vertices certain points are."""

    mesh: TriangleMesh
    vertices: list[int]  # of each point
    faces: Ints  # (f,), the face that was there, of each face
    corners: Floats  # (m, 3, 3), barycentric coordinates, in it, of those of the last m faces

    def original(self, faces: Ints, weights: Floats) -> tuple[Ints, Floats]:
        """Return faces (p,) that were there, and barycentric coordinates (p, 3) in them."""
        new = faces - (len(self.faces) - len(self.corners))
        moved = weights.copy()
        inside = new >= 0
        moved[inside] = np.einsum("pc,pcb->pb", weights[inside], self.corners[new[inside]])
        return self.faces[faces], moved


def split_at(mesh: TriangleMesh, points: Iterable[int | FacePoint]) -> Split:
    """Return a mesh with vertices at all points, which its faces are cut for where needed.

    Vertices keep their numbers; new ones follow.
    """
    pieces: dict[int, list[_Piece]] = {}
    positions: list[Floats] = []
    vertices = []
    for point in points:
        if isinstance(point, int):
            vertices.append(point)
            continue
        _cut_open(mesh, pieces, [point.face])
        piece, inside = _holding(pieces[point.face], np.array(point.barycentric))
        near = np.flatnonzero(inside > _AT)
        around = [piece.vertices[c] for c in near]
        if len(around) == 1:
            vertices.append(around[0])
            continue
        new = mesh.n + len(positions)
        positions.append(point.position(mesh))
        vertices.append(new)
        on_edge = len(around) == 2
        if on_edge and max(around) < mesh.n:
            between = np.isin(mesh.faces, around).sum(axis=1) == 2
            _cut_open(mesh, pieces, np.flatnonzero(between).tolist())
        shares = inside[near] / inside[near].sum()
        for face in [*pieces] if on_edge else [point.face]:
            pieces[face] = [cut for part in pieces[face] for cut in part.cut(around, shares, new)]
    if not pieces:
        return Split(mesh, vertices, np.arange(len(mesh.faces)), np.empty((0, 3, 3)))
    whole = np.setdiff1d(np.arange(len(mesh.faces)), list(pieces))
    found = [(face, piece) for face, parts in sorted(pieces.items()) for piece in parts]
    return Split(
        TriangleMesh(
            np.vstack([mesh.points, *positions]),
            np.vstack([mesh.faces[whole], [piece.vertices for _, piece in found]]),
        ),
        vertices,
        np.append(whole, [face for face, _ in found]),
        np.stack([piece.corners for _, piece in found]),
    )


class _Piece(NamedTuple):
    """A triangle within a face: its vertices, and where they lie in the face, (3, 3)."""

    vertices: list[int]
    corners: Floats

    def cut(self, around: list[int], shares: Floats, new: int) -> list[_Piece]:
        """Return triangles in which a new vertex stands for each of `around` in turn.

        Itself where these are not all its own.
        """
        if not set(around) <= set(self.vertices):
            return [self]
        at = [self.vertices.index(v) for v in around]
        found = []
        for c in at:
            vertices, corners = list(self.vertices), self.corners.copy()
            vertices[c], corners[c] = new, shares @ self.corners[at]
            found.append(_Piece(vertices, corners))
        return found


def _cut_open(mesh: TriangleMesh, pieces: dict[int, list[_Piece]], faces: list[int]) -> None:
    """Add faces to those that are, or will be, in pieces."""
    for face in faces:
        pieces.setdefault(face, [_Piece(mesh.faces[face].tolist(), np.eye(3))])


def _holding(parts: list[_Piece], weights: Floats) -> tuple[_Piece, Floats]:
    """Return the piece that holds a point best, and its barycentric coordinates there."""
    inside = [np.linalg.solve(piece.corners.T, weights) for piece in parts]
    best = int(np.argmax([coordinates.min() for coordinates in inside]))
    return parts[best], np.asarray(inside[best])
