"""The training loop: batches that follow from (seed, step), checkpoints that resume exactly."""

from __future__ import annotations

import csv
import os
import signal
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from spectra_kit._files import atomic_path
from spectra_kit.errors import InvalidInputError
from spectra_kit.neo.loss import ortho_loss, span_loss
from spectra_kit.neo.model import NeoNetwork
from spectra_kit.training.batches import training_batch, validation_batch
from spectra_kit.training.config import TrainConfig
from spectra_kit.training.optim import make_optimizers, warmup_stable_decay
from spectra_kit.training.shards import Corpus

# What may change on resuming.
_FREE = {"minutes", "decay", "batch", "points", "every", "validation", "workers"}
_DTYPES = {"float32": None, "bfloat16": torch.bfloat16, "float16": torch.float16}


@dataclass
class TrainState:
    """What a checkpoint holds beside weights and optimiser states; it grows with every step."""

    step: int = 0
    samples: int = 0
    seconds: float = 0.0
    history: list[dict[str, float]] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class TrainResult:
    """A trained network and how it came about.

    Parameters
    ----------
    network : NeoNetwork
        In evaluation mode.
    record : dict
        Plain JSON values: configuration, steps, samples, minutes, validation curve.
    finished : bool
        False where Ctrl-C ended the run before its schedule; the checkpoint continues it.
    """

    network: NeoNetwork
    record: dict[str, Any]
    finished: bool


def train(
    corpus: Corpus,
    validation: Corpus,
    config: TrainConfig,
    *,
    out: str | os.PathLike[str] | None = None,
    resume: bool = False,
    device: str = "cpu",
    stop_after: int | None = None,
) -> TrainResult:
    """Train a network on a corpus.

    The batch of a step follows from (seed, step) alone, so a run that is stopped and resumed from
    its checkpoint gives the same weights as one in a single go, bit by bit on a CPU.

    Parameters
    ----------
    corpus, validation : Corpus
        What to learn from, and other samples to measure the span error on.
    config : TrainConfig
        The run.
    out : path, optional
        Folder for ``checkpoint.pt`` and ``log.csv``; nothing is written without it.
    resume : bool, default False
        Continue from the checkpoint in `out`. The corpus may have grown since, and ``minutes``,
        ``decay``, ``batch``, ``points``, ``every``, ``validation`` and ``workers`` may differ:
        cheap steps of few points first, precise ones later.
    device : str, default "cpu"
        Where to compute.
    stop_after : int, optional
        Stop, with a checkpoint, once this many steps are done in all, as if by Ctrl-C.

    Returns
    -------
    TrainResult

    Raises
    ------
    InvalidInputError
        If the corpus does not fit the configuration, or there is no checkpoint of this
        configuration to resume.
    """
    _check_corpora(corpus, validation, config)
    torch.manual_seed(config.seed)
    network = NeoNetwork(config.network).to(device)
    pool = ThreadPoolExecutor(config.workers)
    optimizers = make_optimizers(
        network, lr=config.lr, weight_decay=config.weight_decay, apply=pool.map
    )
    scaler = torch.amp.GradScaler(device, enabled=config.precision == "float16")
    state = TrainState()
    folder = None if out is None else Path(out)
    if resume:
        state = _load(folder, config, network, optimizers)
    elif folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    start = time.perf_counter() - state.seconds
    limit = config.steps if stop_after is None else min(stop_after, config.steps)
    losses: list[float] = []
    with (
        pool,
        _until_interrupt() as interrupted,
        tqdm(total=config.steps, initial=state.step, unit="step", disable=None) as bar,
    ):
        while state.step < limit and _progress(config, state) < 1 and not interrupted():
            lr = config.lr * warmup_stable_decay(_progress(config, state), decay=config.decay)
            losses.append(_step(network, optimizers, scaler, corpus, config, state.step, lr, pool))
            state.step += 1
            state.samples += config.batch
            state.seconds = time.perf_counter() - start
            bar.update()
            bar.set_postfix(span=f"{np.mean(losses[-50:]):.4f}", refresh=False)
            if state.step % config.every == 0 or _progress(config, state) >= 1:
                error = validate(network, validation, config, pool=pool)
                _note(state, config, losses, lr, error)
                _save(folder, config, network, optimizers, state)
    _save(folder, config, network, optimizers, state)
    record = _record(corpus, config, state)
    return TrainResult(network.eval(), record, _progress(config, state) >= 1)


def _step(
    network: NeoNetwork,
    optimizers: tuple[torch.optim.Optimizer, ...],
    scaler: torch.amp.GradScaler,
    corpus: Corpus,
    config: TrainConfig,
    step: int,
    lr: float,
    pool: ThreadPoolExecutor,
) -> float:
    """Make one step of the optimisers; return its span loss."""
    parameters = list(network.parameters())
    device = parameters[0].device
    shares = [
        part.to(device).chunk(config.workers) for part in training_batch(corpus, config, step)
    ]

    def work(points: Tensor, mass: Tensor, U: Tensor) -> tuple[float, tuple[Tensor, ...]]:
        with _autocast(device.type, config.precision):
            F = network(points, mass)
        share = len(points) / config.batch
        loss = share * span_loss(F, mass, U)
        total = loss + share * config.alpha * ortho_loss(F, mass)
        return loss.item(), torch.autograd.grad(scaler.scale(total), parameters)

    losses, gradients = zip(*pool.map(work, *shares), strict=True)
    for parameter, *parts in zip(parameters, *gradients, strict=True):
        parameter.grad = torch.stack(parts).sum(0)
    for optimizer in optimizers:
        scaler.unscale_(optimizer)
    torch.nn.utils.clip_grad_norm_(parameters, config.clip)
    for optimizer in optimizers:
        for group in optimizer.param_groups:
            group["lr"] = lr
        scaler.step(optimizer)
        optimizer.zero_grad()
    scaler.update()
    return float(sum(losses))


