"""The command that computes modes."""

from __future__ import annotations

from pathlib import Path

from spectra_kit._validate import check_count, quantity
from spectra_kit.cli import program, tables
from spectra_kit.cli.inputs import prepare
from spectra_kit.cli.output import check_output, finish, print_blocks
from spectra_kit.cli.outputs import PICTURES
from spectra_kit.cli.progress import say, step
from spectra_kit.cli.solving import SHOWN, check_solvers, shown_modes, solve
from spectra_kit.eigensolvers import verify
from spectra_kit.errors import ConvergenceError, OutOfMemoryError


def spectrum(asked: program.Spectrum) -> None:
    """Compute the lowest modes, show a few, save all, draw their eigenvalues."""
    output, picture, seed = asked.output.output, asked.output.picture, asked.reading.seed
    name = asked.solver.solver
    if output:
        check_output(output, [".npz"], [asked.file])
    if picture:
        check_output(picture, PICTURES, [asked.file])
    k = check_count("-k", asked.solver.k, low=1)
    modes = shown_modes(asked.output.modes, (*SHOWN, k - 1), k)
    check_solvers(asked.solver, seed, name)
    geometry, laplacian = prepare(asked.file, asked.reading, asked.operator)
    try:
        result = solve(laplacian, k, name, asked.solver, seed)
    except (ConvergenceError, OutOfMemoryError) as error:
        if output and error.partial is not None:
            _rescue(error, output.with_suffix(".partial.npz"))
        raise
    if asked.solver.verify and (
        result.certificate is None or result.certificate.level != "verified"
    ):
        with step("counting eigenvalues"):
            result = verify(result, laplacian)
    if output:
        with step(f"writing {output}"):
            result.save(output)
    if not asked.general.json:
        print_blocks(
            tables.headline(asked.file, geometry, laplacian),
            tables.modes_table(result, modes),
            tables.certificate_lines(result),
            *([f"spectrum: {output}"] if output else []),
        )

    def draw(path: Path) -> None:
        from spectra_kit.viz import Page, plot_spectrum
        from spectra_kit.viz.spectra import free_boundary

        plot_spectrum(
            path,
            result,
            free_boundary=free_boundary(geometry, result),
            page=Page(tables.title(asked.file, geometry), dpi=asked.drawing.dpi),
        )

    finish(
        asked.general.json,
        picture,
        draw,
        kept=f"the spectrum {output} is whole" if output else "the numbers are whole",
        input=asked.file,
        geometry=tables.geometry_record(geometry),
        **tables.spectrum_record(result),
        output=output and str(output),
    )


def _rescue(error: ConvergenceError | OutOfMemoryError, path: Path) -> None:
    """Save what there is of a spectrum that was not finished."""
    partial = error.partial
    partial.save(path)
    reached = error.n_converged if isinstance(error, ConvergenceError) else partial.k
    say(f"{quantity(partial.k, 'mode')}, of which {reached} converged: {path}")
