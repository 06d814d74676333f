"""Damaged files of meshes and clouds, and damaged arrays."""

from __future__ import annotations

import json
import re
import warnings
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import pyvista
import scipy.linalg
import trimesh
from frame import Case, damaged, flipped, part, pytest_generate_tests  # noqa: F401
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from spectra_kit import (
    cotan_laplacian,
    delaunay_laplacian,
    eigensolve,
    knn_laplacian,
    robust_laplacian,
)
from spectra_kit.eigen import Arpack, Dense, Refined
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


def _other_number(rng: np.random.Generator, data: bytes) -> bytes:
    """One number of the text becomes another: a count, an index or a coordinate."""
    found = list(re.finditer(rb"-?\d+(\.\d+)?", data))
    if not found:
        return data
    chosen = found[rng.integers(len(found))]
    value = int(float(chosen[0][:18])) if rng.random() < 0.5 else 10
    others = [0, -1, 1, value + 1, value - 1, value // 2, -value, 2 * value, 2**31, 2**32 - 1]
    words = (
        "9223372036854775808 100000000000000000000 1e+300 1e-320 nan inf 1_0 0x1 1,5 \uff13 1e --1"
    )
    others += ["", *words.split()]
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
    marks = b" \n\r\0,-.09/#_\\\xff"
    return data[:at] + bytes([marks[rng.integers(len(marks))]]) + data[at:]


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
    others = [0, 1, 2, 3, -1, 5126, 5123, 10**30, 1.5]
    others += ["VEC3", None, True, [], {}, [0], "a", [1e300] * 16]
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


TEXT = (_other_number, _other_number, _other_lines, _inserted)


@part(share=4)
def test_geometry_file(case: Case) -> None:
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
    kind = path.suffix
    if kind in (".glb", ".gltf"):
        _compare_scene_with_trimesh(path, got.points)
    elif kind == ".stl":
        assert len(np.unique(got.points, axis=0)) == got.n  # corners at one place are one vertex
    elif kind == ".npy":
        np.testing.assert_array_equal(got.points, np.load(path))
    elif kind != ".npz":
        _compare_with_trimesh(path, got)
    # Which meshes a scene shows, and how, is said once only.
    if kind in COUNTED and (fault is not _tree_damaged or _described(data) != _described(whole)):
        assert len(getattr(got, "faces", ())) == len(getattr(was, "faces", ()))
        assert kind == ".stl" or got.n == was.n
    if kind == ".npz":  # it has a checksum
        np.testing.assert_array_equal(got.points, was.points)
        np.testing.assert_array_equal(got.faces, was.faces)


@cache
def _of_trades() -> dict[str, tuple[bytes, Geometry]]:
    """A small file of formats that other libraries read, each of which tells how much it holds."""
    nibabel, meshio = pytest.importorskip("nibabel"), pytest.importorskip("meshio")
    mesh = sphere(subdivisions=1).geometry
    surface = pyvista.PolyData.from_regular_faces(np.array(mesh.points), np.array(mesh.faces))
    files = {}
    with TemporaryDirectory() as folder:
        nibabel.freesurfer.write_geometry(f"{folder}/a.pial", mesh.points, mesh.faces)
        write(mesh, f"{folder}/a.gii")
        for name in ("a.vtk", "a.vtp"):
            surface.save(f"{folder}/{name}")
        surface.save(f"{folder}/b.vtk", binary=False)
        surface.cast_to_unstructured_grid().save(f"{folder}/a.vtu")
        meshio.write(f"{folder}/a.mesh", meshio.Mesh(mesh.points, [("triangle", mesh.faces)]))
        head = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS 42\nDATA "
        rows = "".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in mesh.points.tolist())
        Path(folder, "a.pcd").write_text(f"{head}ascii\n{rows}")
        data = f"{head}binary\n".encode() + mesh.points.astype("<f4").tobytes()
        Path(folder, "b.pcd").write_bytes(data)
        for path in sorted(Path(folder).iterdir()):
            files[path.name] = path.read_bytes(), read(path)
    return files


