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
from studies.command import exit_code
from tqdm import tqdm

from spectra_kit._core.validate import check_count
from spectra_kit.eigen import Neo
from spectra_kit.errors import InvalidInputError
from spectra_kit.neo.model import NeoConfig, NeoNetwork
from spectra_kit.neo.pretrained import load_pretrained, save_weights
from spectra_kit.neo.train import checkpoint
from spectra_kit.neo.train.checkpoint import Row
from spectra_kit.neo.train.config import TrainConfig
from spectra_kit.neo.train.corpus import Corpus, Source, open_shards, read_fingerprint, shard_number
from spectra_kit.neo.train.evaluation import errors_of, typical, validate
from spectra_kit.neo.train.ranks import Ranks, process_group
from spectra_kit.neo.train.stream import SampleStream, window
from spectra_kit.neo.train.train import TrainResult, train


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__,
        epilog="Several devices: torchrun --nproc-per-node N apps/train_neo.py ... --device cuda",
    )
    add = parser.add_argument
    add("corpus", type=Path, nargs="*", help="folders of shards; one named twice counts twice")
    add("--validation", type=Path, required=True, help="folder of shards, other samples")
    add("--out", type=Path, required=True, help="folder for checkpoint, log and weights")
    add("--config", help="a name that NeoConfig.named knows (default: small)")
    sizes = "what it has otherwise, such as m=192; may come several times"
    add("--network", action="append", default=[], type=_size, help=sizes)
    add("--frame", choices=["principal", "none"], help="(default: that of the weights; principal)")
    add("--weights", help="begin with these weights, a name or a file, and their configuration")
    beat = "write weights only if they are better than these, a name or a file"
    add("--beat", help=beat)
    add("--steps", type=int, default=100_000, help="length of the schedule")
    add("--minutes", type=float, help="end the schedule by the clock, if not by the steps before")
    pause = "end this call after so many minutes, as Ctrl-C would; --resume goes on"
    add("--pause", type=float, help=pause)
    add("--last", action="store_true", help="end the schedule, too, with this call of --pause")
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
    rows = "steps between rows of the log"  # torchrun takes --log for one of its own
    add("--rows", dest="log", type=int, default=20, help=rows)
    add("--save", type=float, default=60, help="seconds between checkpoints")
    seed = "of weights, order and poses; of a stream's samples, too: not that of the validation's"
    add("--seed", type=int, default=0, help=seed)
    add("--workers", type=int, default=1, help="CPU threads that share each batch")
    add("--device", default="cpu")
    add("--compile", action="store_true", help="torch.compile the network")
    add("--tensorboard", action="store_true", help="event files too, in OUT/events")
    resume = "continue from the checkpoint in --out, or begin where there is none yet"
    add("--resume", action="store_true", help=resume)
    full = "folder of shards, few of many points: test Neo on them for each hour of CPU time"
    add("--hourly", type=Path, help=full)
    add_stream_options(parser.add_argument_group("samples made while training"))
    return parser


def add_stream_options(group: argparse._ActionsContainer) -> None:
    """Add what a stream is, and what its samples are made of."""
    add = group.add_argument
    kept = "make samples, too, and keep the latest in this folder, which is for nothing else"
    add("--stream", type=Path, help=kept)
    add("--makers", type=int, default=1, help="processes that make them (%(default)s)")
    shown = "how often each is shown; 0: whatever is there, and no step waits (%(default)s)"
    add("--shown", type=int, default=2, help=shown)
    add("--capacity", type=int, default=2048, help="samples to draw from (%(default)s)")
    add_corpus_options(group)


def _size(text: str) -> tuple[str, int | float]:
    name, _, value = text.partition("=")
    kinds = {field.name: field.type for field in dataclasses.fields(NeoConfig)}
    del kinds["k"]  # of the samples
    kind = {"int": int, "float": float}.get(str(kinds.get(name)))
    if kind is None:
        raise argparse.ArgumentTypeError(f"{name!r} is no size of a network")
    return name, kind(value)


def _run(args: argparse.Namespace, device: str) -> TrainResult:
    validation = open_shards(args.validation)
    initial = load_pretrained(args.weights).network if args.weights else None
    network = initial.config if initial else NeoConfig.named(args.config or "small")
    if initial and (args.network or args.config):
        raise InvalidInputError(
            "--weights come with their sizes", advice="leave out --network and --config"
        )
    sizes = dict(args.network) | {"frame": args.frame or network.frame, "k": validation.k}
    network = dataclasses.replace(network, **sizes)
    names = {field.name for field in dataclasses.fields(TrainConfig)} & vars(args).keys()
    rest = {name: getattr(args, name) for name in names - {"network", "validation", "shown"}}
    shown = check_count("--shown", args.shown, low=0) if args.stream else 0
    config = TrainConfig(network=network, validation=args.validate, shown=shown, **rest)
    before = checkpoint.read(args.out) if args.resume else None
    if initial is not None and before is None and Ranks.here().first:
        errors = validate(initial.to(device).eval(), validation, config)
        print(f"span error on held-out samples, before: {_errors(errors)}", flush=True)
    begun = 0 if before is None else before["state"]["step"]
    quiet = True if Ranks.here().rank else None
    with (
        _corpus(args, config, begun) as corpus,
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
            pause_after=None if args.pause is None else 60 * args.pause,
            last=args.last,
            tensorboard=args.tensorboard,
            report=_shown(bar),
            hourly=None if args.hourly is None else _hourly(args.out, open_shards(args.hourly)),
        )


