"""Parametric surfaces and deformations: arrays in, arrays out; the other clay of the corpus."""

from __future__ import annotations

from collections.abc import Sequence

import igl
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from spectra_kit._core.types import Floats, Ints
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import TriangleMesh, side_keys


def grid_mesh(points: Floats, *, wrap_v: bool = False) -> TriangleMesh:
    """Triangulate a grid of points (nu, nv, 3), closed in its second direction on demand."""
    nu, nv = points.shape[:2]
    index = np.arange(nu * nv).reshape(nu, nv)
    index = np.concatenate([index, index[:, :1]], axis=1) if wrap_v else index
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    quads = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    return TriangleMesh(points.reshape(-1, 3), quads)


def join(meshes: Sequence[TriangleMesh]) -> TriangleMesh:
    """Put meshes side by side in one; nothing is welded."""
    offsets = np.cumsum([0] + [mesh.n for mesh in meshes[:-1]])
    return TriangleMesh(
        np.concatenate([mesh.points for mesh in meshes]),
        np.concatenate([mesh.faces + o for mesh, o in zip(meshes, offsets, strict=True)]),
    )


def random_rotation(rng: np.random.Generator) -> Floats:
    """Uniform rotation matrix (3, 3), from a uniform quaternion."""
    return np.asarray(Rotation.from_quat(rng.normal(size=4), scalar_first=True).as_matrix())


def superquadric(
    exponents: tuple[float, float], radii: ArrayLike, *, n_u: int = 40, n_v: int = 60
) -> TriangleMesh:
    """Closed superellipsoid: exponents (1, 1) an ellipsoid, towards 0 a box, (0, 1) a cylinder.

    Barr, *Superquadrics and angle-preserving transformations*, IEEE CG&A 1(1), 1981.
    """
    u = np.linspace(-np.pi / 2, np.pi / 2, n_u)[:, None]
    v = np.arange(n_v) * (2 * np.pi / n_v)

    def power(x: Floats, e: float) -> Floats:
        return np.asarray(np.sign(x) * np.abs(x) ** e)

    e1, e2 = exponents
    ring = power(np.cos(u), e1)
    ring[[0, -1]] = 0.0  # cos(pi / 2) is not quite zero, and a small power of it far from it
    coordinates = [ring * power(np.cos(v), e2), ring * power(np.sin(v), e2), power(np.sin(u), e1)]
    points = np.stack(np.broadcast_arrays(*coordinates), axis=-1) * np.asarray(radii)
    return grid_mesh(points, wrap_v=True)


def revolve(profile: Floats) -> TriangleMesh:
    """Turn a profile of (radius, height) rows (p, 2) around the z axis."""
    v = np.arange(64) * (2 * np.pi / 64)
    r, z = profile[:, :1], profile[:, 1:]
    points = np.stack(np.broadcast_arrays(r * np.cos(v), r * np.sin(v), z), axis=-1)
    return grid_mesh(points, wrap_v=True)


def sweep(
    curve: Floats, radius: ArrayLike, *, closed: bool, aspect: float = 1.0, turns: float = 0.0
) -> TriangleMesh:
    """Tube around a curve (p, 3), with an elliptic section that turns along it.

    A `closed` curve does not repeat its first point; another leaves both ends open. The `radius`,
    one or (p,), is half the width of the section, `aspect` its height over its width. Halves of
    `turns`, beside those that close it, keep a closed tube smooth.
    """
    if closed:
        tangent = np.roll(curve, -1, axis=0) - np.roll(curve, 1, axis=0)
    else:
        tangent = np.gradient(curve, axis=0)
    tangent = tangent / np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12)
    # Parallel transport: carry the normal along, project it, and undo the turn it came back with.
    normal = np.empty_like(curve)
    normal[0] = np.linalg.svd(tangent[:1])[2][-1]
    for i in range(1, len(curve)):
        n = normal[i - 1] - (normal[i - 1] @ tangent[i]) * tangent[i]
        normal[i] = n / max(float(np.linalg.norm(n)), 1e-12)
    binormal = np.cross(tangent, normal)
    turn = 2 * np.pi * turns
    if closed:
        last = normal[-1] - (normal[-1] @ tangent[0]) * tangent[0]
        turn -= np.arctan2(last @ binormal[0], last @ normal[0])
    twist = np.linspace(0, turn, len(curve), endpoint=not closed)[:, None]
    v = np.arange(24) * (2 * np.pi / 24)
    r = np.broadcast_to(np.asarray(radius, dtype=np.float64), len(curve))[:, None]
    x, y = r * np.cos(v), aspect * r * np.sin(v)
    along_n, along_b = x * np.cos(twist) - y * np.sin(twist), x * np.sin(twist) + y * np.cos(twist)
    points = (
        curve[:, None]
        + along_n[..., None] * normal[:, None]
        + along_b[..., None] * binormal[:, None]
    )
    if closed:  # half a turn brings the other side of the section to its beginning
        first = np.roll(points[:1], -round(24 * turns), axis=1)
        return grid_mesh(np.concatenate([points, first]), wrap_v=True).with_merged_vertices()
    return grid_mesh(points, wrap_v=True)


