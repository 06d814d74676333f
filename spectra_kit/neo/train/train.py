"""The training loop: batches that follow from (seed, step), checkpoints that resume exactly."""

from __future__ import annotations

import copy
import math
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from spectra_kit.errors import ConvergenceError, InvalidInputError
from spectra_kit.neo.backbones import build_network
from spectra_kit.neo.loss import ortho_loss
from spectra_kit.neo.model import NeoNetwork
from spectra_kit.neo.train import checkpoint
from spectra_kit.neo.train.checkpoint import Log, Row
from spectra_kit.neo.train.config import TrainConfig
from spectra_kit.neo.train.corpus import Corpus, Source
from spectra_kit.neo.train.evaluation import predicted, validate
from spectra_kit.neo.train.loader import Batch, Loader, share_count
from spectra_kit.neo.train.optim import average_weights, make_optimizers, warmup_stable_decay
from spectra_kit.neo.train.ranks import Ranks

# What may change on resuming.
_FREE = {"steps", "minutes", "warmup", "decay", "batch", "every", "log", "save", "validation"}
_FREE |= {"workers", "compile"}
_HOUR = 3600.0
_LEAST = 1e-6  # added to an error before its logarithm is taken: rounding, in float32
Gradients = tuple[Tensor, ...]


@dataclass
class TrainState:
    """What a checkpoint holds beside weights and optimiser states; it grows with every step."""

    step: int = 0
    samples: int = 0
    seconds: float = 0.0
    cpu: float = 0.0  # seconds of this process, its threads together
    losses: list[float] = field(default_factory=list)  # of the steps since the last row
    history: list[Row] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class TrainResult:
    """A trained network and how it came about.

    Parameters
    ----------
    network : NeoNetwork
        In evaluation mode; its weights are averages where the configuration asks for them.
    record : dict
        Plain JSON values: configuration, steps, samples, minutes, validation curve.
    finished : bool
        False where the run was stopped before its schedule ended; the checkpoint continues it.
    """

    network: NeoNetwork
    record: dict[str, Any]
    finished: bool


