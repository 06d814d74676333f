"""Files as other programs write them: each is read right, or refused with a remedy that works."""

import struct
import warnings
from functools import cache

import numpy as np
import pytest

from spectra_kit import delaunay_laplacian, eigensolve
from spectra_kit.eigen import Dense
from spectra_kit.errors import IgnoredContentWarning, InvalidFileError
from spectra_kit.geometry import PointCloud, TriangleMesh, read, sphere, without_nan

# --- surfaces: corners, polygons, and the same cut by hand ----------------------------------------

BALL = sphere(subdivisions=2).geometry
L = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]
OF_L = [[5, 0, 3], [0, 1, 2], [0, 2, 3], [5, 3, 4]]
SIDES = [[i, (i + 1) % 6, (i + 1) % 6 + 6, i + 6] for i in range(6)]
FRAME = [(0, 0), (3, 0), (3, 3), (0, 3), (1, 1), (1, 2), (2, 2), (2, 1)]
OF_FRAME = [[0, 1, 7], [0, 7, 4], [1, 2, 6], [1, 6, 7], [2, 3, 5], [2, 5, 6], [3, 0, 4], [3, 4, 5]]


def flat(outline, z=0.0):
    return [(x, y, z) for x, y in outline]


def fan(polygons):
    return [(p[0], p[i], p[i + 1]) for p in polygons for i in range(1, len(p) - 1)]


def grid(n=11):
    """A square of quads."""
    x, y = (c.ravel() for c in np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n)))
    i = np.arange(n * n).reshape(n, n)
    corners = [c.ravel() for c in (i[:-1, :-1], i[:-1, 1:], i[1:, 1:], i[1:, :-1])]
    return np.c_[x, y, 0 * x].tolist(), np.column_stack(corners).tolist()


PART = [*flat(L), *flat(L, 1.0)]
SURFACES = {
    "ball": (BALL.points.tolist(), BALL.faces.tolist(), BALL.faces),
    "grid": (*grid(), fan(grid()[1])),
    "part": (  # an L pulled out of its plane, whose two caps are cut from a corner that sees little
        PART,
        [[1, 0, 5, 4, 3, 2], [7, 8, 9, 10, 11, 6], *SIDES],
        [t[::-1] for t in OF_L] + [[i + 6 for i in t] for t in OF_L] + fan(SIDES),
    ),
    "frame": (flat(FRAME), [[0, 1, 2, 3, 0, 4, 5, 6, 7, 4]], OF_FRAME),
}
AREAS = {"grid": 1.0, "part": 2 * 3 + 8.0, "frame": 8.0}
V, F, _ = SURFACES["ball"]
L_SHAPED, GRID = SURFACES["part"][:2], SURFACES["grid"][:2]


@cache
def truth(name):
    points, _, triangles = SURFACES[name]
    mesh = TriangleMesh(points, triangles)
    return mesh, lowest(mesh)


def lowest(mesh):
    """λ₁, which is the same however flat polygons are cut: its operator cuts them by itself."""
    return eigensolve(delaunay_laplacian(mesh), 2, Dense()).eigenvalues[1]


def test_what_is_known_of_the_surfaces():
    assert truth("ball")[1] == pytest.approx(2, rel=0.02)  # of the unit sphere
    assert truth("grid")[1] == pytest.approx(np.pi**2, rel=0.03)
    for name, area in AREAS.items():
        assert truth(name)[0].area == pytest.approx(area, rel=1e-12)


# --- the formats, by their rules ------------------------------------------------------------------


def rows(table, form="{}", mark=" ", end="\n"):
    """One line for each row of a table."""
    return "".join(form.format(mark.join(map(repr, row))) + end for row in table)


def obj(points=V, polygons=F, *, v="v {}", f="f {}", corner="{0}", between=""):
    faces = (f.format(" ".join(corner.format(i + 1, i - len(points)) for i in p)) for p in polygons)
    return rows(points, v) + between + "".join(face + "\n" for face in faces)


def off(points=V, polygons=F, *, head="OFF\n{} {} 0\n", v="{}", behind=lambda i: ""):
    faces = (f"{len(p)} {' '.join(map(str, p))}{behind(i)}\n" for i, p in enumerate(polygons))
    return head.format(len(points), len(polygons)) + rows(points, v) + "".join(faces)


