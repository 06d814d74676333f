"""Training: it learns, resumes bit by bit, also when killed, and its parts do what they say."""

import csv
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from statistics import fmean, geometric_mean
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import train_neo
from conftest import ellipsoids, made_once, produced_here, refused

from spectra_kit.errors import ConvergenceError, InvalidInputError, MissingDependencyError
from spectra_kit.neo.model import NeoConfig, NeoNetwork
from spectra_kit.neo.pretrained import load_pretrained
from spectra_kit.neo.train import checkpoint
from spectra_kit.neo.train import corpus as corpus_module
from spectra_kit.neo.train import stream as streaming
from spectra_kit.neo.train.checkpoint import Log
from spectra_kit.neo.train.config import TrainConfig
from spectra_kit.neo.train.corpus import Corpus, generate, open_shards, write_shard
from spectra_kit.neo.train.evaluation import validate
from spectra_kit.neo.train.loader import posed, vary
from spectra_kit.neo.train.optim import (
    Muon,
    average_weights,
    make_optimizers,
    orthogonalise,
    warmup_stable_decay,
)
from spectra_kit.neo.train.ranks import Ranks
from spectra_kit.neo.train.samples import CorpusConfig, Samples
from spectra_kit.neo.train.stream import SampleStream
from spectra_kit.neo.train.train import _Run, _shortened, train

TINY = NeoConfig(width=36, depth=1, heads=2, head_width=18, latents=6, m=16, k=8)
CONFIG = TrainConfig(network=TINY, steps=10, batch=4, validation=4, every=5)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    root = tmp_path_factory.mktemp("corpus")
    for name, seed, n in (("train", 0, 24), ("validation", 1, 8)):
        write_shard(root / name, 0, Samples(*ellipsoids(n, seed), {"family": np.zeros(n)}))
    return root


@pytest.fixture(scope="module")
def corpora(folder):
    return open_shards(folder / "train"), open_shards(folder / "validation")


@pytest.fixture(scope="module")
def whole(corpora):
    """Return a run of ten steps."""
    return train(*corpora, CONFIG)


@pytest.fixture(autouse=True)
def made_here(monkeypatch):
    """Make the samples of corpora once, and those of streams in this process."""
    monkeypatch.setattr(corpus_module, "make_sample", made_once)
    monkeypatch.setattr(streaming, "produced", produced_here)


def same(one, other):
    return all(torch.equal(tensor, other[name]) for name, tensor in one.items())


def stopped(step, *given, **options):
    """Train until Ctrl-C comes within a step: after so many in all."""
    made = _Run.step

    def interrupted(run, *batch):
        loss = made(run, *batch)
        if run.state.step + 1 == step:
            signal.raise_signal(signal.SIGINT)
        return loss

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_Run, "step", interrupted)
        return train(*given, **options)


def rows_of(out):
    with (out / "log.csv").open() as file:
        return list(csv.DictReader(file))


# Optimisers


def test_muon_takes_the_steps_of_torch():
    def run(make):
        generator = torch.Generator().manual_seed(0)
        shapes = ((48, 64), (48, 64), (96, 40))
        parameters = [torch.nn.Parameter(torch.randn(s, generator=generator)) for s in shapes]
        start = [parameter.detach().clone() for parameter in parameters]
        optimizer = make(parameters)
        for _ in range(3):
            for parameter in parameters:
                parameter.grad = torch.randn(parameter.shape, generator=generator)
            optimizer.step()
        return [(p.detach() - s).flatten() for p, s in zip(parameters, start, strict=True)]

    ours = run(lambda parameters: Muon(parameters, 0.01))
    theirs = run(
        lambda parameters: torch.optim.Muon(
            parameters, lr=0.01, weight_decay=0.04, momentum=0.95, adjust_lr_fn="match_rms_adamw"
        )
    )
    for mine, other in zip(ours, theirs, strict=True):  # theirs rounds to bfloat16 inside
        assert torch.cosine_similarity(mine, other, dim=0) > 0.999
        assert mine.norm().item() == pytest.approx(other.norm().item(), rel=0.01)
    matrices = torch.randn(3, 60, 40, generator=torch.Generator().manual_seed(0))
    singular = torch.linalg.svdvals(orthogonalise(matrices))
    assert 0.5 < singular.min() < singular.max() < 1.3


def test_muon_calls_a_closure():
    parameter = torch.nn.Parameter(torch.ones(48, 64))

    def loss():
        found = parameter.square().sum()
        found.backward()
        return found

    assert Muon([parameter], 0.01).step(loss).item() == 48 * 64
    assert parameter.square().sum() < 48 * 64


def test_muon_gets_matrices_and_adamw_the_rest():
    network = NeoNetwork(NeoConfig.named("small"))
    muon, adamw = make_optimizers(network, lr=1e-3)
    chosen = [p for group in muon.param_groups for p in group["params"]]
    rest = [p for group in adamw.param_groups for p in group["params"]]
    assert len(chosen) + len(rest) == len(list(network.parameters()))
    assert all(p.ndim == 2 and min(p.shape) > 32 for p in chosen)
    queries = {id(block.down.queries) for block in network.blocks}
    assert queries <= {id(p) for p in rest}
    with pytest.raises(InvalidInputError, match="both sizes above 32"):
        make_optimizers(torch.nn.Linear(32, 64), lr=1e-3)


