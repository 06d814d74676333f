"""The commands that draw modes: still ones, and swinging ones."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from spectra_kit._validate import check_count, check_positive, quantity
from spectra_kit.cli import program, tables
from spectra_kit.cli.inputs import prepare
from spectra_kit.cli.output import check_output, print_blocks, print_json
from spectra_kit.cli.outputs import PICTURES, up_of
from spectra_kit.cli.progress import counted, step
from spectra_kit.cli.solving import check_solvers, refuse_solving, saved, shown_modes, solve
from spectra_kit.geometry import Geometry
from spectra_kit.operators import Laplacian
from spectra_kit.spectra import Spectrum

_DRAWN, _SWUNG = 12, 6


def modes(asked: program.Modes) -> None:
    """Draw modes on one page."""
    if asked.output.columns is not None:
        check_count("--columns", asked.output.columns, low=1)
    shown = _to_show(asked, PICTURES, _DRAWN)
    from spectra_kit.viz import Page, View, plot_modes

    with step(f"drawing {quantity(len(shown.modes), 'mode')}"):
        plot_modes(
            asked.output.output,
            shown.geometry,
            shown.spectrum,
            modes=shown.modes,
            nodal_lines=not asked.output.no_lines,
            columns=asked.output.columns,
            view=View(up_of(asked.drawing, asked.file), asked.drawing.turn),
            page=Page(tables.title(asked.file, shown.geometry), dpi=asked.drawing.dpi),
        )
    _tell(asked, shown, picture=asked.output.output)


def animate(asked: program.Animate) -> None:
    """Let modes swing, one after the other."""
    seconds = check_positive("--seconds", asked.output.seconds)
    fps = check_count("--fps", asked.output.fps, low=1)
    width = check_count("--width", asked.output.width, low=16)
    shown = _to_show(asked, (".gif", ".mp4"), _SWUNG)
    from spectra_kit.viz import View, animate_modes

    with counted(f"drawing {quantity(len(shown.modes), 'mode')}", "frame") as tell:
        animate_modes(
            asked.output.output,
            shown.geometry,
            shown.spectrum,
            modes=shown.modes,
            seconds_per_mode=seconds,
            fps=fps,
            width=width,
            view=View(up_of(asked.drawing, asked.file), asked.drawing.turn),
            progress=tell,
        )
    _tell(asked, shown, animation=asked.output.output)


@dataclass(frozen=True, eq=False)
class _Shown:
    """A geometry, its operator, modes of it, and which of them to show."""

    geometry: Geometry
    laplacian: Laplacian
    spectrum: Spectrum
    modes: tuple[int, ...]


def _to_show(
    asked: program.Modes | program.Animate, suffixes: tuple[str, ...], usual: int
) -> _Shown:
    """Return modes to show: those asked for, else the first `usual` that are not constant."""
    solver, chosen, seed = asked.solver, asked.output.modes, asked.reading.seed
    check_output(asked.output.output, suffixes, [asked.file, *solver.files])
    for mode in chosen or ():
        check_count("--modes", mode, low=0)
    if solver.spectrum:
        refuse_solving(solver)
    check_solvers(solver, seed, solver.solver)
    geometry, laplacian = prepare(asked.file, asked.reading, asked.operator)
    if solver.spectrum:
        spectrum = saved(solver.spectrum, laplacian)
        if solver.k is not None:
            spectrum = spectrum.truncate(solver.k)
    else:
        needed = max(chosen) + 1 if chosen else usual + laplacian.kernel_dimension
        k = min(needed, len(laplacian.free)) if solver.k is None else solver.k
        spectrum = solve(laplacian, max(k, 1), solver.solver, solver, seed)
    first = spectrum.n_zero_modes
    which = shown_modes(chosen, range(first, first + usual), spectrum.k)
    return _Shown(geometry, laplacian, spectrum, which)


def _tell(asked: program.Modes | program.Animate, shown: _Shown, **written: Path) -> None:
    """Say what was drawn and where it is."""
    if asked.general.json:
        print_json(
            input=asked.file,
            geometry=tables.geometry_record(shown.geometry),
            **tables.spectrum_record(shown.spectrum),
            modes=shown.modes,
            **written,
        )
        return
    print_blocks(
        tables.headline(asked.file, shown.geometry, shown.laplacian),
        tables.modes_table(shown.spectrum, shown.modes),
        *(f"{what}: {path}" for what, path in written.items()),
    )