def off_binary(colours=0):
    data = np.array(V, ">f4").tobytes()
    for p in F:
        data += struct.pack(f">{len(p) + 2}i", len(p), *p, colours) + bytes(4 * colours)
    return b"OFF BINARY\n" + struct.pack(">3i", len(V), len(F), 0) + data


XYZ = ("float x", "float y", "float z")
LISTS = ("list uchar int vertex_indices",)


def header(*elements, form="ascii", extra=""):
    text = f"ply\nformat {form} 1.0\n{extra}"
    for name, count, properties in elements:
        text += f"element {name} {count}\n" + "".join(f"property {p}\n" for p in properties)
    return text + "end_header\n"


def ply(points=V, polygons=F, *, xyz=XYZ, lists=LISTS, v="{}", f="{}", extra="", more=()):
    elements = ("vertex", len(points), xyz), ("face", len(polygons), lists), *more
    sizes = [[len(p), *p] for p in polygons]
    return header(*elements, extra=extra) + rows(points, v) + rows(sizes, f)


def ply_binary(points=V, polygons=F, *, order="<", size="B", index="i", lists=LISTS, behind=b""):
    kind = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    xyz = ("double x", "double y", "double z")
    head = header(("vertex", len(points), xyz), ("face", len(polygons), lists), form=kind)
    data = np.array(points, order + "f8").tobytes()
    for p in polygons:
        data += struct.pack(f"{order}{size}{len(p)}{index}", len(p), *p)
    return head.encode() + data + behind


def strips():
    """The grid in bands, -1 between them, each led over by a corner that is there twice."""
    n = 11
    points, _ = grid(n)
    corners = []
    for row in range(n - 1):
        band = [i for pair in zip(range(n), range(n, 2 * n), strict=True) for i in pair]
        corners += [i + n * row for i in band] + [-1]
    elements = ("vertex", n * n, XYZ), ("tristrips", 1, ("list int int vertex_indices",))
    return header(*elements) + rows(points) + f"{len(corners)} {' '.join(map(str, corners))}\n"


def facet(t, form="%r"):
    corners = "".join(f"   vertex {' '.join(form % c for c in V[i])}\n" for i in t)
    return f" facet normal 0 0 0\n  outer loop\n{corners}  endloop\n endfacet\n"


def stl(head="solid x\n", end="endsolid x\n", form="%r"):
    return head + "".join(facet(t, form) for t in F) + end


def stl_binary(count=320, head=b"made by hand", behind=b""):
    loose = b"".join(struct.pack("<12fH", 0, 0, 0, *np.ravel([V[i] for i in t]), 0) for t in F)
    return head.ljust(80, b"\0") + struct.pack("<I", count) + loose + behind


def lines(text, count=1):
    """The text with as many lines broken before their last word."""
    broken = text.split("\n")
    return "\n".join([*("\n".join(row.rsplit(" ", 1)) for row in broken[:count]), *broken[count:]])


def lines_of_body(text, count):
    head, body = text.split("end_header\n")
    return f"{head}end_header\n{lines(body, count)}"


