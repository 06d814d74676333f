"""The command that shows modes in the browser: as a page of its own, or served to this machine."""

from __future__ import annotations

import argparse
from pathlib import Path

from spectra_kit._validate import check_count, quantity
from spectra_kit.cli import tables
from spectra_kit.cli.options import up_of
from spectra_kit.cli.output import check_output, print_blocks, print_json
from spectra_kit.cli.progress import counted, say
from spectra_kit.cli.solving import (
    Compared,
    alone_record,
    compared,
    name_of,
    named_pair,
    prepare,
    reference_modes,
)
from spectra_kit.cli.unused import refuse_given
from spectra_kit.cli.words import stem
from spectra_kit.explorer import Explorer, write_explorer
from spectra_kit.geometry import Geometry
from spectra_kit.operators import Laplacian
from spectra_kit.spectra import Spectrum
from spectra_kit.viz import View


def explore(arguments: argparse.Namespace) -> None:
    """Write the page, or serve it until Ctrl-C."""
    page: Path = arguments.html or Path(Path(arguments.file).stem + ".html")
    if not arguments.serve:
        refuse_given(arguments, {"port": 0, "no_browser": False}, "without --serve; add it")
    check_output(page, (".html", ".htm"), [arguments.file, *filter(None, [arguments.spectrum])])
    k = check_count("k", arguments.k, low=1)
    check_count("--max-points", arguments.max_points, low=4)
    check_count("--port", arguments.port, low=0, high=65535)
    solvers = named_pair(arguments)
    geometry, laplacian = prepare(arguments)
    reference = reference_modes(arguments, laplacian, solvers)
    pair = None
    if arguments.solver == "none":
        reference = reference.truncate(min(k, reference.k))
    else:
        pair = compared(arguments, laplacian, solvers, reference)
    names = pair.names if pair else (name_of(reference), "")
    with counted(f"writing {page}", "step") as tell:
        written = write_explorer(
            page,
            geometry,
            reference,
            pair.predicted if pair else None,
            comparison=pair.comparison if pair else None,
            names=names,
            title=stem(arguments.file),  # the page itself counts the points
            max_points=arguments.max_points,
            view=View(up_of(arguments)),
            progress=tell,
        )

    def told(url: str | None = None) -> None:
        if arguments.json:
            record = _record(arguments, geometry, reference, pair)
            print_json(**record, explorer=vars(written), url=url)
        else:
            print_blocks(*_tables(arguments, geometry, laplacian, reference, pair), _next(written))
        if url is not None and not arguments.json:
            print_blocks(f"serving it to this machine alone: {url}")
            say("Ctrl-C ends it")

    if not arguments.serve:
        told()
        return
    from spectra_kit.explorer.serve import serve

    serve(page, port=arguments.port, open_browser=not arguments.no_browser, ready=told)


def _record(
    arguments: argparse.Namespace, geometry: Geometry, reference: Spectrum, pair: Compared | None
) -> tables.Record:
    return {
        "input": arguments.file,
        "geometry": tables.geometry_record(geometry),
        **(pair.record() if pair else alone_record(reference)),
    }


def _tables(
    arguments: argparse.Namespace,
    geometry: Geometry,
    laplacian: Laplacian,
    reference: Spectrum,
    pair: Compared | None,
) -> list[str]:
    head = tables.headline(arguments.file, geometry, laplacian)
    if pair is None:
        return [head, tables.certificate_lines(reference)]
    lines = [tables.comparison_line(pair.comparison), f"verdict: {pair.verdict}"]
    return [head, "\n".join(lines), *filter(None, [pair.caution])]


def _next(written: Explorer) -> str:
    """What the page holds, and what to do with it."""
    shown = f"all {quantity(written.n_shown, 'point')}"
    if written.decimated:
        shown = f"{written.n_shown:,} of {written.n_points:,} points (--max-points shows more)"
    rounding = written.quantisation
    values = (
        f"values to {rounding:.0e} of each mode's largest" if rounding else "values as computed"
    )
    return (
        f"page: {written.path}, {written.bytes / 1e6:.1f} MB,"
        f" {quantity(written.n_modes, 'mode')} on {shown},\n"
        f"{values}. Open it in any browser; it needs no\n"
        "network, and can be sent to others as it is."
    )
