"""What the measurements say: one `Result` for each method and problem, and exponents."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from spectra_kit.errors import InvalidInputError

#: Below this many points a solve is mostly overhead: such sizes take no part in exponents.
FIT_FROM = 7500
#: A line through two sizes fits always, and says nothing about a third.
FIT_SIZES = 3


class Fit(NamedTuple):
    """An exponent, and the number of sizes that it was fitted to."""

    exponent: float
    sizes: int


@dataclass(frozen=True, kw_only=True)
class Result:
    """All repeats of one method on one problem.

    Attributes
    ----------
    geometry, device, method, solver : str
        ``"mesh"`` or ``"cloud"``, ``"cpu"`` or ``"cuda"``, the name in `METHODS`, and what it
        stands for.
    points, n : int
        Asked for, and there; n is 0 where nothing was assembled.
    status : {"ok", "failed", "stopped", "skipped", "absent"}
        Of the first repeat that was not ok, if any.
    reason : str
        Why it is not ok.
    seconds : tuple of float
        Of each solve: no assembly, no certificate.
    waiting : float or None
        Share of the time in which another process had the core, median; 0 where it is not known.
    iterations : int or None
        Sweeps or steps, where the method counts them.
    assembly_seconds : float or None
        Of L and M, measured once.
    peak_bytes, device_peak_bytes : int or None
        Largest memory of any repeat above that before the solve, and on the accelerator.
    residual_max, residual_median : float or None
        Of the relative residuals; see `Certificate`.
    eigenvalue_error, span_error : float or None
        Means; see `metrics.Comparison`. The span is that of the modes returned.
    missed : int or None
        Exact modes with more than half of their energy outside that span.
    no_errors : str
        Why there are no exact modes to compare with.
    commits : tuple of str
        At which it was measured.
    """

    geometry: str
    points: int
    n: int
    method: str
    device: str
    solver: str
    status: str
    reason: str
    seconds: tuple[float, ...]
    waiting: float | None
    iterations: int | None
    assembly_seconds: float | None
    peak_bytes: int | None
    device_peak_bytes: int | None
    residual_max: float | None
    residual_median: float | None
    eigenvalue_error: float | None
    span_error: float | None
    missed: int | None
    no_errors: str
    commits: tuple[str, ...]

    @property
    def ok(self) -> bool:
        """Whether every repeat ended well."""
        return self.status == "ok"

    @property
    def label(self) -> str:
        """Name of the method, with the device if it is not the CPU."""
        return self.method if self.device == "cpu" else f"{self.method} ({self.device})"

    @property
    def median(self) -> float:
        """Median of the seconds, NaN without any."""
        return statistics.median(self.seconds) if self.seconds else float("nan")

    def to_json(self) -> dict[str, Any]:
        """Return everything, the median too."""
        return {**asdict(self), "median_seconds": self.median if self.seconds else None}


def summarize(records: Iterable[Mapping[str, Any]]) -> list[Result]:
    """Gather the repeats of each method on each problem.

    Parameters
    ----------
    records : iterable of mapping
        As `measure` returns them.

    Returns
    -------
    list of Result
        By geometry and size, then in the order of the records.
    """
    groups: dict[tuple[str, int, str, str], list[Mapping[str, Any]]] = {}
    for record in records:
        key = record["key"]
        name = key["geometry"], key["points"], key["device"], key["method"]
        groups.setdefault(name, []).append(record)
    results = [_result(*name, repeats) for name, repeats in groups.items()]
    kinds = list(dict.fromkeys(result.geometry for result in results))
    return sorted(results, key=lambda result: (kinds.index(result.geometry), result.points))


def _result(
    geometry: str, points: int, device: str, method: str, repeats: Sequence[Mapping[str, Any]]
) -> Result:
    good = [record for record in repeats if record["status"] == "ok"]
    bad = next((record for record in repeats if record["status"] != "ok"), None)

    shares = [record["waited_seconds"] / record["wall_seconds"] for record in good]

    def first(name: str) -> Any:
        return next((r[name] for r in repeats if r.get(name) is not None), None)

    def largest(name: str) -> int | None:
        return max((record[name] for record in good), default=None)

    return Result(
        geometry=geometry,
        points=points,
        n=first("n") or 0,
        method=method,
        device=device,
        solver=first("solver") or "",
        status="ok" if bad is None else bad["status"],
        reason="" if bad is None else bad["reason"],
        seconds=tuple(record["seconds"] for record in good),
        waiting=statistics.median(shares) if shares else None,
        iterations=first("iterations"),
        assembly_seconds=first("assembly_seconds"),
        peak_bytes=largest("peak_bytes"),
        device_peak_bytes=largest("device_peak_bytes"),
        **{name: largest(name) for name in ("residual_max", "residual_median")},
        **{name: first(name) for name in ("eigenvalue_error", "span_error", "missed")},
        no_errors=first("no_errors") or "",
        commits=tuple(dict.fromkeys(r["commit"] for r in repeats if "commit" in r)),
    )


def fit_exponent(n: Sequence[float], seconds: Sequence[float]) -> float:
    """Fit ``seconds ~ n ** exponent`` by least squares of the logarithms.

    Parameters
    ----------
    n, seconds : sequence of float
        Positive, one each for every size.

    Returns
    -------
    float
        NaN where there are fewer than `FIT_SIZES` sizes.

    Raises
    ------
    InvalidInputError
        If the lengths disagree, or a number is not positive.

    Examples
    --------
    >>> from spectra_kit.benchmarks import fit_exponent
    >>> fit_exponent([1000, 10_000, 100_000], [0.02, 0.2, 2.0])
    1.0
    """
    x, y = np.asarray(n, dtype=np.float64), np.asarray(seconds, dtype=np.float64)
    if x.shape != y.shape or x.ndim != 1 or not ((x > 0).all() and (y > 0).all()):
        raise InvalidInputError(
            f"`n` and `seconds` must be positive and as many, got {list(n)} and {list(seconds)}"
        )
    if len(set(x)) < FIT_SIZES:
        return float("nan")
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def exponents(results: Iterable[Result]) -> dict[tuple[str, str, str], Fit]:
    """Fit an exponent for each geometry, device and method with enough sizes from `FIT_FROM` on."""
    lines: dict[tuple[str, str, str], dict[int, float]] = {}
    for result in results:
        if result.ok and result.n >= FIT_FROM:
            name = result.geometry, result.device, result.method
            lines.setdefault(name, {})[result.n] = result.median
    return {
        name: Fit(fit_exponent(list(line), list(line.values())), len(line))
        for name, line in lines.items()
        if len(line) >= FIT_SIZES
    }