QUIET = None
FILES = [
    # OBJ
    *[(f"{name}.obj", name, obj(*SURFACES[name][:2]), QUIET) for name in SURFACES],
    ("texture.obj", "ball", obj(between="vt 0 0\n" * len(V), corner="{0}/{0}"), QUIET),
    ("texture and normals.obj", "ball", obj(corner="{0}/{0}/{0}", between="vn 0 0 1\n"), QUIET),
    ("normals.obj", "ball", obj(corner="{0}//{0}"), QUIET),
    ("relative.obj", "ball", obj(corner="{1}"), QUIET),
    ("relative with texture.obj", "part", obj(*L_SHAPED, corner="{1}/{1}"), QUIET),
    ("slashes differ.obj", "ball", obj(between="vt 0 0\n").replace("f 1 ", "f 1/1 "), QUIET),
    ("colours.obj", "ball", obj(v="v {} 0.5 0.25 1"), QUIET),
    ("weights of 1.obj", "ball", obj(v="v {} 1.0"), QUIET),
    ("weights.obj", "ball", obj(v="v {} 0.5"), "weights"),
    ("normals in the line.obj", "ball", obj(v="v {} 0 0 1 1 1 1"), "6 numbers behind x, y, z"),
    (
        "groups.obj",
        "ball",
        "mtllib C:\\a\\\no x\n" + obj(between="g a\\\nusemtl b\\\ns off\n"),
        QUIET,
    ),
    ("comment.obj", "ball", "# by D:\\shapes\\\n" + obj(between="# f 1 2 3\\\n"), QUIET),
    ("other comment.obj", "ball", "// by hand\n" + obj(), QUIET),
    ("continued.obj", "part", obj(*L_SHAPED, f="f {}").replace(" 5 4 3", " 5 \\\n4 3"), QUIET),
    ("continued, blank.obj", "part", obj(*L_SHAPED).replace(" 5 4 3", " 5 \\ \t\n4 3"), QUIET),
    (
        "skin.obj",
        "ball",
        obj() + "vw 0 0 0.5\nvw 1 0 0.5\n",
        "2 lines of unknown words, the first is line 483",
    ),
    ("creases.obj", "ball", obj() + "t crease 2/1/0 1 2 4.7\n", "1 line of unknown words"),
    ("version.obj", "ball", "version 1\n" + obj(), "1 line of unknown words, the first is line 1"),
    ("lines.obj", "ball", obj() + "l 1 2 3\np 1\n", "1 line beginning"),
    ("edges.obj", "ball", obj() + "f 1 2\nf 3\n", "2 faces of fewer than 3 corners"),
    ("nan.obj", "ball", "v nan nan nan\n" + obj(corner="{1}"), "1 NaN vertex"),
    ("nan of microsoft.obj", "ball", obj(between="v -nan(ind) 0 0\n"), "1 NaN vertex"),
    ("nan of normals.obj", "ball", obj(between="vn -nan(ind) nan 0\n"), QUIET),
    ("filled up.obj", "ball", obj() + "\0" * 512, QUIET),
    ("dos.obj", "ball", obj().replace("\n", "\r\n") + "\x1a", QUIET),
    ("mac.obj", "ball", obj().replace("\n", "\r"), QUIET),
    ("mark.obj", "ball", b"\xef\xbb\xbf" + obj().encode(), QUIET),
    ("utf-16.obj", "ball", obj().encode("utf-16"), QUIET),
    ("utf-16, big.obj", "ball", b"\xfe\xff" + obj().encode("utf-16-be"), QUIET),
    ("utf-32.obj", "ball", obj().encode("utf-32"), QUIET),
    ("tabs.obj", "ball", obj(v="\tv  {}  ", f="f\t{}\t"), QUIET),
    ("name in latin-1.obj", "ball", b"o K\xf6rper\n" + obj().encode(), QUIET),
    # OFF
    *[(f"{name}.off", name, off(*SURFACES[name][:2]), QUIET) for name in SURFACES],
    ("lower.off", "ball", off(head="off\n{} {} 0\n"), QUIET),
    ("no keyword.off", "ball", off(head="{} {} 0\n"), QUIET),
    ("glued.off", "ball", off(head="OFF{} {} 0\n"), QUIET),
    ("one line.off", "ball", off(head="OFF {} {} 0\n"), QUIET),
    ("comments.off", "ball", off(head="OFF # by\n# D:\\\n\n{} {} 0 # counts\n"), QUIET),
    ("binary.off", "ball", off_binary(), QUIET),
    ("binary with colours.off", "ball", off_binary(3), QUIET),
    ("weights.off", "ball", off(head="4OFF\n{} {} 0\n", v="{} 1"), QUIET),
    (
        "homogeneous.off",
        "ball",
        off((2 * BALL.points).tolist(), head="4OFF\n{} {} 0\n", v="{} 2"),
        QUIET,
    ),
    ("any dimension.off", "ball", off(head="nOFF\n3\n{} {} 0\n"), QUIET),
    ("normals.off", "ball", off(head="NOFF\n{} {} 0\n", v="{} 0 0 1"), QUIET),
    ("colours.off", "ball", off(head="COFF\n{} {} 0\n", v="{} 255 0 0 255"), QUIET),
    ("colours of faces.off", "ball", off(behind=lambda i: " 0.5 0.5 0.5"), QUIET),
    ("some colours.off", "ball", off(behind=lambda i: " 7" if i % 3 else ""), QUIET),
    ("edges.off", "ball", off(polygons=[*F, [0, 1]]), "1 face of fewer than 3"),
    ("behind.off", "ball", off() + "0 1\n1 2\n", "2 lines behind the faces.* line 485"),
    ("flowing.off", "part", off(*L_SHAPED).replace("\n", " "), QUIET),
    ("broken rows.off", "grid", "OFF\n121 100 0\n" + lines(off(*GRID, head=""), 171), QUIET),
    ("dos.off", "ball", off().replace("\n", "\r\n") + "\x1a", QUIET),
    ("nan.off", "ball", off([*V, [np.nan] * 3]), "1 NaN vertex"),
    # STL
    ("text.stl", "ball", stl(), QUIET),
    ("capitals.stl", "ball", stl().upper(), QUIET),
    ("exponents.stl", "ball", stl(form="%.17E"), QUIET),
    ("end solid.stl", "ball", stl(end="end solid x\n"), QUIET),
    ("end loop.stl", "ball", stl().replace("endl", "end l").replace("endf", "end f"), QUIET),
    ("no end.stl", "ball", stl(end=""), "no last line"),
    ("twice.stl", "ball", stl("solid x\nsolid x\n", "endsolid x\nendsolid x\n"), QUIET),
    ("mac.stl", "ball", stl().replace("\n", "\r"), QUIET),
    ("mark.stl", "ball", b"\xef\xbb\xbf" + stl().encode(), QUIET),
    ("utf-16.stl", "ball", stl().encode("utf-16"), QUIET),
    ("binary.stl", "ball", stl_binary(), QUIET),
    ("solid but binary.stl", "ball", stl_binary(head=b"solid x"), QUIET),
    ("zeros behind.stl", "ball", stl_binary(behind=bytes(92)), QUIET),
    ("line end behind.stl", "ball", stl_binary(behind=b"\r\n"), QUIET),
    ("signature behind.stl", "ball", stl_binary(behind=b"signed by hand"), "14 bytes more"),
    ("no count.stl", "ball", stl_binary(0), "count in its header, 0"),
    ("streamed.stl", "ball", stl_binary(0xFFFFFFFF), "count in its header"),
    # PLY
    *[(f"{name}.ply", name, ply(*SURFACES[name][:2]), QUIET) for name in SURFACES],
    *[(f"binary {name}.ply", name, ply_binary(*SURFACES[name][:2]), QUIET) for name in SURFACES],
    ("big.ply", "part", ply_binary(*L_SHAPED, order=">"), QUIET),
    (
        "wide.ply",
        "part",
        ply_binary(*L_SHAPED, size="i", lists=("list int int vertex_index",)),
        QUIET,
    ),
    (
        "short.ply",
        "part",
        ply_binary(*L_SHAPED, index="H", lists=("list uchar ushort vertex_indices",)),
        QUIET,
    ),
    ("strips.ply", "grid", strips(), QUIET),
    ("zero behind.ply", "ball", ply_binary(behind=b"\0"), QUIET),
    ("text behind.ply", "ball", ply_binary(behind=b"made by hand\n"), "13 bytes more"),
    (
        "created by.ply",
        "ball",
        ply(extra="Created by a program\n"),
        "1 line of the header, 'Created",
    ),
    ("comments.ply", "ball", ply(extra="comment a \\\nobj_info b\n"), QUIET),
    ("longer rows.ply", "ball", ply(f="{} 6 0 0 1 0 1 1"), "7 numbers behind each row of 'face'"),
    ("nan of normals.ply", "ball", ply(xyz=(*XYZ, "float nx"), v="{} -nan(ind)"), QUIET),
    ("nan.ply", "ball", ply([*V, [np.nan] * 3]), "1 NaN vertex"),
    ("nan in front.ply", "ball", ply([[np.nan] * 3, *V], [[i + 1 for i in p] for p in F]), "1 NaN"),
    ("empty face.ply", "ball", ply(polygons=[*F, []]), "1 face of fewer than 3"),
    ("capitals.ply", "ball", ply(xyz=[p.upper().replace("FLOAT", "float") for p in XYZ]), QUIET),
    ("broken rows.ply", "ball", lines_of_body(ply(), 9), QUIET),
    ("dos.ply", "ball", ply().replace("\n", "\r\n") + "\x1a", QUIET),
    ("mac.ply", "ball", ply().replace("\n", "\r"), QUIET),
    ("mark.ply", "ball", b"\xef\xbb\xbf" + ply().encode(), QUIET),
    ("edges.ply", "ball", ply(more=[("edge", 2, ("int a", "int b"))]) + "0 1\n1 2\n", QUIET),
]