def test_averaged_weights_forget_the_start_and_then_decay():
    average, network = torch.nn.Linear(1, 1), torch.nn.Linear(1, 1)
    expected = average.weight.item()
    for step, (value, decay) in enumerate([(3.0, 0.1), (-1.0, 2 / 11), (4.0, 0.25), (1.0, 0.25)]):
        torch.nn.init.constant_(network.weight, value)
        average_weights(average, network, step, 0.25)
        expected = decay * expected + (1 - decay) * value
        assert average.weight.item() == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("seconds", [0.0, 100.0, 300.0, 1150.0])
def test_a_shortened_schedule_goes_on_where_the_rate_is(seconds):
    def rate(config, at):
        progress = at / (60 * config.minutes)
        return warmup_stable_decay(progress, warmup=config.warmup, decay=config.decay)

    old = replace(CONFIG, minutes=20, warmup=0.2, decay=0.3)
    for left in (10.0, 200.0, 2000.0):
        new = _shortened(old, seconds, left)
        assert 60 * new.minutes == pytest.approx(min(1200, seconds + left))
        assert rate(new, seconds) == pytest.approx(rate(old, seconds), abs=1e-9)
        assert rate(new, 60 * new.minutes) == 0


# The loop


@pytest.mark.parametrize(
    ("device", "options"),
    [
        ("cpu", {"precision": "float16"}),
        ("cuda", {"precision": "bfloat16", "compile": True}),
        ("cuda", {"precision": "float16"}),
        ("cuda", {"precision": "float32"}),
    ],
)
@pytest.mark.filterwarnings("ignore:`torch.jit.script_method` is deprecated")  # torch's own call
def test_training_learns(corpora, tmp_path, device, options):
    if device == "cuda" and not torch.cuda.is_available():
        pytest.skip("needs an NVIDIA GPU")
    network = replace(TINY, waves=4, bandwidth=3.0)
    config = replace(CONFIG, network=network, steps=30, batch=8, validation=8, every=30, **options)
    torch.manual_seed(config.seed)
    before = validate(NeoNetwork(network).to(device), corpora[1], config)["validation"]
    result = train(*corpora, config, device=device, out=tmp_path)
    assert set(checkpoint.read(tmp_path)["network"]) == set(result.network.state_dict())
    assert result.finished
    assert result.record["samples"] == 240
    assert result.record["span_error"] < 0.4 * before
    again = validate(result.network, corpora[1], config)["validation"]
    assert again == pytest.approx(result.record["span_error"], rel=1e-3)


def test_half_precision_follows_float32_and_shares_change_no_gradient(corpora, whole):
    expected = whole.record["span_error"]
    rounded = train(*corpora, replace(CONFIG, precision="bfloat16"))
    assert rounded.record["span_error"] == pytest.approx(expected, rel=0.1)
    config, losses = replace(CONFIG, steps=3, log=1, ema=0.0), {1: [], 3: []}

    def run(workers):
        told = lambda row: losses[workers].append(row["loss"])  # noqa: E731
        return train(*corpora, replace(config, workers=workers), report=told).network.state_dict()

    with ThreadPoolExecutor(1) as thread:  # where no signal can be waited for
        shared = thread.submit(run, 3).result()
    for name, tensor in run(1).items():
        torch.testing.assert_close(tensor, shared[name], atol=1e-4, rtol=1e-3)
    np.testing.assert_allclose(losses[1], losses[3], rtol=1e-4)


@pytest.fixture(scope="module")
def of_both_kinds(tmp_path_factory):
    """Clouds and meshes, padded, with their operators."""
    folder = tmp_path_factory.mktemp("both")
    generate(
        folder, 8, config=CorpusConfig(seed=1, n_points=128, k=8, shard_size=8, mesh_share=0.5)
    )
    return open_shards(folder)


def test_training_for_what_smoothing_leaves_learns_and_shares_change_nothing(of_both_kinds):
    corpus = of_both_kinds
    config = replace(CONFIG, steps=30, batch=8, validation=8, every=30, beta=0.9, smoothing=4)
    torch.manual_seed(config.seed)
    before = validate(NeoNetwork(TINY), corpus, config)
    after = train(corpus, corpus, config).record["history"][-1]
    assert after["smoothed"] < after["validation"] < before["validation"]
    assert after["smoothed"] < 0.5 * before["smoothed"]
    losses = []
    for workers in (1, 3):
        first = replace(config, workers=workers, steps=2, log=1)
        train(corpus, corpus, first, report=lambda row: losses.append(row["loss"]))
    np.testing.assert_allclose(losses[:2], losses[2:], rtol=1e-4)
    # The loss is the two span errors, weighed as asked for.
    for beta in (0.0, 1.0):
        only = replace(config, beta=beta, steps=1, log=1, alpha=0.0)
        train(corpus, corpus, only, report=lambda row: losses.append(row["loss"]))
    assert losses[-1] < 0.8 * losses[-2]
    assert losses[0] == pytest.approx(0.1 * losses[-2] + 0.9 * losses[-1], rel=1e-4)


