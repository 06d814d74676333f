"""Train a NEO network on corpora of shards, and write its weights."""

from __future__ import annotations

import argparse
import dataclasses
import os
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

import torch
from make_corpus import add_corpus_options, corpus_config
from measure.command import exit_code
from tqdm import tqdm

from spectra_kit.eigensolvers import Neo
from spectra_kit.errors import InvalidInputError
from spectra_kit.neo.model import NeoConfig, NeoNetwork
from spectra_kit.neo.pretrained import load_pretrained, save_weights
from spectra_kit.training import checkpoint
from spectra_kit.training.batches import window
from spectra_kit.training.config import TrainConfig
from spectra_kit.training.evaluation import errors_of, typical
from spectra_kit.training.log import Row
from spectra_kit.training.ranks import Ranks, process_group
from spectra_kit.training.shards import Corpus, join, open_shards
from spectra_kit.training.stream import SampleStream
from spectra_kit.training.train import TrainResult, train, validate


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__,
        epilog="Several devices: torchrun --nproc-per-node N apps/train_neo.py ... --device cuda",
    )
    add = parser.add_argument
    add("corpus", type=Path, nargs="*", help="folders of shards; one named twice counts twice")
    add("--validation", type=Path, required=True, help="folder of shards, other samples")
    add("--out", type=Path, required=True, help="folder for checkpoint, log and weights")
    add("--config", default="small", help="a name that NeoConfig.named knows")
    sizes = "what it has otherwise, such as m=192; may come several times"
    add("--network", action="append", default=[], type=_size, help=sizes)
    add("--frame", choices=["principal", "none"], help="(default: that of the weights; principal)")
    add("--weights", help="begin with these weights, a name or a file, and their configuration")
    add("--steps", type=int, default=100_000, help="length of the schedule")
    add("--minutes", type=float, help="end the schedule by the clock instead")
    add("--batch", type=int, default=16, help="clouds per step, over all devices")
    add("--lr", type=float, default=5e-3)
    add("--warmup", type=float, default=0.1, help="share of the schedule in which the rate rises")
    add("--decay", type=float, default=0.2, help="share of the schedule in which the rate falls")
    add("--ema", type=float, default=0.999, help="decay of the averaged weights; 0 for none")
    add("--alpha", type=float, default=1e-3, help="weight of the orthogonality regulariser")
    add("--beta", type=float, default=0.0, help="share of the loss that comes after smoothing")
    logs = "count logarithms of the samples' errors, so that hard samples do not outweigh the rest"
    add("--relative", action="store_true", help=logs)
    add("--smoothing", type=int, default=8, help="products with L that smooth, at most")
    add("--flips", type=float, default=1.0, help="share of samples in a random proper flip")
    add("--precision", default="float32", choices=["float32", "bfloat16", "float16"])
    add("--validate", type=int, default=64, help="number of validation samples")
    add("--every", type=int, default=200, help="steps between validations")
    add("--log", type=int, default=20, help="steps between rows of the log")
    add("--save", type=float, default=60, help="seconds between checkpoints")
    add("--seed", type=int, default=0)
    add("--workers", type=int, default=1, help="CPU threads that share each batch")
    add("--device", default="cpu")
    add("--compile", action="store_true", help="torch.compile the network")
    add("--tensorboard", action="store_true", help="event files too, in OUT/events")
    resume = "continue from the checkpoint in --out, or begin where there is none yet"
    add("--resume", action="store_true", help=resume)
    full = "folder of shards, few of many points: test Neo on them for each hour of CPU time"
    add("--hourly", type=Path, help=full)
    add("--stream", type=Path, help="make samples, too: the latest are kept in this folder")
    add("--makers", type=int, default=1, help="processes that make them (%(default)s)")
    add("--shown", type=int, default=2, help="how often each is shown (%(default)s)")
    add("--capacity", type=int, default=2048, help="samples to draw from (%(default)s)")
    add_corpus_options(parser)
    return parser


def _size(text: str) -> tuple[str, int | float]:
    name, _, value = text.partition("=")
    kinds = {field.name: field.type for field in dataclasses.fields(NeoConfig)}
    kind = {"int": int, "float": float}.get(str(kinds.get(name)))
    if kind is None:
        raise argparse.ArgumentTypeError(f"{name!r} is no size of a network")
    return name, kind(value)


