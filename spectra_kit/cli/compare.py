"""The command that sets predicted modes beside exact ones."""

from __future__ import annotations

from pathlib import Path

from spectra_kit._validate import check_count
from spectra_kit.cli import program, tables
from spectra_kit.cli.comparing import check_pair, compared, reference_modes
from spectra_kit.cli.inputs import prepare
from spectra_kit.cli.output import check_output, finish, print_blocks
from spectra_kit.cli.outputs import PICTURES, up_of
from spectra_kit.cli.solving import SHOWN, shown_modes

_DRAWN = (1, 2, 5, 10, 25)


def compare(asked: program.Compare) -> None:
    """Set predicted modes beside exact ones, or others, as a table and as a picture."""
    solver, seed, picture = asked.solver, asked.reading.seed, asked.output.picture
    if picture:
        check_output(picture, PICTURES, [asked.file, *solver.files])
    k = check_count("-k", solver.k, low=1)
    shown_modes(asked.output.modes, (), k)
    check_pair(solver, seed)
    geometry, laplacian = prepare(asked.file, asked.reading, asked.operator)
    pair = compared(solver, seed, laplacian, reference_modes(solver, seed, laplacian))
    comparison = pair.comparison
    k = comparison.k
    if not asked.general.json:
        print_blocks(
            tables.headline(asked.file, geometry, laplacian),
            tables.comparison_table(
                pair.names,
                pair.reference,
                pair.predicted,
                comparison,
                shown_modes(asked.output.modes, (*SHOWN, k - 1), k),
            ),
            tables.comparison_lines(pair.names, pair.reference, pair.predicted, comparison),
            f"verdict: {pair.verdict}",
            *([pair.caution] if pair.caution else []),
        )

    def draw(path: Path) -> None:
        from spectra_kit.viz import Page, View, plot_comparison

        first = max(comparison.n_zero_modes - 1, 0)  # one constant function per component is dull
        plot_comparison(
            path,
            geometry,
            pair.reference,
            pair.predicted,
            comparison,
            modes=shown_modes(asked.output.modes, [i + first for i in _DRAWN], k),
            names=pair.names,
            view=View(up_of(asked.drawing, asked.file), asked.drawing.turn),
            page=Page(
                tables.title(asked.file, geometry),
                "; ".join(filter(None, [tables.comparison_line(comparison), pair.caution])),
                asked.drawing.dpi,
            ),
        )

    finish(
        asked.general.json,
        picture,
        draw,
        kept="the numbers are whole",
        input=asked.file,
        geometry=tables.geometry_record(geometry),
        **pair.record(),
    )
