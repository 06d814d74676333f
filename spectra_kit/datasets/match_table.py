"""One row for each pair: how well it was matched, and what speaks against it."""

from __future__ import annotations

import os
from typing import Any

from spectra_kit._core.checked import checked
from spectra_kit.datasets.inputs import Pair
from spectra_kit.datasets.matched import JUDGED, Matched
from spectra_kit.datasets.run import BatchReport
from spectra_kit.datasets.table import check_columns, further, things_of, write

OF_PAIRS = ("source", "target", *JUDGED, "doubts", "map")


@checked
def write_match_table(path: str | os.PathLike[str], report: BatchReport[Pair, Matched]) -> None:
    """Write what was matched as CSV, a row for each pair.

    Parameters
    ----------
    path : path
        The file; it appears whole or not at all.
    report : BatchReport
        What was matched. What failed has no row.

    Raises
    ------
    InvalidInputError
        If it is the report of `compute_all`, a column of the pairs has the name of one of these,
        or the folder does not exist.

    Notes
    -----
    Columns: ``source``, ``target`` and those of the pairs; ``score`` and ``coverage``, ``margin``
    and ``mirror_margin`` over rivals, and ``orientation`` of the map, as `Match` has them;
    ``confidence``, ``mirrored``, ``ambiguous``, ``convincing``, and the ``doubts`` behind them; the
    key ``map`` of the store, for `load_match`.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import spectra_kit as sk
    >>> path = Path(tempfile.mkdtemp()) / "maps.csv"
    >>> nothing = sk.datasets.BatchReport(completed=(), failed=(), seconds=0.0)
    >>> sk.datasets.write_match_table(path, nothing)
    >>> path.read_text().split(",")[:3]
    ['source', 'target', 'score']
    """
    pairs = things_of(report, Pair, "match_all")
    check_columns(pairs, OF_PAIRS)
    columns = ["source", "target", *further(pairs), *OF_PAIRS[2:]]
    write(path, columns, (_match_row(pair, found) for pair, found in report.completed))


def _match_row(pair: Pair, found: Matched) -> dict[str, Any]:
    own = {
        **{name: getattr(found, name) for name in JUDGED},
        "doubts": "; ".join(found.doubts),
        "map": found.key,
    }
    return {"source": pair.source, "target": pair.target, **pair.columns, **own}
