"""The commands of many shapes: `batch` into a store, and `store`, which looks into it."""

import csv
import json
import os
from pathlib import Path

import numpy as np
import pytest
from conftest import bumpy, creature, joined, moved
from running import printed, record, refusal

import spectra_kit as sk
from spectra_kit.cli import main
from spectra_kit.datasets import SpectrumStore
from spectra_kit.geometry import TriangleMesh, sphere, write

HERE = ("-k", 6, "--nworkers", 0)


@pytest.fixture
def scans(tmp_path, monkeypatch):
    """Three shapes in a folder, and the working folder beside it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scans").mkdir()
    write(bumpy(), "scans/a.off")
    write(creature(520), "scans/b.ply")
    write(creature(520).as_cloud(), "scans/c.xyz")
    return tmp_path / "scans"


def test_a_folder_into_a_store_and_a_table(scans, capsys):
    run = ("batch", "scans", "--out", "store", *HERE, "--csv", "t.csv", "--descriptors", "hks,dna")
    made = record(capsys, *run)
    assert (made["inputs"], made["computed"], made["known"], made["failed"]) == (3, 3, 0, [])
    with open("t.csv", newline="") as file:
        rows = {row["name"]: row for row in csv.DictReader(file)}
    assert [*rows] == ["scans/a.off", "scans/b.ply", "scans/c.xyz"]
    exact = sk.spectrum("scans/a.off", 6).eigenvalues
    values = [float(rows["scans/a.off"][f"eigenvalue_{i}"]) for i in range(6)]
    np.testing.assert_allclose(values, exact, rtol=1e-12, atol=1e-12)
    assert rows["scans/c.xyz"]["kind"] == "cloud"
    again = record(capsys, *run)
    assert (again["computed"], again["known"]) == (0, 3)
    text, _ = printed(capsys, *run)
    assert "3 shapes: 0 computed, 3 known, 0 failed" in text


def test_what_fails_is_named_with_its_reason_and_the_rest_goes_on(scans, capsys):
    mesh = bumpy()
    write(TriangleMesh(np.vstack([mesh.points, [[9, 9, 9]]]), mesh.faces), "scans/loose.off")
    (scans / "empty.off").touch()
    assert main(["batch", "scans", "-o", "store", *map(str, HERE), "--json"]) == 2
    out, err = capsys.readouterr()
    told = json.loads(out)
    assert told["computed"] == 3
    reasons = {one["name"]: one["reason"] for one in told["failed"]}
    assert [*reasons] == ["scans/empty.off", "scans/loose.off"]
    assert reasons["scans/loose.off"].endswith("drop them with --repair")
    for name, reason in reasons.items():
        assert f"failed: {name}: {reason}\n" in err
    assert err.endswith("error: 2 shapes of 5 failed, as told above; mend or leave them out;"
                        " what is done is kept\n")  # fmt: skip
    mended = ("batch", "scans", "-o", "store", *HERE, "--repair")
    assert main([*map(str, mended)]) == 2
    assert "1 shape of 5 failed" in capsys.readouterr().err


@pytest.mark.filterwarnings("always::spectra_kit.errors.SplitSurfaceWarning")
def test_seams_are_told_and_repaired_and_specks_left_out(scans, capsys):
    ball, speck = sphere(subdivisions=2).geometry, sphere(subdivisions=0).geometry
    corners = joined(ball, moved(speck, 2, 0, 0, scale=0.01))
    points = corners.points[corners.faces].reshape(-1, 3)
    write(TriangleMesh(points, np.arange(len(points)).reshape(-1, 3)), "scans/flat.ply")
    run = ("batch", "scans/flat.ply", "-o", "store", *HERE)
    for _ in range(2):  # what is known already is told again
        _, err = printed(capsys, *run)
        assert "1 shape of 1, such as 'scans/flat.ply': boundary edges lie along others" in err
        assert "join them with --repair" in err
    _, err = printed(capsys, *run, "--repair", "--largest", "--json")
    assert err == ""
    store = SpectrumStore("store")
    (shape,) = (one for one in store.records() if one.facts["largest"])
    assert (shape.points, shape.components) == (ball.n, 1)
    truth = sk.spectrum(ball, len(shape.eigenvalues)).eigenvalues
    np.testing.assert_allclose(shape.eigenvalues, truth, rtol=1e-9, atol=1e-9)


def test_names_that_stand_for_other_files_now_are_told(scans, capsys, monkeypatch):
    run = ("batch", "scans", "--out", scans.parent / "store", *HERE)
    assert record(capsys, *run)["renewed"] == []
    others = scans.parent / "others"
    (others / "scans").mkdir(parents=True)
    for name in ("a.off", "b.ply"):  # one that differs, and a copy of one
        shape = creature(520, seed=1) if name == "a.off" else creature(520)
        write(shape, others / "scans" / name)
    monkeypatch.chdir(others)
    out, err = printed(capsys, *run, "--json")
    told = json.loads(out)
    assert (told["computed"], told["known"], told["renewed"]) == (1, 1, ["scans/a.off"])
    assert err == (
        "warning: 1 name stood for other files before, or for other bytes, and now for these:"
        " scans/a.off\n"
    )
    assert record(capsys, *run)["renewed"] == []


def test_strict_runs_stop(scans, capsys):
    (scans / "A.off").touch()
    line = refusal(capsys, "batch", "scans", "-o", "store", *HERE, "--strict")
    assert "scans/A.off: the file is empty" in line
    assert list(SpectrumStore("store").entries()) == []


def test_shards_share_a_store(scans, capsys):
    counts = [
        record(capsys, "batch", "scans", "-o", "store", *HERE, "--shard", f"{i}/2")["computed"]
        for i in (1, 2)
    ]
    assert sum(counts) == 3
    assert record(capsys, "batch", "scans", "-o", "store", *HERE)["computed"] == 0


@pytest.mark.slow
def test_workers_do_the_same(scans, capsys):
    run = ("batch", "scans", "-k", 6, "-o")
    record(capsys, *run, "one", "--nworkers", 0)
    assert record(capsys, *run, "two", "--nworkers", 1)["computed"] == 3
    one, two = ({e.key: e.path.read_bytes() for e in SpectrumStore(store).entries()}
                for store in ("one", "two"))  # fmt: skip
    assert one == two


@pytest.mark.parametrize(
    ("message", "options"),
    [
        ("`--shard` must be like 3/100, counted from 1, got 3", ("--shard", "3")),
        ("`part` must be in [1, 3], got 4", ("--shard", "4/3")),
        ("`--descriptors` must be among hks, wks, gps, dna, got sift", ("--descriptors", "sift")),
        ("`output` must be a .csv file", ("--csv", "table.xlsx")),
        ("--nworkers 0, which is this process alone", ("--nworkers", "0", "--nthreads", "2")),
        ("`--nworkers` must be left out", ("--scheduler", "tcp://a:1", "--nworkers", "2")),
    ],
)
def test_options_that_are_wrong(scans, capsys, message, options):
    assert message in refusal(capsys, "batch", "scans", "-o", "store", "-k", 6, *options)


@pytest.mark.parametrize(
    "kind", ["itself", "spelling", "link", "hard link", "folder link", "shape"]
)
def test_a_manifest_is_never_replaced_by_its_table(scans, capsys, kind):
    manifest, text = Path("people.csv"), "file,name,species\nscans/a.off,a,cat\n"
    manifest.write_text(text)
    table = Path("table.csv")
    if kind == "itself":
        table = manifest
    elif kind == "spelling":
        table = Path("scans/../people.csv")
    elif kind == "link":
        table.symlink_to(manifest)
    elif kind == "hard link":
        os.link(manifest, table)
    elif kind == "folder link":
        Path("here").symlink_to(".")
        table = Path("here/people.csv")
    else:  # by another name than it has as an input
        os.link("scans/a.off", "table.csv")
    line = refusal(capsys, "batch", manifest, "--out", "store", *HERE, "--csv", table)
    assert "`output` must not replace an input" in line
    assert manifest.read_text() == text
    assert not Path("store").exists()


def test_what_terminals_obey_is_written_as_it_is_typed(scans, capsys):
    """Whatever a manifest, a file's name or an error says."""
    bad = "\x1b[2J\x1b]0;owned\x07\r\x08\x9b31m\x7f"
    with open("people.csv", "w", newline="", encoding="utf-8") as file:
        rows = [["file", "name"], ["scans/a.off", bad], ["scans/a.off", "two\nlines"],
                [f"none{bad}.off", f"gone{bad}"]]  # fmt: skip
        csv.writer(file).writerows(rows)
    run = ("batch", "people.csv", "--out", "store", *HERE, "--csv", "table.csv")
    assert main([*map(str, run)]) == 2
    told = capsys.readouterr()
    _, listed = printed(capsys, "store", "list", "store")[::-1]
    Path(f"scans/{bad}.off").write_text("")
    assert main(["modes", f"scans/{bad}.off", "-o", "a.png"]) == 2
    texts = (told.out, told.err, listed, capsys.readouterr().err, Path("table.csv").read_text())
    obeyed = {*map(chr, range(32)), *map(chr, range(0x7F, 0xA0))} - {"\n"}
    for text in texts:
        assert not obeyed & {*text}
    assert sum(r"\x1b[2J\x1b]0;owned\x07\x0d\x08\x9b31m\x7f" in text for text in texts) >= 4
    assert r"two\x0alines" in listed


