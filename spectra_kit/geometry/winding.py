"""Winding: which faces run against their neighbours, and which of them to turn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree

from spectra_kit._core.types import Bools, Ints
from spectra_kit.geometry.shapes import TriangleMesh, connected, side_keys

FLIP = [0, 2, 1]


@dataclass(frozen=True, eq=False)
class Sides:
    """The sides of f faces: of which of e edges, and whether from its lower end to its higher."""

    edges: Ints  # (e, 2): lower end, higher end
    edge: Ints  # (3f,): of the side from each corner to the next
    upward: Bools  # (3f,)
    count: Ints  # (e,): sides of each edge
    surplus: Ints  # (e,): sides that run upwards less those that run downwards

    @property
    def clash(self) -> Bools:
        """Mark the edges at which faces are of two windings, shape (e,).

        Elsewhere run as many along it as against it, but for one where the number is odd.
        """
        return np.abs(self.surplus) > self.count % 2

    def turned(self, turned: Bools) -> Sides:
        """Return the sides of the same faces, some of them turned."""
        upward = self.upward ^ np.repeat(turned, 3)
        surplus = np.bincount(self.edge, np.where(upward, 1, -1), len(self.edges))
        return Sides(self.edges, self.edge, upward, self.count, surplus.astype(np.int64))


def sides_of(faces: Ints, n: int) -> Sides:
    """Return the sides of faces on n points, which have three corners each."""
    keys, edge = np.unique(side_keys(faces, n).ravel(), return_inverse=True)
    upward = (faces < np.roll(faces, -1, axis=1)).ravel()
    surplus = np.bincount(edge, np.where(upward, 1, -1)).astype(np.int64)
    edges = np.column_stack(np.divmod(keys, n))
    return Sides(edges, edge, upward, np.bincount(edge), surplus)


def wound_against(mesh: TriangleMesh) -> tuple[Bools, int]:
    """Return the faces of a mesh to turn, shape (f,), and the number of edges that clash then."""
    i, j = mesh.faces.astype(np.int32), np.roll(mesh.faces, -1, axis=1).astype(np.int32)
    ends = np.minimum(i, j).ravel(), np.maximum(i, j).ravel()
    runs = np.where(i < j, 1, -1).astype(np.int16).ravel()
    surplus = sparse.csr_array((runs, ends), shape=(mesh.n, mesh.n)).data  # as `unique_edges`
    if not (np.abs(surplus) > mesh.unique_edges[1] % 2).any():  # as a rule
        return np.zeros(len(mesh.faces), dtype=bool), 0
    sides = sides_of(mesh.faces, mesh.n)
    turned = against_neighbours(sides)
    return turned, int(sides.turned(turned).clash.sum())


def against_neighbours(sides: Sides) -> Bools:
    """Mark the faces to turn for all to agree with their neighbours, the fewest; shape (f,).

    Where that cannot be, as on a Möbius strip, some edges are left at which they do not. Faces of
    three and more at an edge are no neighbours.
    """
    n_faces = len(sides.edge) // 3
    if not sides.clash.any():
        return np.zeros(n_faces, dtype=bool)
    by_edge = np.argsort(sides.edge, kind="stable")
    pairs = by_edge[(sides.count == 2)[sides.edge[by_edge]]].reshape(-1, 2)
    one, other = (pairs // 3).T
    agree = np.logical_xor(*sides.upward[pairs].T)
    # Patches agree inside. Across the edges between two of them, all faces clash.
    patch = connected(one[agree], other[agree], n_faces)
    n_patches = int(patch.max()) + 1
    a, b = patch[one[~agree]], patch[other[~agree]]
    # Those with most edges between them are turned against each other first: a chain of patches
    # leads to each, and the edges that it does not take are as few as may be.
    edges = sparse.csr_array((np.ones(len(a)), (a, b)), shape=(n_patches, n_patches))
    edges = sparse.csr_array(edges + edges.T)
    edges.setdiag(0)
    edges.eliminate_zeros()
    edges.data = 1 / edges.data
    edges.indices, edges.indptr = (x.astype(np.int32) for x in (edges.indices, edges.indptr))
    chain = sparse.coo_array(minimum_spanning_tree(edges))
    a, b = chain.row.astype(np.int64), chain.col.astype(np.int64)
    # Each patch twice, as it is and turned: a chain connects one such half, and the other.
    half = connected(np.r_[a, a + n_patches], np.r_[b + n_patches, b], 2 * n_patches)
    as_is, not_so = half[:n_patches], half[n_patches:]
    size = np.bincount(as_is, np.bincount(patch), half.max() + 1)
    turned = (size[as_is] < size[not_so]) | ((size[as_is] == size[not_so]) & (as_is > not_so))
    return np.asarray(turned[patch])


def pieces(sides: Sides) -> tuple[Ints, Bools]:
    """Return the piece of each face (f,), and whether each piece is closed.

    Faces of one piece are joined across edges at which they agree.
    """
    whole = ~sides.clash[sides.edge]
    face = np.arange(len(sides.edge)) // 3
    shape = (len(face) // 3, len(sides.edges))
    incidence = sparse.csr_array((np.ones(whole.sum()), (face[whole], sides.edge[whole])), shape)
    count, piece = connected_components(incidence @ incidence.T, directed=False)
    closed = np.ones(count, dtype=bool)
    closed[piece[face[sides.surplus[sides.edge] != 0]]] = False
    closed[piece[face[~whole]]] = False
    return piece.astype(np.int64), closed


def turn(faces: Ints, turned: Bools) -> Ints:
    """Return faces of which some are turned."""
    return np.where(turned[:, None], faces[:, FLIP], faces) if turned.any() else faces