@pytest.mark.parametrize("workers", [1, 2])
def test_relative_errors_of_easy_and_hard_samples_count_alike(of_both_kinds, workers):
    """The gradient is the mean of those of the samples, each divided by its error."""
    corpus, beta = of_both_kinds, 0.3
    config = replace(CONFIG, batch=2, alpha=0.0, beta=beta, smoothing=4, precision="float32")
    config = replace(config, relative=True, workers=workers)
    torch.manual_seed(0)
    network = NeoNetwork(TINY)

    def gradients(config, samples):
        run = _Run(config, torch.device("cpu"), Ranks.here(), network)
        losses, found = run.gradients(samples)
        shares = [torch.cat([part.flatten() for part in share]) for share in found]
        return float(sum(losses)), torch.stack(shares).sum(0)

    both = vary(posed(corpus.batch([0, 1]), config, 2), config, 0)
    parts = {}
    for share in (0.0, 1.0):
        plain = replace(config, batch=1, relative=False, beta=share, workers=1)
        parts[share] = [gradients(plain, half) for half in both.parts(2)]
    whole = both if workers == 2 else vary(posed(corpus.batch([0, 1]), config), config, 0)
    loss, together = gradients(config, whole)
    logs, truth = 0.0, torch.zeros_like(together)
    for share, weight in ((0.0, 1 - beta), (1.0, beta)):
        for error, gradient in parts[share]:
            logs += weight * np.log(error) / 2
            truth += weight * gradient / error / 2
    assert loss == pytest.approx(logs, rel=1e-3)
    torch.testing.assert_close(together, truth, rtol=1e-2, atol=1e-5)


def test_what_is_trained_for_is_what_is_told(of_both_kinds):
    corpus = of_both_kinds
    config = replace(CONFIG, batch=8, flips=0.0, jitter=0.0, alpha=0.0, log=1, precision="float32")
    config = replace(config, relative=True, steps=1, validation=8, beta=0.5, smoothing=4, ema=0.0)
    torch.manual_seed(0)
    network = NeoNetwork(TINY)
    told = validate(network, corpus, config)
    sums = {name: [0.0] for name in told}
    for n in range(1, 9):
        means = validate(network, corpus, replace(config, relative=False, validation=n))
        for name, mean in means.items():
            sums[name].append(n * mean)
    for name, total in sums.items():  # over samples one by one
        each = np.diff(total)
        assert told[name] == pytest.approx(geometric_mean(each), rel=1e-3)
        assert told[name] < 0.999 * fmean(each)
    rows = []
    train(corpus, corpus, replace(config, lr=1e-9), initial=network, report=rows.append)
    expected = np.sqrt(told["validation"] * told["smoothed"])  # of beta = 0.5
    assert rows[0]["loss"] == pytest.approx(expected, rel=1e-3)
    assert rows[0]["validation"] == pytest.approx(told["validation"], rel=1e-3)


def test_the_result_is_the_average_and_the_checkpoint_holds_both(corpora, tmp_path, whole):
    result = train(*corpora, CONFIG, out=tmp_path)
    content = checkpoint.read(tmp_path)
    ours = result.network.state_dict()
    assert same(content["average"], ours)
    assert not same(content["network"], ours)
    assert same(content["network"], train(*corpora, replace(CONFIG, ema=0.0)).network.state_dict())
    assert same(ours, whole.network.state_dict())
    still = train(*corpora, replace(CONFIG, lr=1e-9, ema=0.0), initial=result.network)
    assert still.record["span_error"] == pytest.approx(result.record["span_error"], rel=1e-4)


def test_a_stopped_run_resumes_bit_by_bit(corpora, tmp_path):
    config, rows = replace(CONFIG, workers=2, precision="float16", log=3), []
    result = train(*corpora, config, report=rows.append)
    assert not stopped(4, *corpora, config, out=tmp_path).finished
    resumed = train(*corpora, config, out=tmp_path, resume=True)
    assert resumed.finished
    assert same(result.network.state_dict(), resumed.network.state_dict())
    logged = rows_of(tmp_path)
    assert [int(row["step"]) for row in logged] == [3, 5, 6, 9, 10]
    assert float(logged[-1]["validation"]) == result.record["span_error"]
    assert [float(row["loss"]) for row in logged] == [row["loss"] for row in rows]


def test_each_validation_is_saved_and_no_step_waits_for_the_disk(corpora, tmp_path, monkeypatch):
    saved = []
    monkeypatch.setattr(
        checkpoint.Writer, "write", lambda self, content: saved.append(content["state"]["step"])
    )
    stopped(7, *corpora, replace(CONFIG, save=1e9), out=tmp_path)
    assert saved == [5, 7]  # the last as it stops
    monkeypatch.setattr(checkpoint.Writer, "busy", True)
    stopped(7, *corpora, replace(CONFIG, save=1e-9), out=tmp_path)
    assert saved == [5, 7, 7]


def test_ctrl_c_saves_and_ends(corpora, tmp_path):
    config = replace(CONFIG, steps=100_000, every=100_000)
    before = signal.getsignal(signal.SIGINT)  # ignored, where a shell runs this in the background

    def interrupt() -> None:
        while signal.getsignal(signal.SIGINT) is before:
            time.sleep(0.01)
        time.sleep(0.3)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt, daemon=True).start()
    result = train(*corpora, config, out=tmp_path)
    steps = result.record["steps"]
    assert not result.finished
    assert 0 < steps < 100_000
    again = stopped(steps + 1, *corpora, config, out=tmp_path, resume=True)
    assert again.record["steps"] == steps + 1
    assert signal.getsignal(signal.SIGINT) is before


