"""Results of an evaluation as numbers, as Markdown, and as figures."""

from __future__ import annotations

import json
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from spectra_kit._files import atomic_path
from spectra_kit._version import VERSION
from spectra_kit.correspondence import FLIP_MARGIN, geodesic_errors
from spectra_kit.evaluation.matching.measure import THRESHOLDS, PairResult
from spectra_kit.evaluation.matching.protocols import PROTOCOLS, Protocol
from spectra_kit.evaluation.matching.runner import Run, Settings
from spectra_kit.evaluation.matching.subjects import Subject, truth_between
from spectra_kit.evaluation.matching.table import Task
from spectra_kit.viz.correspondence import MatchedPair, plot_correspondences

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]
Name = tuple[str, str, str]  # kind, backend, method

#: A pair with a mean error above this has failed.
BAD = 8.0
# Okabe and Ito's colours: told apart with every kind of colour blindness.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#999999")
_DASHES = ("-", "--", ":", "-.")
_DPI = 150


@dataclass(frozen=True, eq=False, kw_only=True)
class Summary:
    """One method on one backend's spectra of meshes or clouds, over all pairs.

    Attributes
    ----------
    kind, backend, method : str
        What was run.
    pairs : int
        How many pairs have a result.
    mean, median : float
        Over the pairs, of their mean errors as the protocol counts them.
    bad : float
        Share of pairs above `BAD`.
    auc : float
        Mean area under the accuracy curve up to 10.
    direct, symmetric, either : float
        Means over the pairs of each kind of error.
    flipped : int
        Pairs whose symmetric error is smaller than the direct one by more than the margin.
    coverage, energy, bijectivity : float
        Means over the pairs.
    oracle : float
        Mean over the pairs of the best candidate's direct error; NaN without candidates.
    seconds, cpu_seconds : float
        Medians over the pairs: of the clock, and of work.
    """

    kind: str
    backend: str
    method: str
    pairs: int
    mean: float
    median: float
    bad: float
    auc: float
    direct: float
    symmetric: float
    either: float
    flipped: int
    coverage: float
    energy: float
    bijectivity: float
    oracle: float
    seconds: float
    cpu_seconds: float

    @property
    def name(self) -> Name:
        """Kind, backend and method."""
        return self.kind, self.backend, self.method

    @property
    def label(self) -> str:
        """For tables and figures; clouds are named, and of peers no backend."""
        label = self.method if self.method == "pyfm" else f"{self.method}, {self.backend}"
        return label + (", clouds" if self.kind == "cloud" else "")


def counted(result: PairResult, protocol: Protocol) -> float:
    """Return the error that the protocol counts."""
    return result.either if protocol.symmetric else result.direct


def summarize_runs(results: Mapping[Task, PairResult], protocol: Protocol) -> list[Summary]:
    """Summarise results by kind, backend and method.

    Parameters
    ----------
    results : mapping of Task to PairResult
        Of a `Run`.
    protocol : Protocol
        Which errors count.

    Returns
    -------
    list of Summary
        In the order in which they first appear.
    """
    groups: dict[Name, list[PairResult]] = {}
    for task, result in results.items():
        groups.setdefault((task.kind, task.backend, task.method), []).append(result)
    return [_summary(name, rows, protocol) for name, rows in groups.items()]


def ranked(run: Run, name: Name, protocol: Protocol) -> list[Task]:
    """Return the tasks of one group from the best map to the worst."""
    tasks = [t for t in run.results if (t.kind, t.backend, t.method) == name]
    return sorted(tasks, key=lambda task: counted(run.results[task], protocol))


