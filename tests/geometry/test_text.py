"""Two ways through text, all at once where it is usual and line by line, and their room."""

import struct
import tracemalloc

import numpy as np
import pytest
from conftest import data_folder

from spectra_kit.errors import InvalidFileError, InvalidInputError
from spectra_kit.geometry import TriangleMesh, read, sphere, without_nan, write
from spectra_kit.geometry.formats import obj, off, stl, xyz
from spectra_kit.geometry.formats._text import numbers, text_of, words_of

BALL = sphere(subdivisions=1).geometry
MESH = TriangleMesh(BALL.points * np.pi + 1 / 7, BALL.faces)
KINDS = (".obj", ".off", ".stl", ".xyz")
TABLES = (".xyz", ".csv", ".pts")


def written(tmp_path, suffix, mesh=MESH):
    if suffix == ".stl":
        return solid(mesh.points[mesh.faces])
    if suffix in (".csv", ".pts"):
        mark = "," if suffix == ".csv" else " "
        head = "id,x,y,z,u" if suffix == ".csv" else f"{mesh.n}"
        rows = (mark.join(map(str, (i, *p, 0))) for i, p in enumerate(mesh.points.tolist()))
        return "\n".join([head, *rows, ""]).encode()
    write(mesh.as_cloud() if suffix == ".xyz" else mesh, tmp_path / f"a{suffix}")
    return (tmp_path / f"a{suffix}").read_bytes()


def solid(facets, start="facet normal 0 nan 1\n  outer loop", end="endloop\nendfacet"):
    """Text of STL, of which others write the binary form too."""
    corners = (
        "".join(f"vertex {x!r} {y!r} {z!r}\n" for x, y, z in facet) for facet in facets.tolist()
    )
    return "solid a\n{}endsolid\n".format("".join(f"{start}\n{c}{end}\n" for c in corners)).encode()


def ways(kind, text):
    """What is read at once, or None, and what reads it line by line: points, corners, sizes."""
    text = text_of(text)
    if kind == ".obj":
        return obj.at_once(text), lambda: obj.line_by_line(text)
    if kind == ".off":
        head = off._header([words for _, words in words_of(text)][:3])
        return off.at_once(text, head), lambda: off.line_by_line(text, head)
    at_once = xyz.at_once(text) if kind in TABLES else stl.at_once(text)
    found = None if at_once is None else (at_once, ())
    if kind in TABLES:
        return found, lambda: (xyz.line_by_line(text), ())
    return found, lambda: (stl.word_by_word(text)[0], ())


def assert_same(one, other):
    """Equal to the last bit."""
    assert np.asarray(one[0], float).tobytes() == np.asarray(other[0], float).tobytes()
    for ours, theirs in zip(one[1], other[1], strict=True):
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("kind", [*KINDS, ".csv", ".pts"])
@pytest.mark.filterwarnings("ignore")
def test_what_is_read_at_once_is_what_the_lines_say(tmp_path, kind):
    """Of the file, and of it with one character more, less or another."""
    data = written(tmp_path, kind)
    at_once, by_line = ways(kind, data)
    assert_same(at_once, by_line())
    rng = np.random.default_rng(0)
    marks = b"0123456789 \n.-+e/vf#x\\\t,;S"
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


def random_points(rng, n):
    """Decimal numbers of any kind that programs write, and some that none does."""
    words = []
    for _ in range(3 * n):
        digits = "".join(map(str, rng.integers(10, size=rng.integers(1, 20))))
        at = int(rng.integers(len(digits) + 1))
        exponent = rng.choice(["", f"e{rng.integers(-340, 309)}", f"E+{rng.integers(40):02}"])
        point = rng.choice([digits, f"{digits[:at]}.{digits[at:]}"])
        words.append(f"{rng.choice(['', '-', '+'])}{point}{exponent}")
    return words


