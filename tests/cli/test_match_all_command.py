"""`match-all`: the maps of many pairs of a store, on the command line."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from conftest import bumpy, creature, two_parts
from running import printed, record, refusal

from spectra_kit.cli import main
from spectra_kit.datasets import SpectrumStore, load_match
from spectra_kit.geometry import mirrored, permuted, torus, write

HERE = ("--nworkers", 0)


@pytest.fixture(scope="module")
def animals(tmp_path_factory):
    """A store of an animal and its image, made once; tests add maps to it."""
    folder = tmp_path_factory.mktemp("animals")
    write(creature(520), folder / "cat.off")
    write(mirrored(creature(520)), folder / "image.off")
    command = ["batch", folder / "cat.off", folder / "image.off", "-o", folder / "store", "-k", 40]
    assert main([*map(str, command), "--nworkers", "0", "-q"]) == 0
    return folder


def test_all_pairs_into_the_store_and_a_table(animals, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(animals)
    run = ("match-all", "store", "--pairs", "all", *HERE, "--csv", tmp_path / "maps.csv")
    made = record(capsys, *run)
    assert (made["pairs"], made["computed"], made["known"], made["failed"]) == (1, 1, 0, [])
    with (tmp_path / "maps.csv").open(newline="") as file:
        (row,) = csv.DictReader(file)
    assert (row["source"], row["target"]) == (str(animals / "cat.off"), str(animals / "image.off"))
    assert (row["mirrored"], row["convincing"]) == ("True", "True")
    found = load_match(SpectrumStore("store"), row["map"])
    assert (found.point_map == np.arange(520)).mean() > 0.99
    assert len(found.functional_map) == 40
    again = record(capsys, *run)
    assert (again["computed"], again["known"]) == (0, 1)
    text, _ = printed(capsys, *run)
    assert "1 pair: 0 computed, 1 known, 0 failed" in text
    assert f"ambiguous: {made['ambiguous']}\n" in text
    kept = record(capsys, *run, "--sides", "kept")  # another map than that of either side
    assert kept["computed"] == 1
    assert record(capsys, "store", "verify", "store")["damaged"] == []


def test_what_fails_is_named_and_the_rest_goes_on(animals, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(two_parts(), "parts.off")
    write(creature(520), "cat.off")
    printed(capsys, "batch", "cat.off", "parts.off", "-o", "store", "-k", 40, *HERE)
    (tmp_path / "pairs.csv").write_text(
        "source,target\ncat.off,parts.off\ncat.off,cow.off\ncat.off,cat.off\n"
    )
    run = ("match-all", "store", "--pairs", "pairs.csv", *HERE)
    assert main([*map(str, run), "--json"]) == 2
    out, err = capsys.readouterr()
    told = json.loads(out)
    assert (told["pairs"], told["computed"], told["known"]) == (3, 1, 0)
    reasons = {one["name"]: one["reason"] for one in told["failed"]}
    assert [*reasons] == ["cat.off to parts.off", "cat.off to cow.off"]
    assert "be of one connected surface" in reasons["cat.off to parts.off"]
    for name, reason in reasons.items():
        assert f"failed: {name}: {reason}\n" in err
    assert err.endswith("error: 2 pairs of 3 failed, as told above; mend or leave them out;"
                        " what is done is kept\n")  # fmt: skip
    assert "be the name of a shape in the store" in refusal(capsys, *run, "--strict")
    parts = [record_of(capsys, *run, "--shard", f"{i}/2")["pairs"] for i in (1, 2)]
    assert sum(parts) == 3


def record_of(capsys, *arguments):
    """What a command tells, though some of it failed."""
    main([*map(str, arguments), "--json"])
    return json.loads(capsys.readouterr().out)


@pytest.mark.slow
def test_maps_of_a_collection_agree_and_strangers_are_named(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for seed in (1, 2, 3):
        write(permuted(bumpy(162), seed=seed)[0], f"{seed}.off")
    write(torus(n=200).geometry, "ring.off")
    write(two_parts(), "parts.off")
    printed(capsys, "batch", "*.off", "-o", "store", "-k", 30, *HERE)
    (tmp_path / "pairs.csv").write_text(
        "source,target\n1.off,2.off\n2.off,3.off\n3.off,1.off\n1.off,ring.off\nparts.off,1.off\n"
    )
    run = ("match-all", "store", "--pairs", "pairs.csv", "--together", "--csv", "maps.csv")
    told = record_of(capsys, *run)
    assert told["groups"] == [["1.off", "2.off", "3.off"], ["ring.off"]]
    assert (told["foreign"], told["computed"]) == (["ring.off"], 4)
    assert [one["name"] for one in told["failed"]] == ["parts.off to 1.off"]
    rows = [*csv.DictReader(Path("maps.csv").read_text().splitlines())]
    assert all(float(row["cycle_error"]) < 0.1 for row in rows[:3])
    maps = [load_match(SpectrumStore("store"), row["map"]).point_map for row in rows[:3]]
    around = maps[0][maps[1][maps[2]]]
    np.testing.assert_array_equal(around, np.arange(162))
    main([*map(str, run)])
    told = capsys.readouterr().out
    assert "5 pairs: 0 computed, 4 known, 1 failed" in told
    assert "groups: (1.off, 2.off, 3.off), (ring.off)\nforeign: ring.off\n" in told


def test_stores_and_options_that_are_wrong(animals, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert "is no store" in refusal(capsys, "match-all", "nowhere", "--pairs", "all", *HERE)
    assert not (tmp_path / "nowhere").exists()
    run = ("match-all", animals / "store", "--pairs")
    assert "there is no such file" in refusal(capsys, *run, "pairs.csv", *HERE)
    line = refusal(capsys, *run, "all", "-k", 50, *HERE)
    assert "`store` must hold spectra of 50 modes, got none" in line
    line = refusal(capsys, *run, "all", "--nthreads", 2, *HERE)
    assert "--nworkers 0, which is this process alone" in line
    line = refusal(capsys, *run, "all", "--together", "--shard", "1/2")
    assert "--shard has no effect with --together" in line
    line = refusal(capsys, *run, "all", "--together", "--sides", "reversed")
    assert "`--sides` must be either or kept with --together" in line
    write(creature(520), "cat.off")
    printed(capsys, "batch", "cat.off", "-o", "store", "-k", 12, *HERE)
    line = refusal(capsys, "match-all", "store", "--pairs", "all", *HERE)
    assert "hold spectra of at least 30 modes to match" in line
    printed(capsys, "batch", "cat.off", "-o", "store", "-k", 40, *HERE)
    line = refusal(capsys, "match-all", "store", "--pairs", "all", *HERE)
    assert line.endswith("; name it by -k\n")
    line = refusal(capsys, "match-all", "store", "--pairs", "all", "-k", 40, *HERE)
    assert "`store` must hold two shapes to match, got 1" in line
