"""A phase of a leg: what it begins with, and what it leaves to the next."""

from __future__ import annotations

import hashlib
import json
import platform
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch

from legs.leg import Leg
from legs.packing import POOL
from legs.parts import read_parts, write_parts
from spectra_kit.errors import InvalidInputError
from spectra_kit.neo import NeoNetwork, Pretrained, build_network, load_pretrained, save_weights
from spectra_kit.neo.train import checkpoint
from spectra_kit.neo.train.config import TrainConfig
from spectra_kit.neo.train.corpus import generate
from spectra_kit.neo.train.log import Row
from spectra_kit.neo.train.samples import CorpusConfig
from spectra_kit.neo.train.shards import Corpus, open_shards
from spectra_kit.neo.train.stream import SampleStream
from spectra_kit.neo.train.train import TrainResult, train, validate

_FIRST = 2**20  # samples between the numbers of one phase and the next
_VALIDATION_SEED = 2_000_003  # no sample is in both


@dataclass(frozen=True)
class Place:
    """Where a phase runs."""

    out: Path  # where results go
    source: Path  # where those of the last phase lie
    scratch: Path  # for what need not travel: samples, exact checkpoints
    packed: Path  # holds the pools of real meshes, if there are any
    device: str  # to train on
    workers: int  # processes that make samples
    capacity: int  # samples held in memory


def run_phase(
    leg: Leg,
    place: Place,
    *,
    pause_after: float | None,
    last: bool = False,
    say: Callable[[str], None],
) -> None:
    """Train until a leg's schedule ends, or `pause_after` seconds; what follows takes some more.

    With `last` the schedule ends by then. ``place.out`` then holds the log and a checkpoint in
    parts for the next phase; and, where the schedule has ended with better weights,
    ``weights.safetensors``. `say` is told what goes on, line by line.
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
    resume = _settle(leg, place.source, scratch)
    with _samples_of(leg, place, scratch) as stream:

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
    if not result.finished:
        say(f"paused after {result.record['minutes']} minutes of training; the next call goes on")
        return
    _finish(leg, start, result, validation, place, say)
    _write(replace(leg, phase=leg.phase + 1, step=result.record["steps"], finished=True), place)


def _write(leg: Leg, place: Place) -> None:
    """Write a leg where it travels from, and where the next call looks if that is emptied."""
    for folder in (place.out, place.scratch):
        leg.write(folder)


def _compared(leg: Leg, place: Place) -> Leg:
    """Return a leg with the mark of its validation samples, the same in every phase."""
    content = json.dumps(_config(leg, place.packed, "val").fingerprint(), sort_keys=True)
    mark = hashlib.sha256(content.encode()).hexdigest()[:16]
    if leg.validation not in ("", mark):
        raise InvalidInputError(
            f"--packed must hold the pool that leg {leg.name} began with, or none if it had none:"
            f" with {place.packed} the samples to validate on are others, and errors before and"
            " after could not be compared",
            advice="copy the same files there",
        )
    return replace(leg, validation=mark)


def _config(leg: Leg, packed: Path, split: str) -> CorpusConfig:
    """Return what samples are made of: half are meshes, and most come from real ones."""
    pool = packed / POOL.format(split)
    there = pool.is_file()
    return CorpusConfig(
        seed=leg.config.seed if split == "train" else _VALIDATION_SEED,
        n_points=leg.n_points,
        k=leg.config.network.k,
        pool=pool if there else None,
        pool_split=split,
        pool_share=(0.6 if split == "train" else 0.5) if there else 0.0,
        mesh_share=0.5,
    )


def _validation(leg: Leg, place: Place, scratch: Path) -> Corpus:
    folder, config = scratch / "validation", _config(leg, place.packed, "val")
    generate(folder, leg.config.validation, config=config, workers=place.workers)
    return open_shards(folder)


def _samples_of(leg: Leg, place: Place, scratch: Path) -> SampleStream:
    """Samples of this phase's own numbers, or of an earlier one's that lie there."""
    config, folder = _config(leg, place.packed, "train"), scratch / "samples"
    there = [int(path.name.removeprefix("shard_")) for path in folder.glob("shard_*")]
    return SampleStream(
        config,
        workers=place.workers,
        capacity=place.capacity,
        start=min(there) * config.shard_size if there else leg.phase * _FIRST,
        folder=folder,
        bounded=True,
    )


def _error(network: NeoNetwork, validation: Corpus, config: TrainConfig) -> float:
    """Return the span error in float32, in which the weights will be used."""
    return validate(network, validation, replace(config, precision="float32"))["validation"]


def _settle(leg: Leg, source: Path, scratch: Path) -> bool:
    """Put the newest checkpoint of a leg where `train` looks; say whether there is one.

    The one in `scratch` is exact and may be of a phase that was killed; the one that travels is
    rounded, and newer where the last phase ran on another machine.
    """
    here = checkpoint.read(scratch)
    if here is not None and here["state"]["step"] >= leg.step:
        return True
    if leg.phase == 0:
        return False
    checkpoint.write(scratch, read_parts(source))
    return True


def _leave(leg: Leg, place: Place, scratch: Path) -> None:
    """Put what the next phase needs where it travels from."""
    content = checkpoint.read(scratch)
    if content is None:
        return
    write_parts(place.out, content)
    step = content["state"]["step"]
    _write(replace(leg, phase=leg.phase + (step > leg.step), step=step), place)
    if (scratch / "log.csv").is_file():  # not where a phase failed before its first step
        shutil.copyfile(scratch / "log.csv", place.out / "log.csv")


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
    rounded.load_state_dict({name: t.half() for name, t in result.network.state_dict().items()})
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
    gpu = torch.device(device).type == "cuda"
    line = {
        "date": time.strftime("%Y-%m-%d", time.gmtime()),
        "from": start.sha256 if start is not None else None,
        "device": torch.cuda.get_device_name(device) if gpu else platform.machine(),
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


def _line(row: Row) -> str:
    names = ("step", "samples", "seconds", "lr", "rate", "loss", "validation")
    return "  ".join(f"{name} {row[name]:.6g}" for name in names if name in row)
