"""Legs: better weights or none, phases on several machines, and a machine with next to nothing."""

import csv
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
import zipfile
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from spectra_kit.errors import InvalidInputError, MissingDependencyError
from spectra_kit.neo import NeoConfig, build_network
from spectra_kit.neo.pretrained import load_pretrained, save_weights
from spectra_kit.training import wheels
from spectra_kit.training.leg import main
from spectra_kit.training.phases import Leg, new_leg
from spectra_kit.training.wheels import download_wheels, fits, use_wheels

ROOT = Path(__file__).parents[2]
TINY = NeoConfig(width=36, depth=1, heads=2, head_width=18, latents=6, m=16, k=8)


def random_weights(path):
    torch.manual_seed(0)
    save_weights(path, build_network(TINY), {"samples": 100, "minutes": 2.0, "legs": [{"old": 1}]})
    return path


@pytest.fixture
def weights(tmp_path):
    return random_weights(tmp_path / "start.safetensors")


def arguments(tmp_path, weights, **options):
    values = {
        "minutes": 0.05,
        "weights": weights,
        "out": tmp_path / "out",
        "scratch": tmp_path / "scratch",
        "packed": tmp_path / "none",
        "batch": 4,
        "points": 48,
        "n-points": 128,
        "validation": 8,
        "workers": 1,
        "device": "cpu",
        "lr": 5e-3,
        **options,
    }
    return [f"--{name}={value}" for name, value in values.items()]


@pytest.fixture(scope="module")
def ended(tmp_path_factory):
    """The folder of a leg that ended with better weights, what it began with, what it printed."""
    folder = tmp_path_factory.mktemp("leg")
    weights, printed = random_weights(folder / "start.safetensors"), io.StringIO()
    with redirect_stdout(printed):
        assert main(arguments(folder, weights)) == 0
    return folder, weights, printed.getvalue()


@pytest.mark.slow
def test_better_weights_are_written_with_a_line_in_their_record(ended, capsys):
    folder, weights, printed = ended
    path = folder / "out" / "weights.safetensors"
    assert path.stat().st_size < 0.6 * weights.stat().st_size
    loaded = load_pretrained(path)
    assert loaded.config == TINY
    old, line = loaded.record["legs"]
    assert old == {"old": 1}
    assert line["from"] == load_pretrained(weights).sha256
    assert loaded.record["span_error"] == line["after"] < line["before"]
    assert loaded.record["span_error"] == loaded.record["history"][-1]["validation"]
    assert loaded.record["samples"] == 100 + line["samples"]
    assert loaded.record["minutes"] == pytest.approx(2.05, abs=0.03)
    assert f"{line['before']:.5f} -> {line['after']:.5f}" in printed
    assert loaded.sha256 in printed
    with (folder / "out" / "log.csv").open() as file:
        assert {"loss", "lr", "rate"} <= set(next(csv.DictReader(file)))
    assert Leg.read(folder / "out").finished
    assert main(arguments(folder, weights)) == 1
    assert "has ended; give another --out" in capsys.readouterr().err


def test_a_damaged_record_is_refused(tmp_path):
    for content in ("{", "[]", '{"config": {"network": {"planet": 1}}}'):
        (tmp_path / "leg.json").write_text(content)
        with pytest.raises(InvalidInputError, match=r"leg.json is not a whole record of a leg"):
            Leg.read(tmp_path)


@pytest.mark.slow
def test_worse_weights_are_not_written(ended, tmp_path, capsys):
    better = ended[0] / "out" / "weights.safetensors"
    assert main(arguments(tmp_path, better, lr=10.0, minutes=0.02)) == 0
    assert "not better, no weights written" in capsys.readouterr().out
    assert not (tmp_path / "out" / "weights.safetensors").exists()


