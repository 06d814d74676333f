"""The command that shows modes in the browser: as a page of its own, or served to this machine."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import spectra_kit as sk
from spectra_kit._core.validate import check_count, quantity
from spectra_kit.cli import options, tables
from spectra_kit.cli.compare import check_pair, compared, name_of, named_record, reference_modes
from spectra_kit.cli.inputs import prepare
from spectra_kit.cli.output import check_output, tell
from spectra_kit.cli.progress import counted, say
from spectra_kit.cli.words import stem

if TYPE_CHECKING:
    from spectra_kit.show.explorer import Explorer


@dataclass(frozen=True, kw_only=True)
class ExploreOptions(options.OnOne, options.Predictor, options.Upright):
    """Look at modes in the browser, exact and predicted side by side."""

    examples = (
        "explore bunny.obj -o bunny.html",
        "explore bunny.obj --serve",
        f"explore {options.DEMO} -k 24 --solver none",
    )
    keys = "input, geometry, reference, predicted, comparison, verdict, explorer, url"
    needs = ("eigen", "show")

    solver: options.OptionalName | None = None
    """what predicts, or none (default: neo)"""
    html: options.Output | None = None
    """the page to write: one file that needs no network (default: the name of FILE with .html, in
    the current folder)"""
    serve: bool = False
    """serve the page to this machine alone, too, until Ctrl-C"""
    max_points: int = 50_000
    """show at most so many points of a larger geometry"""
    port: int = 0
    """of --serve (default: a free one)"""
    no_browser: bool = False
    """with --serve, do not open a browser"""


def explore(asked: ExploreOptions) -> None:
    """Write the page, or serve it until Ctrl-C."""
    from spectra_kit.show.explorer import write_explorer

    page = asked.html or Path(Path(asked.file).stem + ".html")
    if not asked.serve:
        options.refuse_given(asked, ["port", "no_browser"], "without --serve; add it")
    check_output(page, (".html", ".htm"), asked.inputs)
    check_count("--max-points", asked.max_points, low=4)
    check_count("--port", asked.port, low=0, high=65535)
    check_pair(asked)
    geometry, laplacian = prepare(asked)
    reference = reference_modes(asked, laplacian)
    record: tables.Record = {
        "input": asked.file,
        "geometry": tables.geometry_record(geometry),
    }
    if asked.solver == "none":
        pair, reference = None, reference.truncate(min(asked.k, reference.k))
        alone = named_record(name_of(reference), reference)
        record |= {"reference": alone, "verdict": alone["verdict"]}
        record |= {"predicted": None, "comparison": None}
        blocks = [tables.certificate_lines(reference)]
    else:
        pair = compared(asked, laplacian, reference)
        record |= pair.record()
        blocks = [f"{pair.line()}\nverdict: {pair.verdict()}", *pair.cautions]
    with counted(f"writing {page}", "step") as progress:
        written = write_explorer(
            page,
            geometry,
            reference,
            pair.predicted if pair else None,
            comparison=pair.comparison if pair else None,
            names=pair.names if pair else (name_of(reference), ""),
            title=stem(asked.file),  # the page itself counts the points
            max_points=asked.max_points,
            view=sk.show.View(asked.upwards),
            progress=progress,
        )

    def told(url: str | None = None) -> None:
        served = [f"serving it to this machine alone: {url}"] if url else []
        tell(
            asked,
            record | {"explorer": vars(written), "url": url},
            tables.headline(asked.file, geometry, laplacian),
            *blocks,
            _next(written),
            *served,
        )
        if served and not asked.json:
            say("Ctrl-C ends it")

    if asked.serve:
        from spectra_kit.show.explorer.serve import serve

        serve(page, port=asked.port, open_browser=not asked.no_browser, ready=told)
    else:
        told()


def _next(written: "Explorer") -> str:
    """What the page holds, and what to do with it."""
    shown = f"all {quantity(written.n_shown, 'point')}"
    if written.decimated:
        shown = f"{written.n_shown:,} of {written.n_points:,} points (--max-points shows more)"
    values = "values as computed"
    if written.quantisation:
        values = f"values to {written.quantisation:.0e} of each mode's largest"
    return (
        f"page: {written.path}, {written.bytes / 1e6:.1f} MB,"
        f" {quantity(written.n_modes, 'mode')} on {shown},\n"
        f"{values}. Open it in any browser; it needs no\n"
        "network, and can be sent to others as it is."
    )
