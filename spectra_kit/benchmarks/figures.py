"""The two plots: time against points, and accuracy against time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from spectra_kit.benchmarks.methods import METHODS, Entry
from spectra_kit.benchmarks.results import Fit, Result
from spectra_kit.viz.axes import LINE_COLOURS, log_ticks, tidy
from spectra_kit.viz.front import ParetoPoint
from spectra_kit.viz.page import Page, new_diagram
from spectra_kit.viz.pareto import plot_pareto

# Markers tell the second round of colours from the first; dashes and open markers tell other
# packages from ours.
_MARKERS = "osD^v<>PX"
_DPI = 150


def draw_times(
    results: Sequence[Result], exponents: Mapping[tuple[str, str, str], Fit], path: Path
) -> Path:
    """Draw seconds against points, both logarithmic, a line for each method.

    Parameters
    ----------
    results : sequence of Result
        Of one geometry.
    exponents : mapping
        From (geometry, device, method) to what the legend shall say.
    path : Path
        A ``.png`` file.

    Returns
    -------
    Path
        The same.
    """
    lines: dict[tuple[str, str], list[Result]] = {}
    for result in results:
        if result.ok:
            lines.setdefault((result.device, result.method), []).append(result)
    title = f"{results[0].geometry}: time to solve"
    figure = new_diagram(Page(title, dpi=_DPI), 9, 5.0)
    panel = figure.add_subplot()
    for (device, method), line in lines.items():
        fit = exponents.get((results[0].geometry, device, method))
        power = "" if fit is None else f"  $N^{{{fit.exponent:.2f}}}$"
        style = _style(method, device)
        panel.plot(
            [r.n for r in line],
            [r.median for r in line],
            lw=1.6,
            ls="--" if METHODS[method].peer else "-",
            label=f"{line[0].label}{power}",
            **style,
        )
    sizes = sorted({r.n for line in lines.values() for r in line})
    panel.set(xlabel="points N", ylabel="seconds", xscale="log", yscale="log")
    panel.set_xticks(sizes, [_short(n) for n in sizes])
    panel.xaxis.minorticks_off()
    log_ticks(panel.yaxis, plain=True)
    tidy(panel)
    figure.legend(
        loc="outside right center",
        fontsize=9,
        frameon=False,
        labelspacing=min(0.9, 14 / max(len(lines), 1)),
    )
    figure.savefig(path)
    return path


def draw_accuracy(results: Sequence[Result], path: Path) -> Path:
    """Draw the mean eigenvalue error against seconds, and for each device the front of the best.

    Parameters
    ----------
    results : sequence of Result
        Of one problem.
    path : Path
        A ``.png`` file.

    Returns
    -------
    Path
        The same.
    """
    shown = next(result for result in results if result.ok)
    plot_pareto(
        path,
        pareto_points(results),
        ylabel="mean relative eigenvalue error",
        page=Page(f"{shown.geometry}, {shown.n:,} points: accuracy against time", dpi=_DPI),
    )
    return path


def pareto_points(results: Iterable[Result]) -> list[ParetoPoint]:
    """Return the results that have an error as points of a Pareto plot, a league each device."""
    return [
        ParetoPoint(
            name=result.label,
            group=_group(METHODS[result.method]),
            seconds=result.median,
            error=result.eigenvalue_error,
            league=result.device,
        )
        for result in results
        if result.ok and result.eigenvalue_error is not None
    ]


def _group(entry: Entry) -> str:
    """What kind of method it is."""
    if entry.peer:
        return "other packages"
    if entry.stops in ("", "rounding"):
        return "to rounding" if entry.stops else "predictions"
    return f"to {entry.stops}"


def _style(method: str, device: str) -> dict[str, Any]:
    """Colour and marker of a method: the same in every figure."""
    place = list(METHODS).index(method)
    colour = LINE_COLOURS[place % len(LINE_COLOURS)]
    return {
        "color": colour,
        "marker": _MARKERS[(place + place // len(LINE_COLOURS)) % len(_MARKERS)],
        "ms": 9 if device == "cuda" else 6,
        "mfc": "white" if METHODS[method].peer else colour,
        "mew": 1.4,
    }


def _short(n: int) -> str:
    """Points in thousands or millions."""
    if n < 1000:
        return str(n)
    return f"{n / 1000:.0f}k" if n < 999_500 else f"{n / 1e6:.2g}M"
