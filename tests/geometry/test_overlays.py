"""Values and labels at vertices: read as nibabel wrote them, and written as it reads them."""

import gzip

import numpy as np
import pytest

from spectra_kit.errors import InvalidFileError, InvalidInputError
from spectra_kit.geometry import Overlay, read_overlay, restrict, sphere, write_overlay

nibabel = pytest.importorskip("nibabel")

N = 50
RNG = np.random.default_rng(0)
VALUES = RNG.normal(size=N).astype("f4")
SERIES = RNG.normal(size=(N, 3)).astype("f4")
NAMES = [b"unknown", b"bankssts", b"cuneus"]
TABLE = np.array([[25, 5, 25, 0, 0], [25, 100, 40, 0, 0], [100, 25, 0, 0, 0]])
PARTS = RNG.integers(0, 3, N)


def gifti(path, *arrays, intent="NIFTI_INTENT_SHAPE", table=None):
    rows = [nibabel.gifti.GiftiDataArray(array, intent=intent) for array in arrays]
    nibabel.save(nibabel.gifti.GiftiImage(darrays=rows, labeltable=table), path)


def annotation(path, labels=PARTS, names=NAMES):
    nibabel.freesurfer.write_annot(path, labels, TABLE.copy(), names, fill_ctab=True)


def label_table():
    table = nibabel.gifti.GiftiLabelTable()
    for key, name in ((0, "???"), (7, "cortex")):
        label = nibabel.gifti.GiftiLabel(key=key)
        label.label = name
        table.labels.append(label)
    return table


@pytest.mark.parametrize("name", ["lh.thickness", "lh.curv", "rh.any.fwhm10"])
def test_values_of_freesurfer(tmp_path, name):
    nibabel.freesurfer.write_morph_data(str(tmp_path / name), VALUES)
    np.testing.assert_array_equal(read_overlay(tmp_path / name).values, VALUES)
    packed = tmp_path / f"{name}.gz"
    packed.write_bytes(gzip.compress((tmp_path / name).read_bytes()))
    np.testing.assert_array_equal(read_overlay(packed).values, VALUES)


def test_values_of_gifti(tmp_path):
    gifti(tmp_path / "a.shape.gii", VALUES)
    found = read_overlay(tmp_path / "a.shape.gii")
    np.testing.assert_array_equal(found.values, VALUES)
    assert dict(found.names) == {}
    gifti(tmp_path / "a.func.gii", *SERIES.T)
    np.testing.assert_array_equal(read_overlay(tmp_path / "a.func.gii").values, SERIES)


def test_labels_of_gifti(tmp_path):
    labels = np.where(PARTS > 0, 7, 0).astype("i4")
    gifti(tmp_path / "a.label.gii", labels, intent="NIFTI_INTENT_LABEL", table=label_table())
    found = read_overlay(tmp_path / "a.label.gii")
    np.testing.assert_array_equal(found.values, labels)
    assert found.values.dtype.kind == "i"
    assert dict(found.names) == {0: "???", 7: "cortex"}


def test_annotations(tmp_path):
    annotation(tmp_path / "lh.aparc.annot")
    found = read_overlay(tmp_path / "lh.aparc.annot")
    expected, _, names = nibabel.freesurfer.read_annot(tmp_path / "lh.aparc.annot")
    np.testing.assert_array_equal(found.values, expected)
    np.testing.assert_array_equal(found.values, PARTS)
    assert [found.names[i].encode() for i in range(3)] == names
    annotation(tmp_path / "lh.holes.annot", np.where(PARTS == 2, -1, PARTS))
    np.testing.assert_array_equal(
        read_overlay(tmp_path / "lh.holes.annot").values, np.where(PARTS == 2, -1, PARTS)
    )


