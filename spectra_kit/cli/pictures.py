"""The commands that draw modes: still ones, and swinging ones."""

from __future__ import annotations

import argparse
from pathlib import Path

from spectra_kit._validate import check_count, check_positive, quantity
from spectra_kit.cli import tables
from spectra_kit.cli.options import PICTURES, up_of
from spectra_kit.cli.output import check_output, print_blocks, print_json
from spectra_kit.cli.progress import counted, step
from spectra_kit.cli.solving import Shown, to_show

_DRAWN, _SWUNG = 12, 6


def modes(arguments: argparse.Namespace) -> None:
    """Draw modes on one page."""
    _check(arguments, PICTURES)
    if arguments.columns is not None:
        check_count("--columns", arguments.columns, low=1)
    shown = to_show(arguments, _DRAWN)
    from spectra_kit.viz import Page, View, plot_modes

    with step(f"drawing {quantity(len(shown.modes), 'mode')}"):
        plot_modes(
            arguments.output,
            shown.geometry,
            shown.spectrum,
            modes=shown.modes,
            nodal_lines=not arguments.no_lines,
            columns=arguments.columns,
            view=View(up_of(arguments), arguments.turn),
            page=Page(tables.title(arguments.file, shown.geometry), dpi=arguments.dpi),
        )
    _tell(arguments, shown, "picture")


def animate(arguments: argparse.Namespace) -> None:
    """Let modes swing, one after the other."""
    _check(arguments, (".gif", ".mp4"))
    seconds = check_positive("--seconds", arguments.seconds)
    fps = check_count("--fps", arguments.fps, low=1)
    width = check_count("--width", arguments.width, low=16)
    shown = to_show(arguments, _SWUNG)
    from spectra_kit.viz import View, animate_modes

    with counted(f"drawing {quantity(len(shown.modes), 'mode')}", "frame") as tell:
        animate_modes(
            arguments.output,
            shown.geometry,
            shown.spectrum,
            modes=shown.modes,
            seconds_per_mode=seconds,
            fps=fps,
            width=width,
            view=View(up_of(arguments), arguments.turn),
            progress=tell,
        )
    _tell(arguments, shown, "animation")


def _check(arguments: argparse.Namespace, suffixes: tuple[str, ...]) -> None:
    inputs: list[str | Path] = [arguments.file]
    if arguments.spectrum:
        inputs.append(arguments.spectrum)
    check_output(arguments.output, suffixes, inputs)


def _tell(arguments: argparse.Namespace, shown: Shown, what: str) -> None:
    """Say what was drawn and where it is."""
    if arguments.json:
        print_json(
            input=arguments.file,
            geometry=tables.geometry_record(shown.geometry),
            **tables.spectrum_record(shown.spectrum),
            modes=shown.modes,
            **{what: str(arguments.output)},
        )
        return
    print_blocks(
        tables.headline(arguments.file, shown.geometry, shown.laplacian),
        tables.modes_table(shown.spectrum, shown.modes),
        f"{what}: {arguments.output}",
    )