def waves(points: Floats, rng: np.random.Generator, *, frequency: float) -> Floats:
    """Random smooth function (n,) of unit variance: six plane waves of about this frequency."""
    directions = rng.normal(size=(3, 6)) * frequency
    phase = rng.uniform(0, 2 * np.pi, 6)
    return np.asarray(np.sin(points @ directions + phase).sum(axis=1) * np.sqrt(2 / 6))


def bend(points: Floats, angle: float) -> Floats:
    """Bend the x axis into an arc of `angle` radians in the plane of x and z."""
    x, y, z = points.T
    length = np.ptp(x)
    if abs(angle) < 1e-6 or length == 0:
        return points
    radius = length / angle
    theta = (x - x.mean()) / radius
    return np.column_stack([(radius - z) * np.sin(theta), y, radius - (radius - z) * np.cos(theta)])


def twist(points: Floats, angle: float) -> Floats:
    """Turn sections along the x axis, by `angle` radians from end to end."""
    x, y, z = points.T
    theta = angle * (x - x.mean()) / max(float(np.ptp(x)), 1e-12)
    c, s = np.cos(theta), np.sin(theta)
    return np.column_stack([x, c * y - s * z, s * y + c * z])


def taper(points: Floats, amount: float) -> Floats:
    """Scale sections along the x axis, from 1 - amount to 1 + amount."""
    x, y, z = points.T
    scale = 1 + 2 * amount * (x - x.mean()) / max(float(np.ptp(x)), 1e-12)
    return np.column_stack([x, scale * y, scale * z])


def warped(points: Floats, rng: np.random.Generator, likely: float) -> Floats:
    """Stretch, bend, twist, taper along random axes: each with its own share of `likely`."""
    if rng.random() < 0.6 * likely:
        points = points * np.exp(rng.normal(scale=0.22, size=3))
    for deform, share, most in ((bend, 0.35, 1.8), (twist, 0.25, 1.8), (taper, 0.25, 0.45)):
        if rng.random() < share * likely:
            axes = random_rotation(rng)
            points = deform(points @ axes, rng.uniform(-most, most)) @ axes.T
    return points


def quartered(mesh: TriangleMesh) -> TriangleMesh:
    """Cut each face into four alike at the middles of its edges, however many faces share these."""
    sides, which = np.unique(side_keys(mesh.faces, mesh.n), return_inverse=True)
    low, high = np.divmod(sides, mesh.n)
    ab, bc, ca = mesh.n + which.reshape(-1, 3).T
    a, b, c = mesh.faces.T
    quarters = ([a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca])
    points = np.concatenate([mesh.points, (mesh.points[low] + mesh.points[high]) / 2])
    return TriangleMesh(points, np.concatenate([np.stack(part, axis=1) for part in quarters]))


