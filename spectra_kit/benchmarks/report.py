"""A benchmark as JSON for programs, as Markdown for readers, and as plots."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TypeVar

from spectra_kit._files import atomic_path
from spectra_kit.benchmarks.figures import draw_accuracy, draw_times, pareto_points
from spectra_kit.benchmarks.machine import describe_machine
from spectra_kit.benchmarks.measure import SCHEMA, Settings
from spectra_kit.benchmarks.methods import BASELINE, METHODS
from spectra_kit.benchmarks.results import FIT_FROM, Result, exponents
from spectra_kit.viz.front import pareto_front

Item = TypeVar("Item")
Name = TypeVar("Name")

_ROUNDING = 1e-12  # smaller errors count as equal
_BUSY = 0.05  # of a solve's time without a core; times are longer than they should be

_COLUMNS = (
    "method",
    "stops at",
    "seconds",
    "speed-up",
    "with assembly",
    "GB",
    "residual, max",
    "median",
    "eigenvalue error",
    "span error",
    "missed",
)


def write_report(results: Sequence[Result], settings: Settings, folder: Path) -> list[Path]:
    """Write ``benchmark.json``, ``benchmark.md`` and the plots.

    Parameters
    ----------
    results : sequence of Result
        Of `summarize`.
    settings : Settings
        Under which they were measured.
    folder : Path
        Must exist.

    Returns
    -------
    list of Path
        What was written: JSON, Markdown, then ``time-KIND.png`` and ``accuracy-KIND-POINTS.png``.
    """
    machine = {"name": settings.machine, **describe_machine(devices=settings.devices)}
    fitted = exponents(results)
    record = {
        "schema": SCHEMA,
        "machine": machine,
        "settings": {
            "k": settings.k,
            "threads": settings.threads,
            "repeats": settings.repeats,
            "time_limit": settings.time_limit,
            "operators": settings.operators,
            "model": Path(settings.file).name if settings.file else "creature",
        },
        "commits": sorted({commit for result in results for commit in result.commits}),
        "methods": {
            name: {
                "solver": solver,
                "stops_at": METHODS[name].stops,
                "peer": METHODS[name].peer,
            }
            for name, solver in _solvers(results).items()
        },
        "results": [result.to_json() for result in results],
        "exponents": [
            {"geometry": geometry, "device": device, "method": method, **fit._asdict()}
            for (geometry, device, method), fit in fitted.items()
        ],
    }
    paths = [folder / "benchmark.json", folder / "benchmark.md"]
    with atomic_path(paths[0]) as part:
        part.write_text(json.dumps(record, indent=1) + "\n")
    with atomic_path(paths[1]) as part:
        part.write_text(markdown(results, settings, machine))
    for kind, these in _grouped(results, lambda r: r.geometry):
        if any(result.ok for result in these):
            paths.append(draw_times(these, fitted, folder / f"time-{kind}.png"))
        for points, here in _grouped(these, lambda r: r.points):
            if sum(result.eigenvalue_error is not None for result in here if result.ok) > 1:
                name = f"accuracy-{kind}-{points or here[0].n}.png"
                paths.append(draw_accuracy(here, folder / name))
    return paths


def markdown(results: Sequence[Result], settings: Settings, machine: dict[str, object]) -> str:
    """Return all tables as Markdown.

    Parameters
    ----------
    results : sequence of Result
        Of `summarize`.
    settings : Settings
        Under which they were measured.
    machine : dict
        Of `describe_machine`, with a name.

    Returns
    -------
    str
        One table for each problem, then exponents and what was not measured.
    """
    commits = sorted({commit for result in results for commit in result.commits})
    where = machine["accelerator"] or machine["processor"]
    lines = [
        f"k = {settings.k} modes; {machine['name']}: {where}, threads: {settings.threads};"
        f" median of {settings.repeats} interleaved runs;"
        f" commit {', '.join(commits) or 'unknown'}.",
        "",
        "Seconds leave out assembly and certificate; each method solved something small before."
        f" Speed-up: over {BASELINE}. GB: peak above the operator. Residuals are relative;"
        " eigenvalue and span errors are means against ARPACK at machine precision; missed: exact"
        " modes with more than half of their energy outside the modes found. Bold: no other method"
        " on that device is both faster and more accurate.",
        "",
        "Stops at: the tolerance, each in the sense of its own stopping test (the residuals say"
        " what came of it); *rounding* is machine precision, *default* what the package has set;"
        " predictions have no tolerance. A speed-up compares like with like only where both stop"
        " at the same.",
    ]
    if any(result.ok and result.n >= settings.alone_from for result in results):
        lines += [
            "",
            f"From {settings.alone_from:,} points on no process waits while another one solves:"
            " before each solve the method is started and warmed up anew.",
        ]
    waiting = max((result.waiting or 0.0 for result in results), default=0.0)
    if waiting > _BUSY:
        lines += [
            "",
            f"**Something else was running**: up to {waiting:.0%} of a solve's time was spent"
            " waiting for a core.",
        ]
    for _, here in _grouped(results, lambda r: (r.geometry, r.points)):
        lines += ["", *_table(here, settings.operators[here[0].geometry])]
    lines += ["", *_exponents(results), *_solver_lines(results), *_missing(results)]
    return "\n".join(lines).rstrip() + "\n"


def _table(here: Sequence[Result], operator: str) -> list[str]:
    first = max(here, key=lambda result: result.n)
    assembly = next((r.assembly_seconds for r in here if r.assembly_seconds is not None), None)
    title = f"### {first.geometry}, {first.n or first.points:,} points"
    if not any(result.ok for result in here):
        return [title, "", "Nothing was measured."]
    took = "" if assembly is None else f", assembled in {assembly:.3g} s"
    lines = [title, "", f"Operator: {operator}{took}.", ""]
    lines += ["| " + " | ".join(_COLUMNS) + " |", "|---" * len(_COLUMNS) + "|"]
    base = next((r.median for r in here if r.method == BASELINE and r.ok), None)
    leagues = _grouped(pareto_points(here), lambda point: point.league)
    best = {p.name for _, league in leagues for p in pareto_front(league, floor=_ROUNDING)}
    for result in (result for result in here if result.ok):
        cells = [
            f"**{result.label}**" if result.label in best else result.label,
            METHODS[result.method].stops,
            f"{result.median:.3g}",
            "" if base is None else f"{base / result.median:.2f}",
            f"{result.median + (assembly or 0):.3g}",
            f"{((result.peak_bytes or 0) + (result.device_peak_bytes or 0)) / 1e9:.2f}",
            *(
                "" if value is None else f"{value:.1e}"
                for value in (
                    result.residual_max,
                    result.residual_median,
                    result.eigenvalue_error,
                    result.span_error,
                )
            ),
            "" if result.missed is None else str(result.missed),
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def _exponents(results: Sequence[Result]) -> list[str]:
    fitted = exponents(results)
    if not fitted:
        return []
    lines = [f"Exponents of time against points, from {FIT_FROM:,} points on:", ""]
    for (kind, device), names in _grouped(fitted, lambda name: name[:2]):
        values = ", ".join(
            f"{name[2]} {fitted[name].exponent:.2f} ({fitted[name].sizes} sizes)" for name in names
        )
        lines.append(f"- {kind}, {device}: {values}")
    return [*lines, ""]


def _solver_lines(results: Sequence[Result]) -> list[str]:
    solvers = _solvers(results)
    if not solvers:
        return []
    return ["What the names stand for:", "", *(f"- {n}: `{s}`" for n, s in solvers.items()), ""]


def _missing(results: Sequence[Result]) -> list[str]:
    reasons: dict[tuple[str, str], list[str]] = {}
    for result in results:
        where = f"{result.geometry} {result.n or result.points:,}"
        if not result.ok:
            reasons.setdefault((result.label, result.reason), []).append(where)
        elif result.no_errors:
            why = f"no errors: {result.no_errors}"
            reasons.setdefault((result.label, why), []).append(where)
    if not reasons:
        return []
    lines = [f"- {who} ({', '.join(at)}): {reason}" for (who, reason), at in reasons.items()]
    return ["Not measured, or not to the end:", "", *lines, ""]


def _solvers(results: Iterable[Result]) -> dict[str, str]:
    return {result.method: result.solver for result in results if result.solver}


def _grouped(items: Iterable[Item], key: Callable[[Item], Name]) -> list[tuple[Name, list[Item]]]:
    """Group neighbours that share a key."""
    return [(name, list(group)) for name, group in itertools.groupby(items, key)]
