"""The last step of a match: deform the source onto the target, see which points meet; upsample.

Bending keeps lengths, so it holds the map together where the modes are too smooth to decide, and
positions and normals tell what lengths cannot: how far along a limb a point is. From the points
that a dense surface is matched on, the map is carried to all points.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from spectra_kit._core.threads import in_threads, ranges, thread_count
from spectra_kit._core.types import Floats, Ints
from spectra_kit._sparse.ldl import SparseLDL
from spectra_kit.maps.convert import Correspondence
from spectra_kit.maps.nearest import nearest_within
from spectra_kit.maps.prepare import CURVATURE_SCALE, Prepared, curvatures
from spectra_kit.maps.subsample import around
from spectra_kit.maps.surface import Surface, outward_normals
from spectra_kit.operators.oriented import OrientedTriangles

_BENDS, _FIRST_BENDS = 2, 8  # in each round, and in the first
# Goals on a dense target are exact, so that the deformed surface may follow them closely in the
# end. On five pairs of bodies errors fell by 3 per cent, as with five rounds.
_FINE_ROUNDS = 3
PULL = 400.0  # weight of the target in bending: rigid below lengths of 1/20
# The same between unlike bodies, whose trunks and limbs are of other lengths: below 1/40.
PULL_UNLIKE = 1600.0
_NORMAL_LENGTH = 0.05  # that a turn of the normal by one radian counts like
_SHARE = 10_000  # rotations that a thread works out at a time
_ROOT_STEPS, _ROOT_ERROR = 40, 1e-12  # of Newton's method, which mostly takes a dozen
_NO_ROTATION = 1e-9  # squared norm off 3 by that much


class Deformed(NamedTuple):
    """A surface bent onto another."""

    points: Floats  # (n, 3) where its points are now
    rotations: Floats  # (n, 3, 3) how each of them turned
    start: Surface  # what was bent: the source, or its mirror image


def deform(
    source: Surface,
    target: Surface,
    way_there: Ints,
    *,
    mirrored: bool,
    rounds: int,
    fine_rounds: int = 0,
    bends: tuple[int, int] = (_FIRST_BENDS, _BENDS),
    pull: float = PULL,
) -> Deformed:
    """Bend the source as rigidly as possible onto the target.

    From the target point of each source point, `way_there`; with `mirrored`, the target is a mirror
    image. Each round lowers
    ``1/2 sum_ij w_ij |(y_i - y_j) - R_i (x_i - x_j)|^2 + p sum_i m_i |y_i - c_i|^2``, where i j
    runs over all edges in both directions, over positions y and rotations R in turn (Sorkine and
    Alexa, *As-Rigid-As-Possible Surface Modeling*, SGP 2007, with cotangent weights w), c being the
    target points; then the nearest in position and normal become the new c.
    """
    start = source.reflected() if mirrored else source
    bend, rotate = _bending(start, pull)
    fine = max(pull, len(source.points))  # rigid below the spacing of the points
    tree = cKDTree(rows_of(target.points, target.oriented))
    bent = target.points[way_there]
    for i in range(rounds + fine_rounds):
        if i == rounds:
            bend, rotate = _bending(start, fine)
        bent = bend(bent, target.points[way_there], bends[min(i, 1)])
        if i + 1 < rounds + fine_rounds:
            way_there = tree.query(rows_of(bent, start.oriented))[1]
    return Deformed(bent, rotate(bent), start)


class Contact(NamedTuple):
    """Who meets whom, once a source is bent onto a target."""

    points: Floats  # (n1, 3): of the source
    there: Ints  # (n1,): the target point that is nearest to each of them
    back: Ints  # (n2,): the source point that is nearest to each of the target
    gap: float  # how far they are apart, mean of both ways: lengths in which normals count


def contact(
    source: Surface,
    target: Surface,
    way_there: Ints,
    *,
    mirrored: bool,
    rounds: int,
    bends: tuple[int, int] = (_FIRST_BENDS, _BENDS),
) -> Contact:
    """Return who meets whom, once the source is bent onto the target as `deform` does it."""
    bent = deform(source, target, way_there, mirrored=mirrored, rounds=rounds, bends=bends)
    here = rows_of(bent.points, bent.start.oriented)
    there = rows_of(target.points, target.oriented)
    far_there, to_there = cKDTree(there).query(here, workers=thread_count())
    far_back, back = cKDTree(here).query(there, workers=thread_count())
    gap = float(np.mean([far_back.mean(), far_there.mean()]))
    return Contact(bent.points, to_there, back, gap)


def rows_of(points: Floats, oriented: OrientedTriangles) -> Floats:
    """Return positions and normals, (n, 6), in which points that meet are near."""
    return np.hstack([points, _NORMAL_LENGTH * outward_normals(points, oriented)])


def by_bending(
    source: Prepared,
    target: Prepared,
    way_there: Ints,
    *,
    mirrored: bool,
    rounds: int,
    pull: float = PULL,
) -> tuple[Ints, Floats, Floats]:
    """Return which source point each target point meets once each is bent onto the other.

    With it, where all source points and all target points then are: positions and normals on the
    target and on the source, (n1, 12) and (n2, 12). One way alone leaves errors a twentieth larger.
    `way_there` leads from the points that the source is matched on to those of the target; both
    have a geometry.
    """
    asked: dict[str, Any] = {"mirrored": mirrored, "rounds": rounds, "pull": pull}
    here, there = _bent_onto(source, target, target.chosen[way_there], **asked)
    way_back = cKDTree(here).query(there[target.chosen], workers=thread_count())[1]
    back_there, back_here = _bent_onto(target, source, way_back, **asked)
    here, there = np.hstack([here, back_here]), np.hstack([there, back_there])
    point_map = cKDTree(here).query(there, workers=thread_count())[1]
    return np.asarray(point_map, dtype=np.int64), here, there


def _bent_onto(
    source: Prepared, target: Prepared, way_there: Ints, *, mirrored: bool, rounds: int, pull: float
) -> tuple[Floats, Floats]:
    """Return positions and normals of all points: of the source, bent, and of the target.

    `way_there` leads from the points that the source is matched on to all of the target.
    """
    onto = target.whole_surface
    bent = deform(
        source.surface,
        onto,
        way_there,
        mirrored=mirrored,
        rounds=rounds,
        fine_rounds=0 if target.subsample is None else _FINE_ROUNDS,
        pull=pull,
    )
    points, oriented = bent.points, bent.start.oriented
    if (dense := source.subsample) is not None:
        start = dense.surface.reflected() if mirrored else dense.surface
        points = dense.carried(points, bent.rotations, start.points)
        oriented = start.oriented
    return rows_of(points, oriented), rows_of(onto.points, onto.oriented)


def by_modes(
    source: Prepared, target: Prepared, found: Correspondence
) -> tuple[Ints, Floats, Floats]:
    """Return which source point is nearest to each target point in modes and curvature.

    With it, these of all source points and of all target points, (n1, d) and (n2, d). A point of a
    dense surface looks around where the points around it went.
    """
    C = found.functional_map
    here = source.whole.eigenvectors[:, : C.shape[1]] @ C.T
    there = target.whole.eigenvectors[:, : len(C)]
    if (both := curvatures(source, target)) is not None:
        lifted = (
            curved if side.subsample is None else side.subsample.lift @ curved
            for side, curved in zip((source, target), both, strict=True)
        )
        here, there = (
            np.hstack([rows, CURVATURE_SCALE * curved])
            for rows, curved in zip((here, there), lifted, strict=True)
        )
    if source.subsample is None and target.subsample is None:
        return found.point_map, here, there
    s1, s2 = source.spectrum.n, target.spectrum.n
    went = sparse.csr_array((np.ones(s2), (np.arange(s2), found.point_map)), shape=(s2, s1))
    near1, near2 = (
        around(side.surface.oriented.faces, side.spectrum.n) for side in (source, target)
    )
    ways = sparse.csr_array(near2 @ went @ near1)
    point_map = nearest_within(ways, (here, source.closest), (there, target.closest))
    return point_map, here, there


def _bending(
    surface: Surface, pull: float
) -> tuple[Callable[[Floats, Floats, int], Floats], Callable[[Floats], Floats]]:
    """Return two functions of bent points: bend them to goals so many times; how they turned."""
    points, mass = surface.points, surface.mass
    i, j, w = _weighted_edges(surface)
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
    return np.asarray(np.einsum("ijn,jkn->nik", cofactors + e1 * A, inverse))


def _cofactors(A: Floats) -> Floats:
    """Return the cofactors of matrices, (3, 3, n)."""
    below, above = np.roll(A, -1, axis=0), np.roll(A, 1, axis=0)
    down, up = np.roll(below, -1, axis=1), np.roll(below, 1, axis=1)
    return down * np.roll(above, 1, axis=1) - up * np.roll(above, -1, axis=1)


def _weighted_edges(surface: Surface) -> tuple[Ints, Ints, Floats]:
    """Return the edges i < j with positive cotangent weights."""
    points, oriented, n = surface.points, surface.oriented, len(surface.points)
    low, high = surface.edges.T
    keys = low * n + high
    at: list[Ints] = []
    w: list[Floats] = []
    for c in range(3):
        apex, a, b = oriented.faces[:, c], oriented.faces[:, c - 2], oriented.faces[:, c - 1]
        u, v = points[a] - points[apex], points[b] - points[apex]
        across = np.linalg.norm(np.cross(u, v), axis=1)
        cot = np.einsum("fr,fr->f", u, v) / np.maximum(across, 1e-12 * (u**2).sum(axis=1) + 1e-300)
        at.append(np.searchsorted(keys, np.minimum(a, b) * n + np.maximum(a, b)))
        w.append(0.5 * oriented.weights * np.clip(cot, -10, 10))
    weights = np.bincount(np.concatenate(at), np.concatenate(w), len(keys)).astype(np.float64)
    kept = weights > 0
    return low[kept], high[kept], weights[kept]
