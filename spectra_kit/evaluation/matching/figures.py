"""Accuracy curves, and pictures of the best, median and worst maps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from spectra_kit.correspondence import MapErrors, geodesic_errors
from spectra_kit.evaluation.matching.measure import THRESHOLDS
from spectra_kit.evaluation.matching.protocols import Protocol
from spectra_kit.evaluation.matching.runner import Run, Settings
from spectra_kit.evaluation.matching.subjects import Subject, truth_between
from spectra_kit.evaluation.matching.summaries import BAD, Name, Summary, counted, ranked
from spectra_kit.evaluation.matching.table import Task
from spectra_kit.viz import MatchedPair, Page, View, plot_correspondences
from spectra_kit.viz.axes import LINE_COLOURS

_DASHES = ("-", "--", ":", "-.")
_TICKS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50)  # less is drawn as the first
_DPI = 150


def draw_accuracy(run: Run, rows: Sequence[Summary], protocol: Protocol, path: Path) -> Path:
    """Draw the share of points within each error, for every summary, and over the pairs."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    points, pairs = figure.subplots(1, 2)
    for i, row in enumerate(rows):
        these = [r for t, r in run.results.items() if (t.kind, t.backend, t.method) == row.name]
        curves = [r.accuracy_either if protocol.symmetric else r.accuracy for r in these]
        style = {"color": LINE_COLOURS[i % len(LINE_COLOURS)], "ls": _DASHES[i % len(_DASHES)]}
        points.plot(THRESHOLDS, 100 * np.mean(curves, axis=0), label=row.label, lw=1.6, **style)
        errors = np.sort([max(counted(r, protocol), _TICKS[0]) for r in these])
        share = 100 * np.arange(len(errors) + 1) / len(errors)
        pairs.step(np.append(errors[0], errors), share, where="post", lw=1.6, **style)
    points.set(xlim=(0, 10), xlabel="geodesic error (100 / √area)", ylabel="points (%)")
    pairs.set(xscale="log", xlabel="mean error of a pair (100 / √area)", ylabel="pairs (%)")
    low, high = pairs.get_xlim()
    ticks = [t for t in _TICKS if low <= t <= high]
    pairs.set_xticks(ticks, [f"{t:g}" for t in ticks])
    pairs.set_xticks([], minor=True)
    pairs.axvline(BAD, color="0.6", lw=0.8, zorder=0)
    for axes in (points, pairs):
        axes.set_ylim(0, 101)
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(color="0.92", lw=0.7)
    points.legend(frameon=False, fontsize=8, loc="lower right")
    figure.savefig(path, dpi=_DPI)
    return path


def draw_extremes(
    run: Run,
    settings: Settings,
    protocol: Protocol,
    name: Name,
    *,
    up: Literal["y", "z"] | None = None,
) -> Path:
    """Draw the best, median and worst map of one group, with their errors.

    Parameters
    ----------
    run : Run
        Of `run_tasks`, with results in that group.
    settings : Settings
        Where the maps lie.
    protocol : Protocol
        Which errors rank.
    name : (str, str, str)
        Kind, backend and method.
    up : {"y", "z"}, optional
        As in `viz.View`.

    Returns
    -------
    Path
        ``extremes-KIND-BACKEND-METHOD.png`` in the folder.

    Raises
    ------
    MissingDependencyError
        Without PyVista, or an OpenGL library.
    """
    tasks = ranked(run, name, protocol)
    chosen = {tasks[-1]: "worst", tasks[(len(tasks) - 1) // 2]: "median", tasks[0]: "best"}
    path = settings.folder / f"extremes-{'-'.join(name)}.png"
    plot_correspondences(
        path,
        [
            _drawn(settings, task, f"{what}: {counted(run.results[task], protocol):.2f}")
            for task, what in reversed(chosen.items())
        ],
        view=View(up),
        page=Page(
            f"{name[2]}: {name[1]} spectra of {'meshes' if name[0] == 'mesh' else 'clouds'}",
            f"mean geodesic errors of {len(tasks)} pairs, in hundredths of √area",
        ),
    )
    return path


def _drawn(settings: Settings, task: Task, name: str) -> MatchedPair:
    subjects = [settings.subjects[who] for who in (task.source, task.target)]
    point_map = np.load(settings.map_path(task)).astype(np.int64)
    meshes = [subject.mesh for subject in subjects]
    geometries = [mesh.as_cloud() if task.kind == "cloud" else mesh for mesh in meshes]
    return MatchedPair(
        source=geometries[0],
        target=geometries[1],
        point_map=point_map,
        errors=_spread(subjects[0], subjects[1], point_map),
        name=name,
        names=(task.source, task.target),
    )


def _spread(source: Subject, target: Subject, point_map: NDArray[np.int64]) -> MapErrors:
    """Direct errors along edges on all target points: each has that of the nearest landmark."""
    truth = truth_between(source, target)
    errors = geodesic_errors(source.mesh, point_map, truth)
    points = target.mesh.points
    _, nearest = cKDTree(points[truth.target]).query(points)
    return MapErrors(errors[nearest], np.arange(len(points)))
