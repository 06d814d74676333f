"""Man-made families of the corpus: vessels, machine parts, things joined from parts."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._types import Floats
from spectra_kit.geometry import implicit as clay
from spectra_kit.geometry.shapes import TriangleMesh
from spectra_kit.training import surfaces as s
from spectra_kit.training.bodies import polygonized

Rng = np.random.Generator


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


def machined(rng: Rng) -> TriangleMesh:
    """Boxes, cylinders and rings, added and cut: sharp edges, plates, bores, fillets at times."""
    n = int(rng.integers(2, 7))
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    solids: list[clay.Field] = []
    cuts: list[clay.Field] = []
    centre = np.zeros(3)
    for i in range(n):
        axes = np.eye(3)[rng.permutation(3)] if rng.random() < 0.75 else s.random_rotation(rng)
        half = rng.uniform(0.12, 0.7, 3) * rng.choice([1.0, 1.0, 0.35], 3)
        cut = i > 0 and rng.random() < 0.35
        centre = (low + rng.random(3) * (high - low)) if i else centre
        kind = rng.choice(3, p=[0.5, 0.37, 0.13])
        if kind == 0:
            field, reach = clay.box(centre, half, axes), np.abs(axes) @ half
        elif kind == 1:
            depth = 3.0 if cut else half[2]
            field = clay.cylinder(centre, half[0], depth, axes)
            reach = np.abs(axes) @ np.array([half[0], half[0], half[2]])
        else:
            field = clay.ring(centre, half[0] + 0.15, 0.12 + 0.2 * half[1], axes)
            reach = np.full(3, half[0] + half[1] + 0.3)
        (cuts if cut else solids).append(field)
        if not cut:
            low, high = np.minimum(low, centre - reach), np.maximum(high, centre + reach)
    blend = rng.choice([0.0, 0.0, rng.uniform(0.05, 0.2)])
    body = clay.smooth_union(solids, blend)
    tool = clay.smooth_union(cuts, 0.0) if cuts else None

    def rest(points: Floats) -> Floats:
        value = body(points)
        return value if tool is None else np.asarray(np.maximum(value, -tool(points)))

    margin = 0.1 * float((high - low).max())
    return polygonized(rest, low - margin, high + margin)


def _part(rng: Rng, centre: Floats, radii: Floats, sharp: float) -> TriangleMesh:
    """One closed part: box-like, cylinder-like or round, axis-aligned."""
    exponents = ((sharp, sharp), (sharp, 1.0), (1.0, 1.0))[rng.choice(3, p=[0.55, 0.3, 0.15])]
    mesh = s.superquadric(exponents, radii, n_u=24, n_v=36)
    return mesh.with_points(mesh.points + centre)


def assembly(rng: Rng) -> TriangleMesh:
    """Parts that touch or pierce each other, not welded: aeroplanes, tools, towers."""
    sharp, kind = rng.uniform(0.1, 0.4), rng.integers(3)
    parts: list[TriangleMesh] = []

    def add(centre: ArrayLike, radii: ArrayLike) -> None:
        parts.append(_part(rng, np.asarray(centre), np.asarray(radii), sharp))

    if kind == 0:  # aeroplane: fuselage, wings, tail, engines
        width, span, sweep = rng.uniform(0.08, 0.2), rng.uniform(0.5, 1.2), rng.uniform(-0.1, 0.5)
        parts.append(s.superquadric((1.0, 1.0), [1.0, width, width * rng.uniform(0.8, 1.2)]))
        for x, reach, chord in ((0.1, span, 0.2), (-0.85, 0.4 * span, 0.1)):
            for side in (1, -1):
                wing = s.superquadric((0.5, 0.5), [chord * rng.uniform(0.8, 1.5), reach / 2, 0.025])
                shift = side * (wing.points[:, 1] + reach / 2 * side)
                points = np.add(wing.points, [x, side * reach / 2, 0])
                points[:, 0] -= sweep * shift
                points[:, 2] += rng.choice([0.0, 0.15]) * shift
                parts.append(wing.with_points(points))
        add([-0.85, 0, 0.2], [0.12, 0.02, 0.22])
        if rng.random() < 0.5:
            for side in (1, -1):
                add([0.15, side * 0.4 * span, -0.06], [0.15, 0.06, 0.06])
    elif kind == 1:  # hammer, spoon, lamp, dumb-bell: a shaft with something at its ends
        r, length = rng.uniform(0.05, 0.12), rng.uniform(0.6, 1.2)
        parts.append(s.superquadric((0.15, 1.0), [r, r * rng.uniform(0.6, 1), length]))
        for end in (1, -1)[: rng.integers(1, 3)]:
            add([0, 0, end * length], rng.uniform(0.08, 0.5, 3))
            if rng.random() < 0.5:
                add([rng.uniform(0.1, 0.3), 0, end * length], rng.uniform(0.06, 0.3, 3))
    else:  # a pile: each part set on the border of an earlier one
        boxes = [(np.zeros(3), rng.uniform(0.15, 0.6, 3))]
        add(*boxes[0])
        for _ in range(rng.integers(2, 8)):
            c, size = boxes[rng.integers(len(boxes))]
            side = np.eye(3)[rng.integers(3)] * rng.choice([1, -1])
            radii = rng.uniform(0.06, 0.5, 3)
            slide = (1 - np.abs(side)) * size * rng.uniform(-0.6, 0.6, 3)
            centre = c + side * (size + 0.9 * radii) + slide
            boxes.append((centre, radii))
            add(centre, radii)
    return s.join(parts)
