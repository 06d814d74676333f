"""A procedural animal of any resolution: the surface of the demos, made without a download.

And pairs with a known correspondence: the same animal bent, remeshed, renumbered or mirrored.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import igl
import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from spectra_kit._core.checked import checked
from spectra_kit._core.records import frozen
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_count
from spectra_kit.geometry.implicit import Field, ellipsoid, limb, polygonize, smooth_union
from spectra_kit.geometry.shapes import PointCloud, TriangleMesh

_LOW, _HIGH = np.array([-1.75, -0.85, -1.05]), np.array([1.65, 0.85, 1.35])
_COARSE = 10_000  # vertices that marching cubes and decimation make; subdivision makes the rest

# Largest angles about x, y and z in radians, and half the width over which a joint bends.
_LIMITS = {
    "knee": (0.1, 0.6, 0.1),
    "hip": (0.25, 0.5, 0.15),
    "neck": (0.3, 0.45, 0.5),
    "tail": (0.3, 0.8, 0.8),
    "spine": (0.3, 0.35, 0.5),
}
_SOFT = {"knee": 0.12, "hip": 0.16, "neck": 0.2, "tail": 0.12, "spine": 0.35}


Kind = TypeVar("Kind", TriangleMesh, PointCloud)


@checked
def creature(n_points: int = 8000, *, seed: int = 0, pose: int = 0) -> TriangleMesh:
    """Make a fox-like animal: one closed surface of genus 0, mid-stride and looking aside.

    Parameters
    ----------
    n_points : int, default 8000
        Number of vertices, at least 500; met within 1 per cent.
    seed : int, default 0
        Proportions and stance; 0 is the animal of the pictures.
    pose : int, default 0
        Above 0, the same animal with spine, neck, tail and legs bent at random: vertex i is the
        same point of the skin in every pose, and edges keep their length to a few per cent.

    Returns
    -------
    TriangleMesh
        About 2.5 long, head towards +x, up +z, faces oriented outwards. No symmetry, so its low
        eigenvalues are simple.

    Notes
    -----
    Vertices lie on the zero set of a smooth union of tapered capsules and ellipsoids. Marching
    cubes finds it, edge collapse sets the number of vertices, smoothing within the surface rounds
    the triangles, midpoint subdivision with projection refines them.

    Examples
    --------
    >>> from spectra_kit.geometry import creature
    >>> mesh = creature(1000)
    >>> mesh.n, len(mesh.boundary_vertices), mesh.n - len(mesh.faces) // 2
    (1000, 0, 2)
    """
    check_count("n_points", n_points, low=500, high=5_000_000)
    check_count("seed", seed, low=0)
    check_count("pose", pose, low=0)
    return _posed(*_at_rest(n_points, seed), pose)


def _at_rest(n_points: int, seed: int) -> tuple[_Animal, TriangleMesh]:
    animal = _animal(np.random.default_rng(seed), calm=seed == 0)
    field = animal.field
    levels = 0
    while n_points > _COARSE * 4**levels:
        levels += 1
    # On a closed surface of genus 0 midpoint subdivision turns n vertices into 4 n - 6.
    mesh = _remeshed(field, round((n_points - 2) / 4**levels) + 2)
    for _ in range(levels):
        mesh = TriangleMesh(*igl.upsample(mesh.points, mesh.faces, 1))
        mesh = _relaxed(mesh, field, steps=1)
    return animal, mesh


def _posed(animal: _Animal, mesh: TriangleMesh, pose: int) -> TriangleMesh:
    return mesh.with_points(_bent(animal, mesh.points, pose)) if pose else mesh


@dataclass(frozen=True, eq=False)
class _Animal:
    """The primitives of one animal, in order, and where it bends.

    `hinges` maps a name to the point to turn about and the numbers of the parts beyond it; those
    nearer to the tips come first.
    """

    parts: list[Field]
    hinges: dict[str, tuple[Floats, list[int]]]

    @property
    def field(self) -> Field:
        """All parts melted together."""
        return smooth_union(self.parts, 0.1)


def _animal(rng: np.random.Generator, *, calm: bool) -> _Animal:
    """Put the animal together; `calm` leaves out the random deviations."""

    def vary(amount: float) -> float:
        return 1.0 if calm else float(np.exp(amount * rng.uniform(-1, 1)))

    parts: list[Field] = []
    hinges: dict[str, tuple[Floats, list[int]]] = {}

    def chain(joints: ArrayLike, radii: ArrayLike) -> None:
        p, r = np.asarray(joints, dtype=np.float64), np.asarray(radii, dtype=np.float64)
        for i in range(len(p) - 1):
            parts.append(limb(p[i], p[i + 1], r[i], r[i + 1]))

    def hinge(name: str, pivot: ArrayLike, first: int) -> None:
        hinges[name] = np.asarray(pivot, dtype=np.float64), list(range(first, len(parts)))

    stout, leggy = vary(0.25), vary(0.3)
    chain(
        [[0.52, 0.02, 0.02], [0.18, 0.0, 0.0], [-0.15, -0.01, 0.03], [-0.5, 0.0, 0.04]],
        stout * np.array([0.25, 0.235, 0.2, 0.225]),
    )
    # Legs: hip, knee, ankle, paw; the strides differ, so no mirror symmetry is left.
    strides = np.array([0.24, -0.16, -0.2, 0.26]) * (1 if calm else rng.uniform(-1.3, 1.3, 4))
    for (x, side, hind), stride in zip(
        ((0.5, 1, 0), (0.5, -1, 0), (-0.52, 1, 1), (-0.52, -1, 1)), strides, strict=True
    ):
        hip = np.array([x, 0.12 * side * stout, -0.06])
        knee = hip + [0.4 * stride + (0.1 if hind else -0.05), 0.05 * side, -0.32 * leggy]
        ankle = knee + [0.45 * stride - (0.16 if hind else -0.02), 0.0, -0.28 * leggy]
        paw = ankle + [0.1, 0.01 * side, -0.06]
        thick, first = (0.17 if hind else 0.145), len(parts)
        chain([hip, knee, ankle, paw], [thick, 0.095, 0.06, 0.065])
        hinge(f"knee {x} {side}", knee, first + 1)
        hinge(f"hip {x} {side}", hip, first)
    # Neck and head; the head turns and nods about its own centre.
    yaw, nod = (0.5, 0.1) if calm else rng.uniform([-0.8, -0.4], [0.8, 0.4])
    head = np.array([0.98, 0.08, 0.5]) * [1, 1, vary(0.25)]
    first, neck = len(parts), np.array([0.58, 0.02, 0.08])
    chain(np.array([neck, head - [0.06, 0.0, 0.04]]), [0.19 * stout, 0.125])
    cy, sy, cn, sn = np.cos(yaw), np.sin(yaw), np.cos(nod), np.sin(nod)
    turn = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    turn = turn @ np.array([[cn, 0, sn], [0, 1, 0], [-sn, 0, cn]])

    def at(*local: float) -> Floats:
        return np.asarray(head + turn @ np.array(local))

    parts.append(ellipsoid(head, [0.2, 0.175, 0.165], turn))
    snout = 0.36 * vary(0.3)
    chain([at(0.08, 0, -0.03), at(snout, 0, -0.08)], [0.115, 0.05])
    parts.append(ellipsoid(at(snout + 0.03, 0, -0.055), [0.04, 0.045, 0.035], turn))
    ear = 0.27 * vary(0.4)
    for side, spread in ((1, 0.12), (-1, 0.2)):  # one ear listens elsewhere
        middle = at(-0.05, (0.09 + 0.3 * spread) * side, 0.1 + 0.6 * ear)
        tip = at(0.3 * spread - 0.08, (0.09 + 0.7 * spread) * side, 0.1 + ear)
        chain([at(-0.04, 0.09 * side, 0.1), middle, tip], [0.077, 0.064, 0.024])
    hinge("neck", neck, first)
    # A brush of a tail, swung aside and up.
    t, first = np.linspace(0, 1, 8), len(parts)
    swing, lift = (0.5, 0.55) if calm else rng.uniform([-0.7, -0.2], [0.7, 0.9])
    tail = np.column_stack(
        [-0.66 - 0.8 * t + 0.12 * t**2, swing * t**1.6, 0.1 - 0.25 * t + lift * t**2]
    )
    chain(tail, 0.075 - 0.025 * t + 0.07 * np.sin(np.pi * t**1.3) * vary(0.3))
    hinge("tail", tail[2], first + 2)
    return _Animal(parts, hinges)


def _bent(animal: _Animal, points: Floats, pose: int) -> Floats:
    """Turn every joint by a random angle, those nearer to the tips first, the spine last.

    A point turns by its share of the *angle*, not towards a mean of two positions, so that limbs
    keep their thickness at a joint.
    """
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(pose)
    distances = np.stack([part(points) for part in animal.parts])
    moved, along = points, points[:, 0]

    def turned(kind: str, pivot: Floats, beyond: Floats) -> tuple[Floats, Floats]:
        """Return the points, and how much each takes part: 1 if far `beyond` the joint."""
        t = np.clip(0.5 + 0.5 * beyond / _SOFT[kind], 0.0, 1.0)
        weight = t * t * (3 - 2 * t)
        turns = Rotation.from_rotvec(weight[:, None] * (_LIMITS[kind] * rng.uniform(-1, 1, 3)))
        return pivot + turns.apply(moved - pivot), weight

    for name, (pivot, parts) in animal.hinges.items():
        kind = name.split()[0]
        rest = np.delete(distances, parts, axis=0).min(axis=0)
        moved, weight = turned(kind, pivot, rest - distances[parts].min(axis=0))
        if kind == "hip":  # a leg follows the spine where it is attached
            along = along + weight * (pivot[0] - along)
    return turned("spine", np.zeros(3), along)[0]


def _remeshed(field: Field, n: int) -> TriangleMesh:
    """Closed mesh of the zero set with n vertices and well-shaped triangles."""
    n_cells = 60_000
    mesh = TriangleMesh(*polygonize(field, _LOW, _HIGH, n_cells=n_cells, stride=3))
    if mesh.n < 1.4 * n:  # vertices grow like cells^(2/3)
        n_cells = int(n_cells * (1.5 * n / mesh.n) ** 1.5)
        mesh = TriangleMesh(*polygonize(field, _LOW, _HIGH, n_cells=n_cells, stride=4))
    # The ranges of `_animal` keep its parts apart; only an edit of them can break this.
    assert mesh.n - len(mesh.faces) // 2 == 2, "the animal must be one sphere with no handle"
    points, faces, *_ = igl.decimate(np.asfortranarray(mesh.points), mesh.faces, 2 * n - 4)
    return _relaxed(TriangleMesh(points, faces), field, steps=15)


def _relaxed(mesh: TriangleMesh, field: Field, *, steps: int) -> TriangleMesh:
    """Move vertices within the surface towards the centre of their neighbours."""
    i, j = np.concatenate([mesh.edges, mesh.edges[:, ::-1]]).T
    adjacency = sparse.csr_array((np.ones(len(i)), (i, j)), shape=(mesh.n, mesh.n))
    degree = adjacency.sum(axis=1)[:, None]
    points, gradient = _projected(field, mesh.points)
    for _ in range(steps):
        normals = gradient / np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-12)
        move = adjacency @ points / degree - points
        move -= np.sum(move * normals, axis=1, keepdims=True) * normals
        points, gradient = _projected(field, points + 0.6 * move)
    return mesh.with_points(_projected(field, points)[0])


def _projected(field: Field, points: Floats) -> tuple[Floats, Floats]:
    """One Newton step onto the zero set, and the gradient it went along."""
    gradient = _gradient(field, points)
    # Where fields melt together the slope falls; the floor keeps steps there short.
    squared = np.maximum(np.sum(gradient**2, axis=1), 0.04)
    return points - (field(points) / squared)[:, None] * gradient, gradient


def _gradient(field: Field, points: Floats, *, step: float = 1e-5) -> Floats:
    """Differences to the four corners of a small tetrahedron, whose directions sum to zero."""
    corners = np.array([[1.0, -1, -1], [-1, -1, 1], [-1, 1, -1], [1, 1, 1]])
    return np.asarray(sum(np.outer(field(points + step * c), c) for c in corners) / (4 * step))


@checked
def creature_pair(
    n_source: int = 2000,
    n_target: int | None = None,
    *,
    seed: int = 0,
    poses: tuple[int, int] = (1, 2),
) -> tuple[TriangleMesh, TriangleMesh, Ints]:
    """Make one animal in two poses, with the point of the source that each target point is.

    Parameters
    ----------
    n_source : int, default 2000
        Vertices of the source, at least 500; met within 1 per cent.
    n_target : int, optional
        Vertices of the target; another number gives it other triangles. As many as the source by
        default, and then the very same triangles.
    seed : int, default 0
        Which animal.
    poses : tuple of int, default (1, 2)
        Of source and target, as in `creature`.

    Returns
    -------
    source, target : TriangleMesh
        Nearly isometric. Left and right differ little, so that they are easily confused.
    point_map : ndarray of shape (n2,)
        The source vertex of each target vertex: exact for equal triangles, else the nearest on the
        animal at rest.

    Examples
    --------
    >>> from spectra_kit.geometry import creature_pair
    >>> source, target, point_map = creature_pair(800, 600)
    >>> source.n, target.n, point_map.shape
    (800, 600, (600,))
    """
    from scipy.spatial import cKDTree  # slow to import

    sizes = n_source, n_target or n_source
    for name, n, pose in zip(("n_source", "n_target"), sizes, poses, strict=True):
        check_count(name, n, low=500, high=5_000_000)
        check_count("poses", pose, low=0)
    check_count("seed", seed, low=0)
    at_rest = {n: _at_rest(n, seed) for n in sizes}
    source, target = (_posed(*at_rest[n], pose) for n, pose in zip(sizes, poses, strict=True))
    if sizes[0] == sizes[1]:
        return source, target, frozen(np.arange(source.n))
    one, other = (at_rest[n][1] for n in sizes)
    _, nearest = cKDTree(one.points).query(other.points)
    return source, target, frozen(np.asarray(nearest, dtype=np.int64))


@checked
def permuted(geometry: Kind, *, seed: int = 0) -> tuple[Kind, Ints]:
    """Renumber the points at random.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        The source.
    seed : int, default 0
        Of the order.

    Returns
    -------
    copy : TriangleMesh or PointCloud
        The target: the same points, and faces, in another order.
    point_map : ndarray of shape (n,)
        The source point that each point of the copy is: ``copy.points`` equals
        ``geometry.points[point_map]``.

    Examples
    --------
    >>> from spectra_kit.geometry import creature, permuted
    >>> mesh = creature(600)
    >>> copy, point_map = permuted(mesh, seed=1)
    >>> bool((copy.points == mesh.points[point_map]).all())
    True
    """
    rng = np.random.default_rng(check_count("seed", seed, low=0))
    order = rng.permutation(geometry.n)
    if isinstance(geometry, PointCloud):
        return PointCloud(geometry.points[order]), frozen(order)
    faces = rng.permutation(np.argsort(order)[geometry.faces])
    return TriangleMesh(geometry.points[order], faces), frozen(order)


@checked
def mirrored(geometry: Kind, *, axis: int = 0) -> Kind:
    """Reflect a geometry; point i of the copy is the image of point i.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        What to reflect.
    axis : int, default 0
        The coordinate that changes its sign.

    Returns
    -------
    TriangleMesh or PointCloud
        Isometric to `geometry`, of the opposite orientation. Faces are turned over, so that those
        which looked outwards still do.

    Examples
    --------
    >>> from spectra_kit.geometry import creature, mirrored
    >>> mesh = creature(600)
    >>> bool(mirrored(mesh).area == mesh.area)
    True
    """
    signs = np.ones(3)
    signs[check_count("axis", axis, low=0, high=2)] = -1.0
    if isinstance(geometry, PointCloud):
        return PointCloud(geometry.points * signs)
    return TriangleMesh(geometry.points * signs, geometry.faces[:, ::-1])
