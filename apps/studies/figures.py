"""Figures of measurements: panels of lines, and errors against seconds with the Pareto front.

Matplotlib is imported when one is drawn: processes that measure need none.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.files import atomic_path
from spectra_kit.show import Page
from spectra_kit.show.layout import LINE_COLOURS
from studies.plots import ParetoPoint, pareto_front, plot_pareto

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Errors below are rounding: as good as each other.
ROUNDING = 1e-12
_DASHES = ("-", "--", ":", "-.")
# They tell the second round of colours from the first.
_MARKERS = "osD^v<>PX"
_DPI = 150


def undominated(points: Iterable[ParetoPoint], *, floor: float = ROUNDING) -> set[str]:
    """Return the names of what nothing in its league beats in both time and error."""
    leagues: dict[str, list[ParetoPoint]] = {}
    for point in points:
        leagues.setdefault(point.league, []).append(point)
    return {best.name for one in leagues.values() for best in pareto_front(one, floor=floor)}


def draw_pareto(
    path: Path, points: Sequence[ParetoPoint], *, title: str = "", **options: Any
) -> Path:
    """Draw errors against seconds and a front for each league; see `plots.plot_pareto`."""
    plot_pareto(points, path=path, floor=ROUNDING, page=Page(title, dpi=_DPI), **options)
    return path


def panels(title: str, count: int = 1, *, width: float = 0.0) -> tuple[Figure, list[Axes]]:
    """Return a white page with its title and so many tidy axes beside each other."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(
        figsize=(width or (12 if count > 1 else 8), 4.4), facecolor="white", layout="constrained"
    )
    FigureCanvasAgg(figure)
    axes = [figure.add_subplot(1, count, i + 1) for i in range(count)]
    for panel in axes:
        panel.grid(color="0.92", lw=0.7)
        panel.set_axisbelow(True)
        panel.spines[["top", "right"]].set_visible(False)
        panel.tick_params(labelsize=9)
    figure.suptitle(title, fontsize=11, fontweight="bold", x=0.01, ha="left")
    return figure, axes


def line(i: int) -> dict[str, Any]:
    """Colour and dashes of the line number `i`."""
    return {"color": colour(i), "ls": _DASHES[i % len(_DASHES)], "lw": 1.6}


def dots(i: int) -> dict[str, Any]:
    """Colour and marker of the dots number `i`."""
    marker = _MARKERS[(i + i // len(LINE_COLOURS)) % len(_MARKERS)]
    return {"color": colour(i), "marker": marker, "ms": 6, "mew": 1.4, "lw": 1.6}


def colour(i: int) -> str:
    """One that every eye tells from those beside it."""
    return LINE_COLOURS[i % len(LINE_COLOURS)]


def band(panel: Axes, x: ArrayLike, values: ArrayLike, label: str, **style: Any) -> None:
    """Draw the median over the rows of `values`, and the quartiles as a band."""
    low, median, high = np.percentile(np.asarray(values, dtype=float), (25, 50, 75), axis=0)
    panel.plot(x, median, label=label, **style)
    panel.fill_between(np.asarray(x), low, high, color=style.get("color"), alpha=0.15, lw=0)


def ticks(panel: Axes, values: Iterable[float], names: Iterable[str] | None = None) -> None:
    """Put the ticks of a logarithmic axis of x where something was measured."""
    found = sorted(set(values))
    panel.set_xscale("log")
    panel.set_xticks(found, [f"{value:,g}" for value in found] if names is None else list(names))
    panel.xaxis.minorticks_off()


def legend(figure: Figure, panel: Axes, *, beside: bool = False) -> None:
    """Name the lines of a panel below the page, or beside it."""
    handles, names = panel.get_legend_handles_labels()
    look: dict[str, Any] = {"fontsize": 8, "frameon": False, "ncols": 1 if beside else 3}
    look["loc"] = "outside right center" if beside else "outside lower center"
    figure.legend(handles, names, **look)


def save(figure: Figure, path: Path) -> Path:
    """Write a figure, whole or not at all."""
    with atomic_path(path) as part:
        figure.savefig(part, dpi=_DPI)
    return path