def train(
    corpus: Source,
    validation: Corpus,
    config: TrainConfig,
    *,
    out: str | os.PathLike[str] | None = None,
    resume: bool = False,
    initial: NeoNetwork | None = None,
    device: str = "cpu",
    pause_after: float | None = None,
    last: bool = False,
    tensorboard: bool = False,
    report: Callable[[Row], None] | None = None,
    hourly: Callable[[NeoNetwork, Row], None] | None = None,
) -> TrainResult:
    """Train a network on a corpus, or on a stream, and validate it on other samples.

    The batch of a step follows from (seed, step) and the samples there are. On shards a run that
    is stopped, or killed, and resumed from its checkpoint therefore gives the same weights and
    the same loss curve as one in a single go, bit by bit on a CPU. On a stream it does where
    ``config.shown`` says how often samples are shown; else it shows what is there.

    Where ``torchrun`` started several processes (see `process_group`), each works on its share of
    every batch and all end with the same weights; the first one validates, logs and saves.

    Parameters
    ----------
    corpus : Corpus or SampleStream
        What to learn from.
    validation : Corpus
        Other samples, to measure the span error on.
    config : TrainConfig
        The run.
    out : path, optional
        Folder for ``checkpoint.pt`` and ``log.csv``; nothing is written without it.
    resume : bool, default False
        Continue from the checkpoint in `out`, which is not overwritten otherwise. The corpus may
        have grown since, and ``steps``, ``minutes``, ``warmup``, ``decay``, ``batch``, ``every``,
        ``log``, ``save``, ``validation``, ``workers`` and ``compile`` may differ.
    initial : NeoNetwork, optional
        Weights to begin with, instead of random ones.
    device : str, default "cpu"
        Where to compute.
    pause_after : float, optional
        Stop as if by Ctrl-C, with a checkpoint, this many seconds after the call, but not before a
        step is made.
    last : bool, default False
        Rather than pause, end the schedule by then: the rate falls in the time that is left.
    tensorboard : bool, default False
        Write event files too, into ``out/events``.
    report : callable, optional
        Called with every row of the log as it is made.
    hourly : callable, optional
        Called with the averaged network and a row, validated, for each hour of CPU time that the
        run has taken so far.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from spectra_kit.neo import NeoConfig
    >>> from spectra_kit.neo.train.config import TrainConfig
    >>> from spectra_kit.neo.train.corpus import generate, open_shards
    >>> from spectra_kit.neo.train.samples import CorpusConfig
    >>> from spectra_kit.neo.train.train import train
    >>> tiny = NeoConfig(width=36, depth=1, heads=2, head_width=18, latents=6, m=16, k=4)
    >>> with TemporaryDirectory() as folder:
    ...     for name, seed in (("train", 0), ("validation", 1)):
    ...         made_of = CorpusConfig(seed=seed, n_points=100, k=4)
    ...         made = generate(f"{folder}/{name}", 4, config=made_of)
    ...     corpora = [open_shards(f"{folder}/{name}") for name in ("train", "validation")]
    ...     result = train(*corpora, TrainConfig(network=tiny, steps=3, batch=2))
    >>> result.finished, result.record["samples"]
    (True, 6)
    """
    called = time.perf_counter()
    ranks = Ranks.here()
    _check_sources(corpus, validation, config)
    if last and (pause_after is None or config.minutes is None):
        raise InvalidInputError(
            "last", "come with `minutes` and `pause_after`", f"{config.minutes} and {pause_after}"
        )
    if config.batch < ranks.world:
        raise InvalidInputError("batch", f"be {ranks.world} or more, one a process", config.batch)
    torch.manual_seed(config.seed)
    run = _Run(config, torch.device(device), ranks, initial, corpus.identity(config))
    folder = None if out is None else Path(out)
    if resume:
        run.load(_resumed(folder, config, run.source))
    elif folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        if (folder / checkpoint.NAME).exists():
            raise InvalidInputError(
                "out",
                "hold no checkpoint of another run, which would be overwritten",
                folder,
                advice="resume that run, or train into another folder",
            )
    state = run.state
    with ExitStack() as stack:
        enter = stack.enter_context
        writer = log = None
        if folder is not None and ranks.first:
            writer = enter(checkpoint.Writer(folder))
            log = enter(Log(folder, state.history, tensorboard=tensorboard))
        enter(run.threads)
        if config.compile:
            run.compile(validation.n_points)
        if begin := getattr(corpus, "begin", None):  # a source of somebody else may have nothing
            begin(config)
        batch_of = enter(Loader(corpus, config, run.device, share=ranks.share(config.batch)))
        interrupted = enter(_until_interrupt())
        if last and pause_after is not None:
            left = max(1.0, called + pause_after - time.perf_counter())
            config = run.config = _shortened(config, state.seconds, ranks.agree(left, False)[0])
            pause_after = None
        begun = state.step
        start, saved = time.perf_counter() - state.seconds, time.monotonic()
        cpu = time.process_time() - state.cpu
        losses: list[Tensor] = []
        noted = time.perf_counter(), state.samples
        while True:
            late = pause_after is not None and time.perf_counter() - called > pause_after
            stop = interrupted() or (late and state.step > begun)
            progress, stop = ranks.agree(_progress(config, state), stop)
            if progress >= 1 or stop:
                break
            lr = config.lr * warmup_stable_decay(progress, warmup=config.warmup, decay=config.decay)
            losses.append(run.step(batch_of(state.step), lr))
            state.step += 1
            state.samples += config.batch
            state.seconds = time.perf_counter() - start
            hour = state.cpu // _HOUR
            state.cpu = time.process_time() - cpu
            due = hourly is not None and state.cpu // _HOUR > hour
            validating = state.step % config.every == 0 or _progress(config, state) >= 1
            if not ranks.first:
                losses.clear()
            elif validating or state.step % config.log == 0:
                run.read(losses)  # here a device is waited for
                now = time.perf_counter()
                row = _row(config, state, lr, (state.samples - noted[1]) / (now - noted[0]))
                if validating:
                    row |= validate(run.average, validation, config, threads=run.threads)
                noted = time.perf_counter(), state.samples
                state.history.append(row)
                if log is not None:
                    log.add(row)
                if report is not None:
                    report(row)
            save = validating or due or time.monotonic() - saved > config.save
            if writer is not None and save and not writer.busy:
                run.read(losses)
                writer.write(run.content())
                saved = time.monotonic()
            # After the checkpoint, and beside the log: the clock must not decide what that holds.
            if due and hourly is not None and ranks.first:
                row = {"step": state.step, "samples": state.samples, "cpu": state.cpu}
                errors = validate(run.average, validation, config, threads=run.threads)
                hourly(run.average, row | errors)
        run.read(losses)
        if writer is not None:
            writer.write(run.content())
    record = _record(corpus, config, state)
    return TrainResult(run.average.eval(), record, _progress(config, state) >= 1)


