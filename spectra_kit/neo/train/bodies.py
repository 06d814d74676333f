"""Families of one piece: limbs and balls melted together on skeletons, folded, carved or cut."""

from __future__ import annotations

import numpy as np

from spectra_kit._core.types import Floats
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import implicit as clay
from spectra_kit.geometry.components import largest_component
from spectra_kit.geometry.shapes import TriangleMesh
from spectra_kit.neo.train import surfaces as s

Rng = np.random.Generator
CELLS = 60_000  # marching cubes per implicit surface: finer than 2,048 samples resolve
FEWEST = 400  # faces; a crumb left over by cuts shows the grid and not a shape


def polygonized(field: clay.Field, low: Floats, high: Floats) -> TriangleMesh:
    """Largest part of a zero set; raises where there is none, or next to none."""
    points, faces = clay.polygonize(field, low, high, n_cells=CELLS, stride=2)
    if len(faces) < FEWEST:
        expected = f"have a surface of {FEWEST} faces at least on this grid"
        raise InvalidInputError("field", expected, len(faces), advice="take another seed")
    mesh = TriangleMesh(points, faces)
    return largest_component(mesh).mesh if mesh.component_labels.any() else mesh


def _chain(
    rng: Rng, start: Floats, direction: Floats, length: float, n: int, bend: float
) -> Floats:
    """Joints (n + 1, 3) of a limb that sets out in `direction` and bends at each joint."""
    joints, step = [start], direction / np.linalg.norm(direction)
    for _ in range(n):
        step = step + bend * rng.normal(size=3)
        step /= np.linalg.norm(step)
        joints.append(joints[-1] + step * length / n * rng.uniform(0.8, 1.2))
    return np.array(joints)


class Body:
    """Collects the fields of one body, and what is cut from it, with the box that holds it."""

    def __init__(self) -> None:
        self.fields: list[clay.Field] = []
        self.limbs: list[Floats] = []
        self.balls: list[Floats] = []
        self.cuts: list[clay.Field] = []
        self.low, self.high = np.full(3, np.inf), np.full(3, -np.inf)

    def add(self, field: clay.Field, centre: Floats, reach: Floats | float) -> None:
        """Add a field that is positive `reach` from its centre on."""
        self.fields.append(field)
        self._hold(centre, reach)

    def _hold(self, centre: Floats, reach: Floats | float) -> None:
        self.low = np.minimum(self.low, centre - reach)
        self.high = np.maximum(self.high, centre + reach)

    def chain(self, joints: Floats, radii: Floats) -> None:
        """Add a limb of several segments."""
        pairs = zip(joints[:-1], joints[1:], radii[:-1], radii[1:], strict=True)
        for a, b, ra, rb in pairs:
            centre, reach = (a + b) / 2, np.abs(b - a) / 2 + max(ra, rb)
            self.limbs.append(np.concatenate([a, b, [ra, rb]]))
            self._hold(centre, reach)

    def ball(self, centre: Floats, radii: Floats, rotation: Floats | None = None) -> None:
        """Add an ellipsoid."""
        axes = np.eye(3) if rotation is None else rotation
        self.balls.append(np.concatenate([centre, radii, axes.ravel()]))
        self._hold(centre, float(radii.max()))

    def field(self, blend: float) -> clay.Field:
        """Melt all together, and cut."""
        from spectra_kit.neo.train._clay import add_balls, add_limbs  # numba is slow to import

        limbs, balls = np.reshape(self.limbs, (-1, 8)), np.reshape(self.balls, (-1, 15))

        def melted(points: Floats) -> Floats:
            columns, values = np.ascontiguousarray(points.T), np.full(len(points), np.inf)
            add_limbs(columns, limbs, blend, values)
            add_balls(columns, balls, blend, values)
            return values

        whole = clay.smooth_union([melted, *self.fields], blend)
        if not self.cuts:
            return whole
        tool = clay.smooth_union(self.cuts, 0.0)
        return lambda points: np.asarray(np.maximum(whole(points), -tool(points)))

    def mesh(self, blend: float) -> TriangleMesh:
        """Polygonize the field."""
        margin = blend + 0.08 * float((self.high - self.low).max())
        return polygonized(self.field(blend), self.low - margin, self.high + margin)


