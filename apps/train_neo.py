"""Train a NEO network on a corpus of shards, and write its weights."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path

import torch

from spectra_kit.errors import SpectraKitError
from spectra_kit.neo.model import NeoConfig
from spectra_kit.neo.pretrained import save_weights
from spectra_kit.training.config import TrainConfig
from spectra_kit.training.shards import open_shards
from spectra_kit.training.train import train


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add("corpus", type=Path, help="folder of shards")
    add("validation", type=Path, help="folder of shards, other samples")
    add("--out", type=Path, required=True, help="folder for checkpoint, log and weights")
    add("--config", default="small", help="small, base, deep or large")
    add("--frame", default="principal", choices=["principal", "none"])
    add("--steps", type=int, default=100_000, help="length of the schedule")
    add("--minutes", type=float, help="end the schedule by the clock instead")
    add("--batch", type=int, default=16, help="clouds per step")
    add("--points", type=int, default=512, help="points drawn from each cloud")
    add("--lr", type=float, default=5e-3)
    add("--decay", type=float, default=0.2, help="share of the schedule in which the rate falls")
    add("--alpha", type=float, default=1e-3, help="weight of the orthogonality regulariser")
    add("--flips", type=float, default=1.0, help="share of samples in a random proper flip")
    add("--precision", default="float32", choices=["float32", "bfloat16", "float16"])
    add("--validate", type=int, default=64, help="number of validation samples")
    add("--every", type=int, default=200, help="steps between validations and checkpoints")
    add("--seed", type=int, default=0)
    add("--workers", type=int, default=1, help="CPU threads that share each batch")
    add("--device", default="cpu")
    add("--resume", action="store_true", help="continue from the checkpoint in --out")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Train; return 0, or 1 where the arguments or files do not fit."""
    args = _parser().parse_args(argv)
    torch.set_num_threads(1)  # the workers are the threads
    try:
        network = dataclasses.replace(NeoConfig.named(args.config), frame=args.frame)
        same = ("steps", "minutes", "batch", "points", "lr", "decay", "alpha", "flips", "precision")
        same += ("every", "workers", "seed")
        rest = {name: getattr(args, name) for name in same}
        config = TrainConfig(network=network, validation=args.validate, **rest)
        corpus, validation = open_shards(args.corpus), open_shards(args.validation)
        result = train(
            corpus, validation, config, out=args.out, resume=args.resume, device=args.device
        )
        path = args.out / "weights.safetensors"
        digest = save_weights(path, result.network, result.record)
    except SpectraKitError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    ending = "finished" if result.finished else "interrupted: continue with --resume"
    record = result.record
    print(
        f"{record['steps']} steps, {record['samples']} samples, {record['minutes']} min, {ending}"
    )
    print(f"span error on held-out samples: {record['span_error']}")
    print(f"weights: {path} (sha256 {digest})")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
