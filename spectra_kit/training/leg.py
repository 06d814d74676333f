"""A leg of training: so many minutes from given weights, and new ones only if they are better.

``python -m spectra_kit.training.leg --minutes 25 --config base`` makes its samples while it
trains, on whatever machine it finds itself. A leg may be cut into phases, one call each, that may
run on different machines: what travels is the folder --out. CONTRIBUTING.md has the calls.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from spectra_kit.errors import SpectraKitError
from spectra_kit.training.wheels import download_wheels, use_wheels

# The processes that make samples import this module too, so torch waits until a phase begins.


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="spectra_kit.training.leg", description=__doc__)
    add = parser.add_argument
    add("--minutes", type=float, default=25, help="of training, all phases together (%(default)g)")
    add("--phase-minutes", type=float, help="end this call by then; the next one goes on")
    add("--config", default="base", help="configuration of the network (%(default)s)")
    add("--weights", help="start from this file instead of the shipped weights of --config")
    add("--fresh", action="store_true", help="start from random weights")
    add("--out", type=Path, default=Path("runs/leg"), help="where results go (%(default)s)")
    add("--state", type=Path, help="where the last phase's results lie (default: --out)")
    add("--scratch", type=Path, default=Path("runs/scratch"), help="stays here (%(default)s)")
    compiled = "torch.compile the network (default: on an accelerator)"
    add("--compile", action=argparse.BooleanOptionalAction, help=compiled)
    add("--device", help="(default: cuda where there is one)")
    add("--batch", type=int, help="clouds per step (800 on an accelerator, 16 on a CPU)")
    add("--points", type=int, default=512, help="drawn from each cloud (%(default)s)")
    add("--n-points", type=int, default=2048, help="of each cloud (%(default)s)")
    add("--lr", type=float, default=2e-3, help="peak learning rate (%(default)g)")
    add("--validation", type=int, default=128, help="number of validation samples (%(default)s)")
    add("--workers", type=int, help="processes that make samples (all cores but one)")
    add("--capacity", type=int, default=32768, help="samples held in memory (%(default)s)")
    add("--packed", type=Path, default=Path(".leg"), help="folder of the pool (%(default)s)")
    add("--wheels", type=Path, default=Path(".wheels"), help="folder of wheels (%(default)s)")
    add("--pack", action="store_true", help="only fill --packed and --wheels, for another machine")
    add("--pool", type=Path, help="with --pack: real meshes ($SPECTRA_KIT_DATA/train_pool)")
    add("--python", default="3.12", help="with --pack: the other machine's (%(default)s)")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run a phase, or pack; return 0, or 1 where something does not fit."""
    began = time.perf_counter()
    args = _parser().parse_args(argv)
    try:
        if args.pack:
            _pack(args)
        else:
            for name in use_wheels(args.wheels):
                print(f"{name} is not installed: taken from {args.wheels}")
            _train(args, began)
    except SpectraKitError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def _train(args: argparse.Namespace, began: float) -> None:
    import torch

    from spectra_kit.training.phases import Leg, Place, new_leg, run_phase

    torch.set_num_threads(1)  # the other cores make samples
    device = args.device or ("cuda" if torch.cuda.is_available() else "cpu")
    place = Place(
        out=args.out,
        state=args.state or args.out,
        scratch=args.scratch,
        packed=args.packed,
        device=device,
        workers=args.workers or max(1, (os.cpu_count() or 2) - 1),
        capacity=args.capacity,
    )
    leg = Leg.read(place.state) or new_leg(
        name=args.config,
        weights=args.weights,
        fresh=args.fresh,
        fast=device != "cpu",
        n_points=args.n_points,
        batch=args.batch,
        minutes=args.minutes,
        points=args.points,
        lr=args.lr,
        validation=args.validation,
    )
    if args.compile is not None:
        leg = replace(leg, config=replace(leg.config, compile=args.compile))
    pause = None
    if args.phase_minutes is not None:  # a tenth of it is kept for saving
        pause = 54 * args.phase_minutes - (time.perf_counter() - began)
    run_phase(leg, place, pause_after=pause, say=lambda line: print(line, flush=True))


def _pack(args: argparse.Namespace) -> None:
    from spectra_kit.training.phases import POOL
    from spectra_kit.training.pool import pack_pool

    args.packed.mkdir(parents=True, exist_ok=True)
    files = download_wheels(args.wheels, python=args.python)
    data = os.environ.get("SPECTRA_KIT_DATA")
    pool = args.pool or (Path(data) / "train_pool" if data else None)
    if pool is None:
        print("no pool of real meshes: give --pool FOLDER, or train on procedural shapes alone")
    else:
        for split in ("train", "val"):
            files.append(args.packed / POOL.format(split))
            pack_pool(pool, files[-1], split)
    for file in files:
        print(f"{file.stat().st_size / 2**20:6.1f} MiB  {file}")
    print(f"{sum(file.stat().st_size for file in files) / 2**20:6.1f} MiB in all")


if __name__ == "__main__":
    raise SystemExit(main())