def test_a_pause_keeps_the_schedule_and_a_last_phase_ends_it(corpora, tmp_path):
    config = replace(CONFIG, steps=100_000, minutes=30, warmup=1e-9, every=100_000, log=1)
    part = train(*corpora, config, out=tmp_path, pause_after=0.4)
    assert not part.finished
    assert 0 < part.record["minutes"] < 0.2
    result = train(*corpora, config, out=tmp_path, pause_after=1.5, last=True, resume=True)
    assert result.finished
    assert result.record["steps"] > part.record["steps"]
    assert result.record["minutes"] < 0.4
    rates = np.array([float(row["lr"]) for row in rows_of(tmp_path)])
    np.testing.assert_allclose(rates[1 : part.record["steps"]], config.lr)  # the first is zero
    assert np.all(np.diff(rates[1:]) <= 0)
    assert rates[-1] < 0.3 * config.lr


def test_minutes_end_a_run_with_the_whole_schedule(corpora):
    # The rate falls for most of the time: on a busy machine the last steps are far apart.
    result = train(*corpora, replace(CONFIG, steps=100_000, minutes=0.02, decay=0.9, every=10))
    assert result.finished
    assert 0.015 <= result.record["minutes"] < 0.5
    assert result.record["history"][-1]["lr"] < 0.5 * CONFIG.lr


def test_a_loss_that_is_not_finite_is_an_error(corpora, tmp_path):
    spoilt = NeoNetwork(TINY)
    torch.nn.init.constant_(spoilt.lift.weight, torch.nan)
    for precision in ("float32", "float16"):
        config = replace(CONFIG, steps=40, log=20, precision=precision, save=1e-6)
        with pytest.raises(ConvergenceError, match="the loss is not finite by step"):
            train(*corpora, config, initial=spoilt, out=tmp_path)
        # In float16 steps are skipped at first, and leave the weights as they are.
        assert (tmp_path / "checkpoint.pt").exists() == (precision == "float16")


@pytest.mark.parametrize(
    ("change", "options", "told"),
    [
        ({"flips": 2}, {}, "`flips` must "),
        ({"lr": 0.0}, {}, "`lr` must "),
        ({"minutes": -1.0}, {}, "`minutes` must "),
        # As many functions as points, which span everything.
        ({"network": replace(TINY, m=64)}, {}, "`corpus` must have samples of at least 65 points"),
        ({"beta": 0.5}, {}, "`corpus` must have operators to smooth with, for beta = 0.5, got one"),
        ({}, {"last": True, "pause_after": 1.0}, "`last` must come with `minutes` and"),
        ({}, {"resume": True}, "`out` must hold a checkpoint to resume, got none in "),
    ],
)
def test_what_does_not_fit_a_run_is_refused(corpora, tmp_path, change, options, told):
    with pytest.raises(InvalidInputError, match=told):
        train(*corpora, replace(CONFIG, **change), out=tmp_path, **options)


def test_a_run_is_not_overwritten_and_resumes_under_the_same_configuration_alone(corpora, tmp_path):
    stopped(1, *corpora, CONFIG, out=tmp_path)
    log = (tmp_path / "log.csv").read_bytes()
    with pytest.raises(InvalidInputError, match="`out` must hold no checkpoint of another run"):
        train(*corpora, CONFIG, out=tmp_path)
    assert checkpoint.read(tmp_path)["state"]["step"] == 1
    assert (tmp_path / "log.csv").read_bytes() == log
    with pytest.raises(InvalidInputError, match=r"other values of \['lr'\]"):
        train(*corpora, replace(CONFIG, lr=1e-4), out=tmp_path, resume=True)
    free = replace(CONFIG, batch=2, workers=2)
    assert stopped(2, *corpora, free, out=tmp_path, resume=True).record["samples"] == 6
    # One of before a field came was written with its default.
    content = checkpoint.read(tmp_path)
    del content["config"]["relative"], content["source"]
    checkpoint.write(tmp_path, content)
    with pytest.raises(InvalidInputError, match=r"other values of \['relative'\]"):
        train(*corpora, replace(free, relative=True), out=tmp_path, resume=True)
    assert stopped(3, *corpora, free, out=tmp_path, resume=True).record["steps"] == 3


def test_a_source_of_somebody_else_will_do(corpora, whole):
    corpus, validation = corpora
    names = "n_points", "k", "fewest", "has_operators", "capacity", "made", "identity", "draw"
    other = SimpleNamespace(**{name: getattr(corpus, name) for name in names})
    result = train(other, validation, CONFIG)
    assert same(result.network.state_dict(), whole.network.state_dict())


