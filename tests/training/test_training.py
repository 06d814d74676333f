"""Training: it learns, resumes bit by bit, and its parts do what they are named after."""

import csv
import os
import re
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
import torch
import train_neo
from conftest import ellipsoids

from spectra_kit.errors import ConvergenceError, InvalidInputError
from spectra_kit.neo.model import NeoConfig, NeoNetwork
from spectra_kit.neo.pretrained import load_pretrained
from spectra_kit.training.config import TrainConfig
from spectra_kit.training.optim import (
    Muon,
    average_weights,
    make_optimizers,
    orthogonalise,
    warmup_stable_decay,
)
from spectra_kit.training.shards import open_shards, write_shard
from spectra_kit.training.train import _shortened, train, validate

TINY = NeoConfig(width=36, depth=1, heads=2, head_width=18, latents=6, m=16, k=8)
CONFIG = TrainConfig(network=TINY, steps=10, batch=4, points=48, validation=4, every=5)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    root = tmp_path_factory.mktemp("corpus")
    for name, seed, n in (("train", 0, 24), ("validation", 1, 8)):
        for index in range(2):
            sample = ellipsoids(n // 2, (seed, index))
            write_shard(root / name, index, *sample, {"family": np.full(n // 2, index)})
    return root / "train", root / "validation"


@pytest.fixture(scope="module")
def corpora(folders):
    return open_shards(folders[0]), open_shards(folders[1])


# Optimisers


def test_muon_takes_the_steps_of_torch():
    def gradients(parameters, seed):
        generator = torch.Generator().manual_seed(seed)
        for parameter in parameters:
            parameter.grad = torch.randn(parameter.shape, generator=generator)

    def run(make):
        torch.manual_seed(0)
        parameters = [torch.nn.Parameter(torch.randn(s)) for s in ((48, 64), (48, 64), (96, 40))]
        start = [parameter.detach().clone() for parameter in parameters]
        optimizer = make(parameters)
        for seed in range(3):
            gradients(parameters, seed)
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


def test_newton_schulz_brings_singular_values_near_one():
    matrices = torch.randn(3, 60, 40, generator=torch.Generator().manual_seed(0))
    singular = torch.linalg.svdvals(orthogonalise(matrices))
    assert 0.5 < singular.min() < singular.max() < 1.3


def test_a_network_too_narrow_for_muon_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="both sizes above 32"):
        make_optimizers(torch.nn.Linear(32, 64), lr=1e-3)


def test_muon_gets_matrices_and_adamw_the_rest():
    network = NeoNetwork(NeoConfig.named("small"))
    muon, adamw = make_optimizers(network, lr=1e-3)
    chosen = [p for group in muon.param_groups for p in group["params"]]
    rest = [p for group in adamw.param_groups for p in group["params"]]
    assert len(chosen) + len(rest) == len(list(network.parameters()))
    assert all(p.ndim == 2 and min(p.shape) > 32 for p in chosen)
    queries = {id(block.down.queries) for block in network.blocks}
    assert queries <= {id(p) for p in rest}


def test_averaged_weights_forget_the_start_and_then_decay():
    average, network = torch.nn.Linear(1, 1), torch.nn.Linear(1, 1)
    values = [3.0, -1.0, 4.0, 1.0]
    expected = average.weight.item()
    for step, value in enumerate(values):
        torch.nn.init.constant_(network.weight, value)
        average_weights(average, network, step, 0.25)
        decay = min(0.25, (1 + step) / (10 + step))
        expected = decay * expected + (1 - decay) * value
    assert average.weight.item() == pytest.approx(expected, rel=1e-6)


def test_schedule_rises_stays_and_falls():
    rates = [warmup_stable_decay(p) for p in np.linspace(0, 1, 1001)]
    assert rates[0] == 0
    np.testing.assert_allclose(rates[100:801], 1.0, rtol=1e-12)
    assert np.all(np.diff(rates[:100]) > 0)
    np.testing.assert_allclose(np.diff(rates[800:]), -1 / 200, atol=1e-12)
    assert warmup_stable_decay(1.5) == 0


# The loop


def test_training_learns(corpora):
    config = replace(CONFIG, steps=60, batch=8, validation=8, every=30)
    result = train(*corpora, config)
    first = validate(train(*corpora, config, stop_after=1).network, corpora[1], config)
    assert result.finished
    assert result.record["span_error"] < 0.4 * first
    assert result.record["samples"] == 480
    assert len(result.record["history"]) == 2


def test_the_result_is_the_average_and_the_checkpoint_holds_both(corpora, tmp_path):
    result = train(*corpora, CONFIG, out=tmp_path / "mean")
    content = torch.load(tmp_path / "mean" / "checkpoint.pt", weights_only=True)
    weights = result.network.state_dict()
    assert all(torch.equal(weights[name], t) for name, t in content["average"].items())
    assert not torch.equal(weights["lift.weight"], content["network"]["lift.weight"])
    assert validate(result.network, corpora[1], CONFIG) == result.record["span_error"]
    plain = train(*corpora, replace(CONFIG, ema=0.0)).network.state_dict()
    assert all(torch.equal(plain[name], t) for name, t in content["network"].items())


def test_training_goes_on_from_given_weights(corpora):
    first = train(*corpora, CONFIG)
    still = replace(CONFIG, lr=1e-9, ema=0.0)
    after = train(*corpora, still, initial=first.network)
    assert after.record["span_error"] == pytest.approx(first.record["span_error"], rel=1e-4)


@pytest.mark.parametrize(("workers", "precision"), [(1, "float32"), (2, "float32"), (1, "float16")])
def test_a_stopped_run_resumes_bit_by_bit(corpora, tmp_path, workers, precision):
    config = replace(CONFIG, workers=workers, precision=precision, log=3)
    whole = train(*corpora, config)
    part = train(*corpora, config, out=tmp_path, stop_after=4)
    assert not part.finished
    resumed = train(*corpora, config, out=tmp_path, resume=True)
    assert resumed.finished
    for name, tensor in whole.network.state_dict().items():
        assert torch.equal(tensor, resumed.network.state_dict()[name]), name
    with (tmp_path / "log.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["step"]) for row in rows] == [3, 5, 6, 9, 10]
    assert float(rows[-1]["validation"]) == whole.record["span_error"]
    losses = []
    train(*corpora, config, report=lambda row: losses.append(row["loss"]))
    assert [float(row["loss"]) for row in rows] == losses


def test_workers_share_a_batch_without_changing_the_gradient(corpora):
    one = train(*corpora, CONFIG, stop_after=1).network.state_dict()
    with ThreadPoolExecutor(1) as thread:  # where no signal can be waited for
        run = thread.submit(train, *corpora, replace(CONFIG, workers=2), stop_after=1)
        two = run.result().network.state_dict()
    for name, tensor in one.items():
        torch.testing.assert_close(tensor, two[name], atol=1e-4, rtol=1e-3)


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
    assert not result.finished
    assert 0 < result.record["steps"] < 100_000
    again = train(
        *corpora, config, out=tmp_path, resume=True, stop_after=result.record["steps"] + 1
    )
    assert again.record["steps"] == result.record["steps"] + 1
    assert signal.getsignal(signal.SIGINT) is before


def test_a_pause_keeps_the_schedule_and_a_last_phase_ends_it(corpora, tmp_path):
    config = replace(CONFIG, steps=100_000, minutes=30, warmup=1e-9, every=100_000, log=1)
    part = train(*corpora, config, out=tmp_path, pause_after=0.4)
    assert not part.finished
    assert 0 < part.record["minutes"] < 0.2
    again = train(*corpora, config, out=tmp_path, pause_after=0.4, resume=True)
    assert again.record["steps"] > part.record["steps"]
    called = []
    options = {"out": tmp_path, "pause_after": 1.5, "resume": True}
    result = train(*corpora, config, last=True, wait=lambda: called.append(1), **options)
    assert called == [1]
    assert result.finished
    assert result.record["steps"] > again.record["steps"]
    assert result.record["minutes"] < 0.4
    with (tmp_path / "log.csv").open() as file:
        rates = np.array([float(row["lr"]) for row in csv.DictReader(file)])
    np.testing.assert_allclose(rates[1 : again.record["steps"]], config.lr)  # the first is zero
    assert np.all(np.diff(rates[1:]) <= 0)
    assert rates[-1] < 0.3 * config.lr


@pytest.mark.parametrize("seconds", [0.0, 100.0, 300.0, 1150.0])
@pytest.mark.parametrize("left", [10.0, 200.0, 2000.0])
def test_a_shortened_schedule_goes_on_where_the_rate_is(seconds, left):
    def rate(config, at):
        progress = at / (60 * config.minutes)
        return warmup_stable_decay(progress, warmup=config.warmup, decay=config.decay)

    old = replace(CONFIG, minutes=20, warmup=0.2, decay=0.3)
    new = _shortened(old, seconds, left)
    assert 60 * new.minutes == pytest.approx(min(1200, seconds + left))
    assert rate(new, seconds) == pytest.approx(rate(old, seconds), abs=1e-9)
    assert rate(new, 60 * new.minutes) == 0


def test_a_loss_that_is_not_finite_is_an_error(corpora, tmp_path):
    spoilt = NeoNetwork(TINY)
    torch.nn.init.constant_(spoilt.lift.weight, torch.nan)
    for precision in ("float32", "float16"):
        config = replace(CONFIG, steps=40, log=20, precision=precision)
        with pytest.raises(ConvergenceError, match="the loss is not finite by step"):
            train(*corpora, config, initial=spoilt, out=tmp_path)
        # In float16 steps are skipped at first, and leave the weights as they are.
        assert (tmp_path / "checkpoint.pt").exists() == (precision == "float16")


def test_minutes_end_a_run_with_the_whole_schedule(corpora, tmp_path):
    config = replace(CONFIG, steps=100_000, minutes=0.05, every=10)
    result = train(*corpora, config, out=tmp_path)
    assert result.finished
    assert 0.05 <= result.record["minutes"] < 0.5
    assert result.record["history"][-1]["lr"] < 0.5 * config.lr


@pytest.mark.parametrize("precision", ["bfloat16", "float16"])
def test_half_precision_follows_float32(corpora, precision):
    config = replace(CONFIG, precision=precision)
    expected = train(*corpora, CONFIG).record["span_error"]
    assert train(*corpora, config).record["span_error"] == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize(
    ("change", "argument"),
    [
        ({"steps": 0}, "steps"),
        ({"flips": 2}, "flips"),
        ({"points": 16}, "points"),  # as many as functions, which span everything
        ({"precision": "int8"}, "precision"),
        ({"lr": 0.0}, "lr"),
        ({"minutes": -1.0}, "minutes"),
    ],
)
def test_bad_configurations_are_refused(change, argument):
    with pytest.raises(InvalidInputError, match=f"`{argument}` must "):
        replace(CONFIG, **change)


def test_what_does_not_fit_a_run_is_refused(corpora, tmp_path):
    def refused(config=CONFIG, **options):
        with pytest.raises(InvalidInputError) as caught:
            train(*corpora, config, **options)
        return caught.value

    assert refused(replace(CONFIG, points=100)).argument == "corpus"
    assert refused(out=tmp_path, resume=True).got == f"none in {tmp_path}"
    assert refused(last=True, pause_after=1.0).argument == "last"
    train(*corpora, CONFIG, out=tmp_path, stop_after=1)
    other = refused(replace(CONFIG, lr=1e-4), out=tmp_path, resume=True)
    assert "other values of ['lr']" in str(other)


# The command line


def test_command_line_end_to_end(tmp_path, capsys):
    rng = np.random.default_rng(0)
    for name in ("train", "validation"):
        points = rng.standard_normal((2, 300, 3))
        modes = rng.standard_normal((2, 300, 64))  # as many as the corpus has
        write_shard(tmp_path / name, 0, points, np.full((2, 300), 1 / 300), modes, {})
    out, folder = tmp_path / "run", str(tmp_path / "train")
    argv = [folder, folder, "--validation", str(tmp_path / "validation")]
    argv += ["--steps", "1", "--batch", "2", "--points", "270"]
    assert train_neo.main(["nowhere", *argv[1:], "--out", str(out)]) == 1
    assert "error: `folder` must hold shards, got none in nowhere" in capsys.readouterr().err
    assert train_neo.main([*argv, "--out", str(out), "--frame", "none"]) == 0
    printed = capsys.readouterr().out
    weights = out / "weights.safetensors"
    loaded = load_pretrained(weights)
    assert (loaded.record["steps"], loaded.record["corpus"]["samples"]) == (1, 4)
    assert (loaded.config.k, loaded.config.frame) == (64, "none")
    # No terminal: a line for each validation instead of a bar.
    assert re.search(r"^step 1, 0\.\d min: loss [\d.]+, span error [\d.]+$", printed, re.MULTILINE)
    assert loaded.sha256 in printed

    tuned = [*argv, "--out", str(tmp_path / "tuned"), "--weights", str(weights), "--lr", "1e-9"]
    assert train_neo.main(tuned) == 0
    before = float(re.search(r", before: ([\d.]+)$", capsys.readouterr().out, re.MULTILINE)[1])
    assert before == pytest.approx(loaded.record["span_error"], abs=2e-5)
    assert load_pretrained(tmp_path / "tuned" / "weights.safetensors").config == loaded.config