def bisected(mesh: TriangleMesh, longest: float) -> TriangleMesh:
    """Halve faces across their longest edge until none is longer, so that they can be bent.

    An edge is cut in all faces that share it, so no cracks open; the points in its middle may lie
    there twice.
    """
    points, faces, done = mesh.points, mesh.faces, []
    while len(faces):
        corners = points.T.take(faces.T, axis=1)  # coordinates first, which is twice as quick
        x, y, z = np.concatenate([corners[:, 1:], corners[:, :1]], axis=1) - corners
        lengths = np.sqrt(x**2 + y**2 + z**2)
        long = lengths.max(axis=0) > longest
        done.append(faces[~long])
        # Turn each face so that its longest edge runs from its first corner to its second.
        order = (lengths[:, long].argmax(axis=0)[:, None] + np.arange(3)) % 3
        a, b, c = np.take_along_axis(faces[long], order, axis=1).T
        n = len(points)
        cut, which = np.unique(np.minimum(a, b) * n + np.maximum(a, b), return_inverse=True)
        low, high = np.divmod(cut, n)
        points, middle = np.concatenate([points, (points[low] + points[high]) / 2]), n + which
        faces = np.concatenate([np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)])
    return TriangleMesh(points, np.concatenate(done))


def raised(mesh: TriangleMesh, height: Floats | float) -> TriangleMesh:
    """Move each vertex along its normal; where no face around it has area, it stays."""
    area = igl.PER_VERTEX_NORMALS_WEIGHTING_TYPE_AREA
    normals = igl.per_vertex_normals(mesh.points, mesh.faces, area)
    return mesh.with_points(mesh.points + np.reshape(height, (-1, 1)) * np.nan_to_num(normals))


# At their own vertices: one connected part, at a resolution drawn from coarse to fine


def at_resolution(
    mesh: TriangleMesh, rng: np.random.Generator, *, fewest: int, most: int
) -> TriangleMesh:
    """Return the largest part of a mesh, with `fewest` to `most` vertices, or somewhat fewer.

    Vertices and triangles stay as uneven as they are where their number fits. Of finer meshes, the
    vertices in the cells of a grid are joined, down to a number drawn at random, of all scales
    alike. Coarser ones are subdivided: each triangle into four alike, or the longest edges first.
    """
    wanted = round(float(np.exp(rng.uniform(np.log(fewest), np.log(most)))))
    evenly = rng.random() < 0.5
    part = connected(mesh)
    if part.n < fewest:
        part = _subdivided(part, fewest, evenly)
    return part if part.n <= most else _clustered(part, wanted)


def connected(mesh: TriangleMesh) -> TriangleMesh:
    """Return the largest part of a mesh without doubled vertices and faces, or faces of no area."""
    merged = mesh.with_merged_vertices()
    kept = np.flatnonzero(~merged.degenerate_faces())
    if not len(kept):
        raise InvalidInputError("mesh", "have a face of some area", "none")
    low, middle, high = np.sort(merged.faces[kept], axis=1).T
    kept = kept[np.unique((low * merged.n + middle) * merged.n + high, return_index=True)[1]]
    whole = TriangleMesh(merged.points, merged.faces[kept])
    part = whole.component_labels[whole.faces[:, 0]]
    largest = np.bincount(part, merged.face_areas[kept]).argmax()
    return TriangleMesh(whole.points, whole.faces[part == largest]).without_unreferenced()


def _subdivided(mesh: TriangleMesh, fewest: int, evenly: bool) -> TriangleMesh:
    longest = float(np.linalg.norm(np.ptp(mesh.points, axis=0)))
    while mesh.n < fewest:
        if evenly:
            mesh = quartered(mesh)
        else:
            longest *= 0.8
            mesh = bisected(mesh, longest).with_merged_vertices()
    return mesh


def _clustered(mesh: TriangleMesh, wanted: int) -> TriangleMesh:
    """Join the vertices in each cell of a grid that leaves `wanted` at most.

    Any mesh can be so decimated; libigl's edge collapses never end on some.
    """
    size = 0.5 * float(np.sqrt(mesh.area / wanted))
    while (n := len(np.unique(cells := _cells(mesh.points, size)))) > wanted:
        size *= max(1.02, np.sqrt(n / wanted))  # as on a plane, where cells are many
    which = np.unique(cells, return_inverse=True)[1]
    counts = np.bincount(which)
    sums = np.column_stack([np.bincount(which, axis) for axis in mesh.points.T])
    return connected(TriangleMesh(sums / counts[:, None], which[mesh.faces]))


def _cells(points: Floats, size: float) -> Ints:
    """Return a number for the cell of a grid that each point lies in, ascending by x, y and z."""
    cells = np.floor(points / size).astype(np.int64)
    x, y, z = (cells - cells.min(axis=0)).T
    return np.asarray((x * (y.max() + 1) + y) * (z.max() + 1) + z)
