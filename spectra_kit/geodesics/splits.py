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
    vertices: list[int]
    """Of each point."""
    faces: Ints
    """The face that was there, of each face (f,)."""
    corners: Floats
    """Barycentric coordinates, in it, of the corners of the last of these faces, (m, 3, 3)."""

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
        face, weights = point.face, np.array(point.barycentric)
        piece, inside = _holding(_pieces(mesh, pieces, face), weights)
        near = inside > _AT
        if near.sum() == 1:
            vertices.append(piece.vertices[int(np.argmax(inside))])
            continue
        new = mesh.n + len(positions)
        positions.append(point.position(mesh))
        vertices.append(new)
        if near.all():
            pieces[face].remove(piece)
            pieces[face] += [piece.with_corner(c, new, weights) for c in range(3)]
            continue
        a, b = (piece.vertices[c] for c in np.flatnonzero(near))
        share = inside[near][1] / inside[near].sum()
        _split_edge(mesh, pieces, a, b, new, share)
    whole = np.setdiff1d(np.arange(len(mesh.faces)), list(pieces))
    cut = [(face, piece) for face, parts in sorted(pieces.items()) for piece in parts]
    if not cut:
        return Split(mesh, vertices, np.arange(len(mesh.faces)), np.empty((0, 3, 3)))
    return Split(
        TriangleMesh(
            np.vstack([mesh.points, *positions]),
            np.vstack([mesh.faces[whole], [piece.vertices for _, piece in cut]]),
        ),
        vertices,
        np.append(whole, [face for face, _ in cut]),
        np.stack([piece.corners for _, piece in cut]),
    )


class _Piece:
    """A triangle within a face: its vertices, and where they lie in the face, (3, 3)."""

    def __init__(self, vertices: list[int], corners: Floats) -> None:
        self.vertices, self.corners = vertices, corners

    def with_corner(self, c: int, vertex: int, weights: Floats) -> _Piece:
        vertices, corners = list(self.vertices), self.corners.copy()
        vertices[c], corners[c] = vertex, weights
        return _Piece(vertices, corners)


def _pieces(mesh: TriangleMesh, pieces: dict[int, list[_Piece]], face: int) -> list[_Piece]:
    """Return what a face is cut into, which it is from now on."""
    return pieces.setdefault(face, [_Piece(mesh.faces[face].tolist(), np.eye(3))])


def _holding(parts: list[_Piece], weights: Floats) -> tuple[_Piece, Floats]:
    """Return the piece that holds a point best, and its barycentric coordinates there."""
    inside = [np.linalg.solve(piece.corners.T, weights) for piece in parts]
    best = int(np.argmax([coordinates.min() for coordinates in inside]))
    return parts[best], np.asarray(inside[best])


def _split_edge(
    mesh: TriangleMesh, pieces: dict[int, list[_Piece]], a: int, b: int, new: int, share: float
) -> None:
    """Cut all triangles between vertices a and b at a share of the way from one to the other."""
    if max(a, b) < mesh.n:
        for face in np.flatnonzero((np.isin(mesh.faces, (a, b))).sum(axis=1) == 2).tolist():
            _pieces(mesh, pieces, face)
    for face, parts in pieces.items():
        cut = []
        for piece in parts:
            if a not in piece.vertices or b not in piece.vertices:
                cut.append(piece)
                continue
            i, j = piece.vertices.index(a), piece.vertices.index(b)
            at = (1 - share) * piece.corners[i] + share * piece.corners[j]
            cut += [piece.with_corner(i, new, at), piece.with_corner(j, new, at)]
        pieces[face] = cut
