"""What a run is about: files, folders, patterns and manifests."""

from pathlib import Path

import pytest
from conftest import bumpy, refused

import spectra_kit as sk
from spectra_kit.datasets import Input, Plan, SpectrumStore, compute_all, find_inputs, shard
from spectra_kit.errors import IgnoredContentWarning, InvalidFileError, InvalidInputError
from spectra_kit.geometry import write


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for file in ("scans/b.off", "scans/a.ply", "scans/deep/c.obj", "other.npy"):
        Path(file).parent.mkdir(parents=True, exist_ok=True)
        shape = bumpy().as_cloud() if file.endswith("npy") else bumpy()
        write(shape, file)
    Path("scans/notes.txt").write_text("no shape")
    return tmp_path


def names(*sources):
    return [one.name for one in find_inputs(sources)]


def test_files_folders_and_patterns(folder):
    every = ["scans/a.ply", "scans/b.off", "scans/deep/c.obj"]
    assert names("scans") == every
    assert names(Path("scans") / "deep", "other.npy") == ["scans/deep/c.obj", "other.npy"]
    assert names("scans/*") == every[:2]
    assert names("scans/**/*.o[bf]*") == every[1:]
    assert names("none.off") == ["none.off"]  # to be told of with its reason


def test_fields_of_a_pattern_are_columns(tmp_path):
    for subject in ("01", "02"):
        for side in ("lh", "rh"):
            path = tmp_path / f"sub-{subject}" / "surf" / f"{side}.{subject}.off"
            path.parent.mkdir(parents=True, exist_ok=True)
            sk.geometry.write(sk.geometry.sphere(subdivisions=0).geometry, path)
    pattern = f"{tmp_path}/sub-{{subject}}/su?f/{{side}}.{{subject}}.off"
    assert [dict(one.columns) for one in find_inputs([pattern])] == [
        {"subject": subject, "side": side} for subject in ("01", "02") for side in ("lh", "rh")
    ]
    (tmp_path / "sub-02" / "surf" / "lh.02.off").rename(tmp_path / "sub-02" / "surf" / "lh.03.off")
    assert len(find_inputs([pattern])) == 3  # a field is the same wherever it stands
    odd = tmp_path / "{a}.off"
    sk.geometry.write(sk.geometry.sphere(subdivisions=0).geometry, odd)
    assert [one.path for one in find_inputs([odd])] == [odd]  # that is there is no pattern


def test_a_store_inside_a_folder_is_not_read(folder):
    for path in ("scans/store", "store"):
        SpectrumStore(path).keep_shape(bumpy())
    Path("scans/linked_store").symlink_to("../store")
    assert not any("store" in name for name in names("scans"))


def test_manifests(folder):
    Path("lists").mkdir()
    table = "\ufefffile,name,age\n../scans/a.ply,anna,31\n../scans/b.off,,7\n"
    Path("lists/people.csv").write_text(table, encoding="utf-8")
    first, second = find_inputs(["lists/people.csv"])
    assert (first.name, dict(first.columns)) == ("anna", {"age": "31"})
    assert (second.name, dict(second.columns)) == ("../scans/b.off", {"age": "7"})
    assert first.path.samefile("scans/a.ply")
    commas = "".join(f"{line},\n" for line in table.splitlines())  # as spreadsheets end lines
    Path("lists/people.csv").write_text(commas, encoding="utf-8")
    assert [one.columns for one in find_inputs(["lists/people.csv"])] == [
        first.columns,
        second.columns,
    ]


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("name,age\nanna,3\n", "`manifest` must have a column 'file', got name, age"),
        ("", "`manifest` must have a column 'file', got no row"),
        ("file,age\na.ply,3\n,4\n", "line 3 has not a cell for each column"),
        ("file,age\na.ply\n", "line 2 has not a cell for each column"),
        ("file\na.ply,4\n", "line 2 has not a cell for each column"),
        ('file\n"a.ply\n', "not a table of commas in UTF-8"),
        ("file,file\na.ply,b.ply\n", "otherwise than the others, got 'file', 'file'"),
        ("file,name,name\na.ply,a,b\n", "name each column, and otherwise than the others"),
        ("file,name,label,label\na.ply,a,b,c\n", "otherwise than the others"),
        ("file,label, label\na.ply,b,c\n", "otherwise than the others"),
        ('file,"label",label\na.ply,b,c\n', "otherwise than the others"),
        (",file,age\n0,a.ply,3\n", "name each column, and otherwise than the others, got ''"),
        ("file,name,\na.ply,a,b\n", "name each column"),
        ("file, \na.ply,b\n", "name each column"),
    ],
)
def test_manifests_that_are_none(folder, text, problem):
    Path("people.csv").write_text(text)
    with pytest.raises(InvalidFileError) as caught:
        find_inputs(["people.csv"])
    assert problem in str(caught.value)


