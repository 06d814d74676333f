"""Three of the commands: each takes parsed arguments and writes to stdout."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path

from spectra_kit._validate import check_count
from spectra_kit.cli import tables
from spectra_kit.cli.inputs import EXTRA, assemble, load, solvers_named
from spectra_kit.cli.output import check_output, print_blocks, print_json, progress
from spectra_kit.eigensolvers import eigensolve, verify
from spectra_kit.errors import ConvergenceError, InvalidInputError, OutOfMemoryError
from spectra_kit.geometry import Geometry, diagnose
from spectra_kit.metrics import compare_spectra, subspace_span_error
from spectra_kit.operators import Laplacian

_SHOWN = (0, 1, 2, 5, 10, 25, 50)  # and the last
_DRAWN = (1, 2, 5, 10, 25)


def spectrum(arguments: argparse.Namespace) -> None:
    """Compute the lowest modes, show a few, save all."""
    if arguments.output:
        check_output(arguments.output, ".npz")
    k = check_count("k", arguments.k, low=1)
    modes = _modes(arguments.modes, (*_SHOWN, k - 1), k)
    (solver,) = solvers_named(arguments, arguments.solver)
    geometry, laplacian = _prepare(arguments)
    progress(f"solving for {k} modes with {arguments.solver}")
    try:
        result = eigensolve(laplacian, k, solver)
    except (ConvergenceError, OutOfMemoryError) as error:
        if arguments.output and error.partial is not None:
            rescued = arguments.output.with_suffix(".partial.npz")
            error.partial.save(rescued)
            sys.stderr.write(f"the {error.partial.k} modes that converged: {rescued}\n")
        raise
    if arguments.verify:
        progress("counting eigenvalues")
        result = verify(result, laplacian)
    if arguments.output:
        result.save(arguments.output)
    if arguments.json:
        print_json(
            input=arguments.file,
            geometry=tables.geometry_record(geometry),
            **tables.spectrum_record(result),
            output=arguments.output and str(arguments.output),
        )
        return
    print_blocks(
        tables.headline(arguments.file, geometry, laplacian),
        tables.modes_table(result, modes),
        tables.certificate_lines(result),
    )
    if arguments.output:
        print_blocks(f"spectrum: {arguments.output}")


def compare(arguments: argparse.Namespace) -> None:
    """Set predicted modes beside exact ones, as a table and as a picture."""
    picture: Path | None = arguments.picture
    if picture:
        check_output(picture, ".png")
    k = check_count("k", arguments.k, low=1)
    modes = _modes(arguments.modes, (*_SHOWN, k - 1), k)
    predictor = arguments.solver or _default_predictor()
    names = (arguments.against, predictor)
    solvers = dict(zip(names, solvers_named(arguments, *names), strict=True))
    geometry, laplacian = _prepare(arguments)
    check_count("k", k, low=1, high=len(laplacian.free))
    spectra = {}
    for name, solver in solvers.items():
        progress(f"solving for {k} modes with {name}")
        spectra[name] = eigensolve(laplacian, min(k + EXTRA, len(laplacian.free)), solver)
    exact, predicted = spectra[arguments.against], spectra[predictor]
    progress("comparing")
    comparison = compare_spectra(exact, predicted, k=k)
    subspace = getattr(solvers[predictor], "subspace", None)
    if subspace is not None:
        error, dimension = subspace_span_error(subspace, laplacian, exact, predicted)
        comparison = dataclasses.replace(comparison, span_error=error[:k], span_dimension=dimension)
    if not arguments.json:
        print_blocks(
            tables.headline(arguments.file, geometry, laplacian),
            tables.comparison_table(exact, predicted, comparison, modes),
            tables.comparison_lines(arguments.against, exact, predictor, predicted, comparison),
        )
    if picture:
        from spectra_kit.viz import plot_comparison

        first = max(comparison.n_zero_modes - 1, 0)  # one constant function per component is dull
        progress("drawing")
        plot_comparison(
            picture,
            geometry,
            exact,
            predicted,
            comparison,
            modes=_modes(arguments.modes, [i + first for i in _DRAWN], k),
            names=(f"exact: {arguments.against}", f"predicted: {predictor}"),
            title=f"{Path(arguments.file).stem}, {geometry.n:,} points",
            subtitle=tables.comparison_line(comparison),
        )
    if arguments.json:
        print_json(
            input=arguments.file,
            geometry=tables.geometry_record(geometry),
            exact=tables.spectrum_record(exact),
            predicted=tables.spectrum_record(predicted),
            comparison=tables.comparison_record(comparison),
            picture=picture and str(picture),
        )
    elif picture:
        print_blocks(f"picture: {picture}")


def info(arguments: argparse.Namespace) -> None:
    """Say what a file holds, what is wrong with it, and what the operator makes of it."""
    geometry = load(arguments)
    diagnosis = diagnose(geometry)
    try:
        operator = tables.operator_record(assemble(arguments, geometry))
    except InvalidInputError as error:
        operator = {"refused": str(error)}
    if arguments.json:
        print_json(
            input=arguments.file,
            kind=tables.kind(geometry),
            diagnosis=dataclasses.asdict(diagnosis),
            problems=list(diagnosis.problems),
            operator=operator,
        )
        return
    print_blocks(
        tables.diagnosis_lines(arguments.file, geometry, diagnosis), tables.pairs(operator)
    )


def _prepare(arguments: argparse.Namespace) -> tuple[Geometry, Laplacian]:
    geometry = load(arguments)
    progress(f"assembling the Laplacian of {geometry.n:,} points")
    return geometry, assemble(arguments, geometry)


def _default_predictor() -> str:
    from spectra_kit.neo.pretrained import WEIGHTS

    return "neo" if WEIGHTS else "fourier"


def _modes(asked: Sequence[int] | None, usual: Sequence[int], k: int) -> tuple[int, ...]:
    """The modes to show: those asked for, else the usual ones, up to k."""
    if asked is not None:
        return tuple(check_count("modes", i, low=0, high=k - 1) for i in asked)
    return tuple(sorted({i for i in usual if i < k})) or (k - 1,)
