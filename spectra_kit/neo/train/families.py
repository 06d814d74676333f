"""Families of random surfaces, from animals to machine parts: what the networks learn from.

A family is a function of a random generator that returns one `TriangleMesh`. Same generator
state, same mesh. Sizes are of order one; poses and units are left to the network's own frame.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.components import largest_component
from spectra_kit.geometry.shapes import TriangleMesh
from spectra_kit.neo.train import surfaces as s
from spectra_kit.neo.train.bodies import (
    biped,
    blob,
    lattice,
    machined,
    organism,
    porous,
    quadruped,
    sculpture,
    symmetric,
)
from spectra_kit.neo.train.kits import assembly, furniture, vehicle

Rng = np.random.Generator


def bumpy(rng: Rng) -> TriangleMesh:
    """A sphere or superquadric with bumps, wrinkles or spikes."""
    rounding = (
        (rng.uniform(0.25, 1.6), rng.uniform(0.25, 1.6)) if rng.random() < 0.7 else (1.0, 1.0)
    )
    mesh = s.superquadric(rounding, rng.uniform(0.4, 1.0, 3), n_u=64, n_v=96)
    relief = s.waves(mesh.points, rng, frequency=rng.uniform(1.5, 8.0))
    ridged = 1 - 2 * np.abs(relief) if rng.random() < 0.25 else relief
    depth = rng.uniform(0.0, 0.14)
    return mesh.with_points(mesh.points * (1 + depth * ridged[:, None]))


def tube(rng: Rng) -> TriangleMesh:
    """A torus, torus knot, closed wobbly loop or open spiral, of elliptic and varying section."""
    t = np.linspace(0, 2 * np.pi, 180, endpoint=False)
    closed, kind = True, rng.integers(4)
    if kind == 0:
        curve = np.stack([np.cos(t), np.sin(t), 0 * t], axis=1)
        curve += rng.uniform(0, 0.2) * np.stack([0 * t, 0 * t, np.sin(rng.integers(1, 4) * t)], 1)
    elif kind == 1:
        p, q = ((2, 3), (3, 2), (2, 5), (1, 3), (1, 4), (3, 4))[rng.integers(6)]
        r = 1 + rng.uniform(0.25, 0.45) * np.cos(q * t)
        curve = np.stack([r * np.cos(p * t), r * np.sin(p * t), 0.45 * np.sin(q * t)], axis=1)
    elif kind == 2:
        f = np.arange(1, 4)
        amplitude = rng.normal(size=(2, 3, 3)) / f[:, None] ** 1.2
        curve = np.cos(np.outer(t, f)) @ amplitude[0] + np.sin(np.outer(t, f)) @ amplitude[1]
    else:
        closed, turns = False, rng.uniform(0.3, 2.5)
        r = 1 + rng.uniform(-0.5, 0.8) * t / (2 * np.pi)
        curve = np.stack(
            [r * np.cos(turns * t), r * np.sin(turns * t), rng.uniform(0, 0.35) * t], axis=1
        )
    length = float(np.linalg.norm(np.diff(curve, axis=0), axis=1).sum())
    radius = (
        rng.uniform(0.015, 0.06) * length if kind in (0, 3) else rng.uniform(0.012, 0.03) * length
    )
    swell = 1 + rng.uniform(0, 0.5) * np.cos(rng.integers(1, 5) * t + rng.uniform(0, 6))
    turns = float(rng.integers(0, 3)) / 2
    return s.sweep(curve, radius * swell, closed=closed, aspect=rng.uniform(0.4, 1.0), turns=turns)


def vessel(rng: Rng) -> TriangleMesh:
    """Vases, bottles, wheels, chess pieces; closed or open; some with a handle and a spout."""
    t = np.linspace(0, 1, 90)
    f = np.arange(1, 5)
    r = 0.5 + np.cos(np.pi * np.outer(t, f)) @ (rng.normal(size=4) * rng.uniform(0.1, 0.3) / f)
    r = np.maximum(r, 0.08)
    if rng.random() < 0.3:
        r *= np.where(t > rng.uniform(0.4, 0.8), rng.uniform(0.4, 0.8), 1.0)
    height = rng.uniform(0.4, 2.2)
    profile = np.column_stack([r, height * t])
    kind = rng.integers(4)
    if kind == 0:  # closed by two lids
        lid = np.linspace(0, 1, 12)[1:-1, None]
        bottom = lid * [r[0], 0.0]
        top = np.add(lid[::-1] * [r[-1], 0.0], [0.0, height])
        profile = np.concatenate([bottom, profile, top])
    elif kind == 1:  # a wall of some thickness, and a floor
        inside = profile[::-1] * [rng.uniform(0.7, 0.9), 1.0]
        inside[:, 1] = np.maximum(inside[:, 1], 0.06 * height)
        profile = np.concatenate([profile, inside])
        profile = np.concatenate([[[1e-3, 0.0]], profile, [[1e-3, 0.06 * height]]])
        steps = np.linspace(0, len(profile) - 1, 2 * len(profile))
        profile = np.column_stack([np.interp(steps, np.arange(len(profile)), p) for p in profile.T])
    elif kind == 2:  # a floor, open above
        floor = np.linspace(0, 1, 12)[:-1, None] * profile[:1]
        profile = np.concatenate([floor, profile])
    parts = [s.revolve(profile)]
    if rng.random() < 0.5:
        for side in ((1,), (1, -1))[rng.integers(2)]:
            low, high, reach = rng.uniform(0.15, 0.4), rng.uniform(0.6, 0.9), rng.uniform(0.3, 0.8)
            a = np.linspace(0, np.pi, 40)
            z = low + (high - low) * (1 - np.cos(a)) / 2
            x = np.interp(z, t, r) - 0.03 + reach * np.sin(a) * np.sqrt(np.abs(np.sin(a)) + 0.1)
            curve = np.column_stack([side * x, 0 * x, height * z])
            parts.append(s.sweep(curve, rng.uniform(0.04, 0.09), closed=False))
    if rng.random() < 0.25:
        a = np.linspace(0, 1, 40)
        z0, reach = rng.uniform(0.2, 0.5), rng.uniform(0.4, 0.9)
        x = np.interp(z0, t, r) - 0.05 + reach * a
        curve = np.column_stack([0 * x, x, height * (z0 + (1.0 - z0) * a**2)])
        parts.append(s.sweep(curve, np.linspace(0.14, 0.06, 40), closed=False))
    return s.join(parts)


def sheet(rng: Rng) -> TriangleMesh:
    """Open surfaces: bent plates, cloth, discs, Moebius bands, saddles, domes, helicoids."""
    n_u, n_v, kind = 60, 60, rng.integers(6)
    u, v = np.meshgrid(np.linspace(0, 1, n_u), np.linspace(0, 1, n_v), indexing="ij")
    if kind == 0:
        points = np.stack([2 * u - 1, rng.uniform(0.3, 1.0) * (2 * v - 1), 0 * u], axis=-1)
    elif kind == 1:
        inner, arc = rng.choice([0.0, rng.uniform(0.1, 0.7)]), rng.uniform(2.0, 2 * np.pi)
        r, a = inner + (1 - inner) * u, v * rng.choice([arc, 2 * np.pi])
        points = np.stack([r * np.cos(a), r * np.sin(a), 0 * r], axis=-1)
    elif kind == 2:
        a, w = 2 * np.pi * u, rng.uniform(0.15, 0.5) * (2 * v - 1)
        half = rng.integers(1, 4) * a / 2
        r = 1 + w * np.cos(half)
        points = np.stack([r * np.cos(a), r * np.sin(a), w * np.sin(half)], axis=-1)
    elif kind == 3:
        a, e = v * rng.uniform(2, 2 * np.pi), rng.uniform(0.05, 1) * np.pi * (0.02 + 0.9 * u)
        points = np.stack([np.sin(e) * np.cos(a), np.sin(e) * np.sin(a), np.cos(e)], axis=-1)
    elif kind == 4:
        a, r = (2 * u - 1) * rng.uniform(1, 4), 2 * v - rng.choice([0.2, 1.0])
        points = np.stack([r * np.cos(a), r * np.sin(a), 0.5 * a], axis=-1)
    else:
        a, r = v * rng.uniform(3, 2 * np.pi), rng.uniform(0.3, 0.9)
        points = np.stack([3 * u - 1.5, r * np.cos(a), r * np.sin(a)], axis=-1)
    mesh = s.grid_mesh(points)
    crumple = s.waves(mesh.points, rng, frequency=rng.uniform(0.8, 4.0))
    return s.raised(mesh, rng.uniform(0, 0.15) * crumple)


def scattered(rng: Rng) -> TriangleMesh:
    """Two to four bodies of other families a little apart: clouds of them barely hang together."""
    makers = (blob, bumpy, machined, tube)
    meshes, x = [], 0.0
    for _ in range(rng.integers(2, 5)):
        mesh = makers[rng.integers(len(makers))](rng)
        points = (mesh.points - mesh.points.min(axis=0)) / np.ptp(mesh.points, axis=0).max()
        meshes.append(mesh.with_points(np.add(points, [x, *rng.uniform(-0.2, 0.2, 2)])))
        x += float(points[:, 0].max()) + rng.uniform(-0.1, 0.02)
    return s.join(meshes)


# Order is part of the corpus format: a label is an index into this table. Weights are relative.
FAMILIES: dict[str, tuple[Callable[[Rng], TriangleMesh], float]] = {
    "quadruped": (quadruped, 14),
    "biped": (biped, 13),
    "organism": (organism, 13),
    "blob": (blob, 9),
    "porous": (porous, 3),
    "bumpy": (bumpy, 7),
    "tube": (tube, 6),
    "vessel": (vessel, 7),
    "sheet": (sheet, 7),
    "machined": (machined, 12),
    "assembly": (assembly, 8),
    "scattered": (scattered, 4),
    "furniture": (furniture, 9),
    "vehicle": (vehicle, 7),
    "symmetric": (symmetric, 7),
    "sculpture": (sculpture, 10),
    "lattice": (lattice, 4),
}
# Man-made: bent and twisted less often.
_RIGID = {"machined", "assembly", "vessel", "furniture", "vehicle"}


def _deform(mesh: TriangleMesh, rng: Rng, likely: float) -> TriangleMesh:
    """Stretch, bend, twist, taper, wrinkle or pierce: each with its own probability."""
    points = mesh.points - mesh.points.mean(axis=0)
    points = s.warped(points / np.abs(points).max(), rng, likely)
    mesh = mesh.with_points(points)
    if rng.random() < 0.2 * likely:
        relief = s.waves(points, rng, frequency=rng.uniform(3.0, 12.0))
        mesh = s.raised(mesh, rng.uniform(0.002, 0.02) * relief)
    if rng.random() < 0.08 * likely:  # a scan with a hole
        centre = points[rng.integers(mesh.n)]
        far = np.linalg.norm(points - centre, axis=1) > rng.uniform(0.1, 0.45)
        kept = far[mesh.faces].all(axis=1)
        if 2 * kept.sum() > len(kept):
            mesh = largest_component(TriangleMesh(mesh.points, mesh.faces[kept])).mesh
    return mesh


def make_mesh(family: str, seed: int | tuple[int, ...]) -> TriangleMesh:
    """Make one random mesh.

    Parameters
    ----------
    family : str
        A key of `FAMILIES`.
    seed : int or tuple of int
        Same seed, same mesh.

    Returns
    -------
    TriangleMesh
        Of order one in size, in some pose; a few thousand to some ten thousand vertices.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.neo.train.families import make_mesh
    >>> mesh = make_mesh("tube", 0)
    >>> len(np.unique(mesh.component_labels))
    1
    """
    if family not in FAMILIES:
        raise InvalidInputError("family", f"be one of {sorted(FAMILIES)}", repr(family))
    rng = np.random.default_rng(seed)
    mesh = FAMILIES[family][0](rng)
    return _deform(mesh, rng, 0.3 if family in _RIGID else 1.0)


def draw_family(rng: Rng, changed: Mapping[str, float] = MappingProxyType({})) -> int:
    """Draw the index of a family by the weights of `FAMILIES`, some of them changed."""
    weights = np.array(list(family_weights(changed).values()))
    return int(rng.choice(len(weights), p=weights / weights.sum()))


def family_weights(changed: Mapping[str, float]) -> dict[str, float]:
    """Return the weights of `FAMILIES`, some of them changed: none negative, and not all zero."""
    if strange := sorted(changed.keys() - FAMILIES.keys()):
        raise InvalidInputError("weights", f"be of families {sorted(FAMILIES)}", strange)
    weights = {name: changed.get(name, weight) for name, (_, weight) in FAMILIES.items()}
    if min(weights.values()) < 0 or not 0 < sum(weights.values()) < np.inf:
        raise InvalidInputError("weights", "not be negative, and not all be zero", changed)
    return weights
