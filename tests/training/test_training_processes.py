"""Training in processes that are killed, and in several at once."""

import csv
import os
import random
import subprocess
import sys
import time

import numpy as np
import pytest
import torch
from conftest import ellipsoids

from spectra_kit.neo import NeoConfig, build_network
from spectra_kit.training.checkpoint import read
from spectra_kit.training.config import TrainConfig
from spectra_kit.training.ranks import Ranks, process_group
from spectra_kit.training.shards import open_shards, write_shard
from spectra_kit.training.train import train, validate

# Run by `command` in a process of its own, and by `run_here`, which need not import torch again.
SCRIPT = """
import sys, time, torch
from spectra_kit.neo.model import NeoConfig
from spectra_kit.training.config import TrainConfig
from spectra_kit.training.ranks import process_group
from spectra_kit.training.shards import open_shards
from spectra_kit.training.train import train

torch.set_num_threads(1)
network = NeoConfig(width=36, depth=1, heads=2, head_width=18, latents=6, m=16, k=8)
folder, out, steps, resume, pause = sys.argv[1:]
config = TrainConfig(
    network=network, steps=int(steps), batch=5, points=48, validation=4, every=15, log=1, save=0.01
)
corpus = open_shards(folder)
with process_group("cpu") as device:
    options = {"out": out, "resume": resume == "resume", "device": device}
    train(corpus, corpus, config, report=lambda row: time.sleep(float(pause)), **options)
"""
ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": "1"}


@pytest.fixture
def run_here(monkeypatch):
    """Return a function that runs SCRIPT with the arguments of `command`, in this process."""
    threads = torch.get_num_threads()

    def run(call):
        monkeypatch.setattr(sys, "argv", call[2:])
        exec(compile(SCRIPT, "script", "exec"), {})

    yield run
    torch.set_num_threads(threads)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    rng = np.random.default_rng(0)
    path = tmp_path_factory.mktemp("corpus")
    points, modes = rng.standard_normal((12, 64, 3)), rng.standard_normal((12, 64, 8))
    write_shard(path, 0, points, np.full((12, 64), 1 / 64), modes, {})
    return path


def command(folder, out, *, steps=40, resume=False, pause=0.0):
    """Train for so many steps, with so many seconds between them."""
    rest = [str(folder), str(out), str(steps), "resume" if resume else "begin", str(pause)]
    return [sys.executable, "-c", SCRIPT, *rest]


def curve(out):
    with (out / "log.csv").open() as file:
        rows = list(csv.DictReader(file))
    return [{k: row[k] for k in ("step", "samples", "lr", "loss", "validation")} for row in rows]


@pytest.mark.slow
def test_a_killed_run_resumes_to_the_same_loss_curve(folder, tmp_path, run_here):
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    run_here(command(folder, whole))
    reached = 0
    for attempt in range(2):
        # Paused, so that no machine is done before it is killed: twice at most 0.2 s of 40 steps.
        call = command(folder, killed, resume=attempt > 0, pause=0.02)
        with subprocess.Popen(call, env=ENVIRONMENT) as process:
            while (
                process.poll() is None
                and (read(killed) or {"state": {"step": 0}})["state"]["step"] <= reached
            ):
                time.sleep(0.05)
            time.sleep(random.uniform(0, 0.15))
            process.kill()
        reached = read(killed)["state"]["step"]
        assert 0 < reached < 40
    run_here(command(folder, killed, resume=True))
    assert curve(killed) == curve(whole)
    one, other = read(killed), read(whole)
    for part in ("network", "average"):
        assert all(torch.equal(tensor, other[part][name]) for name, tensor in one[part].items())
    assert one["state"]["losses"] == other["state"]["losses"] == []


@pytest.mark.slow
def test_two_processes_end_with_the_weights_of_one(folder, tmp_path, run_here):
    run_here(command(folder, tmp_path / "one", steps=6))
    launcher = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    arguments = command(folder, tmp_path / "two", steps=6)[3:]
    subprocess.run(
        [sys.executable, *launcher, str(script), *arguments], check=True, env=ENVIRONMENT
    )
    one, two = read(tmp_path / "one"), read(tmp_path / "two")
    for name, tensor in one["network"].items():
        torch.testing.assert_close(tensor, two["network"][name], atol=1e-3, rtol=1e-2)
    losses = [[float(row["loss"]) for row in curve(tmp_path / name)] for name in ("one", "two")]
    np.testing.assert_allclose(*losses, rtol=1e-3)


def test_a_process_on_its_own_is_the_first_and_decides():
    ranks = Ranks.here()
    assert ranks.first
    assert ranks.agree(0.5, True) == (0.5, True)
    tensor = torch.ones(2)
    ranks.add_up([tensor])
    assert torch.equal(tensor, torch.ones(2))
    with process_group("cpu") as device:
        assert device == "cpu"


def learnt(tmp_path, device, **options):
    """Train on ellipsoids; return the span error of random weights and of the trained ones."""
    for index, name in enumerate(("train", "validation")):
        write_shard(tmp_path / name, 0, *ellipsoids(24, index), {})
    corpora = [open_shards(tmp_path / name) for name in ("train", "validation")]
    network = NeoConfig(
        width=36, depth=1, heads=2, head_width=18, latents=6, m=16, k=8, waves=4, bandwidth=3.0
    )
    config = TrainConfig(
        network=network, steps=50, batch=8, points=48, validation=8, every=50, **options
    )
    torch.manual_seed(config.seed)
    before = validate(build_network(network).to(device), corpora[1], config)
    result = train(*corpora, config, device=device, out=tmp_path / "run")
    assert set(read(tmp_path / "run")["network"]) == set(result.network.state_dict())
    return before, result.record["span_error"]


def test_waves_learn_on_a_cpu_within_the_bound_for_cuda(tmp_path):
    before, after = learnt(tmp_path, "cpu", precision="float16")
    assert after < 0.4 * before


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs an NVIDIA GPU")
@pytest.mark.parametrize(
    "options",
    [
        {"precision": "bfloat16", "compile": True},
        {"precision": "float16"},
        {"precision": "float32"},
    ],
)
def test_training_on_cuda_learns(tmp_path, options):
    before, after = learnt(tmp_path, "cuda", **options)
    assert after < 0.4 * before