@pytest.mark.parametrize("name", ["a.func.gii", "a.shape.gii", "lh.thickness", "lh.CURV"])
def test_what_is_written_is_read_by_nibabel(tmp_path, name):
    values = np.where(VALUES > 1, np.nan, VALUES)
    write_overlay(values, tmp_path / name)
    if name.endswith(".gii"):
        data = nibabel.load(tmp_path / name).agg_data()
    else:
        data = nibabel.freesurfer.read_morph_data(tmp_path / name)
    np.testing.assert_array_equal(data, values.astype("f4"))
    np.testing.assert_array_equal(read_overlay(tmp_path / name).values, values)


@pytest.mark.parametrize("name", ["lh.thickness.fsaverage.mgh", "lh.seg.mgz", "lh.packed.mgh.gz"])
def test_volumes_of_freesurfer(tmp_path, name):
    path, plain = tmp_path / name, tmp_path / name.removesuffix(".gz")
    for values, shape in ((VALUES, (N, 1, 1)), (SERIES, (1, N, 1, 3)), (PARTS.astype("i4"), (N,))):
        image = nibabel.MGHImage(values.reshape(*shape, *[1] * (3 - len(shape))), np.eye(4))
        nibabel.save(image, plain)
        if name.endswith(".gz"):
            path.write_bytes(gzip.compress(plain.read_bytes()))
        found = read_overlay(path, n=N).values
        np.testing.assert_array_equal(found, values)
        assert found.dtype == (np.int64 if values is not VALUES and values is not SERIES else float)


def region(path, listed=(7, 3, 44), count=None):
    rows = "".join(f"{i}  -1.500  2.250  30.000 0.0000000000\n" for i in listed)
    count = len(listed) if count is None else count
    path.write_text(f"#!ascii label  , from subject sub-01 vox2ras=TkReg\n{count}\n{rows}")


def test_regions_of_freesurfer(tmp_path):
    path = tmp_path / "lh.cortex.label"
    region(path)
    found = read_overlay(path, n=N).values
    assert found.dtype == bool
    np.testing.assert_array_equal(np.flatnonzero(found), [3, 7, 44])
    np.testing.assert_array_equal(np.sort(nibabel.freesurfer.read_label(path)), [3, 7, 44])
    ball = sphere(subdivisions=3).geometry
    region(path, np.flatnonzero(ball.points[:, 2] > 0).tolist())
    cap = restrict(ball, read_overlay(path, n=ball.n).values)
    assert (ball.points[cap.vertex_index, 2] > 0).all()
    with pytest.raises(InvalidFileError, match=r"give `n`, that of the surface"):
        read_overlay(path)
    for wrong, told in (
        ({"listed": [7, N]}, "lists vertex 50, and the surface has 50"),
        ({"listed": [7, -1]}, "lists vertex -1, and the surface has 50"),
        ({"count": 9}, "announces 9 vertices, got 3"),
        ({"listed": ["1 2"]}, "line 3 is broken: '1 2 -1.500"),
        ({"count": "x"}, "line 2 is broken: 'x'"),
    ):
        region(path, **wrong)
        with pytest.raises(InvalidFileError, match=told):
            read_overlay(path, n=N)


def test_the_number_of_vertices_is_compared(tmp_path):
    write_overlay(VALUES, tmp_path / "lh.curv")
    with pytest.raises(InvalidFileError, match="is of 50 vertices, and the surface has 60"):
        read_overlay(tmp_path / "lh.curv", n=60)


@pytest.mark.parametrize("names", [{}, {0: "???", 1: "V1", 2: "bankssts", -1: "none"}])
def test_labels_are_written_as_labels(tmp_path, names):
    path = tmp_path / "lh.atlas.label.gii"
    labels = np.where(PARTS == 2, -1, PARTS)
    write_overlay(Overlay(labels, names) if names else labels, path)
    (array,) = nibabel.load(path).darrays
    assert array.intent == nibabel.nifti1.intent_codes["NIFTI_INTENT_LABEL"]
    found = read_overlay(path)
    np.testing.assert_array_equal(found.values, labels)
    assert found.values.dtype.kind == "i"
    assert dict(found.names) == (names or {-1: "-1", 0: "0", 1: "1"})
    colours = [label.rgba for label in nibabel.load(path).labeltable.labels]
    assert len(set(colours)) == len(colours)
    write_overlay(PARTS, tmp_path / "lh.counts.shape.gii")
    (array,) = nibabel.load(tmp_path / "lh.counts.shape.gii").darrays
    assert array.intent == nibabel.nifti1.intent_codes["NIFTI_INTENT_SHAPE"]
    for wrong, where in ((VALUES, "a.label.gii"), (Overlay(PARTS, {0: "a"}), "lh.curv")):
        with pytest.raises(InvalidInputError, match=r"be integers for a \.label\.gii"):
            write_overlay(wrong, tmp_path / where)


