"""Checkpoints and logs: whole files, parts that travel, rows that can be read back."""

import csv
import sys

import numpy as np
import pytest
import torch

from spectra_kit.errors import InvalidInputError, MissingDependencyError
from spectra_kit.training.checkpoint import Writer, read, read_parts, write_parts
from spectra_kit.training.log import Log

RANDOM = torch.Generator().manual_seed(0)
CONTENT = {
    "state": {"step": 3, "losses": [0.1, 0.2]},
    "network": {"a": torch.randn(40, 50, generator=RANDOM)},
    "average": {"a": torch.randn(40, 50, generator=RANDOM)},
    "optimizers": [
        {"state": {0: {"momentum_buffer": torch.ones(40, 50)}}, "param_groups": [{"lr": 0.1}]},
        {"state": {0: {"exp_avg": torch.full((30,), 1e-9), "step": torch.tensor(257.0)}}},
    ],
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


def test_parts_hold_averaged_weights_in_halves(tmp_path):
    paths = write_parts(tmp_path, CONTENT, limit=2000)
    assert len(paths) > 1
    assert max(path.stat().st_size for path in paths) <= 2000
    back = read_parts(tmp_path)
    assert back["state"] == CONTENT["state"]
    for name in ("network", "average"):
        assert torch.equal(back[name]["a"], CONTENT["average"]["a"].half().float())
    muon, adamw = back["optimizers"]
    assert muon == {"state": {}, "param_groups": [{"lr": 0.1}]}
    state = adamw["state"][0]
    torch.testing.assert_close(state["exp_avg"], torch.full((30,), 1e-9), rtol=0.01, atol=0)
    assert state["step"] == 257
    plain = {**CONTENT, "average": {}}
    assert len(write_parts(tmp_path, plain)) == 1  # and no part of the last remains
    assert torch.equal(read_parts(tmp_path)["network"]["a"], CONTENT["network"]["a"].half().float())


def test_missing_parts_are_told(tmp_path):
    with pytest.raises(InvalidInputError, match="all 1 parts of a checkpoint, found 0"):
        read_parts(tmp_path)
    write_parts(tmp_path, CONTENT, limit=2000)[-1].unlink()
    with pytest.raises(InvalidInputError, match=r"found \d in .*; copy the rest"):
        read_parts(tmp_path)


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


def test_damaged_parts_are_refused(tmp_path):
    first, second, *_ = write_parts(tmp_path, CONTENT, limit=2000)
    content = second.read_bytes()
    second.write_bytes(content[:-1] + b"?")
    with pytest.raises(InvalidInputError, match="copy all its parts there again"):
        read_parts(tmp_path)
    second.write_bytes(content)
    assert read_parts(tmp_path)["state"] == CONTENT["state"]
    first.write_bytes(b"")
    with pytest.raises(InvalidInputError, match="must end in the sha256"):
        read_parts(tmp_path)


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
    with pytest.raises(MissingDependencyError, match="need the package tensorboard; install it"):
        Log(tmp_path, [], tensorboard=True)