def test_inputs_and_stores_that_are_none(scans, capsys):
    (scans / "deep").mkdir()
    assert "hold meshes or clouds" in refusal(capsys, "batch", "scans/deep", "-o", "store", *HERE)
    line = refusal(capsys, "batch", "scans", "-o", "scans", *HERE)
    assert "be a store, an empty folder or a new one" in line
    assert "is no store" in refusal(capsys, "store", "list", "nowhere")
    assert not (scans.parent / "nowhere").exists()
    assert "on list" in refusal(capsys, "store", "list", "nowhere", "--remove")


def test_a_store_is_listed_verified_and_cleaned(scans, capsys):
    printed(capsys, "batch", "scans", "-o", "store", *HERE)
    listed = record(capsys, "store", "list", "store")
    assert [one["name"] for one in listed["shapes"]] == [
        "scans/a.off",
        "scans/b.ply",
        "scans/c.xyz",
    ]
    kept = SpectrumStore("store")
    assert listed["entries"] == len(list(kept.entries())) == 9
    assert record(capsys, "store", "verify", "store")["damaged"] == []
    entry = next(kept.entries("spectra"))
    entry.path.write_bytes(b"")
    text, said = printed(capsys, "batch", "scans", "-o", "store", *HERE)
    assert "3 shapes: 1 computed, 2 known, 0 failed" in text
    assert f"warning: {entry.path} is damaged and made again" in said
    entry.path.write_bytes(entry.path.read_bytes()[:-1])
    assert main(["store", "verify", "store"]) == 2
    out, err = capsys.readouterr()
    assert f"damaged: {entry.path}" in out
    assert "1 entry of the store" in err
    removed = record(capsys, "store", "verify", "store", "--remove")
    assert removed["removed"] == [str(entry.path)]
    assert record(capsys, "batch", "scans", "-o", "store", *HERE)["computed"] == 1
    assert record(capsys, "store", "clean", "store")["removed"] == []
