"""Candidate maps: all signs and likely orders of the lowest modes, grown with their orientation.

A near-isometric pair leaves the signs of the lowest modes open, and the order of those whose
eigenvalues are close (Ren et al. 2020 explore both as a tree). Each choice is one candidate: a
signed permutation of seven modes. Those that fit best on a few samples are grown on two hundred,
by ZoomOut (Melzi et al. 2019), and fewer and fewer go on. Growing alone turns many candidates front
to back, because the lowest modes of a limb are the same all around it. So two kinds of functions
join the modes:

- the area forms ``n . (grad f_a x grad f_b)`` of mapped pairs of low modes. They change sign where
  a map turns the surface over, and hence hold it to one orientation. They are the orientation term
  of Ren et al. (2018), written for the modes themselves in place of descriptors;
- the smoothed mean curvature, which differs between the front and the back of a limb.

Modes alone say little where two surfaces are far from isometric, as those of two species are. What
these share is how they are built: a trunk with limbs to one side of it. So positions and normals
join the modes, as in Smooth Shells (Eisenberger, Lähner and Cremers, CVPR 2020): the source,
smoothed to its k lowest modes, is bent onto the target by a displacement in these modes, and the
points that are nearest in position, normal, curvature and mapped modes correspond; then k grows.

Nothing is assumed of how the two lie in space. `rigid_candidates` tries turns about the longest
axis of the source, either way along that of the target; `bent` begins with the turn that a map
implies. Normals need no triangles: the normal of the surface with positions ``X = U M``, at a
sample s, is ``sum_ij (n . (grad u_i x grad u_j))(s) M_i x M_j``, from the area forms of the modes.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations, product
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from spectra_kit._core.types import Floats, Ints
from spectra_kit.eigen import Spectrum
from spectra_kit.maps.nearest import nearest_each_way
from spectra_kit.maps.prepare import FORM_K, LOWEST_K, REFINED_K, Prepared, curvatures
from spectra_kit.maps.surface import outward_normals, unit_rows

_CURVATURES = 3  # of the smoothed ones, from the finest
_KEPT = {8: 48, 11: 16}  # from so many modes on, how many go on growing
_SIGNED = 7  # modes whose signs are tried, the constant among them: 2^6 choices
_FIRST_SAMPLES = 48  # on which these are compared
_SAMPLES = 200  # on which they grow
_FORM_MODES = 8  # whose area forms are compared
_FORMS_UNTIL = 20  # modes from which a map holds its orientation by itself, without area forms
_FORM_SHARE = 0.5  # squared length of the area forms, relative to that of the modes
_CURVATURE_SHARE = 0.1  # the same for curvature

SAMPLES = 400  # on which the source is laid onto the target and bent
# Modes to which surfaces are smoothed as one is laid on the other.
_RIGID = (6, 9, 14, 20, LOWEST_K)
_BENT_STEPS = 4  # from these modes to the refined ones
_BENDING_MODES = 20  # in which the source is bent
_STIFFNESS = 0.3  # of the last of these modes, relative to the pull of the points
_NORMALS = 0.4  # length that normals count like, beside positions
_CURVATURE = 0.1  # of each curvature
# Of all modes together, as one surface is laid onto the other, and as it is bent: there they hold a
# right map, which shapes of different kinds, drawn to the nearest point, would leave.
_MODES_RIGID, _MODES_BENT = 0.5, 4.0


def sign_candidates(
    source: Prepared,
    target: Prepared,
    *,
    mirrored: bool,
    orders: int,
    growing: int,
) -> Floats:
    """Return functional maps, (16, 30, 30), grown from all signs and likely orders of low modes.

    They are those that fit best on the way; with `mirrored`, which needs both geometries, of those
    that mirror.
    """
    samples = _sampled(source, target, mirrored)
    maps = _starts(source.spectrum, target.spectrum, orders)
    _, fits = samples.head(_FIRST_SAMPLES).nearest(maps)
    maps = maps[_best(fits, growing)]
    Q, R = np.linalg.qr(samples.rows2)
    for k in range(_SIGNED, LOWEST_K + 1):
        nearest, fits = samples.nearest(maps)
        if k in _KEPT:
            nearest = nearest[_best(fits, _KEPT[k])]
        k_next = min(k + 1, LOWEST_K)
        fit = solve_triangular(R[:k_next, :k_next], Q[:, :k_next].T)
        maps = fit @ samples.rows1[:, :k_next][nearest]
    return maps


def _best(fits: Floats, count: int) -> Ints:
    """Return which fit best, the best first."""
    return np.argsort(-fits, kind="stable")[:count]


def _starts(a: Spectrum, b: Spectrum, count: int) -> Floats:
    """Return signed permutations of the lowest modes, (c, 7, 7): all signs, so many likely orders.

    An order is the likelier, the less the logarithms of the eigenvalues that it pairs differ.
    """
    m = _SIGNED
    logs1, logs2 = np.log(a.eigenvalues[1:m]), np.log(b.eigenvalues[1:m])
    orders = np.array(list(permutations(range(m - 1))))
    differ = ((logs1[orders] - logs2) ** 2).sum(axis=1)
    orders = 1 + orders[np.argsort(differ, kind="stable")[:count]]
    ordered = np.eye(m)[np.insert(orders, 0, 0, axis=1)]
    constant = np.sign(a.eigenvectors[0, 0] * b.eigenvectors[0, 0])
    signs = np.array([(constant, *s) for s in product((1.0, -1.0), repeat=m - 1)])
    return np.asarray((signs[:, None, :, None] * ordered).reshape(-1, m, m))


class _Samples(NamedTuple):
    """What maps are compared by at samples; pairs and c are 0 without geometries."""

    scale: Floats  # (pairs,) of the target's area forms
    rows1: Floats  # (s1, 30) modes of the source
    rows2: Floats  # (s2, 30) and of the target
    forms1: Floats  # (s1, pairs) area forms of pairs of the lowest modes
    forms2: Floats  # (s2, pairs), scaled
    curved1: Floats  # (s1, c) curvatures
    curved2: Floats  # (s2, c)

    def head(self, count: int) -> _Samples:
        """Return the first samples."""
        return _Samples(self.scale, *(values[:count] for values in self[1:]))

    def nearest(self, maps: Floats) -> tuple[Ints, Floats]:
        """Return the source's sample nearest to each of the target's, (c, s2), and the fit (c,).

        The fit is the sum of ``row2 . row1 - |row1|^2 / 2``: the larger, the nearer they are.
        """
        k = maps.shape[1]
        columns1 = [self.rows1[:, :k] @ maps.transpose(0, 2, 1)]
        columns2 = [self.rows2[:, :k]]
        if self.forms2.size and k < _FORMS_UNTIL:
            weight = np.sqrt(_FORM_SHARE * k / self.forms2.shape[1])
            columns1.append(weight * self._mapped_forms(maps))
            columns2.append(weight * self.forms2)
        if self.curved2.size:
            weight = np.sqrt(_CURVATURE_SHARE * k / self.curved2.shape[1])
            there = weight * self.curved1
            columns1.append(np.broadcast_to(there, (len(maps), *there.shape)))
            columns2.append(weight * self.curved2)
        images = np.concatenate(columns1, axis=2, dtype=np.float32).transpose(0, 2, 1)
        scores = np.concatenate(columns2, axis=1, dtype=np.float32) @ images
        scores -= 0.5 * (images**2).sum(axis=1)[:, None]
        return scores.argmax(axis=2), scores.max(axis=2).sum(axis=1)

    def _mapped_forms(self, maps: Floats) -> Floats:
        """Return the forms of the mapped modes at the source's samples, (c, s1, pairs).

        They are antisymmetric, so that a map takes those of pairs to one another by its minors.
        """
        m = min(_FORM_MODES, maps.shape[1])
        C = np.zeros((len(maps), _FORM_MODES, _FORM_MODES))
        C[:, :m, :m] = maps[:, :m, :m]
        a, b = _pairs(_FORM_MODES)
        i, j = a[:, None], b[:, None]
        minors = C[:, i, a] * C[:, j, b] - C[:, i, b] * C[:, j, a]
        return np.asarray(self.forms1 @ minors.transpose(0, 2, 1) / self.scale)


def _sampled(source: Prepared, target: Prepared, mirrored: bool) -> _Samples:
    """Return what candidates of one orientation grow by."""
    sides = [(side, side.samples[:_SAMPLES]) for side in (source, target)]
    rows = [side.spectrum.eigenvectors[chosen, :LOWEST_K] for side, chosen in sides]
    forms1, forms2 = (_forms_at(side, chosen, _FORM_MODES) for side, chosen in sides)
    scale = np.sqrt((forms2**2).mean(axis=0))
    forms2 = (-forms2 if mirrored else forms2) / scale
    both = curvatures(source, target) or [np.empty((side.spectrum.n, 0)) for side, _ in sides]
    curved = [bent[chosen, :_CURVATURES] for bent, (_, chosen) in zip(both, sides, strict=True)]
    return _Samples(scale, rows[0], rows[1], forms1, forms2, curved[0], curved[1])


def _forms_at(side: Prepared, chosen: Ints, m: int) -> Floats:
    """Return the area forms of pairs of the m lowest modes at some points, (s, pairs)."""
    i, j = _pairs(min(m, len(side.form)))
    return np.asarray(side.spectrum.eigenvectors[chosen, : len(side.form)] @ side.form[:, i, j])


def _pairs(m: int) -> tuple[Ints, Ints]:
    """Return the pairs i < j of m modes whose area form may be other than 0: not the constant.

    Those of fewer modes come first.
    """
    j, i = np.tril_indices(m, -1)
    return i[i > 0], j[i > 0]


class Side(NamedTuple):
    """A surface at its samples, in its own axes, the longest first."""

    rows: Floats  # (s, k) its modes
    eigenvalues: Floats  # (k,)
    form_modes: int
    forms: Floats  # (s, pairs): n . (grad u_i x grad u_j), i < j
    curvature: Floats  # (s, c)
    positions: Floats  # (k, 3): coefficients of the positions
    normals: Floats  # (k, 3): and of the normals
    spread: Floats  # (3,): standard deviations of the positions

    def bent_normals(self, positions: Floats) -> Floats:
        """Return unit normals at the samples, (s, 3), with other coefficients of the positions."""
        i, j = _pairs(min(self.form_modes, len(positions)))
        return unit_rows(self.forms[:, : len(i)] @ np.cross(positions[i], positions[j]))


class Rigid(NamedTuple):
    """A map, and how well the source lies on the target with it."""

    functional_map: Floats  # (k, k)
    distance: float  # between nearest points, normals and curvatures, both ways


def side_of(prepared: Prepared, mirrored: bool = False) -> Side:
    """Return a surface at its samples; `mirrored`, its mirror image."""
    surface, spectrum = prepared.surface, prepared.spectrum
    chosen = prepared.samples[:SAMPLES]
    points = surface.points - surface.mass @ surface.points / surface.mass.sum()
    _, axes = np.linalg.eigh((points * surface.mass[:, None]).T @ points)
    axes = axes[:, ::-1]
    axes = axes * [1.0, 1.0, np.linalg.det(axes)]
    if mirrored:
        axes = axes * [-1.0, 1.0, 1.0]
    points, normals = points @ axes, outward_normals(surface.points, surface.oriented) @ axes
    forms = _forms_at(prepared, chosen, FORM_K)
    return Side(
        rows=spectrum.eigenvectors[chosen],
        form_modes=len(prepared.form),
        eigenvalues=spectrum.eigenvalues,
        forms=-forms if mirrored else forms,
        curvature=prepared.curvature[chosen, :_CURVATURES],
        positions=spectrum.project(points),
        normals=spectrum.project(normals),
        spread=np.sqrt(surface.mass @ points**2 / surface.mass.sum()),
    )


def rigid_candidates(source: Side, target: Side, turns: int) -> Floats:
    """Return functional maps, (c, 30, 30), of the source laid onto the target, the nearest first.

    Stretched along its axes to the spread of the target, and turned about the longest one: so many
    `turns`, either way along it.
    """
    found = list[Rigid]()
    for turn in _turns(turns):
        stretched = (source.positions / source.spread) @ turn * target.spread
        found.append(_fitted(source, target, stretched, turn, None, _RIGID))
    found.sort(key=lambda bent: bent.distance)
    return np.stack([bent.functional_map for bent in found])


def bent(source: Side, target: Side, functional_map: Floats) -> Rigid:
    """Refine a map to some 60 modes, the source bent onto the target by what the map says."""
    k = len(functional_map)
    back, _ = nearest_each_way(source.rows[:, :k] @ functional_map.T, target.rows[:, :k])
    here = source.rows[back, :k] @ source.positions[:k]
    u, _, vt = np.linalg.svd(here.T @ (target.rows[:, :k] @ target.positions[:k]))
    turn = (u * [1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    most = min(REFINED_K, source.rows.shape[1], target.rows.shape[1])
    modes = np.unique(np.linspace(k, most, _BENT_STEPS).astype(int)).tolist()
    return _fitted(source, target, source.positions @ turn, None, functional_map, modes)


def _turns(count: int) -> list[Floats]:
    """Return rotations that keep the first axis, so many to a full turn, or reverse it."""
    out = list[Floats]()
    for angle in np.arange(count) * 2 * np.pi / count:
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])
        out += [turn, turn * np.array([[-1.0], [-1.0], [1.0]])]
    return out


def _fitted(
    source: Side,
    target: Side,
    positions: Floats,
    turn: Floats | None,
    functional_map: Floats | None,
    modes: Sequence[int],
) -> Rigid:
    """Alternate between who corresponds to whom and how the source is bent, for growing k.

    With a `turn`, normals only turn, and every axis counts alike: limbs that are bent much are
    laid right later. Without it normals follow the bending, and lengths count as they are.
    """
    C, displacement, weight = functional_map, np.zeros((0, 3)), np.ones(3)
    if turn is not None:
        weight = np.sqrt((target.spread**2).mean()) / target.spread
    for k in modes:
        moved = positions[:k].copy()
        few = min(len(displacement), k)
        moved[:few] += displacement[:few]
        U, V = source.rows[:, :k], target.rows[:, :k]
        there = V @ target.positions[:k]
        if turn is None:
            normals1 = source.bent_normals(moved)
            normals2 = target.bent_normals(target.positions[:k])
        else:
            normals1, normals2 = U @ (source.normals[:k] @ turn), V @ target.normals[:k]
        bends1, bends2 = _CURVATURE * source.curvature, _CURVATURE * target.curvature
        seen1 = np.hstack([U @ moved * weight, _NORMALS * normals1, bends1])
        seen2 = np.hstack([there * weight, _NORMALS * normals2, bends2])
        columns1, columns2 = [seen1], [seen2]
        if C is not None:
            q, share = len(C), _MODES_BENT if turn is None else _MODES_RIGID
            mapped = share / np.sqrt(q)
            columns1.append(mapped * source.rows[:, :q] @ C.T)
            columns2.append(mapped * target.rows[:, :q])
        back, forth = nearest_each_way(np.hstack(columns1), np.hstack(columns2))
        distance = 0.5 * (_rms(seen2 - seen1[back]) + _rms(seen1 - seen2[forth]))
        C = np.asarray(np.linalg.lstsq(V, U[back], rcond=None)[0], dtype=np.float64)
        here, count = U @ positions[:k], min(k, _BENDING_MODES)
        displacement = _displacement(source, there, here, back, forth, count)
    assert C is not None
    return Rigid(functional_map=C, distance=distance)


def _displacement(
    source: Side, there: Floats, here: Floats, back: Ints, forth: Ints, count: int
) -> Floats:
    """Return coefficients, (count, 3), that move points to their partners, smoothly."""
    U = source.rows[:, :count]
    rows = np.vstack([U, U[back]])
    goals = np.vstack([there[forth] - here, there - here[back]])
    last = min(_BENDING_MODES, len(source.eigenvalues) - 1)
    smooth = source.eigenvalues[:count] / source.eigenvalues[last]
    normal = rows.T @ rows + np.diag(_STIFFNESS * len(rows) * smooth)
    return np.asarray(cho_solve(cho_factor(normal), rows.T @ goals))


def _rms(differences: Floats) -> float:
    """Return the root mean square length of rows."""
    return float(np.sqrt((differences**2).sum(axis=1).mean()))