def test_samples_on_which_functions_span_everything_are_refused(tmp_path):
    made_of = CorpusConfig(seed=1, n_points=128, k=4, shard_size=4, mesh_share=1.0)
    generate(tmp_path, 4, config=made_of)
    meshes = open_shards(tmp_path)
    fewest = meshes.labels["n"].min()
    assert made_of.fewest <= meshes.fewest == fewest < 64
    plain = Corpus([replace(meshes.shards[0], labels={})])
    assert plain.fewest == fewest  # counted, where no label tells
    wide = replace(CONFIG, network=replace(TINY, k=4, m=int(fewest)))
    told = f"`corpus` must have samples of at least {fewest + 1} points and 4 modes, got {fewest}"
    with pytest.raises(InvalidInputError, match=told):
        train(meshes, meshes, wide)
    fits = replace(wide, network=replace(TINY, k=4), steps=1)
    train(meshes, meshes, fits)
    other = replace(TINY, k=4, m=8, backbone="pointnet++")  # which takes padding for points
    # Of a stream both follow from what its samples are made of.
    with SampleStream(made_of, workers=1, capacity=8) as stream:
        for source in (meshes, stream):
            told = "have as many points in each sample"
            refused("corpus", told, train, source, meshes, replace(fits, network=other))
        config = replace(wide, network=replace(wide.network, m=40))
        refused("corpus", "have samples of at least 41 points", train, stream, meshes, config)


def test_a_stream_is_resumed_as_it_was_or_not_at_all(tmp_path):
    made_of = CorpusConfig(seed=1, n_points=100, k=4, shard_size=4)
    generate(tmp_path / "validation", 4, config=replace(made_of, seed=2))
    validation = open_shards(tmp_path / "validation")
    config = replace(CONFIG, network=replace(TINY, k=4), batch=2, shown=2)

    def run(config, stop, made_of=made_of, capacity=12, **options):
        with SampleStream(made_of, workers=1, capacity=capacity, ahead=4) as stream:
            return stopped(stop, stream, validation, config, out=tmp_path / "run", **options)

    assert run(config, 2).record["corpus"]["samples"] >= 8  # of all so far
    for change in ({"capacity": 11}, {"made_of": replace(made_of, nonuniform=0.5)}):
        with pytest.raises(InvalidInputError, match=r"other values of \['stream'\]"):
            run(config, 3, resume=True, **change)
    with pytest.raises(InvalidInputError, match=r"other values of \['batch'\]"):
        run(replace(config, batch=3), 3, resume=True)
    assert run(config, 3, resume=True).record["steps"] == 3


def test_an_hour_changes_neither_log_nor_checkpoint_and_its_errors_lose_nothing(
    corpora, tmp_path, monkeypatch
):
    config = replace(CONFIG, steps=6, log=3, every=6, save=1e9)
    train(*corpora, config, out=tmp_path / "without")
    monkeypatch.setattr("spectra_kit.neo.train.train._HOUR", 1e-6)
    hours, shown = [], []

    def told(network, row):
        hours.append(row)
        shown.append({name: tensor.clone() for name, tensor in network.state_dict().items()})

    result = train(*corpora, config, out=tmp_path / "with", hourly=told)
    assert curve(tmp_path / "with") == curve(tmp_path / "without")
    assert [row["step"] for row in hours] == [1, 2, 3, 4, 5, 6]
    assert all(row["validation"] > 0 for row in hours)
    assert same(shown[-1], result.network.state_dict())  # the average
    assert not same(shown[-2], shown[-1])

    def fails(network, row):
        raise OSError("the disk is full")

    with pytest.raises(OSError, match="the disk is full"):
        train(*corpora, config, out=tmp_path / "fails", hourly=fails)
    assert checkpoint.read(tmp_path / "fails")["state"]["step"] == 1


# Processes that are killed, and several at once

SCRIPT = """
import sys, torch
from spectra_kit.neo.model import NeoConfig
from spectra_kit.neo.train.config import TrainConfig
from spectra_kit.neo.train.ranks import process_group
from spectra_kit.neo.train.corpus import open_shards
from spectra_kit.neo.train.train import train

torch.set_num_threads(1)
network = NeoConfig(width=36, depth=1, heads=2, head_width=18, latents=6, m=16, k=8)
folder, out = sys.argv[1:]
config = TrainConfig(network=network, steps=6, batch=5, validation=4, log=1)
corpus = open_shards(folder + "/train")
with process_group("cpu") as device:
    train(corpus, corpus, config, out=out, device=device)
"""
ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": "1"}


@pytest.fixture
def run_here(monkeypatch):
    """Return a function that runs SCRIPT as a call would, in this process."""
    threads = torch.get_num_threads()

    def run(call):
        monkeypatch.setattr(sys, "argv", call[2:])
        exec(compile(SCRIPT, "script", "exec"), {})

    yield run
    torch.set_num_threads(threads)


def curve(out):
    return [
        [row[k] for k in ("step", "samples", "lr", "loss", "validation", "smoothed")]
        for row in rows_of(out)
    ]


STREAM = """
import sys
from pathlib import Path
from spectra_kit.neo.model import NeoConfig

NeoConfig.named = lambda name: NeoConfig(
    width=36, depth=1, heads=2, head_width=18, latents=6, m=10, k=4
)
if __name__ == "__main__":
    import train_neo

    sys.exit(train_neo.main(sys.argv[1:]))
"""


