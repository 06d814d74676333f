"""Three of the commands: each takes parsed arguments and writes to stdout."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Callable
from pathlib import Path

from spectra_kit._validate import check_count, quantity
from spectra_kit.cli import tables
from spectra_kit.cli.folder import drawing
from spectra_kit.cli.inputs import assemble, load, solvers_named
from spectra_kit.cli.options import PICTURES, up_of
from spectra_kit.cli.output import check_output, print_blocks, print_json
from spectra_kit.cli.progress import say, step
from spectra_kit.cli.solving import (
    compared,
    named_pair,
    prepare,
    reference_modes,
    shown_modes,
    solve,
)
from spectra_kit.cli.words import in_options
from spectra_kit.eigensolvers import verify
from spectra_kit.errors import ConvergenceError, InvalidInputError, OutOfMemoryError
from spectra_kit.geometry import diagnose

_SHOWN = (0, 1, 2, 5, 10, 25, 50)  # and the last
_DRAWN = (1, 2, 5, 10, 25)


def spectrum(arguments: argparse.Namespace) -> None:
    """Compute the lowest modes, show a few, save all, draw their eigenvalues."""
    output, picture = arguments.output, arguments.picture
    if output:
        check_output(output, [".npz"], [arguments.file])
    if picture:
        check_output(picture, PICTURES, [arguments.file])
    k = check_count("k", arguments.k, low=1)
    modes = shown_modes(arguments.modes, (*_SHOWN, k - 1), k)
    (solver,) = solvers_named(arguments, arguments.solver)
    geometry, laplacian = prepare(arguments)
    try:
        result = solve(laplacian, k, arguments.solver, solver)
    except (ConvergenceError, OutOfMemoryError) as error:
        if output and error.partial is not None:
            rescued = output.with_suffix(".partial.npz")
            error.partial.save(rescued)
            k = error.partial.k
            reached = error.n_converged if isinstance(error, ConvergenceError) else k
            say(f"{quantity(k, 'mode')}, of which {reached} converged: {rescued}")
        raise
    if arguments.verify and (result.certificate is None or result.certificate.level != "verified"):
        with step("counting eigenvalues"):
            result = verify(result, laplacian)
    if output:
        with step(f"writing {output}"):
            result.save(output)
    if not arguments.json:
        print_blocks(
            tables.headline(arguments.file, geometry, laplacian),
            tables.modes_table(result, modes),
            tables.certificate_lines(result),
            *([f"spectrum: {output}"] if output else []),
        )

    def draw(path: Path) -> None:
        from spectra_kit.viz import Page, plot_spectrum
        from spectra_kit.viz.boundary import free_boundary

        plot_spectrum(
            path,
            result,
            free_boundary=free_boundary(geometry, result),
            page=Page(tables.title(arguments.file, geometry), dpi=arguments.dpi),
        )

    _finish(
        arguments,
        draw,
        kept=f"the spectrum {output} is whole" if output else "the numbers are whole",
        geometry=tables.geometry_record(geometry),
        **tables.spectrum_record(result),
        output=output and str(output),
    )


def compare(arguments: argparse.Namespace) -> None:
    """Set predicted modes beside exact ones, or others, as a table and as a picture."""
    picture: Path | None = arguments.picture
    if picture:
        check_output(picture, PICTURES, [arguments.file, *filter(None, [arguments.spectrum])])
    k = check_count("k", arguments.k, low=1)
    shown_modes(arguments.modes, (), k)
    solvers = named_pair(arguments)
    geometry, laplacian = prepare(arguments)
    pair = compared(arguments, laplacian, solvers, reference_modes(arguments, laplacian, solvers))
    comparison = pair.comparison
    k = comparison.k
    if not arguments.json:
        print_blocks(
            tables.headline(arguments.file, geometry, laplacian),
            tables.comparison_table(
                pair.names,
                pair.reference,
                pair.predicted,
                comparison,
                shown_modes(arguments.modes, (*_SHOWN, k - 1), k),
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
            modes=shown_modes(arguments.modes, [i + first for i in _DRAWN], k),
            names=pair.names,
            view=View(up_of(arguments), arguments.turn),
            page=Page(
                tables.title(arguments.file, geometry),
                "; ".join(filter(None, [tables.comparison_line(comparison), pair.caution])),
                arguments.dpi,
            ),
        )

    _finish(
        arguments,
        draw,
        kept="the numbers are whole",
        geometry=tables.geometry_record(geometry),
        **pair.record(),
    )


def _finish(
    arguments: argparse.Namespace, draw: Callable[[Path], None], *, kept: str, **record: object
) -> None:
    """Draw where that was asked for; print the JSON after that, also where it ends early."""
    picture: Path | None = arguments.picture
    drawn = None
    try:
        if picture:
            with drawing([picture], kept=kept):
                draw(picture)
            drawn = str(picture)
    finally:
        if arguments.json:
            print_json(input=arguments.file, **record, picture=drawn)
    if drawn and not arguments.json:
        print_blocks(f"picture: {drawn}")


def info(arguments: argparse.Namespace) -> None:
    """Say what a file holds, what is wrong with it, and what the operator makes of it."""
    geometry = load(arguments)
    with step("looking at it"):
        diagnosis = diagnose(geometry)
    try:
        with step("assembling the Laplacian"):
            operator = tables.operator_record(assemble(arguments, geometry))
    except InvalidInputError as error:
        operator = {"refused": in_options(str(error))}
    if arguments.json:
        print_json(
            input=arguments.file,
            kind=tables.kind(geometry),
            diagnosis=dataclasses.asdict(diagnosis),
            problems=[in_options(str(problem)) for problem in diagnosis.problems],
            operator=operator,
        )
        return
    print_blocks(
        tables.diagnosis_lines(arguments.file, geometry, diagnosis), tables.pairs(operator)
    )