def _corpus(
    args: argparse.Namespace, config: TrainConfig, step: int
) -> AbstractContextManager[Source]:
    """Return the folders, or the stream from what a step shows of it on."""
    if bool(args.corpus) == (args.stream is not None):
        raise InvalidInputError("give folders of shards, or --stream FOLDER to make samples")
    held_out = {_seed(folder) for folder in (args.validation, args.hourly) if folder is not None}
    if args.stream is None:
        _refuse(held_out & {_seed(folder) for folder in args.corpus} - {None})
        return nullcontext(open_shards(*args.corpus))
    if Ranks.here().world > 1:
        raise InvalidInputError(
            "--stream is for one process",
            advice="make the samples with make_corpus.py, and train on their folder",
        )
    _refuse(held_out & {args.seed})
    made_of = corpus_config(args)
    if config.shown:
        first, _ = window(config, step, args.capacity)
    else:  # those of before, or of numbers that no step has shown
        there = [shard_number(path) for path in args.stream.glob("shard_*")]
        first = min(there) * made_of.shard_size if there else step * config.batch
    return SampleStream(
        made_of,
        workers=args.makers,
        capacity=args.capacity,
        start=first // made_of.shard_size * made_of.shard_size,
        folder=args.stream,
        ahead=made_of.shard_size if config.shown else None,
    )


def _seed(folder: Path) -> int | None:
    """Return the seed that a corpus was made with, None where that is not known."""
    path = folder / "corpus.json"
    return read_fingerprint(path).get("seed") if path.exists() else None


def _refuse(seeds: set[int | None]) -> None:
    """Refuse surfaces that a network would be trained and validated on."""
    if seeds:
        raise InvalidInputError(
            f"samples to train and to validate on are the same: both of seed {seeds.pop()}",
            advice="make those of validation, or the others, with another --seed",
        )


def _hourly(out: Path, full: Corpus) -> Callable[[NeoNetwork, Row], None]:
    """Return what writes the weights so far, and a line on what users would get of them."""
    if not full.has_operators:
        raise InvalidInputError(
            "--hourly", "have operators", "samples without", advice="make it anew"
        )

    def write(network: NeoNetwork, row: Row) -> None:
        path = out / "weights.safetensors"
        save_weights(path, network, {"steps": row["step"], "samples": row["samples"]})
        line = (
            f"{time.strftime('%Y-%m-%d %H:%M')}  {row['cpu'] / 3600:.1f} h, {row['samples']:,}"
            f" samples: span error {_errors(row)}; geometric means of"
        )
        once, whole = (
            errors_of(Neo(weights=path, max_steps=n), full) for n in (1, Neo().max_steps)
        )
        for form, which in (("clouds", 0), ("meshes", 1)):
            chosen = full.labels["mesh"] == which
            if chosen.any():
                before, span, value = (
                    typical(once[name][chosen]) for name in ("predicted", "span", "value")
                )
                line += (
                    f" {form} {before:.5f}, {span:.6f} and eigenvalues {value:.2e} after a step of"
                    f" Neo, {whole['steps'][chosen].mean():.1f} steps to its target;"
                )
        with (out / "hours.txt").open("a") as file:
            file.write(line.rstrip(";") + "\n")

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
    _check_stream(args)
    path = args.out / "weights.safetensors"
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "group").write_text(f"{os.getpgrp()}\n")  # which a signal can pause
    _be_nice_to_other_sessions()
    with process_group(args.device) as device:
        result = _run(args, device)
        if not Ranks.here().first:
            return
        record = dict(result.record)
        if args.weights:
            first = load_pretrained(args.weights)
            told = {name: value for name, value in first.record.items() if name != "history"}
            record["begun_with"] = {"weights": args.weights, "sha256": first.sha256, "record": told}
        worse = args.beat and _worse(args, result.network)
        digest = None if worse else save_weights(path, result.network, record)
    ending = "finished" if result.finished else "interrupted: continue with --resume"
    print(
        f"{record['steps']} steps, {record['samples']} samples, {record['minutes']} min, {ending}"
    )
    told = "not known: validated at the last step alone"
    error = told if record["span_error"] is None else f"{record['span_error']:.5f}"
    print(f"span error on held-out samples ({record['mean']} mean): {error}")
    print(worse if worse else f"weights: {path} (sha256 {digest})")


def _worse(args: argparse.Namespace, network: NeoNetwork) -> str:
    """Return why a network is not written: nothing where it beats the weights that it is to."""
    corpus = open_shards(args.validation)
    rival = load_pretrained(args.beat).network
    old, new = (
        validate(
            one.to("cpu"),
            corpus,
            TrainConfig(network=one.config, steps=1, validation=args.validate),
        )["validation"]
        for one in (rival, network)
    )
    return "" if new < old else f"no weights written: {new:.5f} is no better than {old:.5f}"


def _check_stream(args: argparse.Namespace) -> None:
    """Refuse options of samples that are not made."""
    if args.stream is not None:
        return
    parser = argparse.ArgumentParser()
    add_stream_options(parser)
    given = [
        name for name, value in vars(parser.parse_args([])).items() if value != vars(args)[name]
    ]
    if given:
        raise InvalidInputError(
            f"{', '.join(f'--{name}' for name in given)} is for samples that are made",
            advice="give --stream FOLDER, too, or make a corpus of that kind",
        )


def _be_nice_to_other_sessions() -> None:
    """Extend `nice` to the session that this process leads, by `setsid`.

    Linux shares processors evenly among sessions, whatever the niceness of their processes.
    """
    path = Path("/proc/self/autogroup")
    if os.nice(0) > 0 and os.getsid(0) == os.getpid() and path.exists():
        path.write_text(f"{os.nice(0)}\n")


if __name__ == "__main__":
    raise SystemExit(main())
