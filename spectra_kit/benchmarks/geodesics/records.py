"""What the record of a mesh says of a contender."""

from __future__ import annotations

import statistics
from typing import Any

from spectra_kit.benchmarks.geodesics.contenders import CONTENDERS

Record = dict[str, Any]


def iterations(record: Record, name: str) -> float | None:
    """Return the median iterations of a contender on a mesh; None where it does not iterate."""
    counts = [count for count in record["iterations"].get(name, []) if count is not None]
    return statistics.median(counts) if counts else None


def mean_error(record: Record, name: str, which: str = "mean") -> float | None:
    """Return an error of a contender on a mesh, averaged over sources; None where it failed."""
    errors = record["errors"][name]
    return None if "failure" in errors else statistics.fmean(error[which] for error in errors)


def seconds(record: Record, name: str, what: str = "first") -> float | None:
    """Return the seconds of a contender, modes at hand; None where it failed."""
    found: float | None = record[what][name].get("seconds")
    return found


def seconds_in_all(record: Record, name: str) -> float | None:
    """Return the seconds to the first field, those of the modes that it was handed with them."""
    own = seconds(record, name)
    return None if own is None else own + modes_seconds(record, name)


def modes_seconds(record: Record, name: str) -> float:
    """Return what the modes took that a contender used for its first field."""
    # A solver that has chosen to do without them has not used their time.
    if record["first"][name].get("choice", "").startswith("direct"):
        return 0.0
    found: float = record["spectra"].get(CONTENDERS[name].spectrum, 0.0)
    return found


def ratio(a: float | None, b: float | None) -> float | None:
    """Return a / b, or None where one is missing."""
    return None if a is None or b is None or b == 0 else a / b
