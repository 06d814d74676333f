"""The phases of a leg: what each begins with, and what it leaves to the next."""

from __future__ import annotations

import hashlib
import json
import platform
import secrets
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import torch

from spectra_kit._files import atomic_path, parsing
from spectra_kit.errors import InvalidInputError
from spectra_kit.neo import NeoConfig, NeoNetwork, build_network
from spectra_kit.neo.pretrained import WEIGHTS, Pretrained, load_pretrained, save_weights
from spectra_kit.training import checkpoint
from spectra_kit.training.config import TrainConfig
from spectra_kit.training.corpus import generate
from spectra_kit.training.log import Row
from spectra_kit.training.samples import CorpusConfig
from spectra_kit.training.shards import Corpus, open_shards
from spectra_kit.training.stream import SampleStream
from spectra_kit.training.train import TrainResult, train, validate

POOL = "pool_{}.npz"  # in the packed folder, by split
_FIRST = 2**20  # samples between the numbers of one phase and the next
_SEED, _VALIDATION_SEED = 1_000_000, 2_000_003  # no sample is in both


@dataclass(frozen=True)
class Leg:
    """What the phases of a leg share; ``leg.json`` holds it.

    Parameters
    ----------
    name : str
        Tells this leg from others.
    weights : str
        Name or file that it starts from, empty for random weights.
    config : TrainConfig
        Of all its phases.
    n_points : int
        Points of its samples.
    rival : str
        Weights that the new ones must beat: those that it starts from, else the shipped ones of
        its configuration; empty where there are none.
    asked : dict
        What the first call asked for, which later ones may repeat but not change.
    before : float or None
        Span error of the rival.
    validation : str
        Tells the samples that it was measured on from others.
    phase : int
        Phases that have made steps.
    step : int
        Steps that they made.
    finished : bool
        Whether its schedule has ended.
    """

    name: str
    weights: str
    config: TrainConfig
    n_points: int
    rival: str = ""
    asked: dict[str, Any] = field(default_factory=dict)
    before: float | None = None
    validation: str = ""
    phase: int = 0
    step: int = 0
    finished: bool = False

    def write(self, folder: Path) -> None:
        """Write ``leg.json``."""
        with atomic_path(folder / "leg.json") as path:
            path.write_text(json.dumps(asdict(self), indent=1))

    @classmethod
    def read(cls, folder: Path) -> Leg | None:
        """Read ``leg.json``; None where there is none."""
        path = folder / "leg.json"
        if not path.is_file():
            return None
        with parsing(path, "record of a leg", remedy="copy the state there again"):
            content = json.loads(path.read_text())
            config = content.pop("config")
            config["network"] = NeoConfig(**config["network"])
            return cls(**content, config=TrainConfig(**config))


@dataclass(frozen=True)
class Place:
    """Where a phase runs.

    Parameters
    ----------
    out, state : Path
        Where results go, and where those of the last phase lie.
    scratch : Path
        For what need not travel: samples, exact checkpoints.
    packed : Path
        Holds the pools of real meshes, if there are any.
    device : str
        To train on.
    workers, capacity : int
        Processes that make samples, and samples held in memory.
    """

    out: Path
    state: Path
    scratch: Path
    packed: Path
    device: str
    workers: int
    capacity: int


def new_leg(
    *,
    name: str,
    weights: str | None,
    fresh: bool,
    fast: bool,
    n_points: int,
    batch: int | None,
    **options: Any,
) -> Leg:
    """Return a leg before its first phase.

    Parameters
    ----------
    name : str
        Configuration of the network; its shipped weights are the default start.
    weights : str, optional
        Name or file of other weights.
    fresh : bool
        Start from random weights.
    fast : bool
        Whether an accelerator trains: large batches, bfloat16, compiled.
    n_points : int
        Points of the samples.
    batch : int, optional
        Clouds per step; by default 800 on an accelerator, else 16.
    **options
        More of `TrainConfig`.

    Raises
    ------
    InvalidInputError
        If there are no weights to start from.
    """
    begin = "" if fresh else weights or (name if name in WEIGHTS else "")
    if not (fresh or begin):
        raise InvalidInputError(
            f"there are no shipped weights of {name!r}, only of {sorted(WEIGHTS)};"
            " give --weights FILE, or begin anew with --fresh"
        )
    start = load_pretrained(begin) if begin else None
    config = TrainConfig(
        network=NeoConfig.named(name) if start is None else start.config,
        steps=10**9,
        batch=batch or (800 if fast else 16),
        warmup=0.05,
        decay=0.3,
        precision="bfloat16" if fast else "float32",
        compile=fast,
        every=500,
        # Each leg sees samples of its own.
        seed=_SEED + (len(start.record.get("legs", [])) if start else 0),
        **options,
    )
    rival = begin or (name if name in WEIGHTS else "")
    return Leg(secrets.token_hex(4), begin, config, n_points, rival)


