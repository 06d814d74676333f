"""The command that shows modes in the browser: as a page of its own, or served to this machine."""

from __future__ import annotations

from pathlib import Path

from spectra_kit._validate import check_count, quantity
from spectra_kit.cli import program, tables
from spectra_kit.cli.comparing import (
    Compared,
    alone_record,
    check_pair,
    compared,
    name_of,
    reference_modes,
)
from spectra_kit.cli.inputs import prepare
from spectra_kit.cli.options import refuse_given
from spectra_kit.cli.output import check_output, print_blocks, print_json
from spectra_kit.cli.outputs import up_of
from spectra_kit.cli.progress import counted, say
from spectra_kit.cli.words import stem
from spectra_kit.explorer import Explorer, write_explorer
from spectra_kit.geometry import Geometry
from spectra_kit.operators import Laplacian
from spectra_kit.spectra import Spectrum
from spectra_kit.viz import View


def explore(asked: program.Explore) -> None:
    """Write the page, or serve it until Ctrl-C."""
    solver, output, seed = asked.solver, asked.output, asked.reading.seed
    page = output.html or Path(Path(asked.file).stem + ".html")
    if not output.serve:
        refuse_given(output, ["port", "no_browser"], "without --serve; add it")
    check_output(page, (".html", ".htm"), [asked.file, *solver.files])
    k = check_count("-k", solver.k, low=1)
    check_count("--max-points", output.max_points, low=4)
    check_count("--port", output.port, low=0, high=65535)
    check_pair(solver, seed)
    geometry, laplacian = prepare(asked.file, asked.reading, asked.operator)
    reference = reference_modes(solver, seed, laplacian)
    pair = None
    if solver.solver == "none":
        reference = reference.truncate(min(k, reference.k))
    else:
        pair = compared(solver, seed, laplacian, reference)
    names = pair.names if pair else (name_of(reference), "")
    with counted(f"writing {page}", "step") as tell:
        written = write_explorer(
            page,
            geometry,
            reference,
            pair.predicted if pair else None,
            comparison=pair.comparison if pair else None,
            names=names,
            title=stem(asked.file),  # the page itself counts the points
            max_points=output.max_points,
            view=View(up_of(asked.drawing, asked.file)),
            progress=tell,
        )

    def told(url: str | None = None) -> None:
        if asked.general.json:
            record = _record(asked, geometry, reference, pair)
            print_json(**record, explorer=vars(written), url=url)
        else:
            print_blocks(*_tables(asked, geometry, laplacian, reference, pair), _next(written))
        if url is not None and not asked.general.json:
            print_blocks(f"serving it to this machine alone: {url}")
            say("Ctrl-C ends it")

    if not output.serve:
        told()
        return
    from spectra_kit.explorer.serve import serve

    serve(page, port=output.port, open_browser=not output.no_browser, ready=told)


def _record(
    asked: program.Explore, geometry: Geometry, reference: Spectrum, pair: Compared | None
) -> tables.Record:
    return {
        "input": asked.file,
        "geometry": tables.geometry_record(geometry),
        **(pair.record() if pair else alone_record(reference)),
    }


def _tables(
    asked: program.Explore,
    geometry: Geometry,
    laplacian: Laplacian,
    reference: Spectrum,
    pair: Compared | None,
) -> list[str]:
    head = tables.headline(asked.file, geometry, laplacian)
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