def _run(args: argparse.Namespace, device: str) -> TrainResult:
    validation = open_shards(args.validation)
    initial = load_pretrained(args.weights).network if args.weights else None
    network = initial.config if initial else NeoConfig.named(args.config)
    if initial and args.network:
        raise InvalidInputError("--weights come with their sizes", advice="leave out --network")
    network = dataclasses.replace(network, **dict(args.network))
    network = dataclasses.replace(network, frame=args.frame or network.frame, k=validation.k)
    names = {field.name for field in dataclasses.fields(TrainConfig)} & vars(args).keys()
    rest = {name: getattr(args, name) for name in names - {"network", "validation", "shown"}}
    shown = args.shown if args.stream else 0
    config = TrainConfig(network=network, validation=args.validate, shown=shown, **rest)
    before = checkpoint.read(args.out) if args.resume else None
    if initial is not None and before is None and Ranks.here().first:
        errors = validate(initial.to(device).eval(), validation, config)
        print(f"span error on held-out samples, before: {_errors(errors)}", flush=True)
    quiet = True if Ranks.here().rank else None
    with (
        _corpus(args, config, 0 if before is None else before["state"]["step"]) as corpus,
        tqdm(total=args.steps, unit="step", disable=quiet) as bar,
    ):
        return train(
            corpus,
            validation,
            config,
            out=args.out,
            resume=before is not None,
            initial=initial,
            device=device,
            tensorboard=args.tensorboard,
            report=_shown(bar),
            hourly=None if args.hourly is None else _hourly(args.out, open_shards(args.hourly)),
        )


def _corpus(
    args: argparse.Namespace, config: TrainConfig, step: int
) -> AbstractContextManager[Corpus | SampleStream]:
    """Return the folders, or the stream from what a step shows of it on."""
    if bool(args.corpus) == (args.stream is not None):
        raise InvalidInputError("give folders of shards, or --stream FOLDER to make samples")
    if args.stream is None:
        return nullcontext(join([open_shards(folder) for folder in args.corpus]))
    made_of = corpus_config(args)
    first, _ = window(config, step, args.capacity)
    return SampleStream(
        made_of,
        workers=args.makers,
        capacity=args.capacity,
        start=first // made_of.shard_size * made_of.shard_size,
        folder=args.stream,
        bounded=True,
        ahead=made_of.shard_size,
    )


def _hourly(out: Path, full: Corpus) -> Callable[[NeoNetwork, Row], None]:
    """Return what writes the weights so far, and a line on what users would get of them."""

    def write(network: NeoNetwork, row: Row) -> None:
        path = out / "weights.safetensors"
        save_weights(path, network, {"steps": row["step"], "samples": row["samples"]})
        line = (
            f"{time.strftime('%Y-%m-%d %H:%M')}  {row['cpu'] / 3600:.1f} h, {row['samples']:,}"
            f" samples: loss {row['loss']:.5f}, span error {_errors(row)}"
        )
        once, whole = (
            errors_of(Neo(weights=path, smoothing=n), full) for n in (1, Neo().smoothing)
        )
        for form, which in (("clouds", 0), ("meshes", 1)):
            chosen = full.labels["mesh"] == which
            if chosen.any():
                before, span, value = (
                    typical(once[name][chosen]) for name in ("predicted", "span", "value")
                )
                line += (
                    f"; {form} {before:.5f}, {span:.6f} and eigenvalues {value:.2e} after a step of"
                    f" Neo, {whole['steps'][chosen].mean():.1f} steps to its target"
                )
        with (out / "hours.txt").open("a") as file:
            file.write(line + "\n")

    return write


def _shown(bar: tqdm) -> Callable[[Row], None]:
    def show(row: Row) -> None:
        if bar.disable:  # no terminal: a line for each validation
            if "validation" in row:
                print(
                    f"step {row['step']}, {row['seconds'] / 60:.1f} min: loss {row['loss']:.5f},"
                    f" span error {_errors(row)}",
                    flush=True,
                )
            return
        bar.update(int(row["step"]) - bar.n)
        bar.set_postfix(
            {name: f"{row[name]:.4f}" for name in ("loss", "validation") if name in row}
        )

    return show


def _errors(row: Row) -> str:
    after = f", {row['smoothed']:.6f} after smoothing" if "smoothed" in row else ""
    return f"{row['validation']:.5f}{after}"


def main(argv: Sequence[str] | None = None) -> int:
    """Train; return 0, or 2 where the arguments or files do not fit."""
    args = _parser().parse_args(argv)
    torch.set_num_threads(1)  # the workers are the threads
    return exit_code(lambda: _train(args))


def _train(args: argparse.Namespace) -> None:
    path = args.out / "weights.safetensors"
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "group").write_text(f"{os.getpgrp()}\n")  # which a signal can pause
    _be_nice_to_other_sessions()
    with process_group(args.device) as device:
        result = _run(args, device)
        if not Ranks.here().first:
            return
        digest = save_weights(path, result.network, result.record)
    ending = "finished" if result.finished else "interrupted: continue with --resume"
    record = result.record
    print(
        f"{record['steps']} steps, {record['samples']} samples, {record['minutes']} min, {ending}"
    )
    print(f"span error on held-out samples: {record['span_error']}")
    print(f"weights: {path} (sha256 {digest})")


def _be_nice_to_other_sessions() -> None:
    """Extend `nice` to the session that this process leads, by `setsid`.

    Linux shares processors evenly among sessions, whatever the niceness of their processes.
    """
    path = Path("/proc/self/autogroup")
    if os.nice(0) > 0 and os.getsid(0) == os.getpid() and path.exists():
        path.write_text(f"{os.nice(0)}\n")


if __name__ == "__main__":
    raise SystemExit(main())
