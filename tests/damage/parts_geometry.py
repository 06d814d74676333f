"""Damaged files of meshes and clouds, and damaged arrays."""

from __future__ import annotations

import json
import re
import warnings
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import scipy.linalg
import trimesh
from frame import Case, part, wrong
from mutations import damaged, flipped
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from strict_formats import PARSERS

from spectra_kit import (
    cotan_laplacian,
    delaunay_laplacian,
    eigensolve,
    knn_laplacian,
    robust_laplacian,
)
from spectra_kit.eigensolvers import Arpack, Dense, Multilevel, Refined
from spectra_kit.geometry import (
    Geometry,
    PointCloud,
    TriangleMesh,
    diagnose,
    read,
    rectangle,
    repair,
    sphere,
    write,
)

# Formats that say how much they hold: damage must not make it another amount.
COUNTED = (".off", ".ply", ".stl", ".npz", ".npy", ".glb", ".gltf")


@cache
def _good() -> dict[str, tuple[bytes, Geometry]]:
    """A small file of each format, and what it holds."""
    ball = sphere(subdivisions=1).geometry
    mesh = TriangleMesh(ball.points * np.pi + 1 / 7, ball.faces)
    other = trimesh.Trimesh(mesh.points, mesh.faces, process=False)
    two = trimesh.Scene()
    two.add_geometry(other, transform=trimesh.transformations.translation_matrix([7, 0, 0]))
    two.add_geometry(other, transform=np.diag([2.0, 3.0, 4.0, 1.0]))
    files = {}
    with TemporaryDirectory() as folder:
        for name in ("a.obj", "a.off", "a.ply", "a.stl", "a.glb", "a.gltf", "a.npz"):
            write(mesh, Path(folder, name))
        for name in ("c.ply", "c.xyz", "c.npy"):
            write(mesh.as_cloud(), Path(folder, name))
        other.export(Path(folder, "t.ply"), encoding="ascii")
        other.export(Path(folder, "t.stl"), file_type="stl_ascii")
        other.export(Path(folder, "t.obj"))
        two.export(Path(folder, "two.glb"))
        for path in sorted(Path(folder).iterdir()):
            files[path.name] = path.read_bytes(), read(path)
    return files


