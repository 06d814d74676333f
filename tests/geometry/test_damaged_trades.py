"""Damaged files of other trades: each is refused with a reason, and a batch goes on."""

import base64
import gzip
import re
import zlib

import numpy as np
import pytest
from others import BALL, F, V, polydata, write_gifti
from test_files_of_trades import by_freesurfer, by_meshio, by_vtk, pcd, table

from spectra_kit.datasets import Plan, SpectrumStore, compute_all, find_inputs
from spectra_kit.errors import InvalidFileError
from spectra_kit.geometry import read, write

KINDS = {
    "pial": by_freesurfer,
    "gii": write_gifti,
    "vtk": by_vtk,
    "text.vtk": lambda path: by_vtk(path, binary=False),
    "vtp": by_vtk,
    "text.vtp": lambda path: by_vtk(path, binary=False),
    "vtu": by_vtk,
    "msh": lambda path: by_meshio(path, file_format="gmsh"),
    "old.msh": lambda path: by_meshio(path, file_format="gmsh22", binary=False),
    "mesh": by_meshio,
    "pcd": lambda path: path.write_bytes(
        pcd("binary") + np.c_[V, V].astype("<f4")[:, :4].tobytes()
    ),
    "text.pcd": lambda path: path.write_bytes(pcd("ascii") + table("{} {} {} 1")),
    "pts": lambda path: path.write_bytes(table("{} {} {}", head="42\n")),
}


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """The sphere in each format, as bytes."""
    folder = tmp_path_factory.mktemp("good")
    for kind, make in KINDS.items():
        make(folder / f"a.{kind}")
    return {kind: (folder / f"a.{kind}").read_bytes() for kind in KINDS}


def half(data):
    return data[: len(data) // 2]


def shorter(data):
    return data[:-1]


def swapped(old, new, count=1):
    def damage(data):
        assert old in data
        return data.replace(old, new, count)

    return damage


def second_cell_ends_before(data):
    kind = ">i8" if b"OFFSETS vtktypeint64" in data else ">i4"  # the latter before VTK 9.7
    return swapped(np.array([3, 6], kind).tobytes(), np.array([3, -6], kind).tobytes())(data)


def integer(value, old, which=0, order=">"):
    """Replace one of the integers of four bytes that are `old`."""

    def damage(data):
        found = [
            m.start() for m in re.finditer(re.escape(np.array(old, f"{order}i4").tobytes()), data)
        ]
        at = found[which]
        return data[:at] + np.array(value, f"{order}i4").tobytes() + data[at + 4 :]

    return damage


def nan_of(kind):
    def damage(data):
        first = V.astype(kind)[0].tobytes()
        assert first in data
        return data.replace(first, np.full(3, np.nan, kind).tobytes(), 1)

    return damage


def bomb(data):
    """As many zeros as a point set of six million vertices is, where the points were."""
    packed = base64.b64encode(zlib.compress(bytes(72 << 20)))
    return re.sub(rb"<Data>[^<]*</Data>", b"<Data>" + packed + b"</Data>", data, count=1)


def last_index(value):
    """Replace the last index of the faces, which FreeSurfer writes last."""
    return lambda data: data[:-4] + np.array(value, ">i4").tobytes()


DAMAGED = [
    ("pial", half, r"announces 42 vertices and 80 faces, 1,\d+ bytes, got"),
    ("pial", shorter, "cut short"),
    ("pial", lambda data: data[:30], "must announce its vertices and faces"),
    ("pial", lambda data: b"Once upon a time", r"must begin with b'\\xff\\xff\\xfe'"),
    ("pial", lambda data: b"", "the file is empty"),
    ("pial", integer(2**31 - 1, 80), "cut short"),
    ("pial", integer(79, 80), "rows that it does not count"),
    ("pial", integer(-5, 42), "must announce its vertices and faces"),
    ("pial", last_index(42), r"`faces` must be in \[0, 42\), got 42"),
    ("pial", last_index(-1), r"`faces` must be in \[0, 42\), got -1"),
    ("pial", nan_of(">f4"), "`points` must be finite"),
    ("pial", lambda data: b"\xff\xff\xff" + data[3:], r"quads, or values .*read_overlay\(path\)"),
    ("gii", half, "nibabel cannot read it"),
    ("gii", lambda data: b"not a surface", "nibabel cannot read it"),
    ("gii", swapped(b"NIFTI_INTENT_TRIANGLE", b"NIFTI_INTENT_SHAPE"), "holds no surface"),
    ("gii", swapped(b'Dim0="42"', b'Dim0="43"'), "nibabel cannot read it"),
    ("gii", bomb, "unpack to more than 100 times its size"),
    ("gii", swapped(b"GZipBase64Binary", b"ExternalFileBinary"), "lie in another file"),
    ("vtk", half, "VTK cannot read it"),
    ("vtk", swapped(b"POINTS 42", b"POINTS 4200000000"), "announces 4,200,000,000 of a kind"),
    ("vtk", swapped(b"5.1", b"99999999"), "must begin with '# vtk DataFile Version'"),
    ("vtk", lambda data: data[: data.index(b"POLYGONS")], "no cells; it may .* use kind"),
    ("vtk", second_cell_ends_before,
     "cells that do not follow each other"),
    ("text.vtk", half, "no cells; it may be cut short|VTK cannot read it"),
    ("text.vtk", swapped(b"POLYDATA", b"FIELD"), "VTK cannot read it|no surface"),
    ("vtp", half, "VTK cannot read it"),
    ("vtp", swapped(b'NumberOfPoints="42"', b'NumberOfPoints="99999999999"'), "of a kind in"),
    ("text.vtp", half, "VTK cannot read it"),
    ("vtu", half, "VTK cannot read it"),
    ("vtu", swapped(b'Cells="80"', b'Cells="50"'), "counts 150 corners of cells in 240"),
    ("vtu", lambda data: b"<html></html>", "VTK cannot read it"),
    ("msh", half, r"does not end its \$\w+; it may be cut short"),
    ("msh", swapped(b"$EndElements", b""), r"does not end its \$Elements"),
    ("old.msh", half, "does not end its"),
    ("old.msh", swapped(b"$Nodes\n42", b"$Nodes\n999999999"), "announces 999,999,999 of a kind"),
    ("old.msh", swapped(b"$Nodes\n42", b"$Nodes\n43"), "meshio cannot read it"),
    ("old.msh", swapped(b"$MeshFormat", b"$Nothing"), "meshio cannot read it"),
    ("mesh", half, "meshio cannot read it"),
    ("mesh", swapped(b"Dimension 3", b"Dimension 2147483648"), "announces 2,147,483,648"),
    ("mesh", swapped(b"Triangles\n80", b"Triangles\n90"), "meshio cannot read it"),
    ("mesh", swapped(b"Vertices\n42", b"Vertices\n41"), "meshio cannot read it"),
    ("pcd", half, "announces 42 points, 672 bytes, got"),
    ("pcd", lambda data: data + bytes(15) + b"\1", "rows that it does not count"),
    ("pcd", swapped(b"FIELDS x y z", b"FIELDS u v w"), "must have a whole PCD header"),
    ("pcd", swapped(b"POINTS 42", b"POINTS -1"), "announces -1 points"),
    ("pcd", lambda data: data[:60], "header that ends with DATA"),
    ("pcd", nan_of("<f4"), r"without_nan\(\) leaves such points out"),
    ("text.pcd", lambda data: data[:-40], r"announces 42 points, got 41|line \d+ is broken"),
    ("text.pcd", swapped(b"POINTS 42", b"POINTS 50"), "announces 50 points, got 42"),
    ("pts", half, r"announces 42 points, followed by \d+ lines|is broken"),
]  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory, good):
    folder = tmp_path_factory.mktemp("damaged")
    for i, (kind, damage, _) in enumerate(DAMAGED):
        (folder / f"{i:02}.{kind}").write_bytes(damage(good[kind]))
    packed = gzip.compress(bytes(80 << 20))
    (folder / "90.pial.gz").write_bytes(packed)
    (folder / "91.gii.gz").write_bytes(gzip.compress(good["gii"])[:-9])
    (folder / "92.vtp.gz").write_bytes(good["vtp"])
    return folder


