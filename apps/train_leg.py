"""A leg of training: so many minutes from given weights, and new ones only if they are better.

``python apps/train_leg.py --minutes 25 --config small`` makes its samples while it trains, on
whatever machine it finds itself. A leg may be cut into phases, one call each, that may run on
different machines: what travels is the folder --out. CONTRIBUTING.md has the calls.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

# The package need not be installed. It is imported once wheels have been found; and the processes
# that make samples import this file too, so torch waits until a phase begins.
sys.path.append(str(Path(__file__).parents[1]))
if TYPE_CHECKING:
    from legs.leg import Leg

# What a leg keeps from its first call. The parser leaves them None, to tell what a call asks for.
DEFAULTS: dict[str, Any] = {
    "minutes": 25.0,
    "config": "base",
    "weights": None,
    "fresh": False,
    "batch": None,
    "n_points": 1024,
    "lr": 2e-3,
    "validation": 512,
}


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--minutes", type=float, help="of training, all phases together (25)")
    add("--phase-minutes", type=float, help="end this call by then; the next one goes on")
    add("--last", action="store_true", help="end the leg, too, with this phase")
    add("--config", help="configuration of the network (base)")
    add("--weights", help="start from this file instead of the shipped weights of --config")
    fresh = "start from random weights"
    add("--fresh", action="store_const", const=True, help=fresh)
    add("--out", type=Path, default=Path("runs/leg"), help="where results go (%(default)s)")
    where = "where the last phase's results lie (default: --out, else --scratch)"
    add("--from", type=Path, dest="source", help=where)
    add("--scratch", type=Path, default=Path("runs/scratch"), help="stays here (%(default)s)")
    compiled = "torch.compile the network (default: on an accelerator)"
    add("--compile", action=argparse.BooleanOptionalAction, help=compiled)
    add("--device", help="(default: cuda where there is one)")
    add("--batch", type=int, help="clouds per step (400 on an accelerator, 16 on a CPU)")
    add("--n-points", type=int, help="of each cloud (1024)")
    add("--lr", type=float, help="peak learning rate (0.002)")
    add("--validation", type=int, help="number of validation samples (512)")
    add("--workers", type=int, help="processes that make samples (all cores but one)")
    add("--capacity", type=int, default=32768, help="samples held in memory (%(default)s)")
    add("--packed", type=Path, default=Path(".leg"), help="folder of real meshes (%(default)s)")
    add("--wheels", type=Path, default=Path(".wheels"), help="folder of wheels (%(default)s)")
    add("--pack", action="store_true", help="only fill --packed and --wheels, for another machine")
    add("--pool", type=Path, help="with --pack: real meshes ($SPECTRA_KIT_DATA/train_pool)")
    add("--python", default="3.12", help="with --pack: the other machine's (%(default)s)")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run a phase, or pack; return 0, or 1 where something does not fit.

    The signal with which ``timeout`` ends a command ends a phase like an error: what it has
    reached is put into ``--out``.
    """
    began = time.perf_counter()
    args = _parser().parse_args(argv)
    from legs.packing import use_wheels

    if not args.pack:
        use_wheels(args.wheels)
    before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    try:
        return _run(args, began)
    except ModuleNotFoundError as error:
        print(f"error: {error}; run with --pack where there is a network", file=sys.stderr)
        return 1
    finally:
        signal.signal(signal.SIGTERM, before)


def _run(args: argparse.Namespace, began: float) -> int:
    from spectra_kit.errors import SpectraKitError

    try:
        if args.pack:
            _pack(args)
        else:
            _train(args, began)
    except SpectraKitError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def _train(args: argparse.Namespace, began: float) -> None:
    import torch
    from legs.leg import begun_leg
    from legs.phase import Place, run_phase

    from spectra_kit._core.threads import usable_cores
    from spectra_kit.errors import InvalidInputError

    if args.last and args.phase_minutes is None:
        raise InvalidInputError("`--last` ends the leg with this phase; give --phase-minutes too")
    torch.set_num_threads(1)  # the other cores make samples
    device = args.device or ("cuda" if torch.cuda.is_available() else "cpu")
    begun = begun_leg(args.out, args.source, args.scratch)
    if begun is None:
        leg, source = _new(args, device), args.out
    else:
        leg, source = begun
        print(f"going on with leg {leg.name} of {source}")
        _check_same(leg, args)
    place = Place(
        out=args.out,
        source=source,
        scratch=args.scratch,
        packed=args.packed,
        device=device,
        workers=args.workers or max(1, usable_cores() - 1),
        capacity=args.capacity,
    )
    if args.compile is not None:
        leg = replace(leg, config=replace(leg.config, compile=args.compile))
    pause = None
    if args.phase_minutes is not None:  # a tenth of it is kept for saving
        pause = 54 * args.phase_minutes - (time.perf_counter() - began)
    run_phase(
        leg, place, pause_after=pause, last=args.last, say=lambda line: print(line, flush=True)
    )


def _new(args: argparse.Namespace, device: str) -> Leg:
    from legs.leg import new_leg

    given = {name: getattr(args, name) for name in DEFAULTS}
    asked = {name: DEFAULTS[name] if v is None else v for name, v in given.items()}
    options = {name: value for name, value in asked.items() if name != "config"}
    leg = new_leg(name=asked["config"], fast=device != "cpu", **options)
    return replace(leg, asked={**asked, "batch": leg.config.batch})


def _check_same(leg: Leg, args: argparse.Namespace) -> None:
    """Refuse options that a leg was not begun with, which would do nothing."""
    from spectra_kit.errors import InvalidInputError

    for name, kept in leg.asked.items():
        wanted = getattr(args, name)
        if wanted not in (None, kept):
            raise InvalidInputError(
                f"leg {leg.name} was begun with {name} = {kept!r}, got {wanted!r}",
                advice="leave that option out (--last ends a leg early), or begin another leg with"
                " another --out and --scratch",
            )


def _pack(args: argparse.Namespace) -> None:
    from legs.packing import download_wheels, pack_pools

    files = download_wheels(args.wheels, args.python)
    data = os.environ.get("SPECTRA_KIT_DATA")
    meshes = args.pool or (Path(data) / "train_pool" if data else None)
    if meshes is None:
        print("no pool of real meshes: give --pool FOLDER, or train on procedural shapes alone")
    else:
        files += pack_pools(meshes, args.packed)
    for file in files:
        print(f"{file.stat().st_size / 2**20:6.1f} MiB  {file}")
    print(f"{sum(file.stat().st_size for file in files) / 2**20:6.1f} MiB in all")


if __name__ == "__main__":
    raise SystemExit(main())
