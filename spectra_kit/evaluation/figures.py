"""Figures of the studies, and pictures of the worst modes.

Matplotlib draws the figures; it is imported when one is drawn.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from spectra_kit.evaluation.bench import Bench
from spectra_kit.evaluation.curves import Curve
from spectra_kit.evaluation.findings import Row
from spectra_kit.evaluation.studies import Answer
from spectra_kit.geometry import Geometry
from spectra_kit.viz import Page, ParetoPoint, plot_comparison, plot_pareto
from spectra_kit.viz.axes import LINE_COLOURS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ERRORS = {"span": "span error", "vector": "eigenvector error", "value": "eigenvalue error"}
_LINES = 6  # in one panel
_DRAWN = 3  # modes of a model
_ROUNDING = 1e-10
_DPI = 130


def draw(answer: Answer, folder: Path) -> list[Path]:
    """Draw what a study has to show.

    Parameters
    ----------
    answer : Answer
        With rows in any number; those without measurements are left out.
    folder : Path
        Must exist.

    Returns
    -------
    list of Path
        The ``.png`` files, ``STUDY-WHAT.png`` each.
    """
    rows = [row for row in answer.rows if row.measured]
    drawn = []
    for place in dict.fromkeys(row.place() for row in rows):
        here = [row for row in rows if row.place() == place]
        slug = f"{answer.name}-{place.replace(', ', '-').replace(',', '').replace(' ', '-')}"
        if answer.name == "worst":
            drawn.append(_save(_ranking(here[0], place), folder / f"{slug}.png"))
        elif answer.name == "rotation":
            drawn.append(_save(_spread(here, place), folder / f"{slug}.png"))
        else:
            drawn.append(_save(_modes(here, place), folder / f"{slug}-modes.png"))
        if answer.name == "accuracy":
            drawn.append(_against_time(here, place, folder / f"{slug}-time.png"))
    if answer.name in ("accuracy", "precision", "redundancy"):
        quantity = "m" if answer.name == "redundancy" else "points"
        for models in dict.fromkeys(row.labels["models"] for row in rows):
            these = [row for row in rows if row.labels["models"] == models]
            if len({row.labels[quantity] for row in these}) > 1:
                figure = _against(these, quantity, str(models))
                drawn.append(_save(figure, folder / f"{answer.name}-{models}-{quantity}.png"))
    return drawn


def draw_worst(answer: Answer, bench: Bench, folder: Path, *, count: int = 3) -> list[Path]:
    """Draw the worst modes of the worst models of each set: exact, predicted, difference.

    Parameters
    ----------
    answer : Answer
        Of the study ``"worst"``.
    bench : Bench
        That measured it; the modes are computed again.
    folder : Path
        Must exist.
    count : int, default 3
        Models of each set.

    Returns
    -------
    list of Path
        One ``.png`` file for each model.

    Raises
    ------
    MissingDependencyError
        If this machine cannot draw surfaces.
    """
    drawn = []
    for row in (row for row in answer.rows if row.measured):
        ranked = sorted(row.measured, key=lambda pair: -pair[1].mean("span"))[:count]
        for rank, (case, measurement) in enumerate(ranked, start=1):
            exact, predicted, comparison = bench.compare(case, row.method)
            modes = [int(mode) for mode in np.argsort(-measurement.span)[:_DRAWN]]
            name = f"worst-{row.labels['models']}-{rank}-{case.model.name.replace(' ', '-')}.png"
            geometry: Geometry = case.geometry()
            plot_comparison(
                folder / name,
                geometry,
                exact,
                predicted,
                comparison,
                modes=modes,
                page=Page(
                    f"{case.model.name}: the worst of {exact.k} modes",
                    f"{row.method.name}; mean span error {measurement.mean('span'):.1e}",
                    dpi=120,
                ),
            )
            drawn.append(folder / name)
    return drawn


def draw_curves(curves: Sequence[Curve], folder: Path) -> Path:
    """Draw validation errors against samples seen, one line for each network.

    Parameters
    ----------
    curves : sequence of Curve
        With different names.
    folder : Path
        Must exist.

    Returns
    -------
    Path
        ``training-samples.png``.
    """
    figure, (panel,) = _figure("Validation against samples seen", panels=1)
    for curve, colour in zip(curves, itertools.cycle(LINE_COLOURS), strict=False):
        panel.plot(curve.samples, curve.errors, "o-", color=colour, lw=1.4, ms=3, label=curve.name)
    panel.set(xlabel="samples seen", ylabel="mean span error", xscale="log", yscale="log")
    _legend(figure, panel)
    return _save(figure, folder / "training-samples.png")


def _modes(rows: Sequence[Row], place: str) -> Figure:
    """Each error against the mode number: median over models, and quartiles as a band."""
    figure, axes = _figure(place, panels=3)
    for row, colour in zip(_few(rows), LINE_COLOURS, strict=False):
        for panel, error in zip(axes, _ERRORS, strict=True):
            modes = np.array([getattr(measurement, error) for measurement in row.measurements])
            # The constant mode is inside every span up to rounding: nothing for such an axis.
            number = np.flatnonzero((modes > _ROUNDING).all(axis=0))
            low, median, high = np.percentile(modes[:, number], (25, 50, 75), axis=0)
            panel.plot(number, median, color=colour, lw=1.4, label=_name(row))
            panel.fill_between(number, low, high, color=colour, alpha=0.15, lw=0)
    for panel, title in zip(axes, _ERRORS.values(), strict=True):
        panel.set(title=title, xlabel="mode", yscale="log")
    _legend(figure, axes[0])
    return figure


def _against(rows: Sequence[Row], quantity: str, place: str) -> Figure:
    """Each error against a number: median over models, and quartiles as a band."""
    figure, axes = _figure(place, panels=3)
    others = [name for name in rows[0].labels if name not in ("models", quantity, "weights")]
    lines: dict[str, list[Row]] = {}
    for row in rows:
        lines.setdefault(", ".join(_labelled(name, row) for name in others), []).append(row)
    for (name, line), colour in zip(_first(lines), LINE_COLOURS, strict=False):
        at = np.array([int(row.labels[quantity]) for row in line])
        for panel, error in zip(axes, _ERRORS, strict=True):
            low, median, high = np.array(
                [np.percentile(row.means(error), (25, 50, 75)) for row in line]
            ).T
            panel.plot(at, median, "o-", color=colour, lw=1.4, ms=4, label=name)
            panel.fill_between(at, low, high, color=colour, alpha=0.15, lw=0)
    for panel, title in zip(axes, _ERRORS.values(), strict=True):
        panel.set(title=title, xlabel=quantity, yscale="log")
        ticks = sorted({int(row.labels[quantity]) for row in rows})
        panel.set_xscale("log")
        panel.set_xticks(ticks, [f"{tick:,}" for tick in ticks])
        panel.xaxis.minorticks_off()
    _legend(figure, axes[0])
    return figure


def _against_time(rows: Sequence[Row], place: str, path: Path) -> Path:
    """Span error against seconds, one dot for each solver, ARPACK's time as a line."""
    kinds = {"neo": "network", "fourier": "plane waves", "union": "both"}
    points = [
        ParetoPoint(
            name=row.method.name,
            group=next(kinds[key] for key in row.method.key if key in kinds),
            seconds=row.seconds(),
            error=row.mean(),
        )
        for row in _best_bandwidths(rows)
        if kinds.keys() & set(row.method.key)
    ]
    exact = float(np.median([row.exact_seconds() for row in rows]))
    marks = {"ARPACK, exact": exact}
    plot_pareto(path, points, marks=marks, ylabel="mean span error", page=Page(place, dpi=_DPI))
    return path