def validate(
    network: NeoNetwork,
    corpus: Corpus,
    config: TrainConfig,
    *,
    pool: ThreadPoolExecutor | None = None,
) -> float:
    """Return the mean span error over the first samples of a corpus, with all their points."""
    device = next(network.parameters()).device
    n = min(config.validation, len(corpus))

    @torch.no_grad()
    def error(first: int) -> float:
        indices = range(first, min(first + 8, n))
        batch = validation_batch(corpus, config, indices)
        points, mass, U = (part.to(device) for part in batch)
        with _autocast(device.type, config.precision):
            F = network(points, mass)
        return float(span_loss(F, mass, U)) * len(indices)

    apply = map if pool is None else pool.map
    return float(sum(apply(error, range(0, n, 8)))) / n


def _progress(config: TrainConfig, state: TrainState) -> float:
    """Return the share of the schedule behind us, by steps or by the clock."""
    share = state.step / config.steps
    if config.minutes is not None:
        share = max(share, state.seconds / (60 * config.minutes))
    return share


def _note(
    state: TrainState, config: TrainConfig, losses: list[float], lr: float, error: float
) -> None:
    state.history.append(
        {
            "step": state.step,
            "samples": state.samples,
            "seconds": round(state.seconds, 1),
            "points": config.points,
            "lr": round(lr, 8),
            "loss": round(float(np.mean(losses)), 6),
            "validation": error,
        }
    )
    losses.clear()


def _record(corpus: Corpus, config: TrainConfig, state: TrainState) -> dict[str, Any]:
    return {
        "config": asdict(config),
        "steps": state.step,
        "samples": state.samples,
        "minutes": round(state.seconds / 60, 2),
        "corpus": {"samples": len(corpus), "points": corpus.n_points, "k": corpus.k},
        "span_error": state.history[-1]["validation"] if state.history else None,
        "history": state.history,
    }


def _save(
    folder: Path | None,
    config: TrainConfig,
    network: NeoNetwork,
    optimizers: tuple[torch.optim.Optimizer, ...],
    state: TrainState,
) -> None:
    if folder is None:
        return
    content = {
        "config": asdict(config),
        "state": asdict(state),
        "network": network.state_dict(),
        "optimizers": [optimizer.state_dict() for optimizer in optimizers],
    }
    with atomic_path(folder / "checkpoint.pt") as path:
        torch.save(content, path)
    if state.history:
        with atomic_path(folder / "log.csv") as path, path.open("w", newline="") as file:
            writer = csv.DictWriter(file, list(state.history[0]))
            writer.writeheader()
            writer.writerows(state.history)


def _load(
    folder: Path | None,
    config: TrainConfig,
    network: NeoNetwork,
    optimizers: tuple[torch.optim.Optimizer, ...],
) -> TrainState:
    path = None if folder is None else folder / "checkpoint.pt"
    if path is None or not path.is_file():
        raise InvalidInputError(f"`out` must hold a checkpoint to resume, found none at {path}")
    content = torch.load(path, map_location="cpu", weights_only=True)
    ours, theirs = asdict(config), content["config"]
    differing = sorted(name for name in ours.keys() - _FREE if ours[name] != theirs.get(name))
    if differing:
        raise InvalidInputError(
            f"the checkpoint {path} was written with other values of {differing};"
            " resume with those, or train into another folder"
        )
    network.load_state_dict(content["network"])
    for optimizer, saved in zip(optimizers, content["optimizers"], strict=True):
        optimizer.load_state_dict(saved)
    return TrainState(**content["state"])


def _check_corpora(corpus: Corpus, validation: Corpus, config: TrainConfig) -> None:
    for name, samples, n in (
        ("corpus", corpus, config.points),
        ("validation", validation, config.network.m + 1),
    ):
        if samples.k != config.network.k or samples.n_points < n:
            raise InvalidInputError(
                f"`{name}` must have samples of at least {n} points and {config.network.k} modes,"
                f" got {samples.n_points} and {samples.k}"
            )


def _autocast(device: str, precision: str) -> torch.autocast:
    dtype = _DTYPES[precision]
    return torch.autocast(torch.device(device).type, dtype=dtype, enabled=dtype is not None)


@contextmanager
def _until_interrupt() -> Iterator[Any]:
    """Yield a function that tells whether Ctrl-C was pressed, which then ends nothing by itself."""
    pressed: list[int] = []
    try:
        before = signal.signal(signal.SIGINT, lambda number, _: pressed.append(number))
    except ValueError:  # not in the main thread, which alone may set handlers
        yield lambda: False
        return
    try:
        yield lambda: bool(pressed)
    finally:
        signal.signal(signal.SIGINT, before)