def quadruped(rng: Rng) -> TriangleMesh:
    """Four legs, neck, head, ears or horns, tail: from dachshund to horse, any pose."""
    body, width = Body(), rng.uniform(0.18, 0.4)
    n = 5
    spine = np.column_stack(
        [np.linspace(-0.9, 0.9, n), 0.06 * rng.normal(size=n), 0.1 * rng.normal(size=n)]
    )
    girth = width * rng.uniform(0.75, 1.25, n)
    body.chain(spine, girth)
    leg, thick = rng.uniform(0.4, 1.3), width * rng.uniform(0.25, 0.5)
    for x, side in ((0, 1), (0, -1), (n - 1, 1), (n - 1, -1)):
        hip = spine[x] + [0, side * 0.6 * width, -0.3 * width]
        aim = np.array([0.35 * rng.normal(), 0.15 * side, -1.0])
        joints = _chain(rng, hip, aim, leg, 3, 0.22)
        body.chain(joints, thick * np.array([1.4, 1.0, 0.7, rng.uniform(0.6, 1.0)]))
    neck = np.array([rng.uniform(0.3, 1), 0.2 * rng.normal(), rng.uniform(-0.1, 1.0)])
    joints = _chain(rng, spine[-1], neck, rng.uniform(0.25, 1.1), 2, 0.15)
    body.chain(joints, width * np.array([0.8, 0.6, 0.5]) * rng.uniform(0.7, 1.1))
    _head(rng, body, joints[-1], width * rng.uniform(0.5, 0.95))
    if rng.random() < 0.85:
        aim = np.array([-1, 0.3 * rng.normal(), 0.6 * rng.normal()])
        joints = _chain(rng, spine[0], aim, rng.uniform(0.2, 1.2), 4, 0.3)
        body.chain(joints, np.linspace(0.3, rng.uniform(0.1, 0.2), 5) * width + 0.015)
    return body.mesh(rng.uniform(0.08, 0.3))


def _head(rng: Rng, body: Body, centre: Floats, size: float) -> None:
    """Skull, snout, and often a pair of ears."""
    body.ball(centre, size * rng.uniform(0.8, 1.2, 3))
    aim = np.array([1.0, 0.1 * rng.normal(), rng.uniform(-0.8, 0.2)])
    snout = centre + size * rng.uniform(0.8, 1.8) * aim
    body.chain(np.array([centre, snout]), size * np.array([0.7, rng.uniform(0.3, 0.6)]))
    if rng.random() < 0.75:
        length, spread, thin = rng.uniform(0.5, 2.2), rng.uniform(0.3, 1.0), rng.uniform(0.15, 0.3)
        for side in (1, -1):
            root = centre + size * np.array([-0.2, 0.5 * side, 0.6])
            aim = np.array([0.3 * rng.normal() - 0.2, side * spread, 1.0])
            joints = _chain(rng, root, aim, size * length, 2, 0.15)
            body.chain(joints, size * np.array([thin, 1.3 * thin, 0.7 * thin]))


def biped(rng: Rng) -> TriangleMesh:
    """Trunk upright, two arms, two legs, a head: humans, apes, monsters, with hands at times."""
    body, width = Body(), rng.uniform(0.16, 0.34)
    spine = _chain(rng, np.zeros(3), np.array([0, 0, 1.0]), rng.uniform(0.7, 1.1), 3, 0.12)
    body.chain(spine, width * rng.uniform(0.75, 1.25, 4))
    shoulder, leg, arm = rng.uniform(1.0, 1.5) * width, rng.uniform(0.7, 1.2), rng.uniform(0.7, 1.1)
    body.chain(
        spine[2] + np.array([[0, -shoulder, 0.05], [0, shoulder, 0.05]]), np.full(2, 0.55 * width)
    )
    stance, lift = rng.uniform(0.05, 0.5), rng.uniform(-1.2, 0.8)
    for side in (1, -1):
        hip = spine[0] + [0, side * 0.55 * width, -0.2 * width]
        aim = np.array([0.25 * rng.normal(), side * stance, -1.0])
        joints = _chain(rng, hip, aim, leg, 3, 0.12)
        body.chain(joints, width * np.array([0.6, 0.5, 0.35, 0.3]) * rng.uniform(0.8, 1.1))
        foot = joints[-1] + [rng.uniform(0.1, 0.25), 0.02 * side, -0.03]
        body.chain(np.array([joints[-1], foot]), width * np.array([0.3, 0.25]))
        aim = np.array([0.4 * rng.normal(), side, lift + 0.3 * rng.normal()])
        joints = _chain(rng, spine[2] + [0, side * shoulder, 0.05], aim, arm, 3, 0.18)
        body.chain(joints, width * np.array([0.5, 0.36, 0.3, 0.24]) * rng.uniform(0.8, 1.1))
        if rng.random() < 0.6:
            body.ball(joints[-1], width * np.array([0.42, 0.3, 0.36]))
    if rng.random() < 0.25:
        tail = _chain(rng, spine[0], np.array([-1, 0, -0.5]), rng.uniform(0.5, 1.2), 4, 0.25)
        body.chain(tail, width * np.linspace(0.6, 0.2, 5))
    neck = spine[3] + [0, 0, width * rng.uniform(0.7, 1.2)]
    body.chain(np.array([spine[3], neck]), width * np.array([0.5, 0.45]))
    if rng.random() < 0.4:
        _head(rng, body, neck, width * rng.uniform(0.6, 0.9))
    else:
        body.ball(
            np.add(neck, [0, 0, 0.4 * width]),
            width * rng.uniform(0.6, 1.0) * np.array([0.9, 0.8, 1.1]),
        )
    return body.mesh(rng.uniform(0.06, 0.2))