class _Run:
    """What a run changes: the network, its average, the optimisers and the state."""

    def __init__(
        self,
        config: TrainConfig,
        device: torch.device,
        ranks: Ranks,
        initial: NeoNetwork | None,
        source: dict[str, Any] | None = None,
    ) -> None:
        self.config, self.device, self.ranks, self.source = config, device, ranks, source
        self.network = build_network(config.network)
        if initial is not None:
            self.network.load_state_dict(initial.state_dict())
        self.network.to(device).train().requires_grad_(True)
        self.average = copy.deepcopy(self.network) if config.ema else self.network
        self.parameters = list(self.network.parameters())
        # The compiled one shares the weights; their names in checkpoints stay plain.
        self.forward: Callable[..., Any] = self.network
        if config.compile:
            self.forward = torch.compile(self.network, dynamic=False)
        # Shares of a batch side by side on a CPU, one after the other elsewhere.
        self.threads = ThreadPoolExecutor(config.workers if device.type == "cpu" else 1)
        self.optimizers = make_optimizers(
            self.network, lr=config.lr, weight_decay=config.weight_decay, apply=self.threads.map
        )
        self.scaler = torch.amp.GradScaler(device.type, enabled=config.precision == "float16")
        self.state = TrainState()

    def step(self, batch: Batch, lr: float) -> Tensor:
        """Make one step of the optimisers; return its loss, on the device, as it was counted."""
        config, parameters = self.config, self.parameters
        losses, gradients = self.gradients(batch)
        loss = torch.stack(losses).sum()
        for parameter, *parts in zip(parameters, *gradients, strict=True):
            parameter.grad = parts[0] if len(parts) == 1 else torch.stack(parts).sum(0)
        self.ranks.add_up([loss, *(p.grad for p in parameters if p.grad is not None)])
        for optimizer in self.optimizers:
            self.scaler.unscale_(optimizer)
        torch.nn.utils.clip_grad_norm_(parameters, config.clip)
        for optimizer in self.optimizers:
            for group in optimizer.param_groups:
                group["lr"] = lr
            self.scaler.step(optimizer)
            optimizer.zero_grad()
        self.scaler.update()
        if config.ema:
            average_weights(self.average, self.network, self.state.step, config.ema)
        return loss

    def compile(self, n: int) -> None:
        """Compile the network on a batch of noise, which should not count as training."""
        config, network = self.config, self.config.network
        size = len(range(config.batch)[self.ranks.share(config.batch)])

        def noise(*shape: int) -> Tensor:
            return torch.rand(size, n, *shape, device=self.device)

        self.gradients(Batch(2 * noise(3) - 1, noise() / n, noise(network.k)))

    def read(self, losses: list[Tensor]) -> None:
        """Note losses as numbers, and empty the list."""
        numbers = torch.stack(losses).tolist() if losses else []
        losses.clear()
        self.state.losses += numbers
        bad = not np.isfinite(numbers).all()
        # In float16 the scaler leaves such a step out, and halves its scale: 16 in a row reach one.
        if bad and (self.config.precision != "float16" or self.scaler.get_scale() < 1):
            raise ConvergenceError(
                f"the loss is not finite by step {self.state.step}",
                advice="go on from the last checkpoint with a smaller `lr` than"
                f" {self.config.lr:g}, or in another `precision` than {self.config.precision}",
            )

    def gradients(self, batch: Batch) -> tuple[tuple[Tensor, ...], tuple[Gradients, ...]]:
        """Return the losses of the shares of a batch, and their gradients."""
        count = share_count(len(batch.points), self.config.workers, self.device)
        shares = batch.parts(count)
        losses, gradients = zip(*self.threads.map(self._work, shares), strict=True)
        return losses, gradients

    def _work(self, part: Batch) -> tuple[Tensor, Gradients]:
        """Return the loss of a share of the batch, and its gradients."""
        config, share = self.config, len(part.points) / self.config.batch
        F, errors = predicted(self.forward, part, config)
        weights = errors.new_tensor([1 - config.beta, config.beta] if len(errors) > 1 else [1.0])
        counted = (errors + _LEAST).log() if config.relative else errors  # of each sample
        total = weights @ counted.mean(-1) + config.alpha * ortho_loss(F, part.mass)
        loss = share * (weights @ counted.detach().mean(-1))
        return loss, torch.autograd.grad(self.scaler.scale(share * total), self.parameters)

    def content(self) -> dict[str, Any]:
        """Return what a checkpoint holds."""
        return {
            "config": asdict(self.config),
            "source": self.source,
            "state": asdict(self.state),
            "network": self.network.state_dict(),
            "average": self.average.state_dict() if self.config.ema else {},
            "optimizers": [optimizer.state_dict() for optimizer in self.optimizers],
            "scaler": self.scaler.state_dict(),
        }

    def load(self, content: dict[str, Any]) -> None:
        """Go on from the content of a checkpoint."""
        self.network.load_state_dict(content["network"])
        if self.config.ema:
            self.average.load_state_dict(content["average"])
        for optimizer, saved in zip(self.optimizers, content["optimizers"], strict=True):
            optimizer.load_state_dict(saved)
        self.scaler.load_state_dict(content["scaler"])
        self.state = TrainState(**content["state"])


