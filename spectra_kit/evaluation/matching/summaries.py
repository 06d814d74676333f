"""`Summary`: one method on one kind of spectra, over all pairs."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from spectra_kit.correspondence import FLIP_MARGIN
from spectra_kit.evaluation.matching.measure import PairResult
from spectra_kit.evaluation.matching.protocols import Protocol
from spectra_kit.evaluation.matching.runner import Run
from spectra_kit.evaluation.matching.table import Task

Name = tuple[str, str, str]  # kind, backend, method

#: A pair with a mean error above this has failed.
BAD = 8.0


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
    flipped : int or None
        Pairs with left for right: the symmetric error is smaller than the direct one by more than
        the margin. None if a pair has no symmetric truth.
    partly : int or None
        Other pairs where the smaller error at each correspondence is on average smaller than the
        direct one by more than the margin: an arm or a leg went to the other side.
    coverage, energy, bijectivity : float
        Means over the pairs.
    oracle : float
        Mean over the pairs of the best finalist's direct error; see `PairResult`.
    warned, false_alarms : int
        Pairs above `BAD` that the method called ambiguous, and pairs below it.
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
    flipped: int | None
    partly: int | None
    coverage: float
    energy: float
    bijectivity: float
    oracle: float
    warned: int
    false_alarms: int
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


def _summary(name: Name, rows: Sequence[PairResult], protocol: Protocol) -> Summary:
    def mean(field: str) -> float:
        return statistics.fmean(getattr(row, field) for row in rows)

    errors = [counted(row, protocol) for row in rows]
    sided = not any(math.isnan(row.symmetric) for row in rows)
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
        flipped=sum(row.flipped for row in rows) if sided else None,
        partly=sum(map(_partly, rows)) if sided else None,
        coverage=mean("coverage"),
        energy=mean("energy"),
        bijectivity=mean("bijectivity"),
        oracle=mean("oracle"),
        warned=sum(r.ambiguous for r, e in zip(rows, errors, strict=True) if e > BAD),
        false_alarms=sum(r.ambiguous for r, e in zip(rows, errors, strict=True) if e <= BAD),
        seconds=statistics.median(row.seconds for row in rows),
        cpu_seconds=statistics.median(row.cpu_seconds for row in rows),
    )


def _partly(row: PairResult) -> bool:
    return row.direct - row.either > FLIP_MARGIN and not row.flipped
