"""Plots that only studies draw: time against error, who is how many times sooner."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from spectra_kit._core.types import Floats
from spectra_kit.show.layout import Page, line_style, log_ticks, new_diagram, tidy
from spectra_kit.show.picture import PathLike, plotted

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Errors below are rounding: as good as each other.
ROUNDING = 1e-12
_WIDTH, _HEIGHT = 8.4, 5.2  # inches
_LINE = 0.26  # inches of a line of ratios
_MARKERS = "osD^vP*Xp"
_INK: dict[str, Any] = {"fontsize": 8, "color": "0.2", "parse_math": False}
_LINED = 14.0  # names further than this from their dot, in points, are tied to it by a line
# Right and left first: read more easily than above and below.
_ANGLES = np.deg2rad([0, 180, 20, -20, 160, 200, 40, -40, 140, 220, 90, -90, 65, -65, 115, 245])
_GAPS = (6.0, 10.0, 16.0, 26.0, 40.0, 60.0)  # between a dot and its name, in points
_ROUNDS = 8  # each name is put again where the others leave most room
_OVERLAP, _COVERED, _CROSSED, _OUTSIDE = 40.0, 60.0, 8.0, 1e4  # costs, of one point of gap 1


@dataclass(frozen=True, kw_only=True)
class ParetoPoint:
    """One run of one method: its seconds, and its error."""

    name: str  #: Written beside its dot.
    group: str  #: Points of one group share a colour and a marker.
    seconds: float
    error: float
    league: str = ""  #: Points of one league share a front: a processor, for example.
    #: Seconds and error of the worst case, where these are means: a bar leads to each.
    worst: tuple[float, float] | None = None

    @property
    def place(self) -> tuple[float, float]:
        """Seconds and error, where it is drawn."""
        return self.seconds, max(self.error, ROUNDING)


def pareto_front(points: Iterable[ParetoPoint]) -> list[ParetoPoint]:
    """Return the points that no other one beats in both time and error, the fastest first."""
    front: list[ParetoPoint] = []
    for point in sorted(points, key=lambda p: p.place):
        if not front or point.place[1] < front[-1].place[1]:
            front.append(point)
    return front


def fronts(points: Iterable[ParetoPoint]) -> list[list[ParetoPoint]]:
    """Return the front of each league."""
    leagues: dict[str, list[ParetoPoint]] = {}
    for point in points:
        leagues.setdefault(point.league, []).append(point)
    return [pareto_front(one) for one in leagues.values()]


@plotted
def plot_pareto(
    points: Sequence[ParetoPoint],
    *,
    path: PathLike | None = None,
    page: Page = Page(),
    xlabel: str = "seconds",
    ylabel: str = "error",
) -> Figure:
    """Draw error against time, both logarithmic, and the front that nothing beats.

    Errors that are rounding are hollow dots on a grey ground. A bar leads from the dot of a mean to
    its worst, in time and in error. The steps of the front, of the dots alone, say which error can
    be had within a time: to the left of its first dot none. Each league has its own front.
    """
    figure = new_diagram(page, _WIDTH, _HEIGHT)
    panel = figure.add_subplot(xlabel=xlabel, ylabel=ylabel)
    ends = np.array([p.worst or (p.seconds, p.error) for p in points])
    ends[:, 1] = np.maximum(ends[:, 1], ROUNDING)
    times, errors = np.vstack([_places(points), ends]).T
    panel.set(
        xscale="log",
        yscale="log",
        xlim=_limits(times, right=0.16),
        ylim=_limits(errors, right=0.1),
    )
    tidy(panel)
    lines = []
    for front in fronts(points):
        lines.append(_steps(front, panel.get_xlim()[1]))
        told = None if lines[1:] else "nothing is both faster and better"
        panel.plot(*lines[-1].T, color="0.72", lw=2.0, zorder=1, label=told)
    for i, group in enumerate(dict.fromkeys(p.group for p in points)):
        here = [p.group == group for p in points]
        least = _places(points)[here]
        (x, y), (slow, far) = least.T, ends[here].T
        if np.any(slow > x) or np.any(far > y):
            bars: dict[str, Any] = {"xerr": [0 * x, slow - x], "yerr": [0 * y, far - y]}
            bars |= {"ecolor": line_style(i)[0], "alpha": 0.6, "elinewidth": 1.8, "capsize": 3}
            panel.errorbar(x, y, fmt="none", **bars)
            lines += [np.array([[t, e], [w, e]]) for t, e, w in zip(x, y, slow, strict=True)]
        style: dict[str, Any] = {"color": line_style(i)[0], "marker": _MARKERS[i % len(_MARKERS)]}
        style |= {"ls": "", "ms": 7, "mec": "white", "mew": 0.8, "label": group, "zorder": 3}
        panel.plot(*least.T, **style)
    if rounded := [p for p in points if p.error <= ROUNDING]:
        panel.plot(*_places(rounded).T, ls="", marker="o", ms=3.4, color="white", zorder=3)
        told = f"hollow: {ROUNDING:.2g} or less, rounding"
        panel.axhspan(panel.get_ylim()[0], ROUNDING, color="0.92", lw=0, zorder=0, label=told)
    log_ticks(panel.xaxis, plain=True)
    log_ticks(panel.yaxis)
    handles, names = panel.get_legend_handles_labels()
    columns = 5 if len(handles) < 5 else 3  # as many as the page is wide
    style = {"loc": "outside lower center", "ncols": columns, "columnspacing": 1.5}
    figure.legend(  # the front last
        *([*handles[1:], handles[0]], [*names[1:], names[0]]), fontsize=9, frameon=False, **style
    )
    figure.draw_without_rendering()  # now the axes are where they will be
    _write_names(panel, points, lines)
    return figure


@plotted
def plot_ratios(
    ratios: Mapping[str, tuple[float, float]],
    *,
    path: PathLike | None = None,
    page: Page = Page(),
) -> Figure:
    """Draw the mean and the worst of ratios, a line for each name, from above; and where 1 is."""
    figure = new_diagram(page, _WIDTH, 0.9 + _LINE * len(ratios))
    panel = figure.add_subplot(xlabel="times; above 1, ours is sooner")
    heights = -np.arange(len(ratios))
    means, worst = np.array([*ratios.values()]).T
    colour = line_style(0)[0]
    panel.hlines(heights, worst, means, color=colour, alpha=0.6, lw=1.8)
    panel.plot(worst, heights, ls="", marker="|", ms=9, color=colour, label="worst")
    panel.plot(means, heights, ls="", marker="o", ms=6, color=colour, label="mean")
    panel.axvline(1.0, color="0.4", lw=1.0, zorder=1)
    panel.set(xscale="log", ylim=(heights[-1] - 0.7, 0.7))
    panel.set_yticks(heights, labels=[*ratios], parse_math=False)
    tidy(panel)
    log_ticks(panel.xaxis, plain=True)
    return figure


def _write_names(panel: Axes, points: Sequence[ParetoPoint], lines: Sequence[Floats]) -> None:
    """Write the names where they cover neither each other nor a dot, nor a line if possible."""
    unit = panel.figure.dpi / 72  # pixels in a point

    def on_page(places: Floats) -> Floats:
        return np.asarray(panel.transData.transform(places) / unit)

    places = _places(points)
    offset: dict[str, Any] = {"textcoords": "offset points"}
    texts = [
        panel.annotate(p.name, xy=at, xytext=(0, 0), va="bottom", zorder=4, **_INK, **offset)
        for p, at in zip(points, places, strict=True)
    ]
    sizes = np.array([text.get_window_extent().size for text in texts]) / unit
    anchors, room = on_page(places), panel.bbox.get_points() / unit
    corners = place_labels(anchors, sizes, room, np.vstack([_dots(on_page(x)) for x in lines]))
    for text, place, low, size in zip(texts, places, corners - anchors, sizes, strict=True):
        text.set_position(tuple(low))
        nearest = np.clip(0.0, low, low + size)
        if np.linalg.norm(nearest) > _LINED:
            tie = {"arrowstyle": "-", "color": "0.6", "lw": 0.6, "shrinkA": 0, "shrinkB": 3}
            panel.annotate("", xy=place, xytext=tuple(nearest), arrowprops=tie, **offset)


def _steps(front: Sequence[ParetoPoint], end: float) -> Floats:
    """Corners of the least error that can be had within a time, up to `end`: (c, 2)."""
    seconds, errors = np.repeat(_places(front), 2, axis=0).T
    return np.column_stack([np.append(seconds[1:], end), errors])


def _places(points: Sequence[ParetoPoint]) -> Floats:
    """Seconds and errors, (p, 2)."""
    return np.array([p.place for p in points])


def _limits(values: Sequence[float], *, right: float) -> tuple[float, float]:
    """The ends of a logarithmic axis, with some room."""
    spread = max(np.log10(max(values) / min(values)), 0.5)
    return min(values) * 10 ** (-0.1 * spread), max(values) * 10 ** (right * spread)


def _dots(corners: Floats) -> Floats:
    """Points along a line through `corners`, closer than a label is high."""
    counts = 2 + (np.abs(np.diff(corners, axis=0)).max(axis=1) / 3).astype(int)
    sides = zip(corners[:-1], corners[1:], counts, strict=True)
    return np.vstack([np.linspace(a, b, count) for a, b, count in sides])


def place_labels(anchors: Floats, sizes: Floats, room: Floats, obstacles: Floats) -> Floats:
    """Return the lower left corner (l, 2) of each label near its anchor, all in points (1/72 inch).

    Labels of `sizes` (l, 2) stay inside the corners of `room` (2, 2); they overlap each other, an
    anchor, or points of `obstacles` (o, 2) only where there is no other place.
    """
    candidates = _candidates(anchors, sizes)  # (l, c, 2)
    ends = candidates + sizes[:, None]
    cost = np.tile(np.repeat(_GAPS, len(_ANGLES)), (len(anchors), 1))
    cost += 0.05 * np.tile(np.arange(len(_ANGLES)), len(_GAPS))  # the order above, when in doubt
    cost += _OUTSIDE * ((candidates < room[0]) | (ends > room[1])).any(axis=2)
    cost += _COVERED * _inside(anchors, candidates - 3, ends + 3)
    cost += _CROSSED * _inside(obstacles, candidates, ends)
    chosen = cost.argmin(axis=1)
    for _ in range(_ROUNDS):
        before = chosen.copy()
        for i in range(len(anchors)):
            others = np.delete(np.arange(len(anchors)), i)
            low, high = candidates[others, chosen[others]], ends[others, chosen[others]]
            common = np.minimum(ends[i][:, None], high + 2) - np.maximum(
                candidates[i][:, None], low - 2
            )
            overlap = np.prod(np.clip(common, 0.0, None), axis=2).sum(axis=1)
            chosen[i] = (cost[i] + _OVERLAP * overlap).argmin()
        if (chosen == before).all():
            break
    return np.asarray(candidates[np.arange(len(anchors)), chosen])


def _candidates(anchors: Floats, sizes: Floats) -> Floats:
    """Lower left corners of all places for each label, near ones first: (l, c, 2)."""
    towards = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])
    # The edge of the label, not its centre, keeps the gap: steep directions centre it.
    lean = np.clip(1.6 * towards, -1.0, 1.0)
    steps = np.concatenate([gap * towards for gap in _GAPS])
    leans = np.tile(lean, (len(_GAPS), 1))
    centres = anchors[:, None] + steps + leans * sizes[:, None] / 2
    return np.asarray(centres - sizes[:, None] / 2)


def _inside(points: Floats, low: Floats, high: Floats) -> Floats:
    """How many points each box holds: (l, c)."""
    at = points[:, None, None]
    return np.asarray(((at > low) & (at < high)).all(axis=3).sum(axis=0), dtype=np.float64)
