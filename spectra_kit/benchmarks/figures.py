"""The two plots: time against points, and accuracy against time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spectra_kit._files import atomic_path
from spectra_kit.benchmarks.methods import METHODS
from spectra_kit.benchmarks.results import Fit, Result, error_of, undominated

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

# Okabe and Ito's colours: told apart with every kind of colour blindness. Markers tell the second
# round from the first; dashes and open markers tell other packages from ours.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
_MARKERS = "osD^v<>PX"
_FLOOR = 1e-12  # of errors in the plot: below it there is only rounding
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
    figure, panel = _figure(f"{results[0].geometry}: time to solve")
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
    _seconds(panel.yaxis)
    _legend(figure, panel)
    return _save(figure, path)


def draw_accuracy(results: Sequence[Result], path: Path) -> Path:
    """Draw the mean eigenvalue error against seconds, and the front that nothing beats.

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
    shown = [r for r in results if r.ok and r.eigenvalue_error is not None]
    figure, panel = _figure(f"{shown[0].geometry}, {shown[0].n:,} points: accuracy against time")
    for device in dict.fromkeys(r.device for r in shown):
        front = undominated([r for r in shown if r.device == device], floor=_FLOOR)
        panel.plot(
            [r.median for r in front],
            [error_of(r, _FLOOR) for r in front],
            color="0.8",
            lw=2,
            marker="o",
            ms=17,
            drawstyle="steps-post",
            label=None if panel.lines else "nothing is both faster\nand more accurate",
            zorder=1,
        )
    for result in shown:
        panel.plot(
            result.median,
            error_of(result, _FLOOR),
            ls="",
            label=result.label,
            zorder=3,
            **_style(result.method, result.device),
        )
    panel.set(xlabel="seconds", ylabel="mean relative eigenvalue error", xscale="log", yscale="log")
    _seconds(panel.xaxis)
    low, high = panel.get_ylim()
    panel.set_ylim(min(low, _FLOOR / 10), max(high, 1e-1))
    panel.axhspan(panel.get_ylim()[0], _FLOOR, color="0.95", zorder=0)
    panel.text(
        0.99, 0.01, "rounding", transform=panel.transAxes, fontsize=8, color="0.4", ha="right"
    )
    _legend(figure, panel)
    return _save(figure, path)


def _style(method: str, device: str) -> dict[str, Any]:
    """Colour and marker of a method: the same in every figure."""
    place = list(METHODS).index(method)
    colour = _COLOURS[place % len(_COLOURS)]
    return {
        "color": colour,
        "marker": _MARKERS[place % len(_MARKERS)],
        "ms": 9 if device == "cuda" else 6,
        "mfc": "white" if METHODS[method].peer else colour,
        "mew": 1.4,
    }


def _short(n: int) -> str:
    """Points in thousands or millions."""
    if n < 1000:
        return str(n)
    return f"{n / 1000:.0f}k" if n < 999_500 else f"{n / 1e6:.2g}M"


def _seconds(axis: Axis) -> None:
    """Label 1, 2 and 5 of each power of ten, as plain numbers."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _figure(title: str) -> tuple[Figure, Axes]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 5.2), facecolor="white")
    FigureCanvasAgg(figure)
    figure.subplots_adjust(left=0.09, right=0.7, top=0.9, bottom=0.12)
    panel = figure.add_subplot()
    panel.grid(visible=True, which="major", color="0.9", lw=0.6)
    panel.set_axisbelow(True)
    panel.spines[["top", "right"]].set_visible(False)
    panel.tick_params(labelsize=9)
    panel.set_title(title, fontsize=12, fontweight="bold", loc="left")
    return figure, panel


def _legend(figure: Figure, panel: Axes) -> None:
    handles, names = panel.get_legend_handles_labels()
    figure.legend(
        handles,
        names,
        loc="center left",
        bbox_to_anchor=(0.71, 0.5),
        fontsize=9,
        frameon=False,
        labelspacing=min(0.9, 14 / len(names)),
    )


def _save(figure: Figure, path: Path) -> Path:
    with atomic_path(path) as part:
        figure.savefig(part, dpi=_DPI)
    return path
