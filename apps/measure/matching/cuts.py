"""FAUST bodies without an arm, a leg or the lower half, and which points of others they have.

A cut is a plane in the reference body, `REFERENCE` of the data set, which stands upright at height
1. The landmarks that all bodies share carry it to the others, whatever their poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components, dijkstra

from measure.matching.subjects import Subject
from spectra_kit._core.types import Bools, Floats, Ints
from spectra_kit.geodesics import edge_graph
from spectra_kit.geometry import TriangleMesh, largest_component

REFERENCE = "tr_reg_000"
_TILT = 15.0  # degrees, the most by which a plane leans
#: From where the plane may stand, to where, and the ends of what it takes off, in the reference.
_AXES = {
    "arm": (
        ((0.125, 0.78, 0.10), (0.095, 0.68, 0.08), ((0.02, 0.41, 0.11),)),
        ((0.355, 0.78, 0.10), (0.385, 0.68, 0.08), ((0.44, 0.39, 0.10),)),
    ),
    "leg": (
        ((0.185, 0.46, 0.10), (0.185, 0.33, 0.09), ((0.165, 0.01, 0.12),)),
        ((0.295, 0.46, 0.10), (0.305, 0.33, 0.09), ((0.32, 0.01, 0.12),)),
    ),
    "half": (
        ((0.24, 0.60, 0.12), (0.24, 0.50, 0.12), ((0.165, 0.01, 0.12), (0.32, 0.01, 0.12))),
    ),
}  # fmt: skip
KINDS = tuple(_AXES)  #: What is taken off: the half is the lower one.


@dataclass(frozen=True, eq=False)
class Part:
    """What is left of a body, and which of its vertices each vertex is."""

    mesh: TriangleMesh
    vertices: Ints  #: (n,): ascending


class CutPair(NamedTuple):
    """Numbers of two FAUST bodies, the first of which is cut, and the cut."""

    part: int
    whole: int
    kind: str
    seed: int

    def __str__(self) -> str:
        return f"{self.part:03d}-{self.whole:03d}-{self.kind}-{self.seed}"


def cut_pairs(persons: Sequence[int], count: int, *, seed: int = 0) -> list[CutPair]:
    """Draw bodies of different persons in different poses, kinds of cuts in turn.

    Body 10 p + q is person p in pose q. A larger number adds pairs to those of a smaller one.
    """
    rng, pairs = np.random.default_rng(seed), []
    for i in range(count):
        (one, other), (pose, another) = rng.permutation(persons)[:2], rng.permutation(10)[:2]
        kind = KINDS[i % len(KINDS)]
        pairs.append(CutPair(int(10 * one + pose), int(10 * other + another), kind, i))
    return pairs


def cut_landmarks(reference: Subject, kind: str, seed: int) -> Bools:
    """Choose a cut of a kind, and tell which landmarks are left, (c,).

    Seeds choose the side, where on its stretch the plane stands, and how it leans, by up to 15
    degrees. What lies beyond it and hangs together with the hand, the foot or the feet is taken.
    """
    rng = np.random.default_rng([KINDS.index(kind), seed])
    sides = _AXES[kind]
    first, last, ends = sides[rng.integers(len(sides))]
    start, stop = np.array(first), np.array(last)
    axis = (stop - start) / np.linalg.norm(stop - start)
    place = start + rng.uniform() * (stop - start)
    sideways = np.cross(axis, rng.normal(size=3))
    sideways *= np.tan(np.radians(_TILT * rng.uniform())) / np.linalg.norm(sideways)
    points = reference.mesh.points
    beyond = (points - place) @ (axis + sideways) > 0
    graph = edge_graph(reference.mesh)
    inside = sparse.diags_array(beyond.astype(np.float64))
    _, piece = connected_components(sparse.csr_array(inside @ graph @ inside), directed=False)
    tips = [int(((points - end) ** 2).sum(axis=1).argmin()) for end in ends]
    left: Bools = ~(beyond & np.isin(piece, piece[tips]))
    return left[reference.landmarks]


def left_of(subject: Subject, kept: Bools) -> Bools:
    """Tell which vertices of a subject are left where these landmarks are, (n,).

    Each vertex follows the landmark that is nearest along the edges.
    """
    _, _, nearest = dijkstra(
        edge_graph(subject.mesh),
        directed=False,
        indices=np.unique(subject.landmarks),
        min_only=True,
        return_predecessors=True,
    )
    votes = np.zeros(subject.mesh.n)
    np.add.at(votes, subject.landmarks, np.where(kept, 1.0, -1.0))
    return np.asarray(votes[nearest] >= 0)


def part_of(subject: Subject, kept: Bools) -> Part:
    """Cut a subject: the largest piece of the faces whose corners are all left."""
    left = left_of(subject, kept)
    faces = subject.mesh.faces[left[subject.mesh.faces].all(axis=1)]
    whole = TriangleMesh(subject.mesh.points, faces)
    piece = largest_component(whole)
    return Part(piece.mesh, piece.vertex_index)


def overlap(one: Bools, other: Bools, mass: Floats) -> float:
    """Return the intersection over the union of two regions, by area."""
    return float(mass[one & other].sum() / mass[one | other].sum())
