"""`TrainConfig`: what a training run follows from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from spectra_kit._core.checked import checked
from spectra_kit._core.validate import check_count, check_positive
from spectra_kit.errors import InvalidInputError
from spectra_kit.neo.model import NeoConfig


@checked
@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """Everything a training run follows from, next to its corpus.

    Parameters
    ----------
    network : NeoConfig
        Sizes, and the frame in which the network will be asked to predict.
    steps : int
        Length of the schedule in steps. With `minutes`, an upper bound.
    minutes : float, optional
        Length of the schedule in wall-clock time, if `steps` are not done before; such a run ends
        when it must, but does not repeat bit by bit.
    batch : int, default 16
        Samples per step, over all devices.
    lr, weight_decay, clip : float, default 5e-3, 0.04 and 1
        Peak learning rate, decoupled decay, bound on the gradient's norm. Short runs like a
        higher rate than the paper's 8e-4: after 2,000 samples the span error was 0.074, 0.066
        and 0.068 with peaks of 2e-3, 4e-3 and 8e-3.
    warmup, decay : float, default 0.1 and 0.2
        Shares of the schedule in which the rate rises, and falls.
    ema : float, default 0.999
        Decay per step of the averaged weights, which are validated and returned; 0 for none.
    alpha : float, default 1e-3
        Weight of `ortho_loss`.
    beta : float, default 0
        Share of the loss that is the span error after smoothing, see `smoothed_residuals`; for
        corpora with operators.
    relative : bool, default False
        Count the logarithms of the samples' errors: those of easy samples as much as those of hard
        ones, which are a hundred times larger, and what smoothing leaves as much as what it takes.
        Errors on the validation samples are geometric means, then.
    smoothing : int, default 8
        Products with L that a mode is smoothed by at most, as many as damp what lies above all.
    flips : float, default 1
        In the principal frame: share of samples that are shown in a random one of the four
        proper flips, for clouds whose third moments are unclear and for prediction in many poses.
        After 2,000 samples, 1 and 0.25 gave the same span error (0.074) in the unflipped pose.
    jitter : float, default 0.03
        In the principal frame: size of random rotations, in radians, and of random shrinking.
    shown : int, default 0
        In a stream with ``ahead``: how often a sample is shown in the mean. The batch of a step
        then follows from (seed, step), as it does in a corpus. 0 draws from what there is.
    precision : {"float32", "bfloat16", "float16"}, default "float32"
        Of the matrix products (autocast). Losses are always float32.
    validation : int, default 64
        How many samples of the validation corpus, the first ones, to validate on.
    every, log : int, default 200 and 20
        Steps between validations, and between rows of the log.
    save : float, default 60
        Seconds between checkpoints.
    workers : int, default 1
        Equal shares of each batch. On a CPU each has a thread, which takes four samples at a time,
        and they meet once per step, so on a busy machine two of them with one thread each are
        several times faster than one whose every matrix product waits for two threads. On an
        accelerator they follow one another: half the share, half the memory.
    compile : bool, default False
        Compile the network with `torch.compile`: for accelerators.
    seed : int, default 0
        Of initial weights, order and poses.

    Examples
    --------
    >>> from spectra_kit.neo import NeoConfig
    >>> from spectra_kit.neo.train.config import TrainConfig
    >>> TrainConfig(network=NeoConfig.named("small"), steps=1000, relative=True).batch
    16
    """

    network: NeoConfig
    steps: int
    minutes: float | None = None
    batch: int = 16
    lr: float = 5e-3
    weight_decay: float = 0.04
    clip: float = 1.0
    warmup: float = 0.1
    decay: float = 0.2
    ema: float = 0.999
    alpha: float = 1e-3
    beta: float = 0.0
    relative: bool = False
    smoothing: int = 8
    flips: float = 1.0
    jitter: float = 0.03
    shown: int = 0
    precision: Literal["float32", "bfloat16", "float16"] = "float32"
    validation: int = 64
    every: int = 200
    log: int = 20
    save: float = 60.0
    workers: int = 1
    compile: bool = False
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("steps", "batch", "smoothing", "validation", "every", "log", "workers"):
            check_count(name, getattr(self, name), low=1)
        for name in ("lr", "clip", "warmup", "decay", "save"):
            check_positive(name, getattr(self, name))
        check_count("shown", self.shown, low=0)
        if self.minutes is not None:
            check_positive("minutes", self.minutes)
        for name in ("weight_decay", "warmup", "decay", "ema", "alpha", "beta", "flips", "jitter"):
            if not 0 <= getattr(self, name) <= 1:
                raise InvalidInputError(name, "be in [0, 1]", getattr(self, name))