@pytest.mark.parametrize(("name", "surface", "content", "told"), FILES, ids=[f[0] for f in FILES])
def test_surfaces_are_read_right(tmp_path, name, surface, content, told):
    path = tmp_path / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    mesh, eigenvalue = truth(surface)
    got = read_with(path, told)
    assert isinstance(got, TriangleMesh)
    assert (got.n, len(got.faces)) == (mesh.n, len(mesh.faces))
    assert got.area == pytest.approx(mesh.area, rel=1e-6)
    assert lowest(got) == pytest.approx(eigenvalue, rel=1e-5)
    if told is QUIET and not name.endswith(".stl"):
        np.testing.assert_allclose(got.points, mesh.points, atol=1e-6)
        np.testing.assert_array_equal(read(path, kind="cloud").points, got.points)
        if surface == "ball":
            np.testing.assert_array_equal(got.faces, mesh.faces)


def read_with(path, told, **options):
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        got = read(path, **options)
    assert len(heard) == (told is not QUIET), [str(w.message) for w in heard]
    for w in heard:
        assert w.category is IgnoredContentWarning
        with pytest.raises(IgnoredContentWarning, match=told):
            raise w.message
        assert str(w.message).startswith(f"{path}: ")
    return got


P = BALL.points[:50].tolist()
CLOUDS = [
    ("points.obj", rows(P, "v {}"), QUIET),
    ("with normals.obj", rows(P, "v {}") + "vn 0 0 1\n" * 50, QUIET),
    ("with colours.obj", rows(P, "v {} 1 0 0"), QUIET),
    ("named points.obj", rows(P, "v {}") + "p 1 2 3\n", QUIET),
    (
        "with lines.obj",
        rows(P, "v {}") + "l 1 2 3\nl 3 4\n",
        "2 lines beginning with 'l', the first is line 51",
    ),
    ("points.off", off(P, []), QUIET),
    ("points.ply", header(("vertex", 50, XYZ)) + rows(P), QUIET),
    ("no faces.ply", ply(P, []), QUIET),
    ("blanks.xyz", rows(P), QUIET),
    ("commas.xyz", rows(P, mark=", "), QUIET),
    ("semicolons.xyz", rows(P, mark=";"), QUIET),
    ("decimal commas.xyz", rows(P, mark=";").replace(".", ","), QUIET),
    ("tabs.xyz", rows(P, mark="\t"), QUIET),
    ("trailing commas.xyz", rows(P, "{},", mark=","), QUIET),
    ("names.xyz", "X Y Z\n" + rows(P), QUIET),
    ("names, quoted.xyz", '"x","y","z"\n' + rows(P, mark=","), QUIET),
    ("names behind a number.xyz", "id;x;y;z\n" + rows(P, "7;{}", mark=";"), QUIET),
    ("names in a comment.xyz", "//X Y Z\n" + rows(P), QUIET),
    ("names and normals.xyz", "x y z nx ny nz\n" + rows(P, "{} 0 0 1"), QUIET),
    ("count.xyz", "50\n" + rows(P), QUIET),
    ("count and names.xyz", "50\nx,y,z\n" + rows(P, mark=","), QUIET),
    ("comment.xyz", "# D:\\scans\\\n" + rows(P), QUIET),
    ("nan behind.xyz", rows(P, "{} -nan(ind)"), "passed over 1 column behind the first three"),
    ("intensity.csv", rows(P, "{},7", mark=","), r"over 1 column .* x, y, z in a first line"),
    ("semicolons.csv", rows(P, "{};0.5;0.25", mark=";"), "passed over 2 columns behind"),
    ("comment of three.txt", "# x y z\n" + rows(P, "{} 7"), "passed over 1 column behind"),
    ("scalars.xyz", rows(P, "{} 7 300 5"), "passed over 3 columns behind"),
    ("normals.xyz", rows(P, "{} 0.6 0 0.8"), QUIET),
    ("colours.csv", rows(P, "{};7;255;0", mark=";"), QUIET),
    ("shades.xyz", rows(P, "{} 0.25 1 0"), QUIET),
    ("named.csv", "x,y,z,intensity,frame\n" + rows(P, "{},7,8", mark=","), QUIET),
    ("agreed on.pts", "50\n" + rows(P, "{} -500 7 8 9"), QUIET),
    ("mac.xyz", rows(P).replace("\n", "\r"), QUIET),
    ("utf-16.xyz", rows(P).encode("utf-16"), QUIET),
]