def organism(rng: Rng) -> TriangleMesh:
    """A trunk of one to four balls with any number of limbs: hands, octopuses, insects, trees."""
    body, n = Body(), int(rng.integers(1, 5))
    trunk = _chain(rng, np.zeros(3), rng.normal(size=3), 0.45 * (n - 1) + 0.01, n, 0.5)[:n]
    radii = rng.uniform(0.2, 0.55, n)
    for centre, radius in zip(trunk, radii, strict=True):
        body.ball(centre, radius * rng.uniform(0.6, 1.3, 3), s.random_rotation(rng))
    thick, length, wiggle = rng.uniform(0.06, 0.2), rng.uniform(0.5, 1.6), rng.uniform(0.05, 0.5)
    for _ in range(rng.integers(2, 9)):
        i, aim = int(rng.integers(n)), rng.normal(size=3)
        aim /= np.linalg.norm(aim)
        start = trunk[i] + 0.6 * radii[i] * aim
        joints = _chain(rng, start, aim, length * rng.uniform(0.5, 1.3), 4, wiggle)
        body.chain(joints, thick * np.linspace(1.2, rng.uniform(0.4, 1.0), 5))
        if rng.random() < 0.3:
            body.ball(joints[-1], thick * rng.uniform(1.0, 2.2, 3))
    return body.mesh(rng.uniform(0.05, 0.3))


def blob(rng: Rng) -> TriangleMesh:
    """Ellipsoids melted together: busts, bunnies, stones, fruit."""
    body, centre = Body(), np.zeros(3)
    for _ in range(rng.integers(2, 9)):
        radii = rng.uniform(0.18, 0.6) * rng.uniform(0.5, 1.4, 3)
        body.ball(centre, radii, s.random_rotation(rng))
        centre = centre + rng.uniform(0.2, 0.6) * s.random_rotation(rng)[0] * rng.choice([1.0, 1.5])
    return body.mesh(rng.uniform(0.05, 0.5))


def porous(rng: Rng) -> TriangleMesh:
    """A ball or block with random tunnels, or a shell of them: sponges of high genus."""
    frame, half = s.random_rotation(rng), rng.uniform(0.6, 1.0, 3)
    outer = clay.box(np.zeros(3), half) if rng.random() < 0.5 else clay.ellipsoid(np.zeros(3), half)
    waves = s.random_rotation(rng) * rng.uniform(2.5, 5.0)
    phase, level = rng.uniform(0, 6.28, 3), rng.uniform(-0.2, 0.6)

    def field(points: Floats) -> Floats:
        # The gyroid in a random pose, sliced by a level; the factor makes its slope about one.
        q = points @ waves + phase
        value = (np.sin(q) * np.cos(np.roll(q, 1, axis=1))).sum(axis=1) - level
        return np.asarray(np.maximum(outer(points), 0.25 * value))

    mesh = polygonized(field, -half - 0.1, half + 0.1)
    return mesh.with_points(mesh.points @ frame)


def lattice(rng: Rng) -> TriangleMesh:
    """Limbs along the edges of a random graph: frames, baskets, molecules, pretzels."""
    body, n = Body(), int(rng.integers(4, 11))
    nodes = rng.normal(size=(n, 3)) * rng.choice([1.0, 1.0, 0.3], 3)
    if rng.random() < 0.5:  # a cage: nodes on a ball
        nodes /= np.linalg.norm(nodes, axis=1, keepdims=True)
    gaps = np.linalg.norm(nodes[:, None] - nodes, axis=2) + 10 * np.eye(n)
    edges = {(min(i, j), max(i, j)) for i in range(n) for j in np.argsort(gaps[i])[:2].tolist()}
    order = rng.permutation(n).tolist()
    edges |= {(min(e), max(e)) for e in zip(order, order[1:] + order[:1], strict=True)}
    thick = rng.uniform(0.07, 0.25)
    for i, j in edges:
        body.chain(nodes[[i, j]], thick * rng.uniform(0.7, 1.3, 2))
    if rng.random() < 0.4:
        for node in nodes:
            body.ball(node, thick * rng.uniform(1.2, 2.2, 3))
    return body.mesh(rng.uniform(0.0, 0.25))


