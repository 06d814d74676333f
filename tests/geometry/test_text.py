"""Two ways through text, all at once where it is usual and line by line, and their room."""

import struct
import tracemalloc

import numpy as np
import pytest

from spectra_kit.errors import InvalidFileError, InvalidInputError
from spectra_kit.geometry import TriangleMesh, read, sphere, without_nan, write
from spectra_kit.geometry.formats import obj, off
from spectra_kit.geometry.formats._text import text_of, words_of

BALL = sphere(subdivisions=1).geometry
MESH = TriangleMesh(BALL.points * np.pi + 1 / 7, BALL.faces)


def written(tmp_path, suffix):
    write(MESH, tmp_path / f"a{suffix}")
    return (tmp_path / f"a{suffix}").read_bytes()


def ways(kind, text):
    text = text_of(text)
    if kind == ".obj":
        return obj.at_once(text), lambda: obj.line_by_line(text)
    head = off._header([words for _, words in words_of(text)][:3])
    return off.at_once(text, head), lambda: off.line_by_line(text, head)


def assert_same(one, other):
    np.testing.assert_array_equal(one[0], other[0])
    for ours, theirs in zip(one[1], other[1], strict=True):
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("kind", [".obj", ".off"])
@pytest.mark.filterwarnings("ignore")
def test_what_is_read_at_once_is_what_the_lines_say(tmp_path, kind):
    """Of the file, and of it with one character more, less or another."""
    data = written(tmp_path, kind)
    at_once, by_line = ways(kind, data)
    assert_same(at_once, by_line())
    rng = np.random.default_rng(0)
    marks = b"0123456789 \n.-+e/vf#x\\\t"
    n = 0
    for _ in range(300):
        at = int(rng.integers(len(data)))
        mark = bytes([marks[rng.integers(len(marks))]]) * int(rng.integers(2))
        changed = data[:at] + mark + data[at + int(rng.integers(2)) :]
        try:
            at_once, by_line = ways(kind, changed)
        except InvalidInputError:
            continue  # in the header
        if at_once is not None:
            n += 1
            assert_same(at_once, by_line())
    assert n > 100


@pytest.mark.parametrize(
    "text",
    [
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\ng a\nf 1/1/1 2/1/1 3/1/1\nf -1//1 -2//1 -3\n",
        "# a\nv 0 0 0 1 1 1\nv 1 0 0\nv 0 1 0 1\nv 1 1 0 # b\ns off\nf 1 2 4 3\nf 1 2 3\n\n",
        "v 1 2 3\nv 4 5 6\nf -1 -2 1\nv 7 8 9\nf -1 -2 -3\nv 0 0 0\nf -1 -2 -3\n",
    ],
)
def test_both_ways_through_the_corners_of_obj(text):
    at_once, by_line = ways(".obj", text.encode())
    assert_same(at_once, by_line())


XYZ = "property float x\nproperty float y\nproperty float z\n"
PLY = "ply\nformat {} 1.0\nelement vertex {}\n" + XYZ + "element face {}\n"
PLY += "property list uchar int vertex_indices\nend_header\n"
HUGE = 10**12


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("vertices.ply", PLY.format("ascii", HUGE, 1) + "0 0 0\n" * 9),
        ("vertices, binary.ply", PLY.format("binary_little_endian", HUGE, 1) + "0" * 99),
        ("faces.ply", PLY.format("ascii", 1, HUGE) + "0 0 0\n" + "3 0 0 0\n" * 9),
        ("faces, binary.ply", PLY.format("binary_big_endian", 1, HUGE) + "\0" * 99),
        ("a long face.ply", PLY.format("ascii", 1, 1) + f"0 0 0\n{HUGE} 0 0 0\n"),
        ("vertices.off", f"OFF\n{HUGE} 1 0\n0 0 0\n"),
        ("faces.off", f"OFF\n1 {HUGE} 0\n0 0 0\n3 0 0 0\n"),
        ("a long face.off", f"OFF\n1 1 0\n0 0 0\n{HUGE} 0 0 0\n"),
        ("binary.off", b"OFF BINARY\n" + struct.pack(">3i", 2**31 - 1, 2**31 - 1, 0) + bytes(99)),
        ("faces, binary.off", b"OFF BINARY\n" + struct.pack(">3i", 0, 2**31 - 1, 0) + bytes(99)),
        ("count.stl", bytes(80) + struct.pack("<I", 2**32 - 2) + bytes(100)),
        ("count.xyz", f"{HUGE}\n0 0 0\n"),
        ("index.obj", f"v 0 0 0\nf 1 1 {HUGE}\n"),
    ],
)
def test_announced_sizes_take_no_room(tmp_path, name, content):
    """At most 100 times the file, and what reading a small one takes at all."""
    path = tmp_path / name
    path.write_bytes(content.encode("latin-1") if isinstance(content, str) else content)
    tracemalloc.start()
    try:
        with pytest.raises(InvalidFileError):
            read(path)
        assert tracemalloc.get_traced_memory()[1] < 100 * path.stat().st_size + 2**20
    finally:
        tracemalloc.stop()


def test_reading_takes_room_in_proportion_to_the_file(tmp_path):
    mesh = sphere(subdivisions=4).geometry
    for name in ("a.obj", "a.off"):
        write(mesh, tmp_path / name)
        tracemalloc.start()
        try:
            read(tmp_path / name)
            assert tracemalloc.get_traced_memory()[1] < 20 * (tmp_path / name).stat().st_size
        finally:
            tracemalloc.stop()


def test_scans_lead_back_to_their_rows(tmp_path):
    """Points of a grid of rows and columns, a third of which saw nothing."""
    rng = np.random.default_rng(0)
    scan = rng.normal(size=(60, 3))
    blind = rng.permutation(60)[:20]
    scan[blind] = np.nan
    np.savetxt(tmp_path / "scan.xyz", scan)
    np.save(tmp_path / "scan.npy", scan)
    for source in (scan, tmp_path / "scan.xyz", str(tmp_path / "scan.npy")):
        seen = without_nan(source)
        assert (seen.geometry.n, seen.report.nan_points) == (40, 20)
        np.testing.assert_array_equal(seen.geometry.points, scan[seen.vertex_index])
        np.testing.assert_array_equal(seen.restore(seen.geometry.points), scan)
    faces = np.arange(60).reshape(-1, 3)
    kept = faces[np.isfinite(scan[faces]).all(axis=(1, 2))]
    part = without_nan(scan, faces)
    np.testing.assert_array_equal(part.vertex_index[part.geometry.faces], kept)
    with pytest.raises(InvalidInputError, match="`faces` must have one without NaN points"):
        without_nan(np.vstack([SOMEWHERE, [np.nan] * 3]), [[0, 1, 2]])


SOMEWHERE = [[0, 0, 0], [1, 0, 0]]