@part()
def test_files_of_other_trades(case: Case) -> None:
    """Either refused, or as many points and faces as there were, but for what is told.

    No library ends the process.
    """
    rng = case.rng
    name = sorted(_of_trades())[rng.integers(len(_of_trades()))]
    data, was = _of_trades()[name]
    faults = [damaged, flipped, _header_damaged]
    faults += TEXT * (name in ("a.mesh", "b.vtk", "a.pcd"))
    path = case.folder / name
    path.write_bytes(faults[rng.integers(len(faults))](rng, data))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        got = read(path)
    assert told or (got.n, len(getattr(got, "faces", ()))) == (
        was.n,
        len(getattr(was, "faces", ())),
    )


def _described(data: bytes) -> list[object]:
    """How the arrays of a glTF lie in its buffers."""
    tree = json.loads(data[slice(*_json_of(data))])
    return [tree.get(key) for key in ("accessors", "bufferViews", "buffers")]


def _compare_with_trimesh(path: Path, got: Geometry) -> None:
    try:
        other = trimesh.load(path, process=False, maintain_order=True)
    except Exception:  # noqa: BLE001  # it stumbles over more than we do
        return
    with np.errstate(over="ignore"):
        finite = np.isfinite(got.points.astype(np.float32)).all()  # its PLY has no other numbers
    if finite:
        smallest = float(np.finfo(np.float32).tiny)
        np.testing.assert_allclose(other.vertices, got.points, rtol=1e-5, atol=smallest)
    np.testing.assert_array_equal(_from_lowest(other), _from_lowest(got))


def _from_lowest(geometry: object) -> np.ndarray | None:
    """The faces from their lowest corner on: it cuts quads into the same triangles, turned."""
    if (faces := getattr(geometry, "faces", None)) is None:
        return None
    faces = np.asarray(faces)
    turns = np.argmin(faces, axis=1)[:, None] + np.arange(3)
    return np.take_along_axis(faces, turns % 3, axis=1)


def _compare_scene_with_trimesh(path: Path, points: np.ndarray) -> None:
    try:
        parts = trimesh.load_scene(path, process=False, skip_materials=True).dump()
    except Exception:  # noqa: BLE001  # damage in what is no geometry, such as a camera
        return
    meshes = [part.vertices for part in parts if isinstance(part, trimesh.Trimesh)]
    clouds = [part.vertices for part in parts if isinstance(part, trimesh.PointCloud)]
    other = np.vstack(meshes or clouds)
    order = [np.lexsort(np.round(p, 4).T) for p in (points, other)]
    atol = 1e-3 * np.abs(points).max()
    np.testing.assert_allclose(points[order[0]], other[order[1]], rtol=1e-3, atol=atol)


# --- arrays ---------------------------------------------------------------------------------------


def _one_of(rng, values):
    return values[rng.integers(len(values))]


def _put(rng, array, values):
    """Write one of the values into a random entry."""
    array[tuple(rng.integers(size) for size in array.shape)] = _one_of(rng, values)
    return array


def _some_at(rng, array, others):
    """Write the others into as many random rows."""
    array[rng.integers(len(array), size=len(others))] = others
    return array


def _rows(rng, array, most=5):
    return array[rng.integers(len(array), size=rng.integers(1, most + 1))]