def states(group):
    """Return the states of the processes of a group, such as T for a stopped one."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # it has ended
            state, _, its, *_ = path.read_text().rpartition(")")[2].split()
            found += [state] * (int(its) == group)
    return found


@pytest.mark.slow
def test_a_killed_run_on_a_stream_ends_as_one_in_a_single_go(tmp_path, monkeypatch):
    made_of = CorpusConfig(seed=1, n_points=100, k=4, shard_size=4, mesh_share=0.5)
    generate(tmp_path / "validation", 4, config=made_of)
    few = NeoConfig(width=36, depth=1, heads=2, head_width=18, latents=6, m=10, k=4)
    monkeypatch.setattr(NeoConfig, "named", lambda name: few)

    def arguments(name):
        values = {"validation": tmp_path / "validation", "out": tmp_path / name, "steps": 16}
        values |= {"stream": tmp_path / f"{name}_samples", "shown": 2, "capacity": 16, "batch": 2}
        values |= {"points": 100, "modes": 4, "shard-size": 4, "mesh-share": 0.5, "beta": 0.5}
        values |= {"every": 1000, "rows": 1, "save": 0.1}
        words = [str(word) for name, value in values.items() for word in (f"--{name}", value)]
        return ["--resume", *words]

    (tmp_path / "streamed.py").write_text(STREAM)
    apps = str(Path(train_neo.__file__).parent)
    environment = {**ENVIRONMENT, "PYTHONPATH": os.pathsep.join([apps, *sys.path])}
    call = [sys.executable, str(tmp_path / "streamed.py"), *arguments("killed")]
    niced = ["nice", "-n", "5", *call]
    with subprocess.Popen(niced, env=environment, start_new_session=True) as process:
        while process.poll() is None:
            there = checkpoint.read(tmp_path / "killed")
            if there is not None and there["state"]["step"] > 2:
                break
            time.sleep(0.05)
        group = int((tmp_path / "killed" / "group").read_text())
        autogroup = Path(f"/proc/{group}/autogroup")
        nice = str(min(os.nice(0) + 5, 19))  # of these tests, and five more
        assert not autogroup.exists() or autogroup.read_text().split()[-1] == nice
        os.killpg(group, signal.SIGSTOP)
        assert len(states(group)) > 1  # those that make samples, too
        while set(states(group)) - {"T", "Z"}:
            time.sleep(0.05)
        os.killpg(group, signal.SIGCONT)
        process.kill()
    ends = time.monotonic() + 60
    while set(states(group)) - {"Z"}:  # the others end with it
        assert time.monotonic() < ends
        time.sleep(0.05)
    assert 2 < checkpoint.read(tmp_path / "killed")["state"]["step"] < 16
    for folder in ("killed", "killed_samples"):
        shutil.copytree(tmp_path / folder, tmp_path / folder.replace("killed", "less"))
    for lost in sorted((tmp_path / "less_samples").glob("shard_*"))[:1]:  # samples, too
        shutil.rmtree(lost)
    for name in ("whole", "killed", "less"):
        assert train_neo.main(arguments(name)) == 0
    whole = checkpoint.read(tmp_path / "whole")
    for name in ("killed", "less"):
        found = checkpoint.read(tmp_path / name)
        assert found["state"]["step"] == whole["state"]["step"] == 16
        assert same(found["network"], whole["network"])
        assert same(found["average"], whole["average"])
        assert curve(tmp_path / name) == curve(tmp_path / "whole")
    kept = sorted((tmp_path / "killed_samples").glob("shard_*"))
    assert len(kept) < (16 + 4) / 4 + 3  # of 24 samples in all, the last ones


@pytest.mark.slow
def test_two_processes_end_with_the_weights_of_one(folder, tmp_path, run_here, monkeypatch):
    call = [sys.executable, "-c", SCRIPT, str(folder)]
    run_here([*call, str(tmp_path / "one")])
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = str(server.getsockname()[1])
    # As torchrun tells them; this process is the first.
    told = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port, "WORLD_SIZE": "2", "RANK": "0"}
    for name, value in (told | {"TORCHELASTIC_RUN_ID": "test"}).items():
        monkeypatch.setenv(name, value)
    call.append(str(tmp_path / "two"))
    with subprocess.Popen(call, env={**os.environ, "OMP_NUM_THREADS": "1", "RANK": "1"}) as other:
        run_here(call)
    assert other.returncode == 0
    one, two = (checkpoint.read(tmp_path / name) for name in ("one", "two"))
    for name, tensor in one["network"].items():
        torch.testing.assert_close(tensor, two["network"][name], atol=1e-3, rtol=1e-2)
    losses = [[float(row["loss"]) for row in rows_of(tmp_path / name)] for name in ("one", "two")]
    np.testing.assert_allclose(*losses, rtol=1e-3)


# Checkpoints and logs

CONTENT = {
    "state": {"step": 3, "losses": [0.1, 0.2]},
    "network": {"a": torch.randn(40, 50, generator=torch.Generator().manual_seed(0))},
}


def test_damaged_checkpoints_are_refused(tmp_path):
    """Each bit counts: PyTorch itself reads most flipped ones without a word."""
    assert checkpoint.read(tmp_path) is None
    checkpoint.write(tmp_path, CONTENT)
    path = tmp_path / "checkpoint.pt"
    assert list(tmp_path.iterdir()) == [path]
    whole = path.read_bytes()
    random = np.random.default_rng(0)
    for at in random.integers(len(whole), size=60):
        flipped = bytearray(whole)
        flipped[at] ^= 1 << random.integers(8)
        for damaged in (bytes(flipped), whole[:at], whole + whole[:at] + b"."):
            path.write_bytes(damaged)
            with pytest.raises(InvalidInputError, match=r"must end in the sha256 .* begin the run"):
                checkpoint.read(tmp_path)
    path.write_bytes(whole)
    assert checkpoint.read(tmp_path)["state"] == CONTENT["state"]
    with pytest.raises(InvalidInputError, match="does not exist"):
        checkpoint.write(tmp_path / "no", CONTENT)


def test_a_checkpoint_beside_the_loop_is_a_snapshot_and_its_errors_are_told(tmp_path, monkeypatch):
    weights, go, write = torch.zeros(1000), threading.Event(), checkpoint.write
    monkeypatch.setattr(checkpoint, "write", lambda *given: go.wait(60) and write(*given))
    with checkpoint.Writer(tmp_path) as writer:
        writer.write({"optimizers": [{"a": weights}]})
        weights += 1
        assert writer.busy
        go.set()
    assert not writer.busy
    assert checkpoint.read(tmp_path)["optimizers"][0]["a"].sum() == 0
    with (
        pytest.raises(InvalidInputError, match="does not exist"),
        checkpoint.Writer(tmp_path / "no") as writer,
    ):
        writer.write(CONTENT)
    with checkpoint.Writer(tmp_path / "no") as writer:
        writer.write(CONTENT)
        with pytest.raises(InvalidInputError, match="does not exist"):
            writer.write(CONTENT)
        monkeypatch.setattr(writer, "_last", None)


def row(step, **values):
    return {"step": step, "loss": 0.1 / step, **values}


def test_a_resumed_log_drops_what_came_after_the_checkpoint(tmp_path):
    with Log(tmp_path, []) as log:
        for step in (1, 2, 3):
            log.add(row(step))
    with Log(tmp_path, [row(1), row(2, validation=0.5)]) as log:
        log.add(row(4))
    rows = rows_of(tmp_path)
    assert [(r["step"], r["validation"]) for r in rows] == [("1", ""), ("2", "0.5"), ("4", "")]
    assert float(rows[2]["loss"]) == 0.1 / 4


@pytest.mark.filterwarnings("ignore")
def test_event_files_hold_the_rows(tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "torch.utils.tensorboard", None)
        with pytest.raises(MissingDependencyError, match="needs tensorboard; pip install"):
            Log(tmp_path, [], tensorboard=True)
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


# The command line


def test_command_line_end_to_end(tmp_path, capsys, monkeypatch):
    narrow = replace(NeoConfig.named("small"), width=40, depth=1, latents=8)
    monkeypatch.setattr(NeoConfig, "named", {"small": narrow}.get)
    rng = np.random.default_rng(0)
    for name in ("train", "validation"):
        points = rng.standard_normal((2, 300, 3))
        modes = rng.standard_normal((2, 300, 64))  # as many as the corpus has
        write_shard(tmp_path / name, 0, Samples(points, np.full((2, 300), 1 / 300), modes))
    out, folder = tmp_path / "run", str(tmp_path / "train")
    argv = [folder, folder, "--validation", str(tmp_path / "validation")]
    argv += ["--steps", "1", "--batch", "2"]
    assert train_neo.main(["nowhere", *argv[1:], "--out", str(out)]) == 2
    assert "error: `folder` must hold shards, got none in nowhere" in capsys.readouterr().err
    sized = ["--network", "m=200", "--network", "bandwidth=5.5"]
    assert train_neo.main([*argv, "--out", str(out), "--frame", "none", *sized]) == 0
    printed = capsys.readouterr().out
    weights = out / "weights.safetensors"
    loaded = load_pretrained(weights)
    assert (loaded.record["steps"], loaded.record["corpus"]["samples"]) == (1, 4)
    assert loaded.config == replace(narrow, k=64, frame="none", m=200, bandwidth=5.5)
    # No terminal: a line for each validation instead of a bar.
    assert re.search(r"^step 1, 0\.\d min: loss [\d.]+, span error [\d.]+$", printed, re.MULTILINE)
    assert loaded.sha256 in printed

    tuned = [*argv, "--out", str(tmp_path / "tuned"), "--weights", str(weights), "--lr", "1e-9"]
    assert train_neo.main(tuned) == 0
    before = float(re.search(r", before: ([\d.]+)$", capsys.readouterr().out, re.MULTILINE)[1])
    assert before == pytest.approx(loaded.record["span_error"], abs=2e-5)
    finetuned = load_pretrained(tmp_path / "tuned" / "weights.safetensors")
    assert finetuned.config == loaded.config
    assert finetuned.record["begun_with"]["sha256"] == loaded.sha256
    capsys.readouterr()
    assert train_neo.main([*tuned, *sized]) == 2
    assert "leave out --network" in capsys.readouterr().err
    for wrong in ("frame=none", "m=2.5"):
        with pytest.raises(SystemExit):
            train_neo.main([*argv, "--out", str(out), "--network", wrong])


@pytest.fixture
def streamed(tmp_path, monkeypatch):
    """Return a function that runs the app on a stream, of samples that are made in this process."""
    made_of = CorpusConfig(seed=7, n_points=128, k=4, shard_size=4)
    generate(tmp_path / "validation", 4, config=made_of)
    few = NeoConfig(width=36, depth=1, heads=2, head_width=18, latents=6, m=16, k=4)
    monkeypatch.setattr(NeoConfig, "named", {"small": few}.get)

    def run(out, **options):
        values = {"stream": out / "samples", "validation": tmp_path / "validation", "shown": 0}
        values |= {"points": 128, "modes": 4, "shard-size": 4, "capacity": 16, "batch": 2}
        values |= {"steps": 10**6, "every": 10**6, "rows": 1, "out": out, **options}
        return train_neo.main(
            [f"--{name}={value}" for name, value in values.items()] + ["--resume"]
        )

    return run


def test_a_run_in_pieces_goes_on_and_its_weights_must_be_better(streamed, tmp_path, capsys):
    first, second = tmp_path / "run", tmp_path / "elsewhere"
    pieces = {"minutes": 30, "pause": 0.01}
    assert streamed(first, **pieces) == 0
    assert "interrupted: continue with --resume" in capsys.readouterr().out
    steps = checkpoint.read(first)["state"]["step"]
    second.mkdir()  # what travels is the checkpoint
    shutil.copy(first / "checkpoint.pt", second)
    assert streamed(second, **pieces) == 0
    state = checkpoint.read(second)["state"]
    assert state["step"] > steps
    numbers = open_shards(second / "samples").labels["index"]
    assert numbers.min() >= steps * 2 // 4 * 4  # others than before
    capsys.readouterr()
    weights = second / "weights.safetensors"
    told = {"weights": weights, "beat": weights, "steps": 1}
    for lr, name in ((1e-9, "same"), (10.0, "worse")):
        assert streamed(tmp_path / name, lr=lr, **told) == 0
        assert "no weights written" in capsys.readouterr().out
        assert not (tmp_path / name / "weights.safetensors").exists()
    assert streamed(tmp_path / "better", **(told | {"steps": 24, "lr": 5e-3})) == 0
    record = load_pretrained(tmp_path / "better" / "weights.safetensors").record
    assert record["begun_with"]["record"]["samples"] == state["samples"]


def test_hours_of_the_run_are_told_by_what_users_get(tmp_path, monkeypatch):
    made_of = CorpusConfig(seed=1, n_points=128, k=4, shard_size=4, mesh_share=0.5)
    generate(tmp_path / "train", 4, config=made_of)
    other = replace(made_of, seed=7)
    generate(tmp_path / "validation", 4, config=other)
    generate(tmp_path / "full", 2, config=replace(other, n_points=256, shard_size=2))
    few = NeoConfig(width=36, depth=1, heads=2, head_width=18, latents=6, m=16, k=4)
    monkeypatch.setattr(NeoConfig, "named", {"small": few}.get)
    monkeypatch.setattr("spectra_kit.neo.train.train._HOUR", 1e-3)
    folders = [str(tmp_path / name) for name in ("train", "validation", "full", "run")]
    options = ("", "--validation", "--hourly", "--out")
    argv = [word for pair in zip(options, folders, strict=True) for word in pair if word]
    argv += ["--steps", "3", "--batch", "2", "--beta", "0.5", "--every", "100", "--resume"]
    assert train_neo.main(argv) == 0
    lines = (tmp_path / "run" / "hours.txt").read_text().splitlines()
    assert len(lines) == 3
    number = r"[\d.e+-]+"
    for line in lines:
        assert re.search(rf"h, \d samples: span error {number}, {number} after smoothing;", line)
        assert re.search(rf"meshes {number}, {number} and eigenvalues {number} after a step", line)
    assert int((tmp_path / "run" / "group").read_text()) == os.getpgrp()
    assert train_neo.main([*argv, "--steps", "4"]) == 0  # begins where it was, and ends later
    assert len((tmp_path / "run" / "hours.txt").read_text().splitlines()) == 4
    assert train_neo.main([*argv[1:], "--resume"]) == 2  # neither folders nor a stream


def test_options_of_the_app_that_do_not_fit_are_refused(tmp_path, capsys):
    made_of = CorpusConfig(seed=4, n_points=128, k=4, shard_size=4)
    for name, seed in (("OTHER", 4), ("TRAIN", 1), ("OLD", 2)):
        generate(tmp_path / name, 4, config=replace(made_of, seed=seed))
    for file in ("eigenvalues", "starts", "columns", "entries"):
        (tmp_path / "OLD" / "shard_0000" / f"{file}.npy").unlink()
    given = ["--validation", str(tmp_path / "OTHER"), "--out", str(tmp_path / "run")]
    given += ["--steps", "1", "--batch", "2"]
    sizes = [f"--network={size}" for size in ("m=16", "waves=0", "width=36", "depth=1")]
    for words, told in (
        ("--mesh-share 0.5 --makers 2", "--makers, --mesh_share is for samples that"),
        ("--weights small --config small", "--weights come with their sizes"),
        ("--stream S --shown -1", "`--shown` must be at least 0, got -1"),
        ("--stream S --seed 4", "samples to train and to validate on are the same"),
        ("OTHER", "samples to train and to validate on are the same: both of seed 4"),
        ("TRAIN --hourly OLD", "`--hourly` must have operators"),
    ):
        options = [str(tmp_path / word) if word.isupper() else word for word in words.split()]
        options += [] if "--weights" in options else sizes
        assert train_neo.main([*options, *given]) == 2
        assert told in capsys.readouterr().err
