"""Options that change nothing as things are: refused, for who gives one expects something of it."""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping

from spectra_kit.cli.options import DEMO, DRAWING, MAKING
from spectra_kit.errors import InvalidInputError


def refuse_given(arguments: argparse.Namespace, defaults: Mapping[str, object], why: str) -> None:
    """Refuse options that have no effect as things are, where they differ from their defaults."""
    for option, default in defaults.items():
        if getattr(arguments, option, default) != default:
            raise InvalidInputError(
                f"--{option.replace('_', '-')} has no effect {why}, or leave it out"
            )


def refuse_unused(arguments: argparse.Namespace) -> None:
    """Refuse what is for the demo on files alone, and what is for pictures where none is drawn."""
    given = vars(arguments)
    if DEMO not in (given.get(name, "") for name in ("file", "source", "target")):
        refuse_given(arguments, MAKING, f"on files; name {DEMO!r} instead")
    if given.get("no_pictures"):
        refuse_given(arguments, DRAWING, "with --no-pictures; let them be drawn")
    elif not given.get("picture", True):
        refuse_given(arguments, DRAWING, "without a picture; name one by --picture")
    if not math.isfinite(turn := given.get("turn", 0.0)):
        raise InvalidInputError(f"`--turn` must be a finite number of degrees, got {turn}")
