"""Checkpoints and logs: whole files, and rows that can be read back."""

import csv
import sys

import numpy as np
import pytest
import torch

from spectra_kit.errors import InvalidInputError, MissingDependencyError
from spectra_kit.training.checkpoint import Writer, read
from spectra_kit.training.log import Log

CONTENT = {
    "state": {"step": 3, "losses": [0.1, 0.2]},
    "network": {"a": torch.randn(40, 50, generator=torch.Generator().manual_seed(0))},
}


def test_a_checkpoint_is_a_snapshot(tmp_path):
    weights = torch.zeros(1000)
    with Writer(tmp_path) as writer:
        assert read(tmp_path) is None
        writer.write({"network": {"a": weights}})
        weights += 1
    assert read(tmp_path)["network"]["a"].sum() == 0
    assert [path.name for path in tmp_path.iterdir()] == ["checkpoint.pt"]
    assert not writer.busy


def test_a_checkpoint_that_cannot_be_written_is_an_error(tmp_path):
    with (
        pytest.raises(InvalidInputError, match="does not exist"),
        Writer(tmp_path / "no") as writer,
    ):
        writer.write(CONTENT)


def test_damaged_checkpoints_are_refused(tmp_path):
    """Each bit counts: PyTorch itself reads most flipped ones without a word."""
    with Writer(tmp_path) as writer:
        writer.write(CONTENT)
    path = tmp_path / "checkpoint.pt"
    whole = path.read_bytes()
    random = np.random.default_rng(0)
    for at in random.integers(len(whole), size=100):
        flipped = bytearray(whole)
        flipped[at] ^= 1 << random.integers(8)
        for damaged in (bytes(flipped), whole[:at], whole + whole[:at] + b"."):
            path.write_bytes(damaged)
            with pytest.raises(InvalidInputError, match=r"must end in the sha256 .* begin the run"):
                read(tmp_path)
    path.write_bytes(whole)
    assert read(tmp_path)["state"] == CONTENT["state"]


def row(step, **values):
    return {"step": step, "loss": 0.1 / step, **values}


def test_a_resumed_log_drops_what_came_after_the_checkpoint(tmp_path):
    with Log(tmp_path, []) as log:
        for step in (1, 2, 3):
            log.add(row(step))
    with Log(tmp_path, [row(1), row(2, validation=0.5)]) as log:
        log.add(row(4))
    with (tmp_path / "log.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(r["step"], r["validation"]) for r in rows] == [("1", ""), ("2", "0.5"), ("4", "")]
    assert float(rows[2]["loss"]) == 0.1 / 4


@pytest.mark.filterwarnings("ignore")
def test_event_files_hold_the_rows(tmp_path):
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    with Log(tmp_path, [], tensorboard=True) as log:
        log.add(row(1))
        log.add(row(20, validation=0.25, lr=1e-3))
    events = EventAccumulator(str(tmp_path / "events"))
    events.Reload()
    assert set(events.Tags()["scalars"]) == {"loss", "validation", "lr"}
    assert [event.step for event in events.Scalars("loss")] == [1, 20]
    assert events.Scalars("validation")[0].value == 0.25


def test_event_files_need_tensorboard(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    with pytest.raises(MissingDependencyError, match="needs tensorboard; pip install"):
        Log(tmp_path, [], tensorboard=True)