@pytest.mark.slow
def test_phases_go_on_where_the_last_ended_on_another_machine(tmp_path, weights, capsys):
    first, second = tmp_path / "first", tmp_path / "second"
    options = {"minutes": 0.05, "phase-minutes": 0.01}
    assert main(arguments(tmp_path, weights, out=first, scratch=tmp_path / "a", **options)) == 0
    assert "paused" in capsys.readouterr().out
    assert {path.name for path in first.iterdir()} == {"leg.json", "log.csv", "checkpoint.01of01"}
    before = Leg.read(first)
    assert (before.phase, before.config.network) == (1, TINY)
    other = arguments(tmp_path, weights, out=second, scratch=tmp_path / "b", state=first, minutes=9)
    assert main(other) == 1
    assert "was begun with minutes = 0.05, got 9.0; leave" in capsys.readouterr().err
    later = {"out": second, "scratch": tmp_path / "b", "packed": tmp_path / "none"}
    later |= {"state": first, "workers": 1, "device": "cpu"}
    assert main([*(f"--{name}={value}" for name, value in later.items()), "--no-compile"]) == 0
    printed = capsys.readouterr().out
    assert "phase 2" in printed
    with (second / "log.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert int(rows[-1]["step"]) > before.step > 0
    assert float(rows[-1]["seconds"]) >= 3
    assert max(float(row["lr"]) for row in rows) <= 5e-3
    assert json.loads((second / "leg.json").read_text())["before"] == before.before


@pytest.mark.slow
def test_a_leg_goes_on_without_its_results_and_ends_when_told_to(tmp_path, weights, capsys):
    options = {"minutes": 30, "phase-minutes": 0.02}
    call = arguments(tmp_path, weights, **options)
    assert main(call) == 0
    first = Leg.read(tmp_path / "out")
    shutil.rmtree(tmp_path / "out")
    assert main([*call, "--last"]) == 0
    printed = capsys.readouterr().out
    assert f"going on with leg {first.name} of {tmp_path / 'scratch'}" in printed
    last = Leg.read(tmp_path / "out")
    assert last.finished
    assert last.phase == 2
    assert last.step > first.step
    with (tmp_path / "out" / "log.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert float(rows[-1]["seconds"]) < 60
    assert (tmp_path / "scratch" / first.name / "samples" / "corpus.json").is_file()


@pytest.mark.slow
def test_a_phase_that_is_told_to_end_leaves_its_results(tmp_path, weights):
    def end():
        while not any(len(p.read_text().split()) > 1 for p in tmp_path.glob("scratch/*/log.csv")):
            time.sleep(0.1)
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=end, daemon=True).start()
    assert main(arguments(tmp_path, weights, minutes=30)) == 0
    assert Leg.read(tmp_path / "out").step >= 20
    assert (tmp_path / "out" / "checkpoint.01of01").is_file()


def test_what_does_not_belong_to_a_leg_is_refused(tmp_path, weights, capsys):
    call = arguments(tmp_path, weights)
    assert main([*call, "--last"]) == 1
    assert "give --phase-minutes too" in capsys.readouterr().err
    assert main([*call, "--state", str(tmp_path / "nowhere")]) == 1
    assert "`state` must hold the leg.json of an earlier phase" in capsys.readouterr().err
    options = {"n_points": 128, "batch": 4, "minutes": 1.0, "points": 48}
    leg = new_leg(name="x", weights=str(weights), fresh=False, fast=False, **options)
    (tmp_path / "scratch").mkdir()
    replace(leg, validation="others").write(tmp_path / "scratch")
    assert main(call) == 1
    assert "`packed` must hold the pool that leg" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_leg_from_nothing_must_beat_the_shipped_weights():
    options = {"weights": None, "n_points": 2048, "batch": None, "minutes": 1.0}
    leg = new_leg(name="small", fresh=True, fast=False, **options)
    assert (leg.weights, leg.rival) == ("", "small")
    assert new_leg(name="paper-deep", fresh=True, fast=False, **options).rival == ""
    assert new_leg(name="small", fresh=False, fast=False, **options).rival == "small"


# Installs itself in every process: only what training may use, and what that needs, is there.
BARE = """
import importlib.metadata as metadata, re, sys
from importlib.machinery import PathFinder

allowed, queue = set(), ["torch", "numpy", "scipy", "numba", "cholespy", "qdldl"]
queue += ["threadpoolctl", "trimesh"]
while queue:
    name = re.split(r"[^\\w.-]", queue.pop())[0]
    name = re.sub(r"[-_.]+", "-", name).lower()
    if name in allowed:
        continue
    allowed.add(name)
    try:
        needs = metadata.requires(name) or []
    except metadata.PackageNotFoundError:
        continue
    queue += [need for need in needs if "extra ==" not in need]
tops = metadata.packages_distributions()
plain = lambda names: {re.sub(r"[-_.]+", "-", name).lower() for name in names}
banned = {top for top, names in tops.items() if not plain(names) & allowed} - {"spectra_kit"}
assert {"igl", "tqdm", "safetensors", "matplotlib", "pyvista", "potpourri3d"} <= banned

class Bare(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        there = name.partition(".")[0] not in banned
        return super().find_spec(name, path, target) if there else None

sys.meta_path[sys.meta_path.index(PathFinder)] = Bare
"""


@pytest.mark.slow
def test_training_imports_what_it_needs_alone(tmp_path, weights):
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "sitecustomize.py").write_text(BARE)
    environment = {
        **os.environ,
        "PYTHONPATH": f"{tmp_path / 'site'}:{ROOT}",
        "OMP_NUM_THREADS": "1",
    }
    probe = [sys.executable, "-c", "import igl"]
    banned = subprocess.run(probe, env=environment, capture_output=True, text=True, check=False)
    assert "No module named 'igl'" in banned.stderr
    call = [sys.executable, "-m", "spectra_kit.training.leg"]
    call += arguments(tmp_path, weights, minutes=0.02)
    done = subprocess.run(call, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert " -> " in done.stdout
    assert (tmp_path / "out" / "weights.safetensors").is_file()


def test_a_leg_needs_weights_or_a_fresh_start(tmp_path, capsys):
    missing = ["--config", "paper-deep", "--device", "cpu", "--out", str(tmp_path / "out")]
    assert main([*missing, "--wheels", str(tmp_path)]) == 1
    assert "no shipped weights of 'paper-deep'" in capsys.readouterr().err
    options = {"weights": None, "n_points": 2048, "batch": None, "minutes": 1.0}
    with pytest.raises(InvalidInputError, match="or begin anew with --fresh"):
        new_leg(name="paper-deep", fresh=False, fast=False, **options)
    leg = new_leg(name="paper-deep", fresh=True, fast=True, **options)
    assert leg.config.network == NeoConfig.named("paper-deep")
    assert (leg.config.batch, leg.config.precision, leg.config.compile) == (800, "bfloat16", True)
    leg.write(tmp_path)
    assert Leg.read(tmp_path) == leg


# Wheels


@pytest.mark.parametrize(
    ("wheel", "answer"),
    [
        ("a-1-cp312-cp312-manylinux_2_24_x86_64.manylinux_2_28_x86_64.whl", True),
        ("a-1-cp310-abi3-manylinux_2_27_x86_64.whl", True),
        ("a-1-py3-none-any.whl", True),
        ("a-1-py2.py3-none-any.whl", True),
        ("a-1-2-cp312-cp312-linux_x86_64.whl", True),
        ("a-1-cp313-abi3-manylinux_2_27_x86_64.whl", False),
        ("a-1-cp310-cp310-manylinux_2_24_x86_64.whl", False),
        ("a-1-cp312-cp312-manylinux_2_24_aarch64.whl", False),
        ("a-1-cp312-cp312-win_amd64.whl", False),
    ],
)
def test_wheels_fit_by_their_names(wheel, answer):
    assert fits(wheel, python=(3, 12), machine="x86_64") is answer


def test_wheels_are_used_where_a_package_is_missing(tmp_path, monkeypatch):
    assert use_wheels(tmp_path) == []  # all installed here
    monkeypatch.setattr(wheels, "NEEDED", ("math", "a_tiny_package"))
    monkeypatch.setattr(sys, "path", list(sys.path))
    with pytest.raises(
        MissingDependencyError, match=r"a_tiny_package, .* \(found \[\]\); run with"
    ):
        use_wheels(tmp_path)
    with zipfile.ZipFile(tmp_path / "a_tiny_package-1.0-py3-none-any.whl", "w") as archive:
        archive.writestr("a_tiny_package.py", "ANSWER = 42")
    assert use_wheels(tmp_path) == ["a_tiny_package"]
    import a_tiny_package

    assert a_tiny_package.ANSWER == 42
    assert Path(a_tiny_package.__file__).parent.parent == tmp_path


def test_a_failed_download_is_told(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path))
    with pytest.raises(MissingDependencyError, match=r"pip could not download numba, llvmlite, "):
        download_wheels(tmp_path)
    folders = ["--wheels", str(tmp_path), "--packed", str(tmp_path / "packed")]
    assert main(["--pack", *folders]) == 1
    assert "error: pip could not download" in capsys.readouterr().err