KINDS = ("complex", "U", "O", "bool", "f2", "i4", "M8[s]", "S5", "f4")
POINT_DAMAGE = (
    lambda rng, p: _put(rng, p, [np.nan, np.inf, -np.inf]),
    lambda rng, p: _put(rng, p, [1e-310, 5e-324, 1e150, -1e200, 1e308, 0.0]),
    lambda rng, p: p * 10.0 ** rng.integers(-320, 308),
    lambda rng, p: p * 10.0 ** rng.integers(-12, 13, size=3),
    lambda rng, p: np.ones_like(p) * rng.normal(),  # all at one place
    lambda rng, p: p[:, :1] * rng.normal(size=3),  # on a line
    lambda rng, p: _some_at(rng, p, _rows(rng, p)),  # pairs at one place
    lambda rng, p: _some_at(rng, p, _rows(rng, p, 1) * 10.0 ** rng.integers(1, 200)),  # far away
    lambda rng, p: p[: rng.integers(5)],
    lambda rng, p: p.astype(_one_of(rng, KINDS)),
    lambda rng, p: _one_of(rng, (p.T, p[:, :2], p.ravel(), p[None], np.hstack([p, p]))),
)
FACE_DAMAGE = (
    lambda rng, f, n: _put(rng, f, (n, -1, n - 1, 0, 2**31, -(2**63))),
    lambda rng, f, _: _one_of(rng, (f * 1.0, f.astype("u1"), f.T, f[:, :2], f.ravel() > 3, [[0]])),
    lambda rng, f, n: _some_at(rng, f, rng.integers(n, size=(rng.integers(1, 20), 3))),
    lambda rng, f, _: np.vstack([f, _rows(rng, f)[:, rng.permutation(3)]]),  # there twice
    lambda rng, f, _: f[rng.random(len(f)) < rng.random()],
    lambda rng, f, n: np.minimum(f[: rng.integers(3)], max(n - 1, 0)),  # none or few
)
SOLVERS = (Dense(), Arpack(), Refined())


@part(share=2)
def test_geometry_arrays(case: Case) -> None:
    """Either refused, or its operator has the lowest modes that a dense solver finds of it."""
    rng = case.rng
    ball, plane = sphere(subdivisions=1).geometry, rectangle(n=60).geometry
    base = (ball, plane)[rng.integers(2)]
    as_cloud = rng.random() < 0.4
    points, faces = np.array(base.points), np.array(base.faces)
    for _ in range(rng.integers(1, 3)):
        if as_cloud or rng.random() < 0.6:
            points = _damaged(POINT_DAMAGE, rng, points)
        else:
            faces = _damaged(FACE_DAMAGE, rng, faces, len(points))
    geometry: Geometry = PointCloud(points) if as_cloud else TriangleMesh(points, faces)
    assert np.isfinite(np.asarray(points, dtype=float)).all()
    assert as_cloud or (np.asarray(faces) >= 0).all()
    assert as_cloud or (np.asarray(faces) < len(points)).all()
    diagnose(geometry)
    if rng.random() < 0.3:
        geometry = repair(geometry).geometry
    operators = [robust_laplacian, delaunay_laplacian, knn_laplacian, cotan_laplacian]
    laplacian = operators[rng.integers(4 - as_cloud)](geometry)
    k = min(5, laplacian.n - 1)
    spectrum = eigensolve(laplacian, k, SOLVERS[rng.integers(len(SOLVERS))])
    _compare_with_dense(laplacian, spectrum)


def _damaged(kinds, rng, array, *others):
    """Damage what another damage left, where that can be done."""
    with warnings.catch_warnings(action="ignore"):
        try:
            return _one_of(rng, kinds)(rng, np.array(array), *others)
        except (TypeError, ValueError, IndexError, OverflowError, RuntimeError):
            return array


def _compare_with_dense(laplacian, spectrum) -> None:
    root = np.sqrt(laplacian.mass)
    matrix = laplacian.stiffness.toarray() / root[:, None] / root
    everything = scipy.linalg.eigvalsh((matrix + matrix.T) / 2)
    truth, largest = everything[: spectrum.k], everything[-1]
    np.testing.assert_allclose(spectrum.eigenvalues, truth, rtol=1e-6, atol=1e-9 * largest)
    count, _ = connected_components(sparse.csr_array(laplacian.stiffness != 0), directed=False)
    assert spectrum.n_zero_modes <= count