def _ranking(row: Row, place: str) -> Figure:
    """Models by span error, worst first."""
    figure, (panel,) = _figure(f"{place}, {row.method.name}", panels=1)
    ranked = sorted(row.measured, key=lambda pair: -pair[1].mean("span"))
    names = [case.model.name for case, _ in ranked]
    panel.bar(range(len(names)), [m.mean("span") for _, m in ranked], color=LINE_COLOURS[0])
    panel.set_xticks(range(len(names)), names, rotation=60, ha="right", fontsize=7)
    panel.set(ylabel="mean span error", yscale="log")
    return figure


def _spread(rows: Sequence[Row], place: str) -> Figure:
    """Span error of each model in each rotation, and their mean."""
    figure, (panel,) = _figure(f"{place}, random rotations", panels=1)
    ranked = sorted(rows, key=lambda row: -row.mean())
    for i, row in enumerate(ranked):
        means = row.means("span")
        panel.scatter(np.full(len(means), i), means, color=LINE_COLOURS[0], s=10, alpha=0.6, lw=0)
        panel.plot([i - 0.3, i + 0.3], [means.mean()] * 2, color=LINE_COLOURS[1], lw=1.4)
    names = [str(row.labels["model"]) for row in ranked]
    panel.set_xticks(range(len(names)), names, rotation=60, ha="right", fontsize=7)
    panel.set(ylabel="mean span error", yscale="log")
    return figure


def _few(rows: Sequence[Row]) -> Sequence[Row]:
    """Rows that fit one panel: of the plane waves only the best bandwidth of each size."""
    return _best_bandwidths(rows)[:_LINES]


def _best_bandwidths(rows: Sequence[Row]) -> list[Row]:
    best: dict[object, Row] = {}
    for row in rows:
        kind = next(iter(row.method.key))
        key: object = id(row) if kind == "neo" else (kind, row.method.columns)
        if key not in best or row.mean() < best[key].mean():
            best[key] = row
    return list(best.values())


def _first(lines: dict[str, list[Row]]) -> list[tuple[str, list[Row]]]:
    """Lines that fit one panel, by the same rule at their first number."""
    kept = _few([rows[0] for rows in lines.values()])
    return [(name, rows) for name, rows in lines.items() if any(rows[0] is row for row in kept)]


def _name(row: Row) -> str:
    shown = [name for name in row.labels if name not in ("models", "points", "weights")]
    return ", ".join(_labelled(name, row) for name in shown)


def _labelled(name: str, row: Row) -> str:
    value = row.labels[name]
    return f"{name} = {value:,}" if isinstance(value, int) else str(value)


def _figure(title: str, *, panels: int) -> tuple[Figure, list[Axes]]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12 if panels > 1 else 8, 4.4), facecolor="white")
    FigureCanvasAgg(figure)
    # By hand: Matplotlib's own layouts draw everything twice.
    figure.subplots_adjust(
        left=0.1 if panels == 1 else 0.06, right=0.98, top=0.85, bottom=0.28, wspace=0.22
    )
    axes = [figure.add_subplot(1, panels, i + 1) for i in range(panels)]
    for panel in axes:
        panel.grid(visible=True, which="major", color="0.9", lw=0.6)
        panel.set_axisbelow(True)
        panel.spines[["top", "right"]].set_visible(False)
        panel.tick_params(labelsize=8)
        panel.tick_params(which="minor", labelsize=7)
    figure.suptitle(title, fontsize=11, fontweight="bold", x=0.01, ha="left")
    return figure, axes


def _legend(figure: Figure, panel: Axes) -> None:
    handles, names = panel.get_legend_handles_labels()
    figure.legend(handles, names, loc="lower center", ncols=3, fontsize=8, frameon=False)


def _save(figure: Figure, path: Path) -> Path:
    figure.savefig(path, dpi=_DPI)
    return path