def _swapped_tokens(rng: np.random.Generator, data: bytes) -> bytes:
    words = re.split(rb"(\s+)", data)
    i, j = 2 * rng.integers((len(words) + 1) // 2, size=2)
    words[i], words[j] = words[j], words[i]
    return b"".join(words)


def _other_number(rng: np.random.Generator, data: bytes) -> bytes:
    """One number of the text becomes another: a count, an index or a coordinate."""
    found = list(re.finditer(rb"-?\d+(\.\d+)?", data))
    if not found:
        return data
    chosen = found[rng.integers(len(found))]
    value = int(float(chosen[0][:18])) if rng.random() < 0.5 else 10
    others = [0, -1, 1, value + 1, value - 1, value // 2, -value, 2 * value, 2**31, 2**32 - 1]
    others += [
        2**63,
        10**20,
        1e300,
        1e-320,
        "nan",
        "inf",
        "1_0",
        "0x1",
        "",
        "1,5",
        "\uff13",
        "1e",
        "--1",
    ]
    other = str(others[rng.integers(len(others))]).encode()
    return data[: chosen.start()] + other + data[chosen.end() :]


def _other_lines(rng: np.random.Generator, data: bytes) -> bytes:
    """A line is missing, there twice, torn, or changed for another."""
    rows = data.split(b"\n")
    i, j = rng.integers(len(rows), size=2)
    at = int(rng.integers(len(rows[i]) + 1))
    change = rng.integers(4)
    if change == 0:
        del rows[i]
    elif change == 1:
        rows.insert(j, rows[i])
    elif change == 2:
        rows[i : i + 1] = [rows[i][:at], rows[i][at:]]
    else:
        rows[i], rows[j] = rows[j], rows[i]
    return b"\n".join(rows)


def _inserted(rng: np.random.Generator, data: bytes) -> bytes:
    at = int(rng.integers(len(data) + 1))
    marks = (
        b" ",
        b"\n",
        b"\r",
        b"\0",
        b",",
        b"-",
        b".",
        b"0",
        b"9",
        b"/",
        b"#",
        b"_",
        b"\\",
        b"\xff",
    )
    return data[:at] + marks[rng.integers(len(marks))] + data[at:]


def _header_damaged(rng: np.random.Generator, data: bytes) -> bytes:
    size = min(len(data), 400)
    fault = (flipped, _other_number, _other_lines, _inserted)[rng.integers(4)]
    return fault(rng, data[:size]) + data[size:]


def _json_of(data: bytes) -> tuple[int, int]:
    """Where the JSON of a glTF begins and ends."""
    is_glb = data[:4] == b"glTF"
    return (20, 20 + int.from_bytes(data[12:16], "little")) if is_glb else (0, len(data))


def _tree_damaged(rng: np.random.Generator, data: bytes) -> bytes:
    """A value somewhere in the JSON of a glTF becomes another, or is gone."""
    start, end = _json_of(data)
    node = tree = json.loads(data[start:end])
    while True:
        keys = list(node) if isinstance(node, dict) else list(range(len(node)))
        if not keys:
            return data
        key = keys[rng.integers(len(keys))]
        if not isinstance(node[key], dict | list) or rng.random() < 0.1:
            break
        node = node[key]
    others = [
        0,
        1,
        2,
        3,
        -1,
        5126,
        5123,
        10**30,
        1.5,
        "VEC3",
        None,
        True,
        [],
        {},
        [0],
        "a",
        [1e300] * 16,
    ]
    if rng.random() < 0.2:
        del node[key]
    elif isinstance(node[key], int) and rng.random() < 0.5:
        node[key] += int(rng.integers(-13, 14))
    else:
        node[key] = others[rng.integers(len(others))]
    text = json.dumps(tree, separators=(",", ":")).encode()
    if data[:4] != b"glTF":
        return text
    text += b" " * (-len(text) % 4)
    rest = data[end:]
    sizes = (20 + len(text) + len(rest)).to_bytes(4, "little") + len(text).to_bytes(4, "little")
    return data[:8] + sizes + data[16:20] + text + rest


TEXT = (_swapped_tokens, _other_number, _other_number, _other_lines, _inserted)


@part(share=4)
def geometry_file(case: Case) -> None:
    """What is read is what the file says, and as much as it was."""
    rng = case.rng
    name = str(rng.choice(sorted(_good())))
    data, was = _good()[name]
    faults = [damaged, damaged, flipped, _header_damaged]
    faults += TEXT * (name not in ("a.glb", "two.glb", "a.npz", "c.npy", "a.stl"))
    faults += [_tree_damaged] * 4 * ("gl" in name)
    fault = faults[rng.integers(len(faults))]
    whole, data = data, fault(rng, data)
    path = case.folder / name
    path.write_bytes(data)
    got = read(path)
    points, faces = got.points, getattr(got, "faces", None)
    kind = path.suffix
    if kind in (".glb", ".gltf"):
        _compare_with_trimesh(path, points)
    else:
        try:
            strict_points, strict_faces = PARSERS[kind](data)
        except Exception as error:  # noqa: BLE001  # whatever the strict parser stumbles over
            wrong(f"{name} was read as {got}, but is none: {error!r}")
        if kind == ".stl":  # of which the corners are compared, not who shares them
            points, faces = points[faces].reshape(-1, 3), strict_faces
            if len(np.unique(got.points, axis=0)) < got.n:
                wrong(f"{name}: corners at one place are not one vertex")
        if not np.array_equal(points, strict_points):
            wrong(f"{name}: the points are not those of the file")
        if (faces is None) != (strict_faces is None) or not np.array_equal(faces, strict_faces):
            wrong(f"{name}: the faces are not those of the file")
    n_faces = [len(getattr(g, "faces", ())) for g in (got, was)]
    # Which meshes a scene shows, and how, is said once only.
    is_counted = kind in COUNTED and not (
        fault is _tree_damaged and _described(data) == _described(whole)
    )
    if is_counted and (n_faces[0] != n_faces[1] or (kind != ".stl" and got.n != was.n)):
        wrong(f"{name}: {was} became {got}")
    if kind == ".npz" and not (
        np.array_equal(got.points, was.points) and np.array_equal(got.faces, was.faces)
    ):
        wrong(f"{name}: other numbers than were stored, in spite of the checksum")


def _described(data: bytes) -> list[object]:
    """How the arrays of a glTF lie in its buffers."""
    tree = json.loads(data[slice(*_json_of(data))])
    return [tree.get(key) for key in ("accessors", "bufferViews", "buffers")]


def _compare_with_trimesh(path: Path, points: np.ndarray) -> None:
    try:
        parts = trimesh.load_scene(path, process=False, skip_materials=True).dump()
    except Exception:  # noqa: BLE001  # damage in what is no geometry, such as a camera
        return
    meshes = [part.vertices for part in parts if isinstance(part, trimesh.Trimesh)]
    clouds = [part.vertices for part in parts if isinstance(part, trimesh.PointCloud)]
    other = np.vstack(meshes or clouds)
    order = [np.lexsort(np.round(p, 4).T) for p in (points, other)]
    if points.shape != other.shape or not np.allclose(
        points[order[0]], other[order[1]], rtol=1e-3, atol=1e-3 * np.abs(points).max()
    ):
        wrong(f"{path.name}: other points than trimesh has")


# --- arrays ---------------------------------------------------------------------------------------


def _put(values: list[object]):
    """Write one of the values into a random entry."""

    def damage(rng, points, faces):
        points[tuple(rng.integers(s) for s in points.shape)] = values[rng.integers(len(values))]
        return points, faces

    return damage


def _scaled(rng, points, faces):
    return points * 10.0 ** rng.integers(-320, 308), faces


def _stretched(rng, points, faces):
    return points * 10.0 ** rng.integers(-12, 13, size=3), faces


def _coincident(rng, points, faces):
    return np.ones_like(points) * rng.normal(), faces


def _collinear(rng, points, faces):
    return points[:, :1] * rng.normal(size=3), faces


def _pairs_joined(rng, points, faces):
    points[rng.integers(len(points), size=5)] = points[rng.integers(len(points), size=5)]
    return points, faces


def _outlier(rng, points, faces):
    points[rng.integers(len(points))] *= 10.0 ** rng.integers(1, 200)
    return points, faces


def _few(rng, points, faces):
    n = int(rng.integers(0, 5))
    return points[:n], np.minimum(faces[: rng.integers(0, 3)], max(n - 1, 0))


def _dtype(rng, points, faces):
    kinds = ("complex", "U", "O", "bool", "f2", "i4", "M8[s]", "S5", "f4")
    with warnings.catch_warnings(action="ignore"):
        return points.astype(kinds[rng.integers(len(kinds))]), faces


def _shape(rng, points, faces):
    shapes = (points.T, points[:, :2], points.ravel(), points[None], np.hstack([points, points]))
    return shapes[rng.integers(len(shapes))], faces


def _faces_put(rng, points, faces):
    n = len(points)
    values = (n, -1, n - 1, 0, 2**31, -(2**63))
    faces[tuple(rng.integers(s) for s in faces.shape)] = values[rng.integers(len(values))]
    return points, faces


def _faces_kind(rng, points, faces):
    kinds = (
        faces.astype(float),
        faces.astype("u1"),
        faces.T,
        faces[:, :2],
        faces.ravel() > 3,
        [[0]],
    )
    return points, kinds[rng.integers(len(kinds))]


def _faces_random(rng, points, faces):
    chosen = rng.integers(len(faces), size=rng.integers(1, 20))
    faces[chosen] = rng.integers(len(points), size=(len(chosen), 3))
    return points, faces


def _faces_repeated(rng, points, faces):
    again = faces[rng.integers(len(faces), size=5)]
    return points, np.vstack([faces, again[:, rng.permutation(3)]])


def _faces_dropped(rng, points, faces):
    return points, faces[rng.random(len(faces)) < rng.random()]


DAMAGE = {
    "number": _put([np.nan, np.inf, -np.inf]),
    "value": _put([1e-310, 5e-324, 1e150, -1e200, 1e308, 0.0]),
    **{
        f.__name__: f
        for f in (
            _scaled,
            _stretched,
            _coincident,
            _collinear,
            _pairs_joined,
            _outlier,
            _few,
            _dtype,
            _shape,
            _faces_put,
            _faces_kind,
            _faces_random,
            _faces_repeated,
            _faces_dropped,
        )
    },
}
SOLVERS = (Dense(), Arpack(), Refined(), Multilevel())


@part(share=2)
def geometry_arrays(case: Case) -> None:
    """Either refused, or its operator has the lowest modes that a dense solver finds of it."""
    rng = case.rng
    ball, plane = sphere(subdivisions=1).geometry, rectangle(n=60).geometry
    base = (ball, plane)[rng.integers(2)]
    as_cloud = rng.random() < 0.4
    kinds = [kind for kind in DAMAGE if not (as_cloud and "_faces" in kind)]
    points, faces = np.array(base.points), np.array(base.faces)
    for kind in rng.choice(kinds, size=rng.integers(1, 3)):
        points, faces = _again(DAMAGE[kind], rng, points, faces)
    geometry: Geometry = PointCloud(points) if as_cloud else TriangleMesh(points, faces)
    if not np.isfinite(np.asarray(points, dtype=float)).all():
        wrong("numbers that are none were taken")
    if not as_cloud and not ((np.asarray(faces) >= 0) & (np.asarray(faces) < len(points))).all():
        wrong("indices out of range were taken")
    diagnose(geometry)
    if rng.random() < 0.3:
        geometry = repair(geometry).geometry
    operators = [robust_laplacian, delaunay_laplacian, knn_laplacian, cotan_laplacian]
    laplacian = operators[rng.integers(4 - as_cloud)](geometry)
    k = min(5, laplacian.n - 1)
    spectrum = eigensolve(laplacian, k, SOLVERS[rng.integers(len(SOLVERS))])
    _compare_with_dense(laplacian, spectrum)


def _again(damage, rng, points, faces):
    """Damage what another damage left, where that can be done."""
    with warnings.catch_warnings(action="ignore"):
        try:
            return damage(rng, np.array(points), np.array(faces))
        except (TypeError, ValueError, IndexError, OverflowError, RuntimeError):
            return points, faces


def _compare_with_dense(laplacian, spectrum) -> None:
    root = np.sqrt(laplacian.mass)
    matrix = laplacian.stiffness.toarray() / root[:, None] / root
    everything = scipy.linalg.eigvalsh((matrix + matrix.T) / 2)
    truth, largest = everything[: spectrum.k], everything[-1]
    close = np.abs(spectrum.eigenvalues - truth) <= 1e-6 * np.abs(truth) + 1e-9 * largest
    if not close.all():
        wrong(f"{spectrum.provenance.solver}: {spectrum.eigenvalues} where there are {truth}")
    count, _ = connected_components(sparse.csr_array(laplacian.stiffness != 0), directed=False)
    if spectrum.n_zero_modes > count:
        wrong(f"{spectrum.n_zero_modes} zero modes of {count} components")
