"""Families put together from parts that pierce each other, as downloaded models are."""

from __future__ import annotations

import igl
import numpy as np
from numpy.typing import ArrayLike

from spectra_kit.geometry.shapes import TriangleMesh
from spectra_kit.neo.train import surfaces as s

Rng = np.random.Generator
_CORNERS = [(x, y) for x in (-1, 1) for y in (-1, 1)]


class _Kit:
    """Collects parts that pierce each other; x is ahead or to the right, z is up."""

    def __init__(self, rng: Rng) -> None:
        self.rng, self.parts = rng, list[TriangleMesh]()

    def plate(self, centre: ArrayLike, half: ArrayLike) -> None:
        """Add a box of 12 triangles."""
        corners, faces = igl.bounding_box(np.array([-np.asarray(half), np.asarray(half)]))
        self.parts.append(TriangleMesh(corners + np.asarray(centre), faces))

    def round(
        self, centre: ArrayLike, radii: ArrayLike, sharp: float | tuple[float, float] = 0.5
    ) -> None:
        """Add a cushion, by `sharp` between box (0) and ellipsoid (1), along and around z."""
        exponents = sharp if isinstance(sharp, tuple) else (sharp, sharp)
        mesh = s.superquadric(exponents, radii, n_u=20, n_v=30)
        self.parts.append(mesh.with_points(mesh.points + np.asarray(centre)))

    def rod(self, start: ArrayLike, end: ArrayLike, r0: float, r1: float | None = None) -> None:
        """Add a tube from `start` to `end`, open at its ends."""
        radii = np.linspace(r0, r0 if r1 is None else r1, 8)
        line = np.linspace(np.asarray(start), np.asarray(end), 8)
        self.parts.append(s.sweep(line, radii, closed=False))

    def wheel(self, centre: ArrayLike, radius: float, half_width: float) -> None:
        """Add a disc or a tyre with spokes, its axle along y."""
        c = np.asarray(centre, dtype=np.float64)
        if self.rng.random() < 0.6:
            disc = s.superquadric((0.15, 1.0), [radius, radius, half_width], n_u=12, n_v=36)
            points = disc.points[:, [0, 2, 1]]
        else:
            a = np.linspace(0, 2 * np.pi, 40, endpoint=False)
            minor = min(half_width, 0.3 * radius)
            circle = (radius - minor) * np.stack([np.cos(a), 0 * a, np.sin(a)], 1)
            disc = s.sweep(circle, minor, closed=True)
            points = disc.points
            for i in range(0, 40, 40 // int(self.rng.integers(3, 7))):
                self.rod(c, c + circle[i], 0.1 * radius)
        self.parts.append(disc.with_points(points + c))

    def mesh(self) -> TriangleMesh:
        """Join all parts, with edges short enough to be bent."""
        mesh = s.join(self.parts)
        return s.bisected(mesh, 0.15 * float(np.ptp(mesh.points, axis=0).max()))


def _chair(kit: _Kit) -> None:
    """Chair, stool, bench."""
    rng = kit.rng
    w, d, h, thin = rng.uniform([0.35, 0.3, 0.3, 0.015], [1.0, 0.7, 1.0, 0.05])
    r, splay = rng.uniform(0.02, 0.06), rng.choice([0.0, rng.uniform(0.0, 0.2)])
    cushion, square = rng.random() < 0.4, rng.random() < 0.5
    (kit.round if cushion else kit.plate)([0, 0, h], [w, d, rng.uniform(0.03, 0.1)])
    for x, y in _CORNERS:
        foot = [x * (w - r + splay), y * (d - r + splay), 0]
        if square:
            kit.plate([x * (w - r), y * (d - r), h / 2], [r, r, h / 2])
        else:
            kit.rod(foot, [x * (w - 2 * r), y * (d - 2 * r), h], 0.7 * r, r)
    tall = rng.choice([0.0, rng.uniform(0.4, 1.0), rng.uniform(0.4, 1.0)])
    if tall and rng.random() < 0.5:
        kit.plate([0, d - thin, h + tall], [w, thin, 0.5 * tall])
        for x in (-1, 1):
            kit.rod([x * (w - r), d - thin, h - 0.02], [x * (w - r), d - thin, h + tall], r)
    elif tall:
        n = rng.integers(2, 7)
        for x in np.linspace(-w + r, w - r, n):
            kit.rod([x, d - thin, h - 0.02], [x, d - thin, h + tall], 0.6 * r)
        kit.plate([0, d - thin, h + tall], [w, r, 1.5 * r])
    if tall and rng.random() < 0.4:
        for x in (-1, 1):
            kit.plate([x * w, 0, h + 0.4 * tall], [r, d, 0.6 * r])
            kit.rod([x * w, -0.8 * d, h - 0.02], [x * w, -0.8 * d, h + 0.4 * tall], 0.6 * r)


def _cupboard(kit: _Kit) -> None:
    """Cupboard, shelf, chest of drawers."""
    rng = kit.rng
    w, d, h, thin = rng.uniform([0.35, 0.3, 0.3, 0.015], [1.0, 0.7, 1.0, 0.05])
    h *= rng.uniform(0.6, 1.8)
    for x in (-1, 1):
        kit.plate([x * w, 0, h], [thin, d, h])
    n = int(rng.integers(2, 7))
    for z in np.linspace(thin, 2 * h - thin, n):
        kit.plate([0, 0, z], [w, d, thin])
    if rng.random() < 0.6:
        kit.plate([0, d, h], [w, thin / 2, h])
    for z in (np.linspace(0, 2 * h, n)[:-1] + h / (n - 1)) if rng.random() < 0.6 else ():
        if rng.random() < 0.7:  # a drawer, pulled out a little
            out = rng.choice([0.0, rng.uniform(0.0, 0.3)])
            kit.plate([0, -d - out, z], [0.95 * w, thin, 0.85 * h / (n - 1)])
            kit.round([0, -d - out - 2 * thin, z], [2 * thin, 2 * thin, 2 * thin], 1.0)


def _sofa(kit: _Kit) -> None:
    """Sofa, bed."""
    rng = kit.rng
    w, d = rng.uniform(0.35, 1.0), rng.uniform(0.3, 0.7)
    seat, soft = rng.uniform(0.1, 0.25), rng.uniform(0.15, 0.5)
    kit.round([0, 0, seat], [w, d, seat], 0.15)
    n = int(rng.integers(1, 4))
    for x in (2 * np.arange(n) + 1 - n) * w / n:
        kit.round(
            [x, -0.1 * d, 2.1 * seat], [0.98 * w / n, 0.9 * d, rng.uniform(0.5, 1) * seat], soft
        )
    kit.round([0, 0.9 * d, 2.5 * seat], [w, 0.2 * d, rng.uniform(1.0, 2.5) * seat], soft)
    for x in (-1, 1)[: rng.integers(0, 3)]:
        kit.round([x * w, 0, 1.8 * seat], [0.15 * w, d, 1.8 * seat], soft)
    for x, y in _CORNERS:
        kit.rod([x * 0.9 * w, y * 0.9 * d, -0.15], [x * 0.9 * w, y * 0.9 * d, 0.05], 0.04)


def _car(kit: _Kit) -> None:
    """Car, van, lorry, train."""
    rng = kit.rng
    w, h = rng.uniform(0.25, 0.5), rng.uniform(0.12, 0.3)
    soft, r = rng.uniform(0.1, 0.6), rng.uniform(0.14, 0.28)
    kit.round([0, 0, h + 0.5 * r], [1, w, h], soft)
    back, front = -rng.uniform(0.2, 0.95), rng.uniform(0.1, 0.9)
    tall = rng.uniform(0.6, 2.0) * h
    cabin = [(front - back) / 2, 0.92 * w, tall]
    kit.round([(front + back) / 2, 0, 2 * h + 0.4 * r + 0.5 * tall], cabin, soft)
    axles = np.linspace(-0.7, 0.7, rng.choice([2, 2, 2, 3, 4, 5]))
    for x in axles:
        for y in (-1, 1):
            kit.wheel([x, y * 0.95 * w, 0.5 * r], min(r, 0.6 / len(axles)), 0.2 * w)
    if rng.random() < 0.5:
        for x in (-1, 1):
            kit.plate([x, 0, 0.9 * h], [0.05, 0.9 * w, 0.2 * h])


def _ship(kit: _Kit) -> None:
    """An open hull, with a deck, cabins, masts and sails."""
    rng = kit.rng
    w = rng.uniform(0.25, 0.5)
    u, v = np.meshgrid(np.linspace(-1, 1, 40), np.linspace(0, np.pi, 24), indexing="ij")
    beam = w * (1 - np.abs(u) ** rng.uniform(1.5, 4)) + 0.01
    hull = np.stack([u, beam * np.cos(v), -rng.uniform(0.8, 1.5) * beam * np.sin(v)], -1)
    hull[..., 2] += rng.uniform(0, 0.2) * u**2
    kit.parts.append(s.grid_mesh(hull))
    if rng.random() < 0.7:
        kit.plate([0, 0, -0.05], [0.8, 0.75 * w, 0.01])
    low, x = -0.05, rng.uniform(-0.6, 0.3)
    for _ in range(rng.integers(1, 4)):
        size = [rng.uniform(0.1, 0.35), rng.uniform(0.3, 0.65) * w, rng.uniform(0.06, 0.15)]
        kit.plate([x, 0, low + size[2]], size)
        low += 2 * size[2] - 0.01
    for _ in range(rng.integers(0, 4)):
        x, tall = rng.uniform(-0.7, 0.7), rng.uniform(0.3, 1.0)
        kit.rod([x, 0, -0.1], [x, 0, tall], rng.uniform(0.015, 0.06))
        if rng.random() < 0.5:
            kit.plate([x + 0.05, 0, 0.6 * tall], [0.008, 0.8 * w, 0.35 * tall])


def _bicycle(kit: _Kit) -> None:
    """Bicycle, motor-cycle."""
    rng = kit.rng
    r, tube = rng.uniform(0.3, 0.45), rng.uniform(0.02, 0.06)
    for x in (-0.6, 0.6):
        kit.wheel([x, 0, 0], r, rng.uniform(0.03, 0.1))
    seat, head, crank = [-0.3, 0, 0.6], [0.42, 0, 0.6], [-0.1, 0, -0.05]
    back, fork = [-0.6, 0, 0], [0.6, 0, 0]
    bars = [(back, seat), (back, crank), (crank, seat), (crank, head), (seat, head)]
    bars += [(fork, head), (head, [0.4, 0, 0.75])]
    for a, b in bars:
        kit.rod(a, b, tube)
    kit.rod([0.4, -0.3, 0.75], [0.4, 0.3, 0.75], tube)
    kit.round([-0.3, 0, 0.63], [0.15, 0.08, 0.05], 0.8)
    if rng.random() < 0.5:
        kit.round([0, 0, 0.25], [0.35, 0.12, 0.25], 0.6)


def furniture(rng: Rng) -> TriangleMesh:
    """Chairs, cupboards, sofas."""
    kit = _Kit(rng)
    (_chair, _cupboard, _sofa)[rng.integers(3)](kit)
    return kit.mesh()


def vehicle(rng: Rng) -> TriangleMesh:
    """Cars, ships, bicycles."""
    kit = _Kit(rng)
    (_car, _ship, _bicycle)[rng.integers(3)](kit)
    return kit.mesh()


def assembly(rng: Rng) -> TriangleMesh:
    """Parts that touch or pierce each other, not welded: aeroplanes, tools, piles."""
    kit = _Kit(rng)
    (_aeroplane, _tool, _pile)[rng.integers(3)](kit, rng.uniform(0.1, 0.4))
    return s.join(kit.parts)


def _add(kit: _Kit, centre: ArrayLike, radii: ArrayLike, sharp: float) -> None:
    """Add a part that is like a box, a cylinder or round."""
    exponents = ((sharp, sharp), (sharp, 1.0), (1.0, 1.0))
    kit.round(centre, radii, exponents[kit.rng.choice(3, p=[0.55, 0.3, 0.15])])


def _aeroplane(kit: _Kit, sharp: float) -> None:
    """Fuselage, wings, tail, engines."""
    rng = kit.rng
    width, span, sweep = rng.uniform(0.08, 0.2), rng.uniform(0.5, 1.2), rng.uniform(-0.1, 0.5)
    kit.round([0, 0, 0], [1.0, width, width * rng.uniform(0.8, 1.2)], 1.0)
    for x, reach, chord in ((0.1, span, 0.2), (-0.85, 0.4 * span, 0.1)):
        for side in (1, -1):
            wing = s.superquadric((0.5, 0.5), [chord * rng.uniform(0.8, 1.5), reach / 2, 0.025])
            shift = side * (wing.points[:, 1] + reach / 2 * side)
            points = np.add(wing.points, [x, side * reach / 2, 0])
            points[:, 0] -= sweep * shift
            points[:, 2] += rng.choice([0.0, 0.15]) * shift
            kit.parts.append(wing.with_points(points))
    _add(kit, [-0.85, 0, 0.2], [0.12, 0.02, 0.22], sharp)
    if rng.random() < 0.5:
        for side in (1, -1):
            _add(kit, [0.15, side * 0.4 * span, -0.06], [0.15, 0.06, 0.06], sharp)


def _tool(kit: _Kit, sharp: float) -> None:
    """Hammer, spoon, lamp, dumb-bell: a shaft with something at its ends."""
    rng = kit.rng
    r, length = rng.uniform(0.05, 0.12), rng.uniform(0.6, 1.2)
    kit.round([0, 0, 0], [r, r * rng.uniform(0.6, 1), length], (0.15, 1.0))
    for end in (1, -1)[: rng.integers(1, 3)]:
        _add(kit, [0, 0, end * length], rng.uniform(0.08, 0.5, 3), sharp)
        if rng.random() < 0.5:
            centre = [rng.uniform(0.1, 0.3), 0, end * length]
            _add(kit, centre, rng.uniform(0.06, 0.3, 3), sharp)


def _pile(kit: _Kit, sharp: float) -> None:
    """Each part set on the border of an earlier one."""
    rng = kit.rng
    boxes = [(np.zeros(3), rng.uniform(0.15, 0.6, 3))]
    for _ in range(rng.integers(2, 8)):
        c, size = boxes[rng.integers(len(boxes))]
        side = np.eye(3)[rng.integers(3)] * rng.choice([1, -1])
        radii = rng.uniform(0.06, 0.5, 3)
        slide = (1 - np.abs(side)) * size * rng.uniform(-0.6, 0.6, 3)
        boxes.append((c + side * (size + 0.9 * radii) + slide, radii))
    for centre, radii in boxes:
        _add(kit, centre, radii, sharp)