def begun_leg(out: Path, state: Path | None, scratch: Path) -> tuple[Leg, Path] | None:
    """Find the leg to go on with.

    Parameters
    ----------
    out, scratch : Path
        Where it may lie, the first before the second, where `state` is not given.
    state : Path, optional
        Where it must lie.

    Returns
    -------
    tuple of Leg and Path
        And where it lies; None where there is none yet. A leg that has ended in `scratch` alone
        is none.

    Raises
    ------
    InvalidInputError
        If there is none in `state`, or it has ended.
    """
    if state is not None and Leg.read(state) is None:
        raise InvalidInputError(
            f"`state` must hold the leg.json of an earlier phase, found none in {state};"
            " copy what that phase left there, or begin a leg without --state"
        )
    for folder in (out, scratch) if state is None else (state,):
        leg = Leg.read(folder)
        if leg is not None and not leg.finished:
            return leg, folder
        if leg is not None and folder != scratch:
            raise InvalidInputError(
                f"the leg {leg.name} in {folder} has ended; give another --out to begin the next"
            )
    return None


def run_phase(
    leg: Leg,
    place: Place,
    *,
    pause_after: float | None,
    last: bool = False,
    say: Callable[[str], None],
) -> bool:
    """Train until a leg's schedule ends, or the pause.

    Parameters
    ----------
    leg : Leg
        As the last phase left it.
    place : Place
        Where.
    pause_after : float, optional
        Seconds after which the training stops; what follows takes some more.
    last : bool, default False
        Rather than stop, end the schedule by then.
    say : callable
        Told what goes on, line by line.

    Returns
    -------
    bool
        Whether the schedule has ended. ``place.out`` then holds ``weights.safetensors`` if the
        new weights are better; always the log, and a checkpoint in parts for the next phase.

    Raises
    ------
    InvalidInputError
        If the samples to validate on are not those of the first phase.
    """
    called = time.perf_counter()
    scratch = place.scratch / leg.name
    leg = _compared(leg, place)
    validation = _validation(leg, place, scratch)
    start = load_pretrained(leg.weights, place.device) if leg.weights else None
    if leg.rival and leg.before is None:
        rival = load_pretrained(leg.rival, place.device)
        config = replace(leg.config, network=rival.config)
        leg = replace(leg, before=_error(rival.network, validation, config))
    _write(leg, place)
    say(f"leg {leg.name}, phase {leg.phase + 1}; span error to beat: {leg.before}")
    resume = _settle(leg, place.state, scratch)
    samples = _samples(leg, place.packed, "train")
    folder = scratch / "samples"  # a phase on the same machine begins with them
    with SampleStream(
        samples,
        workers=place.workers,
        capacity=place.capacity,
        start=_first(folder, samples.shard_size, leg.phase * _FIRST),
        folder=folder,
        bounded=True,
    ) as stream:

        def wait() -> None:
            # The first steps should not show the same few samples again and again.
            enough = min(place.capacity, 4 * leg.config.batch)
            if not stream.ready(enough, timeout=max(0.0, called + 60 - time.perf_counter())):
                say(f"fewer than {enough} samples after a minute: beginning with those there are")
            while not stream.ready(1, timeout=60):
                say("waiting for the first sample")

        spent = time.perf_counter() - called
        try:
            result = train(
                stream,
                validation,
                leg.config,
                out=scratch,
                resume=resume,
                initial=None if start is None else start.network,
                device=place.device,
                pause_after=None if pause_after is None else max(1.0, pause_after - spent),
                last=last,
                wait=wait,
                report=lambda row: say(_line(row)),
            )
        finally:  # a failure must not cost the whole phase
            _leave(leg, place, scratch)
        say(f"made meanwhile: {stream.report()}")
    if result.finished:
        _finish(leg, start, result, validation, place, say)
        _write(replace(leg, phase=leg.phase + 1, step=result.record["steps"], finished=True), place)
    else:
        say(f"paused after {result.record['minutes']} minutes of training; the next call goes on")
    return result.finished


def _write(leg: Leg, place: Place) -> None:
    """Write a leg where it travels from, and where the next call looks if that is emptied."""
    for folder in (place.out, place.scratch):
        folder.mkdir(parents=True, exist_ok=True)
        leg.write(folder)


def _compared(leg: Leg, place: Place) -> Leg:
    """Return a leg with the mark of its validation samples, the same in every phase."""
    content = json.dumps(_samples(leg, place.packed, "val").fingerprint(), sort_keys=True)
    mark = hashlib.sha256(content.encode()).hexdigest()[:16]
    if leg.validation not in ("", mark):
        raise InvalidInputError(
            f"`packed` must hold the pool that leg {leg.name} began with, or none if it had none:"
            f" with {place.packed} the samples to validate on are others, and errors before and"
            " after could not be compared; copy the same files there"
        )
    return replace(leg, validation=mark)


