"""The trials of runs over many shapes: they tell what happened, on a few shapes."""

import json
import shutil
from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
from conftest import creature, data_folder
from studies import run as command
from studies.batch import command as app
from studies.batch import shapes
from studies.batch.shapes import write_pool, write_sizes
from studies.batch.trials import TRIALS, Setting, equal

from spectra_kit.cli import main
from spectra_kit.datasets import Plan, SpectrumStore
from spectra_kit.geometry import read, write


@pytest.fixture
def setting(tmp_path):
    (tmp_path / "shapes").mkdir()
    paths = [tmp_path / "shapes" / f"{i}.ply" for i in range(4)]
    for i, path in enumerate(paths):
        write(creature(520, seed=i), path)
    return Setting(tmp_path / "work", paths, 1, "2GB")


class Here(Setting):
    """Runs are of this process: what they tell is the same, and sooner."""

    def run(self, store, *options):
        with redirect_stdout(StringIO()) as told:
            main(self.command(store, *options)[3:])
        return json.loads(told.getvalue()), 1.0


@pytest.mark.slow
def test_trials_tell_what_happened(setting):
    here = Here(setting.folder, setting.shapes, 0, setting.memory_limit)
    told = TRIALS["speed"](here)
    assert told["computed"] == [4, 4, 0]
    assert told["failed"] == [0, 0]
    assert told["same bytes"]
    told = TRIALS["damaged"](here)
    assert told["found"] == told["of these three"] == told["computed"] == 3
    assert told["as undisturbed"]
    told = TRIALS["memory"](here)
    assert told["computed"] == 4
    assert 0.05 < told["GB, largest process"] <= told["GB, all processes"] < 8


def test_broken_files_are_named_among_whole_ones(setting):
    told = TRIALS["broken"](replace(setting, workers=0, shapes=setting.shapes[:1]))
    assert (told["broken"], told["named"], told["others that failed"]) == (30, 30, 0)
    assert told["computed"] == 1


def test_stores_that_differ_are_told(tmp_path):
    stores = [SpectrumStore(tmp_path / name) for name in "ab"]
    for store in stores:
        store.spectrum(creature(520), Plan(k=5))
    assert equal(*(store.path for store in stores))
    path = next(stores[1].entries("spectra")).path
    path.write_bytes(path.read_bytes() + b" ")
    assert not equal(*(store.path for store in stores))
    path.unlink()
    assert not equal(*(store.path for store in stores))


@pytest.mark.data
@pytest.mark.skipif(data_folder() is None, reason="set SPECTRA_KIT_DATA to the real shapes")
def test_shapes_of_the_trials_are_real_and_of_all_sizes(tmp_path, monkeypatch):
    monkeypatch.setattr(shapes, "_SIZES", (1000, 9000))
    paths = write_pool(data_folder() / "train_pool", tmp_path / "pool", 3)
    assert [read(path).n >= 300 for path in paths] == [True] * 3
    for name in ("cow.npz", "spot.npz"):  # the smallest, at once made
        shutil.copy(data_folder() / "ood_public" / name, tmp_path)
    sizes = [read(path).n for path in write_sizes(tmp_path, tmp_path / "sizes", 3)]
    np.testing.assert_allclose(sizes, [1000, 3000, 9000], rtol=0.1)


def test_a_trial_is_not_made_twice(setting, tmp_path, monkeypatch):
    calls = []
    monkeypatch.setitem(TRIALS, "speed", lambda setting: calls.append(1) or {"computed": 4})
    monkeypatch.setattr(app, "write_pool", lambda *_: setting.shapes)
    monkeypatch.setenv("SPECTRA_KIT_DATA", str(tmp_path))
    for _ in range(2):
        assert command.main(["batch", str(tmp_path), "--trials", "speed", "--shapes", "4"]) == 0
    assert calls == [1]
    record = json.loads((tmp_path / "batch.json").read_text())
    assert record["trials"]["speed"]["computed"] == 4
    assert record["trials"]["speed"]["asked"]["shapes"] == 4
