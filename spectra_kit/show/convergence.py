"""How iterative solvers of one system converge: by iterations, and by the clock."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from spectra_kit._core.checked import checked
from spectra_kit._core.records import Brief, frozen
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_positive, real_array
from spectra_kit.errors import InvalidInputError
from spectra_kit.show.layout import LINE_COLOURS, Page, line_style, new_figure, short, tidy
from spectra_kit.show.picture import PathLike, plotted

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_STAGES = ("#D9D9D9", "#B4C7DE", "#8297B8", "#BAD0AE", "#8AAB80", "#A0A0A0", "#6E6E6E")
_SPECTRUM = "#F4E3B2"
_FLOOR = 1e-16  # of relative residuals in the picture: below it there is only rounding
_ROW = 0.27  # inches of one bar


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class SolverRun(Brief):
    """One solver at work: what it did before its first iteration, and its residuals since.

    Attributes
    ----------
    name : str
        Of the solver.
    stages : mapping of str to float
        Seconds of what comes before the iterations, in this order.
    spectrum_seconds : float, default 0
        Seconds that the modes took which it uses; 0 if it uses none.
    times : ndarray of shape (i,)
        Seconds from the start of the solve to when each residual was known, ascending.
    residuals : ndarray of shape (i,)
        Relative residuals: at the start and after each iteration, or of a direct solver the one
        that it ends with. Without any, only the seconds are drawn.
    """

    name: str
    stages: Mapping[str, float]
    spectrum_seconds: float = 0.0
    times: Floats = field(default_factory=lambda: np.zeros(0))
    residuals: Floats = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        times = real_array("times", self.times)
        residuals = real_array("residuals", self.residuals)
        if times.ndim != 1 or residuals.shape != times.shape or (np.diff(times) < 0).any():
            raise InvalidInputError(
                "times",
                "be ascending seconds, one for each of `residuals`",
                f"shapes {times.shape} and {residuals.shape}",
            )
        object.__setattr__(self, "times", frozen(times))
        object.__setattr__(self, "residuals", frozen(residuals))

    @property
    def start(self) -> float:
        """Seconds before the iterations, those of the spectrum left out."""
        return float(sum(self.stages.values()))

    @property
    def seconds(self) -> float:
        """Seconds in all, those of the spectrum left out."""
        return self.start + self.solve_seconds

    @property
    def solve_seconds(self) -> float:
        """Seconds of the iterations."""
        return float(self.times[-1]) if len(self.times) else 0.0

    @property
    def iterations(self) -> int | None:
        """How many there were; None for a solver that has none."""
        count = len(self.residuals)
        return count - 1 if count > 1 else None


@plotted
def plot_convergence(
    runs: Sequence[SolverRun],
    *,
    path: PathLike | None = None,
    page: Page = Page(),
    rtol: float = 1e-8,
    solve_name: str = "solve",
) -> Figure:
    """Draw the residuals of solvers against iterations and against the clock, and their stages.

    Parameters
    ----------
    runs : sequence of SolverRun
        At least one.
    $path
    $page
    rtol : float, default 1e-8
        The relative residual at which the solvers stop, a line across.
    solve_name : str, default "solve"
        What to call the iterations, beside the names of the other stages.

    $returns

    Notes
    -----
    The clock begins where nothing but the geometry is there: a curve starts when all its stages
    are over. The second clock counts the modes too, which the first one takes as given.
    Bars below share the seconds of the clock above them.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.show import Page, SolverRun, plot_convergence
    >>> times, residuals = np.array([0.0, 0.1, 0.2]), np.array([1.0, 1e-4, 1e-9])
    >>> run = SolverRun(name="CG", stages={"setup": 0.1}, times=times, residuals=residuals)
    >>> plot_convergence([run], page=Page(dpi=40))
    Picture(path=None)
    """
    if not runs:
        raise InvalidInputError("runs", "hold at least one SolverRun", "none")
    check_positive("rtol", rtol)
    # Below the first diagram is a table, below the two clocks are the bars of its rows.
    rows = _ROW * (len(runs) + 1.2)
    begin = page.head + 0.25
    height = begin + 3.4 + rows + 1.1
    figure = new_figure(page, 12, height)
    across = {"left": 0.06, "right": 0.985, "wspace": 0.06, "width_ratios": (1.15, 1, 1)}
    down = {"top": 1 - begin / height, "bottom": 0.75 / height, "hspace": 0.32 * 6 / height}
    grid = figure.add_gridspec(2, 3, height_ratios=(3.4, rows), **across, **down)
    iterations = figure.add_subplot(grid[0, 0])
    _draw_curves(iterations, runs, "by iterations", None)
    iterations.set(yscale="log", xlabel="iteration", ylabel="relative residual")
    _draw_table(figure.add_subplot(grid[1, 0]), runs)
    names = dict.fromkeys(name for run in runs for name in run.stages)
    colours = {name: _STAGES[i % len(_STAGES)] for i, name in enumerate(names)}
    for column, told in ((1, "at hand"), (2, "counted")):
        before = [run.spectrum_seconds * (column - 1) for run in runs]
        clock = figure.add_subplot(grid[0, column], sharey=iterations)
        _draw_curves(clock, runs, f"by the clock, the spectrum {told}", before)
        _draw_bars(figure.add_subplot(grid[1, column], sharex=clock), runs, colours, before)
        clock.tick_params(labelleft=False)
    every = np.concatenate([_shown(run) for run in runs] + [np.array([1.0, rtol])])
    iterations.set_ylim(float(every.min()) / 4, float(every.max()) * 4)
    for panel in figure.axes[:1] + figure.axes[2::2]:
        panel.axhline(rtol, color="0.6", lw=0.8, zorder=0)
    _set_key(figure, colours, any(run.spectrum_seconds for run in runs), solve_name)
    return figure


def _shown(run: SolverRun) -> Floats:
    return np.asarray(np.maximum(run.residuals, _FLOOR))


def _draw_curves(
    panel: Axes, runs: Sequence[SolverRun], title: str, before: Sequence[float] | None
) -> None:
    """Residuals by iteration; or by the clock, where curves begin when all before is over.

    A direct solver is a point.
    """
    for i, run in enumerate(runs):
        colour, dashes = line_style(i)
        residuals, begin = _shown(run), run.start + (before[i] if before else 0.0)
        times = begin + run.times if before else np.arange(float(len(residuals)))
        if run.iterations is None and len(residuals):
            panel.plot(times, residuals, color=colour, marker="D", ms=6, ls="", clip_on=False)
        elif run.iterations is not None:
            if before:
                ends = [0, times[0]], residuals[[0, 0]]
                panel.plot(*ends, color=colour, ls=dashes, lw=0.9, alpha=0.5)
            panel.plot(times, residuals, color=colour, ls=dashes, lw=1.7)
        elif before:
            panel.axvline(begin, color=colour, ls=":", lw=1.4)
    panel.set_title(title, fontsize=11, loc="left")
    tidy(panel)
    panel.set_xlim(left=0)


def _draw_bars(
    panel: Axes, runs: Sequence[SolverRun], colours: Mapping[str, str], before: Sequence[float]
) -> None:
    """The stages of each run, one after the other."""
    for row, run in enumerate(runs):
        stages = [(seconds, colours[name]) for name, seconds in run.stages.items()]
        left = 0.0
        for seconds, colour in (
            *((before[row], _SPECTRUM), *stages),
            (run.solve_seconds, line_style(row)[0]),
        ):
            panel.barh(row, seconds, left=left, height=0.66, color=colour)
            left += seconds
        panel.text(left, row, f" {short(left)} s", fontsize=8, color="0.3", va="center")
    most = max(run.seconds + first for run, first in zip(runs, before, strict=True))
    panel.set(xlim=(0, 1.16 * most), xlabel="seconds")
    panel.set_ylim(len(runs) - 0.4, -0.6)
    panel.set_yticks([])
    panel.spines[["top", "right"]].set_visible(False)
    panel.tick_params(labelsize=9)


def _draw_table(panel: Axes, runs: Sequence[SolverRun]) -> None:
    """Names with their lines, and their iterations, beside the bars."""
    panel.set(xlim=(0, 1))
    panel.set_ylim(len(runs) - 0.4, -0.6)
    panel.axis("off")
    panel.text(0.97, -0.75, "iterations", fontsize=8, color="0.4", ha="right", va="bottom")
    for row, run in enumerate(runs):
        colour, dashes = line_style(row)
        residuals = run.residuals
        if len(residuals) == 1:
            panel.plot(0.035, row, color=colour, marker="D", ms=6)
        else:
            sample = dashes if len(residuals) else ":"
            panel.plot([0, 0.07], [row, row], color=colour, ls=sample, lw=1.9)
        panel.text(0.1, row, run.name, fontsize=9.5, va="center", parse_math=False)
        count = "\N{EN DASH}" if run.iterations is None else f"{run.iterations}"
        panel.text(0.97, row, count, fontsize=9.5, va="center", ha="right")


def _set_key(figure: Figure, colours: Mapping[str, str], spectrum: bool, solve_name: str) -> None:
    """What the colours of the bars stand for."""
    from matplotlib.patches import Patch

    key = [Patch(color=_SPECTRUM, label="spectrum")] if spectrum else []
    key += [Patch(color=colour, label=name) for name, colour in colours.items()]
    key.append(Patch(color=LINE_COLOURS[0], label=f"{solve_name} (colour of the line)"))
    figure.legend(
        handles=key, loc="lower right", ncols=len(key), frameon=False, fontsize=9, handlelength=1.2
    )