def _progress(config: TrainConfig, state: TrainState) -> float:
    """Return the share of the schedule behind us, by steps or by the clock."""
    share = state.step / config.steps
    if config.minutes is not None:
        share = max(share, state.seconds / (60 * config.minutes))
    return share


def _shortened(config: TrainConfig, seconds: float, left: float) -> TrainConfig:
    """Return a schedule that ends `left` seconds after the `seconds` so far, if not before.

    The rate goes on from where it is; it falls over the old time if that is left, else at once.
    """
    assert config.minutes is not None
    whole, total = 60 * config.minutes, seconds + left
    if total >= whole:
        return config
    now = warmup_stable_decay(seconds / whole, warmup=config.warmup, decay=config.decay)
    fall = min(config.decay * whole, total, left / now if now else total)
    rise = min(config.warmup * whole, total)
    return replace(config, minutes=total / 60, warmup=rise / total, decay=fall / total)


def _row(config: TrainConfig, state: TrainState, lr: float, rate: float) -> Row:
    """Return a row of the log, over the steps since the last one."""
    finite = [loss for loss in state.losses if math.isfinite(loss)]  # others were skipped
    loss = float(np.mean(finite)) if finite else math.nan
    loss = math.exp(loss) if config.relative else loss
    state.losses.clear()
    return {
        "step": state.step,
        "samples": state.samples,
        "seconds": round(state.seconds, 1),
        "lr": round(lr, 8),
        "rate": round(rate, 2),
        "loss": loss,
    }


def _record(corpus: Source, config: TrainConfig, state: TrainState) -> dict[str, Any]:
    validations = [row for row in state.history if "validation" in row]
    latest = validations[-1] if validations and validations[-1]["step"] == state.step else {}
    return {
        "config": asdict(config),
        "steps": state.step,
        "samples": state.samples,
        "minutes": round(state.seconds / 60, 2),
        "corpus": {"samples": corpus.made, "points": corpus.n_points, "k": corpus.k},
        "span_error": latest.get("validation"),
        "mean": "geometric" if config.relative else "arithmetic",
        "history": validations,
    }


def _resumed(
    folder: Path | None, config: TrainConfig, source: dict[str, Any] | None
) -> dict[str, Any]:
    content = None if folder is None else checkpoint.read(folder)
    if content is None:
        raise InvalidInputError(
            "out",
            "hold a checkpoint to resume",
            f"none in {folder}",
            advice="call without `resume` to begin a run",
        )
    ours, theirs = asdict(config), content["config"]
    free = _FREE - {"batch"} if config.shown else _FREE  # which says where in a stream a step is
    theirs = {f.name: f.default for f in fields(TrainConfig)} | theirs  # new ones came later
    differing = sorted(name for name in ours.keys() - free if ours[name] != theirs[name])
    if content.get("source", source) != source:
        differing.append("stream")
    if differing:
        raise InvalidInputError(
            f"the checkpoint in {folder} was written with other values of {differing}",
            advice="resume with those, or train into another folder",
        )
    return content


def _check_sources(corpus: Source, validation: Corpus, config: TrainConfig) -> None:
    least = config.network.m + 1  # the functions span everything on fewer
    for name, source in (("corpus", corpus), ("validation", validation)):
        if source.k != config.network.k or source.fewest < least:
            raise InvalidInputError(
                name,
                f"have samples of at least {least} points and {config.network.k} modes",
                f"{source.fewest} and {source.k}",
                advice="make it of more points or modes, or train a network with a smaller m",
            )
        if source.fewest < source.n_points and config.network.backbone != "neo":
            raise InvalidInputError(
                name,
                f"have as many points in each sample, for {config.network.backbone}, which takes"
                " padding for points",
                "meshes of fewer",
                advice="make it without meshes, or take backbone='neo'",
            )
        if config.beta and not source.has_operators:
            raise InvalidInputError(
                name,
                f"have operators to smooth with, for beta = {config.beta:g}",
                "one without",
                advice="make it anew, or take beta=0",
            )


@contextmanager
def _until_interrupt() -> Iterator[Any]:
    """Yield a function that tells whether to stop: Ctrl-C and SIGTERM end nothing by themselves."""
    told: list[int] = []
    before: dict[signal.Signals, Any] = {}
    if threading.current_thread() is threading.main_thread():  # which alone may set handlers
        for number in (signal.SIGINT, signal.SIGTERM):
            before[number] = signal.signal(number, lambda number, _: told.append(number))
    try:
        yield lambda: bool(told)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
