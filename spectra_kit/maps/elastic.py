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

from spectra_kit._core.threads import in_threads, ranges, thread_count
from spectra_kit._core.types import Floats, Ints
from spectra_kit._sparse.ldl import SparseLDL
from spectra_kit.maps.curvature import outward_normals
from spectra_kit.maps.options import DEFAULT, MatchOptions
from spectra_kit.maps.placed import Placed
from spectra_kit.operators.oriented import OrientedTriangles

PULL = 400.0  # weight of the target in bending: rigid below lengths of 1/20
_NORMAL_LENGTH = 0.05  # that a turn of the normal by one radian counts like
_SHARE = 10_000  # rotations that a thread works out at a time
_ROOT_STEPS, _ROOT_ERROR = 40, 1e-12  # of Newton's method, which mostly takes a dozen
_NO_ROTATION = 1e-9  # squared norm off 3 by that much


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
    bend, rotate = _bending(start.points, start.oriented, source.mass, PULL)
    fine = max(PULL, len(source.points))  # rigid below the spacing of the points
    tree = cKDTree(rows_of(target.points, target.oriented))
    bent = target.points[way_there]
    rounds = options.rounds + fine_rounds
    for i in range(rounds):
        if i == options.rounds:
            bend, rotate = _bending(start.points, start.oriented, source.mass, fine)
        bends = options.bends if i else options.first_bends
        bent = bend(bent, target.points[way_there], bends)
        if i + 1 < rounds:
            way_there = tree.query(rows_of(bent, start.oriented))[1]
    return Bent(bent, rotate(bent), start)


class Met(NamedTuple):
    """Who meets whom, once a source is bent onto a target."""

    points: Floats  # (n1, 3): of the source
    there: Ints  # (n1,): the target point that is nearest to each of them
    back: Ints  # (n2,): the source point that is nearest to each of the target
    gap: float  # how far they are apart, mean of both ways: lengths in which normals count


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
    here = rows_of(bent.points, bent.start.oriented)
    there = rows_of(target.points, target.oriented)
    far_there, to_there = cKDTree(there).query(here, workers=thread_count())
    far_back, back = cKDTree(here).query(there, workers=thread_count())
    gap = float(np.mean([far_back.mean(), far_there.mean()]))
    return Met(bent.points, to_there, back, gap)


def rows_of(points: Floats, oriented: OrientedTriangles) -> Floats:
    """Return positions and normals, (n, 6), in which points that meet are near."""
    return np.hstack([points, _NORMAL_LENGTH * outward_normals(points, oriented)])


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
        found = _polar(covariances[start:stop])
        lost = ~(np.abs((found**2).sum(axis=(1, 2)) - 3.0) < _NO_ROTATION)
        u, _, vt = np.linalg.svd(covariances[start:stop][lost])
        vt[np.linalg.det(u) * np.linalg.det(vt) < 0, 2] *= -1
        found[lost] = np.swapaxes(u @ vt, 1, 2)
        out[start:stop] = found

    in_threads(rotate, ranges(len(covariances), _SHARE))
    return out


def _polar(covariances: Floats) -> Floats:
    """Return these rotations in closed form but for a root; what S does not tell is no rotation.

    Four times faster than so many singular value decompositions, which most of the bending would
    be. If R is that of ``A = S^T = R H`` and e1, e2 are the sums of the eigenvalues of H and of
    their products in pairs, ``cof A = R (H^2 - e1 H + e2)``, so ``R (A^T A + e2) = cof A + e1 A``;
    and e1 is the largest root of ``(x^2 - |A|^2)^2 - 8 x det A - 4 |cof A|^2``, which Newton's
    method reaches from above.
    """
    A = np.ascontiguousarray(covariances.transpose(2, 1, 0))  # long axis last
    cofactors = _cofactors(A)
    f = (A**2).sum(axis=(0, 1))
    linear, constant = 8 * (A[0] * cofactors[0]).sum(axis=0), 4 * (cofactors**2).sum(axis=(0, 1))
    e1 = np.sqrt(3 * f)
    with np.errstate(divide="ignore", invalid="ignore"):  # S = 0, or one line: told by the norm
        for _ in range(_ROOT_STEPS):
            gap = e1**2 - f
            step = (gap**2 - linear * e1 - constant) / (4 * e1 * gap - linear)
            e1 = e1 - step
            if not (np.abs(step) > _ROOT_ERROR * e1).any():
                break
        M = np.einsum("kin,kjn->ijn", A, A)
        M[[0, 1, 2], [0, 1, 2]] += 0.5 * (e1**2 - f)
        inverse = _cofactors(M)
        inverse /= (M[0] * inverse[0]).sum(axis=0)
    out: Floats = np.einsum("ijn,jkn->nik", cofactors + e1 * A, inverse)
    return out


def _cofactors(A: Floats) -> Floats:
    """Return the cofactors of matrices, (3, 3, n)."""
    below, above = np.roll(A, -1, axis=0), np.roll(A, 1, axis=0)
    down, up = np.roll(below, -1, axis=1), np.roll(below, 1, axis=1)
    return down * np.roll(above, 1, axis=1) - up * np.roll(above, -1, axis=1)


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