def write_matching_report(run: Run, settings: Settings, protocol: Protocol) -> Path:
    """Write ``matching.md``, ``matching.json`` and the accuracy curves into the folder.

    Parameters
    ----------
    run : Run
        Of `run_tasks`.
    settings : Settings
        Its settings.
    protocol : Protocol
        Which errors count.

    Returns
    -------
    Path
        The Markdown file.
    """
    folder = settings.folder
    rows = summarize_runs(run.results, protocol)
    record = {
        "version": VERSION,
        "protocol": {"name": protocol.name, "pairs": len(protocol.pairs)},
        "k": settings.k,
        "summaries": [asdict(row) for row in rows],
        "failures": [{**asdict(task), "reason": why} for task, why in run.failures.items()],
    }
    with atomic_path(folder / "matching.json") as part:
        part.write_text(json.dumps(record, indent=1) + "\n")
    with atomic_path(folder / "matching.md") as part:
        part.write_text(_markdown(run, rows, settings, protocol))
    if rows:
        draw_accuracy(run, rows, protocol, folder / "accuracy.png")
    return folder / "matching.md"


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
        style = {"color": _COLOURS[i % len(_COLOURS)], "ls": _DASHES[i // len(_COLOURS) % 4]}
        points.plot(THRESHOLDS, 100 * np.mean(curves, axis=0), label=row.label, lw=1.6, **style)
        errors = np.sort([counted(r, protocol) for r in these])
        share = 100 * np.arange(1, len(errors) + 1) / len(errors)
        pairs.step(errors, share, where="post", lw=1.6, **style)
    points.set(xlim=(0, 10), xlabel="geodesic error (100 / √area)", ylabel="points (%)")
    pairs.set(xscale="log", xlabel="mean error of a pair (100 / √area)", ylabel="pairs (%)")
    pairs.axvline(BAD, color="0.6", lw=0.8, zorder=0)
    for axes in (points, pairs):
        axes.set_ylim(0, 101)
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(color="0.92", lw=0.7)
    points.legend(frameon=False, fontsize=8, loc="lower right")
    _save(figure, path)
    return path


def draw_extremes(run: Run, settings: Settings, protocol: Protocol, name: Name) -> Path:
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
    chosen = {"best": tasks[0], "median": tasks[(len(tasks) - 1) // 2], "worst": tasks[-1]}
    path = settings.folder / f"extremes-{'-'.join(name)}.png"
    plot_correspondences(
        path,
        [
            _drawn(settings, task, f"{what}: {counted(run.results[task], protocol):.2f}")
            for what, task in chosen.items()
        ],
        title=f"{name[2]}: {name[1]} spectra of {'meshes' if name[0] == 'mesh' else 'clouds'}",
        subtitle=f"mean geodesic errors of {len(tasks)} pairs, in hundredths of √area",
    )
    return path


def _summary(name: Name, rows: Sequence[PairResult], protocol: Protocol) -> Summary:
    def mean(field: str) -> float:
        return statistics.fmean(getattr(row, field) for row in rows)

    errors = [counted(row, protocol) for row in rows]
    return Summary(
        kind=name[0],
        backend=name[1],
        method=name[2],
        pairs=len(rows),
        mean=statistics.fmean(errors),
        median=statistics.median(errors),
        bad=statistics.fmean(error > BAD for error in errors),
        auc=mean("auc_either" if protocol.symmetric else "auc"),
        direct=mean("direct"),
        symmetric=mean("symmetric"),
        either=mean("either"),
        flipped=sum(row.flipped for row in rows),
        coverage=mean("coverage"),
        energy=mean("energy"),
        bijectivity=mean("bijectivity"),
        oracle=mean("oracle"),
        seconds=statistics.median(row.seconds for row in rows),
        cpu_seconds=statistics.median(row.cpu_seconds for row in rows),
    )


_HEADS = (
    "method, spectra",
    "pairs",
    "mean",
    "median",
    "over 8",
    "AUC",
    "direct",
    "symmetric",
    "either",
    "flipped",
    "oracle",
    "coverage",
    "energy",
    "back",
    "s",
    "CPU s",
)


def _markdown(run: Run, rows: Sequence[Summary], settings: Settings, protocol: Protocol) -> str:
    what = "the smaller of direct and symmetric" if protocol.symmetric else "direct"
    lines = [
        "# Matching",
        "",
        f"{len(protocol.pairs)} pairs ({protocol.name}: {PROTOCOLS[protocol.name]});"
        f" {settings.k} modes; spectra_kit {VERSION}.",
        "",
        "Errors are geodesic distances along the edges of the source, in hundredths of the root of"
        f" its area; *mean*, *median*, *over 8* (share of pairs) and *AUC* (up to 10): {what}"
        " errors. *Flipped*: pairs whose mean symmetric error is lower than the direct one by more"
        f" than {FLIP_MARGIN:g}. *Oracle*: direct error if the truth chose among the candidates."
        " *Coverage*: share of the source's area hit. *Energy*: Dirichlet, 1 for an isometry."
        " *Back*: mean distance to where the transposed functional map leads back. Seconds are"
        " medians of one pair, spectra given.",
        "",
    ]
    if rows:
        lines += ["| " + " | ".join(_HEADS) + " |", "|---" * len(_HEADS) + "|"]
        lines += ["| " + " | ".join(_cells(row)) + " |" for row in rows]
        lines += ["", *_relative(rows), "![accuracy](accuracy.png)", ""]
    else:
        lines += ["Nothing was measured.", ""]
    reasons: dict[str, list[Task]] = {}
    for task, why in run.failures.items():
        reasons.setdefault(why, []).append(task)
    if reasons:
        lines += ["Not matched:", ""]
        for why, tasks in reasons.items():
            first = tasks[0]
            who = (
                f"{first.source} to {first.target} ({first.kind}, {first.backend}, {first.method})"
            )
            more = f" and {len(tasks) - 1} more" if len(tasks) > 1 else ""
            lines.append(f"- {who}{more}: {why}")
        lines.append("")
    return "\n".join(lines)


def _cells(row: Summary) -> list[str]:
    def number(value: float, digits: int) -> str:
        return "" if np.isnan(value) else f"{value:.{digits}f}"

    return [
        row.label,
        str(row.pairs),
        f"**{row.mean:.2f}**",
        number(row.median, 2),
        f"{row.bad:.0%}",
        number(row.auc, 3),
        number(row.direct, 2),
        number(row.symmetric, 2),
        number(row.either, 2),
        str(row.flipped),
        number(row.oracle, 2),
        number(row.coverage, 2),
        number(row.energy, 2),
        number(row.bijectivity, 2),
        number(row.seconds, 2),
        number(row.cpu_seconds, 2),
    ]


def _relative(rows: Sequence[Summary]) -> list[str]:
    """How other spectra compare with exact ones, method by method."""
    exact = {(row.kind, row.method): row.mean for row in rows if row.backend == "exact"}
    lines = [
        f"- {row.label}: {row.mean / exact[row.kind, row.method]:.2f} times the mean error with"
        " exact spectra"
        for row in rows
        if row.backend != "exact" and exact.get((row.kind, row.method))
    ]
    return [*lines, ""] if lines else []


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


def _spread(source: Subject, target: Subject, point_map: NDArray[np.int64]) -> Floats:
    """Direct errors on all target points: each has that of the nearest landmark."""
    truth = truth_between(source, target)
    errors = geodesic_errors(source.mesh, point_map, truth)
    points = target.mesh.points
    _, nearest = cKDTree(points[truth.target]).query(points)
    return np.asarray(errors[nearest])


def _save(figure: Figure, path: Path) -> None:
    with atomic_path(path) as part:
        figure.savefig(part, dpi=_DPI)