def machined(rng: Rng) -> TriangleMesh:
    """Boxes, cylinders and rings, added and cut: sharp edges, plates, bores, fillets at times."""
    body, centre = Body(), np.zeros(3)
    for i in range(rng.integers(2, 7)):
        axes = np.eye(3)[rng.permutation(3)] if rng.random() < 0.75 else s.random_rotation(rng)
        half = rng.uniform(0.12, 0.7, 3) * rng.choice([1.0, 1.0, 0.35], 3)
        cut = i > 0 and rng.random() < 0.35
        centre = (body.low + rng.random(3) * (body.high - body.low)) if i else centre
        kind = rng.choice(3, p=[0.5, 0.37, 0.13])
        if kind == 0:
            field, reach = clay.box(centre, half, axes), np.abs(axes) @ half
        elif kind == 1:
            field = clay.cylinder(centre, half[0], 3.0 if cut else half[2], axes)
            reach = np.abs(axes) @ half[[0, 0, 2]]
        else:
            field = clay.ring(centre, half[0] + 0.15, 0.12 + 0.2 * half[1], axes)
            reach = np.full(3, half[0] + half[1] + 0.3)
        if cut:
            body.cuts.append(field)
        else:
            body.add(field, centre, reach)
    return body.mesh(rng.choice([0.0, 0.0, rng.uniform(0.05, 0.2)]))


def symmetric(rng: Rng) -> TriangleMesh:
    """Mirrored twins and things of n equal arms: beetles, stars, propellers, gears, flowers."""
    body = Body()
    body.ball(np.zeros(3), rng.uniform(0.1, 0.45, 3))
    start, n = np.zeros(3), int(rng.integers(1, 9))
    for _ in range(rng.integers(2, 6)):
        way = rng.normal(size=3) * [1.0, rng.choice([0.15, 0.6]), rng.choice([0.2, 0.7])]
        end = start + rng.uniform(0.4, 0.9) * way / np.linalg.norm(way)
        end[0] = abs(end[0])
        if n > 1:  # stay in the sector that is seen
            end[1] = min(abs(end[1]), 0.5 * np.tan(np.pi / n) * end[0])
        half, axes = rng.uniform(0.06, 0.3, 3), s.random_rotation(rng)
        body.chain(np.array([start, end]), rng.uniform([0.06, 0.05], [0.25, 0.2]))
        kind = rng.choice(3, p=[0.5, 0.25, 0.25])
        if kind == 0:
            body.ball(end, half, axes)
        else:
            tip = clay.box(end, half) if kind == 1 else clay.cylinder(end, half[0], half[1] / 2)
            body.add(tip, end, half)
        start = end if rng.random() < 0.7 else np.zeros(3)
    arm = body.field(rng.choice([0.0, rng.uniform(0.05, 0.25)]))

    def field(points: Floats) -> Floats:
        folded = np.abs(points)
        folded[:, 2] = points[:, 2]
        if n > 1:  # all arms onto the first one, and its two halves onto each other
            angle = np.arctan2(points[:, 1], points[:, 0])
            angle = np.abs((angle + np.pi / n) % (2 * np.pi / n) - np.pi / n)
            radius = np.hypot(points[:, 0], points[:, 1])
            folded[:, 0], folded[:, 1] = radius * np.cos(angle), radius * np.sin(angle)
        else:
            folded[:, 1] = points[:, 1]
        return arm(folded)

    # A first look on a coarse grid finds the box.
    grid = np.stack(np.meshgrid(*[np.linspace(-3, 3, 31)] * 3, indexing="ij"), -1).reshape(-1, 3)
    inside = grid[field(grid) < 0.15]
    return polygonized(field, inside.min(axis=0) - 0.25, inside.max(axis=0) + 0.25)


def sculpture(rng: Rng) -> TriangleMesh:
    """A body with fur, folds or scales, whole or cut off open: scans, busts, statues, armour."""
    makers = (quadruped, biped, organism, blob)
    mesh = makers[rng.choice(4, p=[0.2, 0.25, 0.15, 0.4])](rng)
    size = float(np.ptp(mesh.points, axis=0).max())
    relief = np.zeros(mesh.n)
    for _ in range(rng.integers(1, 4)):
        fine = s.waves(mesh.points, rng, frequency=rng.uniform(4.0, 20.0) / size)
        fine = 1 - 2 * np.abs(fine) if rng.random() < 0.5 else fine
        where = np.clip(s.waves(mesh.points, rng, frequency=rng.uniform(1.0, 4.0) / size), 0, 1)
        relief += rng.uniform(0.2, 1.0) * fine * (where if rng.random() < 0.6 else 1.0)
    depth = rng.uniform(0.004, 0.025) * size
    mesh = s.raised(mesh, depth * relief)
    if rng.random() < 0.4:
        height = mesh.points @ s.random_rotation(rng)[0]
        above = (height > np.quantile(height, rng.uniform(0.05, 0.5)))[mesh.faces].all(axis=1)
        mesh = largest_component(TriangleMesh(mesh.points, mesh.faces[above])).mesh
    return mesh