@pytest.mark.parametrize("heading", ["", "x,y,z,c\n", "frame;Z;Y;X\n", "# x y z c\n", "2\n"])
def test_a_table_of_points_is_no_manifest(folder, heading):
    row = "1.5;2;3;4\n" if ";" in heading else "1.5,2,3,4\n"
    Path("cloud.csv").write_text(heading + 2 * row)
    (one,) = find_inputs(["cloud.csv"])
    assert (one.name, one.path, one.columns) == ("cloud.csv", Path("cloud.csv"), {})


def test_a_manifest_may_have_columns_x_y_z(folder):
    Path("people.csv").write_text("file,x,y,z\nscans/a.ply,1,2,3\n")
    (one,) = find_inputs(["people.csv"])
    assert one.columns == {"x": "1", "y": "2", "z": "3"}


def test_a_folder_of_tables_says_what_takes_them(folder):
    Path("tables").mkdir()
    Path("tables/cloud.csv").write_text("1,2,3\n")
    with pytest.raises(InvalidInputError, match=r"xyz\), got none; .*the pattern tables/\*\.csv"):
        find_inputs(["tables"])


def test_a_manifest_in_another_encoding_or_missing(folder):
    Path("people.csv").write_bytes(b"file\n\xff\xfe.off\n")
    with pytest.raises(InvalidFileError, match="not a table of commas in UTF-8"):
        find_inputs(["people.csv"])
    with pytest.raises(InvalidFileError, match="there is no such file"):
        find_inputs(["nobody.csv"])


def test_links_to_folders_are_followed_and_those_to_nothing_are_named(folder):
    Path("elsewhere/inner").mkdir(parents=True)
    for file in ("elsewhere/d.off", "elsewhere/inner/e.ply"):
        write(bumpy(), file)
    for name, target in {
        "linked": "../elsewhere",
        "again": "../elsewhere",  # the same files by another name
        "deep/circle": "../../scans",
        "self": ".",
        "gone.off": "../.git/annex/gone.off",
        "round.off": "round.off",
        "file.stl": "../elsewhere/d.off",
        "away": "nowhere",
        "notes.off": "deep",  # a folder, of which the name says nothing
    }.items():
        Path("scans", name).symlink_to(target)
    Path("elsewhere/circle").symlink_to(".")
    found = names("scans")
    every = ["scans/a.ply", "scans/b.off", "scans/deep/c.obj"]
    linked = [f"scans/{name}/{file}" for name in ("again", "linked")
              for file in ("d.off", "inner/e.ply")]  # fmt: skip
    others = ["scans/file.stl", "scans/gone.off", "scans/notes.off/c.obj", "scans/round.off"]
    assert found == sorted([*every, *linked, *others])
    assert set(names("scans/*.off")) == {"scans/b.off", "scans/gone.off", "scans/round.off"}
    report = compute_all(
        [one for one in find_inputs(["scans"]) if "o" in one.path.stem], SpectrumStore("store"),
        Plan(k=4),
    )  # fmt: skip
    assert [one.input.name for one in report.failed] == ["scans/gone.off", "scans/round.off"]
    assert all(isinstance(one.error, InvalidFileError) for one in report.failed)


def test_geometries_of_other_formats_are_told(folder):
    Path("scans/deep/part.3mf").touch()
    Path("scans/deep/table.csv").touch()  # which may be anything
    with pytest.warns(IgnoredContentWarning, match=r"over 1 file .* 'part\.3mf'.* trimesh\.load"):
        assert len(names("scans")) == 3
    assert names("scans/deep/*.csv") == ["scans/deep/table.csv"]


def test_sources_that_name_nothing_or_one_thing_twice(folder):
    Path("empty").mkdir()
    for source, expected in (("empty", "hold meshes or clouds"), ("*.stl", "match meshes or cl")):
        with pytest.raises(ValueError, match=f"`'.*'` must {expected}"):
            find_inputs([source])
    Path("empty/part.3mf").touch()  # of another format: by whom it is read
    with pytest.raises(ValueError, match=r"got none; of 'part\.3mf': hand over trimesh\.load"):
        find_inputs(["empty"])
    refused("sources", "name a file at least, got none", find_inputs, [])
    refused("sources", "have names of their own, got 1 several times", find_inputs,
            ["scans/a.ply", "scans/*.ply"])  # fmt: skip


def test_shards_are_disjoint_and_stay_where_they_are():
    every = [Input(name=f"{i}.off", path=Path(f"{i}.off")) for i in range(200)]
    parts = [shard(every, part, 7) for part in range(1, 8)]
    assert sorted(one.name for part in parts for one in part) == sorted(x.name for x in every)
    assert min(map(len, parts)) > 10
    fewer = [shard(every[::2], part, 7) for part in range(1, 8)]
    for part, less in zip(parts, fewer, strict=True):
        assert {one.name for one in less} <= {one.name for one in part}


@pytest.mark.parametrize(("part", "parts"), [(0, 3), (4, 3), (1, 0)])
def test_shards_that_are_none(part, parts):
    refused("parts" if parts == 0 else "part", "be ", shard, [], part, parts)
