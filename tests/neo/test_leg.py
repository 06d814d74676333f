"""Legs: better weights or none, phases on several machines, and what a bare machine needs."""

import csv
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
import zipfile
from dataclasses import replace
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
import torch
from conftest import produced_here
from legs.leg import Leg, new_leg
from legs.packing import NEEDED, download_wheels, use_wheels
from legs.parts import read_parts, write_parts
from train_leg import main

from spectra_kit.errors import InvalidInputError, MissingDependencyError
from spectra_kit.neo import NeoConfig, build_network, load_pretrained, save_weights
from spectra_kit.neo.train import stream as streaming

ROOT = Path(__file__).parents[2]
TINY = NeoConfig(width=36, depth=1, heads=2, head_width=18, latents=6, m=16, k=8)
NEW = {"weights": None, "n_points": 1024, "batch": None, "minutes": 1.0}


@pytest.fixture(scope="module", autouse=True)
def made_here():
    """Make the samples in this process, which starts nothing."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(streaming, "produced", produced_here)
        yield


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("start") / "start.safetensors"
    save_weights(path, build_network(TINY), {"samples": 100, "minutes": 2.0, "legs": [{"past": 1}]})
    return path


def arguments(tmp_path, weights, **options):
    values = {"out": tmp_path / "out", "scratch": tmp_path / "scratch", "packed": tmp_path / "none"}
    values |= {"minutes": 0.02, "weights": weights, "batch": 4, "n-points": 64}
    values |= {"validation": 4, "workers": 1, "device": "cpu", "lr": 5e-3, "capacity": 8}
    return [f"--{name}={value}" for name, value in (values | options).items()]


def rows(folder):
    with (folder / "log.csv").open() as file:
        return list(csv.DictReader(file))


def test_better_weights_are_written_with_a_line_in_their_record_and_worse_ones_not(
    tmp_path, weights, capsys
):
    assert main(arguments(tmp_path, weights)) == 0
    printed = capsys.readouterr().out
    path = tmp_path / "out" / "weights.safetensors"
    assert path.stat().st_size < 0.6 * weights.stat().st_size
    loaded = load_pretrained(path)
    assert loaded.config == TINY
    past, line = loaded.record["legs"]
    assert past == {"past": 1}
    assert line["from"] == load_pretrained(weights).sha256
    assert loaded.record["span_error"] == line["after"] < line["before"]
    assert loaded.record["span_error"] == loaded.record["history"][-1]["validation"]
    assert loaded.record["samples"] == 100 + line["samples"]
    assert loaded.record["minutes"] == pytest.approx(2.02, abs=0.03)
    assert f"{line['before']:.5f} -> {line['after']:.5f}" in printed
    assert loaded.sha256 in printed
    assert {"loss", "lr", "rate"} <= set(rows(tmp_path / "out")[0])
    assert Leg.read(tmp_path / "out").finished
    assert main(arguments(tmp_path, weights)) == 1
    assert "has ended; give another --out" in capsys.readouterr().err

    assert main(arguments(tmp_path / "worse", path, lr=10.0, minutes=0.01)) == 0
    assert "not better, no weights written" in capsys.readouterr().out
    assert not (tmp_path / "worse" / "out" / "weights.safetensors").exists()


@pytest.mark.slow
def test_phases_go_on_elsewhere_when_told_to_end_and_without_results(tmp_path, weights, capsys):
    first, second = tmp_path / "out", tmp_path / "second"
    call = arguments(tmp_path, weights, minutes=30, **{"phase-minutes": 0.02})
    assert main(call) == 0
    assert "paused" in capsys.readouterr().out
    assert {path.name for path in first.iterdir()} == {"leg.json", "log.csv", "checkpoint.01of01"}
    paused = Leg.read(first)
    assert (paused.phase, paused.config.network) == (1, TINY)

    there = {"out": second, "scratch": tmp_path / "b", "packed": tmp_path / "none"}
    there |= {"from": first, "workers": 1, "device": "cpu", "capacity": 8}
    elsewhere = [*(f"--{name}={value}" for name, value in there.items()), "--no-compile"]
    assert main([*elsewhere, "--minutes=9"]) == 1
    assert "was begun with minutes = 30.0, got 9.0; leave" in capsys.readouterr().err

    def end():
        while not any(len(p.read_text().split()) > 4 for p in tmp_path.glob("b/*/log.csv")):
            time.sleep(0.05)
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=end, daemon=True).start()
    assert main(elsewhere) == 0
    assert "phase 2" in capsys.readouterr().out
    stopped = Leg.read(second)
    assert stopped.step > paused.step > 0
    assert stopped.before == paused.before
    assert (second / "checkpoint.01of01").is_file()

    shutil.rmtree(first)
    assert main([*call, "--last"]) == 0
    printed = capsys.readouterr().out
    assert f"going on with leg {paused.name} of {tmp_path / 'scratch'}" in printed
    last = Leg.read(first)
    assert last.finished
    assert (last.phase, last.step > paused.step) == (2, True)
    assert float(rows(first)[-1]["seconds"]) < 60
    assert max(float(row["lr"]) for row in rows(first)) <= 5e-3
    assert (tmp_path / "scratch" / paused.name / "samples" / "corpus.json").is_file()


def test_what_does_not_belong_to_a_leg_is_refused(tmp_path, weights, capsys):
    def refused(*options):
        assert main([*arguments(tmp_path, weights), *options]) == 1
        return capsys.readouterr().err

    assert "give --phase-minutes too" in refused("--last")
    assert "`--from` must hold the leg.json of an earlier" in refused(f"--from={tmp_path / 'no'}")
    options = {"n_points": 64, "batch": 4, "minutes": 1.0}
    leg = new_leg(name="x", weights=str(weights), fresh=False, fast=False, **options)
    replace(leg, validation="others").write(tmp_path / "scratch")
    assert "--packed must hold the pool that leg" in refused()
    assert not (tmp_path / "out").exists()
    assert main(["--config", "paper-deep", "--device", "cpu", "--out", str(tmp_path / "out")]) == 1
    assert "of 'paper-deep', only of ['small']; give --weights FILE" in capsys.readouterr().err


def test_a_leg_is_read_back_and_a_damaged_record_refused(tmp_path):
    leg = new_leg(name="paper-deep", fresh=True, fast=True, **NEW)
    assert leg.config.network == NeoConfig.named("paper-deep")
    assert (leg.config.batch, leg.config.precision, leg.config.compile) == (400, "bfloat16", True)
    assert leg.rival == ""
    leg.write(tmp_path)
    assert Leg.read(tmp_path) == leg
    for content in ("{", "[]", '{"config": {"network": {"planet": 1}}}'):
        (tmp_path / "leg.json").write_text(content)
        with pytest.raises(InvalidInputError, match=r"leg.json: not a whole record of a leg"):
            Leg.read(tmp_path)
    # One from nothing must beat the shipped weights, too.
    legs = [new_leg(name="small", fresh=fresh, fast=False, **NEW) for fresh in (True, False)]
    assert [(leg.weights, leg.rival) for leg in legs] == [("", "small"), ("small", "small")]


# Checkpoints that travel


@pytest.fixture
def content():
    random = torch.Generator().manual_seed(0)
    return {
        "state": {"step": 3, "losses": [0.1, 0.2]},
        "network": {"a": torch.randn(40, 50, generator=random)},
        "average": {"a": torch.randn(40, 50, generator=random)},
        "optimizers": [
            {"state": {0: {"momentum_buffer": torch.ones(40, 50)}}, "param_groups": [{"lr": 0.1}]},
            {"state": {0: {"exp_avg": torch.full((30,), 1e-9), "step": torch.tensor(257.0)}}},
        ],
    }


def test_parts_hold_the_averages_as_halves(tmp_path, content):
    write_parts(tmp_path, content, limit=2000)
    assert len(list(tmp_path.iterdir())) > 2
    assert all(path.stat().st_size <= 2000 for path in tmp_path.iterdir())
    back = read_parts(tmp_path)
    assert back["state"] == content["state"]
    for name in ("network", "average"):
        assert torch.equal(back[name]["a"], content["average"]["a"].half().float())
    muon, adamw = back["optimizers"]
    assert muon == {"state": {}, "param_groups": [{"lr": 0.1}]}
    averages = adamw["state"][0]
    torch.testing.assert_close(averages["exp_avg"], torch.full((30,), 1e-9), rtol=0.01, atol=0)
    assert averages["step"] == 257
    write_parts(tmp_path, {**content, "average": {}})
    assert [path.name for path in tmp_path.iterdir()] == ["checkpoint.01of01"]
    assert torch.equal(read_parts(tmp_path)["network"]["a"], content["network"]["a"].half().float())


def test_missing_and_damaged_parts_are_refused(tmp_path, content):
    with pytest.raises(InvalidInputError, match=r"all 1 parts .* found 0"):
        read_parts(tmp_path)
    write_parts(tmp_path, content, limit=2000)
    part = sorted(tmp_path.iterdir())[1]
    data = part.read_bytes()
    part.write_bytes(data[:-1] + b"?")
    with pytest.raises(InvalidInputError, match="copy all its parts there again"):
        read_parts(tmp_path)
    part.write_bytes(data)
    assert read_parts(tmp_path)["state"] == content["state"]
    part.unlink()
    with pytest.raises(InvalidInputError, match=r"found \d; copy the rest"):
        read_parts(tmp_path)


# A bare machine

IMPORTS = """
import builtins, sys

