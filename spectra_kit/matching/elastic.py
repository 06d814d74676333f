"""The last step of a match: bend the source onto the target, and see which points meet.

Bending keeps lengths, so it holds the map together where the modes are too smooth to decide, and
positions and normals tell what lengths cannot: how far along a limb a point is.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from spectra_kit._types import Floats, Ints
from spectra_kit.linalg.ldl import SparseLDL
from spectra_kit.linalg.threads import in_threads, ranges
from spectra_kit.matching.curvature import outward_normals
from spectra_kit.matching.options import DEFAULT, MatchOptions
from spectra_kit.matching.placed import Placed
from spectra_kit.operators.oriented import OrientedTriangles

_SHARE = 2500  # rotations that a thread works out at a time


class Bent(NamedTuple):
    """A surface bent onto another."""

    points: Floats  # (n, 3) where its points are now
    rotations: Floats  # (n, 3, 3) how each of them turned
    start: Placed  # what was bent: the source, or its mirror image


def bend_onto(
    source: Placed,
    target: Placed,
    way_there: Ints,
    *,
    mirrored: bool = False,
    fine_rounds: int = 0,
    options: MatchOptions = DEFAULT,
) -> Bent:
    """Bend the source as rigidly as possible onto the target.

    From the target point of each source point, `way_there`; with `mirrored`, the target is a mirror
    image. Each round lowers
    ``1/2 sum_ij w_ij |(y_i - y_j) - R_i (x_i - x_j)|^2 + p sum_i m_i |y_i - c_i|^2``, where i j
    runs over all edges in both directions, over positions y and rotations R in turn (Sorkine and
    Alexa, *As-Rigid-As-Possible Surface Modeling*, SGP 2007, with cotangent weights w), c being the
    target points; then the nearest in position and normal become the new c.
    """
    start = mirror_image(source) if mirrored else source
    bend, rotate = _bending(start.points, start.oriented, source.mass, options.pull)
    fine = max(options.pull, len(source.points))  # rigid below the spacing of the points
    tree = cKDTree(rows_of(target.points, target.oriented, options))
    bent = target.points[way_there]
    rounds = options.rounds + fine_rounds
    for i in range(rounds):
        if i == options.rounds:
            bend, rotate = _bending(start.points, start.oriented, source.mass, fine)
        bends = options.bends if i else options.first_bends
        bent = bend(bent, target.points[way_there], bends)
        if i + 1 < rounds:
            way_there = tree.query(rows_of(bent, start.oriented, options))[1]
    return Bent(bent, rotate(bent), start)


class Met(NamedTuple):
    """Who meets whom, once a source is bent onto a target."""

    points: Floats  # (n1, 3): of the source
    there: Ints  # (n1,): the target point that is nearest to each of them
    back: Ints  # (n2,): the source point that is nearest to each of the target


def meeting(
    source: Placed,
    target: Placed,
    way_there: Ints,
    *,
    mirrored: bool = False,
    options: MatchOptions = DEFAULT,
) -> Met:
    """Return who meets whom, once the source is bent onto the target as `bend_onto` does it."""
    bent = bend_onto(source, target, way_there, mirrored=mirrored, options=options)
    here = rows_of(bent.points, bent.start.oriented, options)
    there = rows_of(target.points, target.oriented, options)
    return Met(bent.points, cKDTree(there).query(here)[1], cKDTree(here).query(there)[1])


def rows_of(points: Floats, oriented: OrientedTriangles, options: MatchOptions) -> Floats:
    """Return positions and normals, (n, 6), in which points that meet are near."""
    return np.hstack([points, options.normal_length * outward_normals(points, oriented)])


def mirror_image(placed: Placed) -> Placed:
    """Return a surface as a mirror shows it."""
    return Placed(
        points=placed.points * [-1.0, 1.0, 1.0],
        mass=placed.mass,
        oriented=placed.oriented.reversed(),
    )


def _bending(
    points: Floats, oriented: OrientedTriangles, mass: Floats, pull: float
) -> tuple[Callable[[Floats, Floats, int], Floats], Callable[[Floats], Floats]]:
    """Return two functions of bent points: bend them to goals so many times; how they turned."""
    i, j, w = _edges(points, oriented)
    n = len(points)
    graph = sparse.coo_array((w, (i, j)), shape=(n, n)).tocsr()
    graph = graph + graph.T
    stiffness = sparse.diags_array(np.asarray(graph.sum(axis=1)).ravel()) - graph
    factor = SparseLDL(sparse.csr_array(stiffness + sparse.diags_array(pull * mass)))
    sides = points[i] - points[j]
    tails = sparse.csr_array((np.ones(len(i)), (i, np.arange(len(i)))), shape=(n, len(i)))
    heads = sparse.csr_array((np.ones(len(j)), (j, np.arange(len(j)))), shape=(n, len(j)))
    both, difference = sparse.csr_array(tails + heads), sparse.csr_array(tails - heads)

    def rotate(bent: Floats) -> Floats:
        outer = (w[:, None] * sides)[:, :, None] * (bent[i] - bent[j])[:, None, :]
        return _rotations((both @ outer.reshape(-1, 9)).reshape(n, 3, 3))

    def bend(bent: Floats, goals: Floats, times: int) -> Floats:
        for _ in range(times):
            rotations = rotate(bent)
            turned = 0.5 * np.einsum("eij,ej->ei", rotations[i] + rotations[j], sides)
            bent = factor.solve(difference @ (w[:, None] * turned) + (pull * mass)[:, None] * goals)
        return bent

    return bend, rotate


def _rotations(covariances: Floats) -> Floats:
    """Return the rotations R that fit best: the largest trace of ``R S`` for each S, (n, 3, 3)."""
    out = np.empty_like(covariances)

    def rotate(start: int, stop: int) -> None:
        u, _, vt = np.linalg.svd(covariances[start:stop])
        flipped = np.linalg.det(u) * np.linalg.det(vt) < 0
        vt[flipped, 2] *= -1
        out[start:stop] = np.swapaxes(u @ vt, 1, 2)

    in_threads(rotate, ranges(len(covariances), _SHARE))
    return out


def _edges(points: Floats, oriented: OrientedTriangles) -> tuple[Ints, Ints, Floats]:
    """Return the edges i < j with positive cotangent weights."""
    i: list[Ints] = []
    j: list[Ints] = []
    w: list[Floats] = []
    for c in range(3):
        apex, a, b = oriented.faces[:, c], oriented.faces[:, c - 2], oriented.faces[:, c - 1]
        u, v = points[a] - points[apex], points[b] - points[apex]
        across = np.linalg.norm(np.cross(u, v), axis=1)
        cot = np.einsum("fr,fr->f", u, v) / np.maximum(across, 1e-12 * (u**2).sum(axis=1) + 1e-300)
        i.append(np.minimum(a, b))
        j.append(np.maximum(a, b))
        w.append(0.5 * oriented.weights * np.clip(cot, -10, 10))
    n = len(points)
    edges, edge = np.unique(np.concatenate(i) * n + np.concatenate(j), return_inverse=True)
    weights = np.bincount(edge, np.concatenate(w)).astype(np.float64)
    kept = weights > 0
    return edges[kept] // n, edges[kept] % n, weights[kept]