@pytest.mark.filterwarnings("ignore")
def test_numbers_are_those_of_float():
    rng = np.random.default_rng(0)
    integers = [str(2**62 - 1), str(2**53 + 1), "0", "-0", "007", str(10**17 + 1), str(2**64)]
    for count in range(1, 200, 8):
        words = random_points(rng, count) + (rng.choice(integers, count % 9).tolist())
        text = "\n".join(words).encode()
        expected = np.array([float(word) for word in words])
        assert numbers(text, np.float64, len(words)).tobytes() == expected.tobytes()


def rows(rng, n, behind=""):
    words = random_points(rng, n)
    return [" ".join(words[3 * i : 3 * i + 3]) + behind for i in range(n)]


def polygons(rng, n, sizes):
    return [rng.integers(1, n + 1, size=int(rng.choice(sizes))).tolist() for _ in range(2 * n)]


def generated(kind, rng):
    """A file as programs write them, whose lines are noise."""
    n = int(rng.integers(4, 30))
    sizes = [[3], [4], [3, 4], [3, 12]][rng.integers(4)]
    faces = polygons(rng, n, sizes)
    gap = rng.choice([" ", "  ", "\t", " \t"])
    if kind == ".xyz":
        lines = rows(rng, n, rng.choice(["", " 1 2 3", " a", " nan 0.5"]))
    elif kind == ".off":
        colour = ["", " 7", " 255 0 0", " 0.5 1 1e-1 .25"][rng.integers(4)]
        lines = ["OFF", f"{n} {len(faces)} 0", *rows(rng, n, rng.choice(["", " 255 0 x", " 1"]))]
        lines += [" ".join(map(str, [len(p), *(c - 1 for c in p)])) + colour for p in faces]
    elif kind == ".stl":
        head, end = "facet normal 0 -nan(ind) 1\nouter loop", "endloop\nendfacet"
        parts = ["vertex " + row for row in rows(rng, 3 * n)]
        loops = ["\n".join([head, *parts[3 * i : 3 * i + 3], end]) for i in range(n)]
        half = n // 2
        lines = ["solid a", *loops[:half], "endsolid a", "solid", *loops[half:], "endsolid"]
    else:
        corner = rng.choice(["{0}", "{0}/{0}", "{0}/{0}/{0}", "{0}//{0}", "{1}", "{1}/{1}", "{0}/"])
        lines = ["v " + r for r in rows(rng, n, rng.choice(["", " 1.0", " 0.5 1 .25"]))]
        lines += ["# a comment", "g of / faces", "vt 0 0", "vn nan 0 1"]
        lines += ["f " + " ".join(corner.format(c, c - n - 1) for c in p) for p in faces]
        if rng.random() < 0.5:
            lines.insert(int(rng.integers(len(lines))), lines[0])
    text = "\n".join(gap * bool(rng.integers(2)) + line.replace(" ", gap) for line in lines)
    text = text.upper() if kind == ".stl" and rng.random() < 0.3 else text
    return (text + "\n").replace("\n", rng.choice(["\n", "\r\n", "\r", " \n\n"])).encode()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.filterwarnings("ignore")
def test_files_of_noise_are_read_at_once_and_as_the_lines_say(kind):
    rng = np.random.default_rng(0)
    for _ in range(30):
        at_once, by_line = ways(kind, generated(kind, rng))
        assert at_once is not None
        assert_same(at_once, by_line())


@pytest.mark.data
@pytest.mark.skipif(data_folder() is None, reason="set SPECTRA_KIT_DATA to the real shapes")
@pytest.mark.parametrize("kind", KINDS)
def test_real_shapes_are_read_at_once_and_as_the_lines_say(tmp_path, kind):
    for name in ("faust_r", "smal_r", "scape_a"):
        mesh = read(min((data_folder() / name).glob("*.npz")), kind="mesh")
        at_once, by_line = ways(kind, written(tmp_path, kind, mesh))
        assert at_once is not None
        assert_same(at_once, by_line())


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