def noting(name, globals=None, *rest, plain=builtins.__import__, seen=set()):
    if globals and globals.get("__name__", "").partition(".")[0] in ("spectra_kit", "legs"):
        seen.add(name.partition(".")[0])
    return plain(name, globals, *rest)

builtins.__import__ = noting
sys.path.insert(0, "apps")
import legs.phase
from spectra_kit.neo.train.samples import CorpusConfig, make_sample
for i in range(3):
    make_sample(CorpusConfig(seed=3, n_points=100, k=4), i)
print(*noting.__kwdefaults__["seen"])
"""


def test_all_that_training_imports_is_packed():
    call = [sys.executable, "-c", IMPORTS]
    done = subprocess.run(call, capture_output=True, text=True, check=True, cwd=ROOT)
    homes = packages_distributions()
    imported = {home for name in done.stdout.split() for home in homes.get(name, [])}
    there = {"torch", "numpy", "scipy"}  # and what these bring
    assert imported - there - {"spectra_kit"} == set(NEEDED)


def test_wheels_for_this_python_are_unpacked_once(tmp_path, monkeypatch):
    installed = tmp_path / "site-packages"
    installed.mkdir()
    (installed / "a_tiny_package.py").write_text("ANSWER = 1")
    monkeypatch.setattr(sys, "path", [str(installed), *sys.path])
    use_wheels(tmp_path)  # nothing is packed
    for version, answer in (("{}.{}".format(*sys.version_info), 42), ("3.1", 7)):
        (tmp_path / version).mkdir()
        with zipfile.ZipFile(tmp_path / version / "a-1.0-py3-none-any.whl", "w") as archive:
            archive.writestr("a_tiny_package.py", f"ANSWER = {answer}")
    for _ in range(2):
        use_wheels(tmp_path)
    import a_tiny_package

    assert a_tiny_package.ANSWER == 42


def test_a_failed_download_and_a_missing_package_are_told(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path))
    with pytest.raises(MissingDependencyError, match=r"not download lazy-loader, "):
        download_wheels(tmp_path, "3.12")
    folders = ["--wheels", str(tmp_path), "--packed", str(tmp_path / "packed")]
    assert main(["--pack", *folders]) == 1
    assert "error: pip could not download" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "legs.leg", None)
    assert main(folders) == 1
    assert "run with --pack where there is a network" in capsys.readouterr().err