def _first(folder: Path, shard_size: int, default: int) -> int:
    """Return the number of the first sample that lies in a folder of shards."""
    numbers = [int(path.name.removeprefix("shard_")) for path in folder.glob("shard_*")]
    return min(numbers) * shard_size if numbers else default


def _samples(leg: Leg, packed: Path, split: str) -> CorpusConfig:
    """Return what samples are made of: three of ten, or half to validate, are real meshes."""
    pool = packed / POOL.format(split)
    there = pool.is_file()
    return CorpusConfig(
        seed=leg.config.seed if split == "train" else _VALIDATION_SEED,
        n_points=leg.n_points,
        k=leg.config.network.k,
        pool=pool if there else None,
        pool_split=split,
        pool_share=(0.3 if split == "train" else 0.5) if there else 0.0,
    )


def _validation(leg: Leg, place: Place, scratch: Path) -> Corpus:
    folder = scratch / "validation"
    samples = _samples(leg, place.packed, "val")
    generate(folder, leg.config.validation, config=samples, workers=place.workers)
    return open_shards(folder)


def _error(network: NeoNetwork, validation: Corpus, config: TrainConfig) -> float:
    """Return the span error in float32, in which the weights will be used."""
    return validate(network, validation, replace(config, precision="float32"))


def _settle(leg: Leg, state: Path, scratch: Path) -> bool:
    """Put the newest checkpoint of a leg where `train` looks; say whether there is one.

    The one in `scratch` is exact and may be of a phase that was killed; the one that travels is
    rounded, and newer where the last phase ran on another machine.
    """
    here = checkpoint.read(scratch)
    if here is not None and here["state"]["step"] >= leg.step:
        return True
    if leg.phase == 0:
        return False
    with checkpoint.Writer(scratch) as writer:
        writer.write(checkpoint.read_parts(state))
    return True


def _leave(leg: Leg, place: Place, scratch: Path) -> None:
    """Put what the next phase needs where it travels from."""
    content = checkpoint.read(scratch)
    if content is None:
        return
    checkpoint.write_parts(place.out, content)
    step = content["state"]["step"]
    _write(replace(leg, phase=leg.phase + (step > leg.step), step=step), place)
    if (scratch / "log.csv").is_file():  # not where a phase failed before its first step
        (place.out / "log.csv").write_bytes((scratch / "log.csv").read_bytes())


def _finish(
    leg: Leg,
    start: Pretrained | None,
    result: TrainResult,
    validation: Corpus,
    place: Place,
    say: Callable[[str], None],
) -> None:
    """Write the new weights and their record, if they are better than the old."""
    rounded = build_network(leg.config.network).eval()
    halves = {name: t.half().float() for name, t in result.network.state_dict().items()}
    rounded.load_state_dict(halves)
    rounded.to(place.device)
    after = _error(rounded, validation, leg.config)
    if leg.before is not None and after >= leg.before:
        say(f"span error {leg.before:.5f} -> {after:.5f}: not better, no weights written")
        return
    path = place.out / "weights.safetensors"
    record = _record(leg, start, result.record, after, place.device)
    digest = save_weights(path, rounded, record, dtype=torch.float16)
    was = "nothing to compare with" if leg.before is None else f"{leg.before:.5f}"
    say(f"span error {was} -> {after:.5f}: {path} (sha256 {digest})")


def _record(
    leg: Leg, start: Pretrained | None, record: dict[str, Any], after: float, device: str
) -> dict[str, Any]:
    """Return the record of the new weights: their whole training, and a line on this leg."""
    old = start.record if start is not None else {}
    line = {
        "date": time.strftime("%Y-%m-%d", time.gmtime()),
        "from": start.sha256 if start is not None else None,
        "device": _device_name(device),
        "minutes": record["minutes"],
        "samples": record["samples"],
        "batch": leg.config.batch,
        "before": leg.before,
        "after": after,
    }
    rows = [{**row, "samples": row["samples"] + old.get("samples", 0)} for row in record["history"]]
    rows[-1] = {**rows[-1], "validation": after}  # of the rounded weights, which are shipped
    return {
        **record,
        "steps": record["steps"] + old.get("steps", 0),
        "samples": record["samples"] + old.get("samples", 0),
        "minutes": round(record["minutes"] + old.get("minutes", 0.0), 2),
        "span_error": after,
        "history": rows,
        "legs": [*old.get("legs", []), line],
    }


def _device_name(device: str) -> str:
    kind = torch.device(device)
    return torch.cuda.get_device_name(kind) if kind.type == "cuda" else platform.machine()


def _line(row: Row) -> str:
    names = ("step", "samples", "seconds", "lr", "rate", "loss", "validation")
    return "  ".join(f"{name} {row[name]:.6g}" for name in names if name in row)