OF_PACKED = [
    ("90.pial.gz", "unpacks to more than 67,108,864 bytes"),
    ("91.gii.gz", "cannot be unpacked"),
    ("92.vtp.gz", "is not packed"),
]
EVERY = [(f"{i:02}.{kind}", reason) for i, (kind, _, reason) in enumerate(DAMAGED)] + OF_PACKED


@pytest.mark.parametrize(("name", "reason"), EVERY, ids=[name for name, _ in EVERY])
def test_each_is_refused_with_its_reason(folder, capfd, name, reason):
    with pytest.raises(InvalidFileError, match=reason) as caught:
        read(folder / name)
    assert str(caught.value).startswith(str(folder / name))
    assert capfd.readouterr() == ("", "")  # libraries are not heard


def test_what_is_damaged_here_was_whole(good, tmp_path):
    for kind, data in good.items():
        (tmp_path / f"a.{kind}").write_bytes(data)
        np.testing.assert_allclose(read(tmp_path / f"a.{kind}").points, V, atol=1e-6)


def test_a_batch_names_them_all_and_goes_on(folder, tmp_path):
    write(BALL, folder / "99.ply")
    inputs = find_inputs([folder])
    report = compute_all(inputs, SpectrumStore(tmp_path / "store"), Plan(k=4))
    assert [one.path.name for one, _ in report.completed] == ["99.ply"]
    failed = {one.input.path.name: one.error for one in report.failed}
    assert set(failed) == {name for name, _ in EVERY}
    for name, reason in EVERY:
        assert isinstance(failed[name], InvalidFileError)
        assert re.search(reason, str(failed[name]))


def test_cells_that_overlap_are_refused_as_objects_too():
    from spectra_kit import as_geometry

    surface = polydata()
    offsets = np.arange(0, 3 * len(F) + 1, 3)
    offsets[5] = 999
    from vtkmodules.util.numpy_support import numpy_to_vtkIdTypeArray
    from vtkmodules.vtkCommonDataModel import vtkCellArray

    cells = vtkCellArray()
    cells.SetData(*(numpy_to_vtkIdTypeArray(part, deep=True) for part in (offsets, F.ravel())))
    surface.SetPolys(cells)
    with pytest.raises(ValueError, match="do not follow each other"):
        as_geometry(surface)
