"""Figures of measurements: panels of lines.

Matplotlib is imported when one is drawn: processes that measure need none.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.files import atomic_path
from spectra_kit.errors import MissingDependencyError
from spectra_kit.show.layout import LINE_COLOURS, tidy

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_DASHES = ("-", "--", ":", "-.")
# They tell the second round of colours from the first.
_MARKERS = "osD^v<>PX"
_DPI = 150


def panels(
    title: str, count: int = 1, *, size: tuple[float, float] | None = None
) -> tuple[Figure, list[Axes]]:
    """Return a white page with its title and so many tidy axes beside each other."""
    from matplotlib.figure import Figure

    size = size or (12 if count > 1 else 8, 4.4)
    figure = Figure(figsize=size, facecolor="white", layout="constrained")
    axes = list(figure.subplots(1, count, squeeze=False)[0])
    for panel in axes:
        tidy(panel)
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


def ticks(panel: Axes, values: Iterable[float]) -> None:
    """Put the ticks of a logarithmic axis of x where something was measured."""
    found = sorted(set(values))
    panel.set_xscale("log")
    panel.set_xticks(found, [f"{value:,g}" for value in found])
    panel.xaxis.minorticks_off()


def legend(figure: Figure, panel: Axes) -> None:
    """Name the lines of a panel below the page."""
    named = panel.get_legend_handles_labels()
    figure.legend(*named, fontsize=8, frameon=False, ncols=3, loc="outside lower center")


@contextmanager
def unless_missing(what: str) -> Iterator[None]:
    """Tell what is not drawn, where a package for it is missing."""
    try:
        yield
    except MissingDependencyError as error:
        print(f"{what} not drawn: {error}", file=sys.stderr)


def save(figure: Figure, path: Path) -> Path:
    """Write a figure, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(path) as part:
        figure.savefig(part, dpi=_DPI)
    return path