@pytest.mark.parametrize(("name", "content", "told"), CLOUDS, ids=[c[0] for c in CLOUDS])
def test_clouds_are_read_right(tmp_path, name, content, told):
    path = tmp_path / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    for kind in (None, "cloud"):
        got = read_with(path, told, kind=kind)
        assert isinstance(got, PointCloud)
        np.testing.assert_array_equal(got.points, P)


def test_planar_vertices_are_in_the_plane(tmp_path):
    (tmp_path / "flat.obj").write_text(obj([row[:2] for row in grid()[0]], grid()[1]))
    got = read_with(tmp_path / "flat.obj", "x and y alone: z is 0")
    np.testing.assert_array_equal(got.points, grid()[0])
    assert got.area == pytest.approx(1)


# --- what is refused, and what its refusal advises ------------------------------------------------

OPEN = stl(end="").removesuffix(facet(F[-1]))


def with_end(path):
    path.write_text(path.read_text() + "endsolid\n")
    return read(path)


def cut(number):
    def follow(path):
        path.write_bytes(path.read_bytes()[:-number])
        return read(path)

    return follow


def changed(old, new):
    def follow(path):
        path.write_text(path.read_text().replace(old, new))
        return read(path)

    return follow


def of_points(path):
    return read(path, kind="cloud")


