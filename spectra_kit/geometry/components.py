"""Splitting a mesh into its connected components."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spectra_kit._core.checked import checked
from spectra_kit._core.records import Rebuilt
from spectra_kit._core.types import Ints
from spectra_kit.geometry.shapes import MeshLike, TriangleMesh, box_unit


@checked
@dataclass(frozen=True, eq=False)
class Component(Rebuilt):
    """One connected part of a mesh.

    Parameters
    ----------
    mesh : TriangleMesh
        The part alone, vertices and faces in their original order.
    vertex_index : ndarray of shape (n,)
        The vertex of the whole mesh that each vertex of the part is, ascending.
    face_index : ndarray of shape (f,)
        The face of the whole mesh that each face of the part is, ascending.
    """

    mesh: TriangleMesh
    vertex_index: Ints
    face_index: Ints


@checked
def components(mesh: MeshLike) -> list[Component]:
    """Split `mesh` into connected components.

    Two faces are connected if they share a vertex (index); faces that only touch in space are
    not, see `TriangleMesh.with_merged_vertices`.

    Parameters
    ----------
    mesh : TriangleMesh
        The mesh to split. Its unreferenced vertices belong to no component.

    Returns
    -------
    list of Component
        In the order of their first face.

    Examples
    --------
    >>> from spectra_kit.geometry import TriangleMesh, components
    >>> points = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 0, 0], [6, 0, 0], [5, 1, 0]]
    >>> parts = components(TriangleMesh(points, [[3, 4, 5], [0, 1, 2]]))
    >>> [part.vertex_index.tolist() for part in parts]
    [[3, 4, 5], [0, 1, 2]]
    """
    labels = _part_of_faces(mesh)
    order = np.argsort(labels, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(labels[order])) + 1)
    return [component_of(mesh, faces) for faces in sorted(groups, key=lambda group: int(group[0]))]


@checked
def largest_component(mesh: MeshLike) -> Component:
    """Return the connected component of largest area.

    Parameters
    ----------
    mesh : TriangleMesh
        The mesh to choose from.

    Returns
    -------
    Component
        The first of the largest, if several are equal.
    """
    areas = mesh.with_points(mesh.points / box_unit(mesh.points)).face_areas
    labels = _part_of_faces(mesh)
    largest = labels[np.bincount(labels, areas)[labels].argmax()]
    return component_of(mesh, np.flatnonzero(labels == largest))


def _part_of_faces(mesh: TriangleMesh) -> Ints:
    return mesh.component_labels[mesh.faces[:, 0]]


def component_of(mesh: TriangleMesh, face_index: Ints) -> Component:
    """Return some of the faces as a mesh of its own."""
    vertex_index, corners = np.unique(mesh.faces[face_index], return_inverse=True)
    part = TriangleMesh(mesh.points[vertex_index], corners.reshape(-1, 3))
    return Component(part, vertex_index, face_index)