def test_several_columns(tmp_path):
    write_overlay(SERIES, tmp_path / "a.func.gii")
    data = nibabel.load(tmp_path / "a.func.gii").agg_data()
    np.testing.assert_array_equal(np.column_stack(data), SERIES)
    with pytest.raises(InvalidInputError, match=r"have shape \(n,\) in files of FreeSurfer"):
        write_overlay(SERIES, tmp_path / "lh.curv")
    with pytest.raises(InvalidFileError, match=r"cannot write values as '\.csv'"):
        write_overlay(VALUES, tmp_path / "a.csv")


def surface(path):
    from others import write_gifti

    write_gifti(path)


def cut(make, size):
    def damaged(path):
        make(path)
        path.write_bytes(path.read_bytes()[:size])

    return damaged


def torn(make, old, new):
    def damaged(path):
        make(path)
        data = path.read_bytes()
        assert old in data
        path.write_bytes(data.replace(old, new, 1))

    return damaged


def volume(path, shape):
    nibabel.save(nibabel.MGHImage(VALUES.reshape(shape), np.eye(4)), path)


def flat(path):
    volume(path, (N, 1, 1))


def morph(path):
    nibabel.freesurfer.write_morph_data(str(path), VALUES)


@pytest.mark.parametrize(
    ("name", "make", "reason"),
    [
        ("lh.curv", cut(morph, -1), "announces 50 vertices with 1 values, got 199 bytes"),
        ("lh.curv", cut(morph, 10), "cut short"),
        ("lh.curv", torn(morph, b"\0\0\0\x32", b"\x7f\xff\xff\xff"), "announces 2,147,483,647"),
        ("lh.curv", lambda path: path.write_text("1 2 3"), "no values of vertices that are known"),
        ("lh.curv", lambda path: path.touch(), "the file is empty"),
        ("lh.curv", lambda path: None, "there is no such file"),
        ("lh.annot", cut(annotation, 300), "announces 50 vertices, and has not all of them"),
        ("lh.annot", cut(annotation, 450), "nibabel cannot read it"),
        ("lh.annot", torn(annotation, b"\0\0\0\x32", b"\x7f\xff\xff\xff"), "has not all of them"),
        ("a.mgh", lambda path: volume(path, (5, 5, 2)), "holds an image of shape .5, 5, 2, 1."),
        ("a.mgh", cut(flat, 300), "announces 50 vertices with 1 value, got 16 bytes"),
        ("a.mgh", cut(flat, 16), "must begin as .mgh does"),
        ("a.mgz", lambda path: path.write_text("1 2 3"), "must begin as .mgh does"),
        ("a.mgz", cut(flat, 200), "gzip cannot read it"),
        ("a.mgh", torn(flat, b"\0\0\0\x32", b"\x7f\0\0\0"), "announces 2,130,706,432"),
        ("a.gii", surface, "holds no values at each of the vertices"),
        ("a.gii", cut(lambda path: gifti(path, VALUES), 500), "nibabel cannot read it"),
        ("a.gii", lambda path: gifti(path, VALUES, VALUES[:9]), "arrays of several lengths"),
    ],
)
def test_damaged_overlays_are_refused(tmp_path, name, make, reason):
    make(tmp_path / name)
    with pytest.raises(InvalidFileError, match=reason):
        read_overlay(tmp_path / name)