def finite(path):
    return without_nan(path).geometry


SCAN = [*P, [np.nan] * 3]
REMEDIES = [
    ("no end.stl", OPEN, "if it is whole, add that line", with_end, len(V)),
    ("seen.ply", header(("vertex", 51, XYZ)) + rows(SCAN), r"without_nan\(\)", finite, 50),
    ("seen.xyz", rows(SCAN), r"without_nan\(\)", finite, 50),
    ("seen.obj", rows(SCAN, "v {}"), r"without_nan\(\)", finite, 50),
    ("torn.obj", obj([[np.nan] * 3, *V[1:]]), r"without_nan\(\)", finite, len(V) - 1),
    ("texture.obj", rows(P, "v {}") + "vt 0 0\n", 'kind="cloud"', of_points, 50),
    (
        "bands.ply",
        strips().replace("tristrips", "bands"),
        'kind="cloud"',
        of_points,
        121,
    ),
    (
        "more rows.ply",
        ply_binary(behind=struct.pack("<B3i", 3, 0, 1, 2)),
        "cut them off",
        cut(13),
        len(V),
    ),
    ("more facets.stl", stl_binary(behind=b"\1" * 50), "cut them off", cut(50), len(V)),
    (
        "names.xyz",
        "x y z\n" + rows(P, "{} 0 0 1"),
        "or remove that line",
        changed("x y z\n", ""),
        50,
    ),
    ("commas.xyz", rows(P).replace(".", ","), "with decimal points", changed(",", "."), 50),
    (
        "crossed.obj",
        obj(flat([(0, 0), (1, 0), (1, 1), (0, 1)]), [[0, 2, 1, 3]]),
        "face 0.* list its corners in order around it",
        changed("f 1 3 2 4", "f 1 2 3 4"),
        4,
    ),
]


@pytest.mark.parametrize(
    ("name", "content", "advice", "follow", "n"), REMEDIES, ids=[r[0] for r in REMEDIES]
)
def test_what_a_refusal_advises_works(tmp_path, name, content, advice, follow, n):
    path = tmp_path / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(InvalidFileError, match=advice):
        read(path)
    assert follow(path).n == n
