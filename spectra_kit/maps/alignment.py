"""Maps that are held by where points lie: positions and normals, bent as far as a map needs it.

Modes alone say little where two surfaces are far from isometric, as those of two species are. What
these share is how they are built: a trunk with limbs to one side of it. So positions and normals
join the modes, as in Smooth Shells (Eisenberger, Lähner and Cremers, CVPR 2020): the source,
smoothed to its k lowest modes, is bent onto the target by a displacement in these modes, and the
points that are nearest in position, normal, curvature and mapped modes correspond; then k grows.

Nothing is assumed of how the two lie in space. `placed_candidates` tries turns about the longest
axis of the source, either way along that of the target; `bent` begins with the turn that a map
implies. Normals need no triangles: the normal of the surface with positions ``X = U M``, at a
sample s, is ``sum_ij (n . (grad u_i x grad u_j))(s) M_i x M_j``, from the area forms of the modes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from spectra_kit._core.types import Floats, Ints
from spectra_kit.maps.candidates import GROWING_CURVATURES
from spectra_kit.maps.curvature import outward_normals
from spectra_kit.maps.prepare import LOWEST_K, REFINED_K, Prepared

SAMPLES = 400  # on which the source is laid onto the target and bent
_LAID = (6, 9, 14, 20, LOWEST_K)  # modes to which surfaces are smoothed as one is laid on the other
_BENT_STEPS = 4  # from these modes to the refined ones
_BENDING_MODES = 20  # in which the source is bent
_STIFFNESS = 0.3  # of the last of these modes, relative to the pull of the points
_NORMALS = 0.4  # length that normals count like, beside positions
_CURVATURE = 0.1  # of each curvature
# Of all modes together, as one surface is laid onto the other, and as it is bent: there they hold a
# right map, which shapes of different kinds, drawn to the nearest point, would leave.
_MODES_LAID, _MODES_BENT = 0.5, 4.0


class Side(NamedTuple):
    """A surface at its samples, in its own axes, the longest first."""

    rows: Floats  # (s, k) its modes
    eigenvalues: Floats  # (k,)
    forms: Floats  # (s, q, q): n . (grad u_i x grad u_j)
    curvature: Floats  # (s, c)
    positions: Floats  # (k, 3): coefficients of the positions
    normals: Floats  # (k, 3): and of the normals
    spread: Floats  # (3,): standard deviations of the positions

    def bent_normals(self, positions: Floats) -> Floats:
        """Return unit normals at the samples, (s, 3), with other coefficients of the positions."""
        q = min(self.forms.shape[1], len(positions))
        turns = positions[:q].T @ (self.forms[:, :q, :q] @ positions[:q])
        normals = np.stack([turns[:, 1, 2], turns[:, 2, 0], turns[:, 0, 1]], axis=1)
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        out: Floats = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
        return out


class Laid(NamedTuple):
    """A map, and how well the source lies on the target with it."""

    functional_map: Floats  # (k, k)
    distance: float  # between nearest points, normals and curvatures, both ways


def side_of(prepared: Prepared, *, mirrored: bool = False) -> Side:
    """Return a surface at its samples; `mirrored`, its mirror image."""
    surface, spectrum = prepared.surface, prepared.spectrum
    assert surface is not None
    chosen = prepared.samples[:SAMPLES]
    points = surface.points - surface.mass @ surface.points / surface.mass.sum()
    _, axes = np.linalg.eigh((points * surface.mass[:, None]).T @ points)
    axes = axes[:, ::-1]
    axes = axes * [1.0, 1.0, np.linalg.det(axes)]
    if mirrored:
        axes = axes * [-1.0, 1.0, 1.0]
    points, normals = points @ axes, outward_normals(surface.points, surface.oriented) @ axes
    form = surface.form
    forms = np.tensordot(spectrum.eigenvectors[chosen, : len(form)], form, axes=(1, 0))
    return Side(
        rows=spectrum.eigenvectors[chosen],
        eigenvalues=spectrum.eigenvalues,
        forms=-forms if mirrored else forms,
        curvature=surface.curvature[chosen, :GROWING_CURVATURES],
        positions=spectrum.project(points),
        normals=spectrum.project(normals),
        spread=np.sqrt(surface.mass @ points**2 / surface.mass.sum()),
    )


def placed_candidates(source: Side, target: Side, turns: int) -> Floats:
    """Return functional maps, (c, 30, 30), of the source laid onto the target, the nearest first.

    Stretched along its axes to the spread of the target, and turned about the longest one: so many
    `turns`, either way along it.
    """
    found = list[Laid]()
    for turn in _turns(turns):
        stretched = (source.positions / source.spread) @ turn * target.spread
        found.append(_fitted(source, target, stretched, turn, None, _LAID))
    found.sort(key=lambda bent: bent.distance)
    return np.stack([bent.functional_map for bent in found])


def bent(source: Side, target: Side, functional_map: Floats) -> Laid:
    """Refine a map to some 60 modes, the source bent onto the target by what the map says."""
    k = len(functional_map)
    back, _ = _both_ways(source.rows[:, :k] @ functional_map.T, target.rows[:, :k])
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
) -> Laid:
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
            q, share = len(C), _MODES_BENT if turn is None else _MODES_LAID
            mapped = share / np.sqrt(q)
            columns1.append(mapped * source.rows[:, :q] @ C.T)
            columns2.append(mapped * target.rows[:, :q])
        back, forth = _both_ways(np.hstack(columns1), np.hstack(columns2))
        distance = 0.5 * (_rms(seen2 - seen1[back]) + _rms(seen1 - seen2[forth]))
        C = np.asarray(np.linalg.lstsq(V, U[back], rcond=None)[0], dtype=np.float64)
        displacement = _displacement(
            source, there, U @ positions[:k], back, forth, min(k, _BENDING_MODES)
        )
    assert C is not None
    return Laid(functional_map=C, distance=distance)


def _displacement(
    source: Side,
    there: Floats,
    here: Floats,
    back: Ints,
    forth: Ints,
    count: int,
) -> Floats:
    """Return coefficients, (count, 3), that move points to their partners, smoothly."""
    U = source.rows[:, :count]
    rows = np.vstack([U, U[back]])
    goals = np.vstack([there[forth] - here, there - here[back]])
    last = min(_BENDING_MODES, len(source.eigenvalues) - 1)
    smooth = source.eigenvalues[:count] / source.eigenvalues[last]
    normal = rows.T @ rows + np.diag(_STIFFNESS * len(rows) * smooth)
    return np.asarray(cho_solve(cho_factor(normal), rows.T @ goals))


def _both_ways(rows1: Floats, rows2: Floats) -> tuple[Ints, Ints]:
    """Return which row of the first is nearest to each of the second, and the reverse."""
    first, second = rows1.astype(np.float32), rows2.astype(np.float32)
    squares = (second**2).sum(axis=1)[:, None] + (first**2).sum(axis=1) - 2 * second @ first.T
    return squares.argmin(axis=1), squares.argmin(axis=0)


def _rms(differences: Floats) -> float:
    """Return the root mean square length of rows."""
    return float(np.sqrt((differences**2).sum(axis=1).mean()))
