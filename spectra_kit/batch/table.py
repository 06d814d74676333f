"""One row for each shape, or for each pair: what it is, and how far it can be trusted."""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from spectra_kit._checked import checked
from spectra_kit._files import atomic_path
from spectra_kit.batch.inputs import Input, Pair
from spectra_kit.batch.match_all import MatchReport
from spectra_kit.batch.matched import Matched
from spectra_kit.batch.run import BatchReport
from spectra_kit.errors import InvalidInputError
from spectra_kit.store import Completed

_OWN = ("name", "kind", "points", "faces", "area", "components", "zero_modes", "level", "residual",
        "problems", "warnings", "same_as", "shape", "spectrum")  # fmt: skip
_NUMBERED = re.compile(r"(eigenvalue|dna)_\d+")
_OF_PAIRS = ("source", "target", "score", "coverage", "margin", "mirror_margin", "orientation",
             "confidence", "mirrored", "ambiguous", "convincing", "doubts", "map")  # fmt: skip


@checked
def write_table(path: str | os.PathLike[str], report: BatchReport) -> None:
    """Write what was computed as CSV, a row for each shape.

    Parameters
    ----------
    path : path
        The file; it appears whole or not at all.
    report : BatchReport
        What was computed. What failed has no row.

    Raises
    ------
    InvalidInputError
        If a column of the manifest has the name of one of these, or the folder does not exist.

    Notes
    -----
    Columns: ``name`` and those of the manifest; ``kind``, ``points``, ``faces``, ``area`` and
    ``components``; ``zero_modes``, ``level`` and ``residual`` tell how far the modes can be
    trusted; ``problems`` of the geometry and ``warnings`` of the solver; ``same_as``, an earlier
    name of the very same geometry; the keys ``shape`` and ``spectrum`` of the store;
    ``eigenvalue_0`` and so on in 1/length^2, and ``dna_1`` and so on where the plan wants ShapeDNA.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import spectra_kit as sk
    >>> folder = Path(tempfile.mkdtemp())
    >>> sk.geometry.write(sk.geometry.creature(600), folder / "animal.off")
    >>> inputs, store = sk.batch.find_inputs([folder]), sk.store.SpectrumStore(folder / "store")
    >>> report = sk.batch.compute_all(inputs, store, sk.store.Plan(k=3))
    >>> sk.batch.write_table(folder / "table.csv", report)
    >>> (folder / "table.csv").read_text().splitlines()[0].split(",")[-2:]
    ['eigenvalue_1', 'eigenvalue_2']
    """
    check_columns([one for one, _ in report.completed])
    records = [done.record for _, done in report.completed]
    columns = [
        *("name", *_further(one for one, _ in report.completed), *_OWN[1:]),
        *(f"eigenvalue_{i}" for i in range(max((len(r.eigenvalues) for r in records), default=0))),
        *(f"dna_{i + 1}" for i in range(max((len(r.dna) for r in records), default=0))),
    ]
    first = dict[str, str]()
    rows = (
        _row(one, done, first.setdefault(done.record.shape, one.name))
        for one, done in report.completed
    )
    _write(path, columns, rows)


@checked
def write_match_table(path: str | os.PathLike[str], report: MatchReport) -> None:
    """Write what was matched as CSV, a row for each pair.

    Parameters
    ----------
    path : path
        The file; it appears whole or not at all.
    report : MatchReport
        What was matched. What failed has no row.

    Raises
    ------
    InvalidInputError
        If a column of the pairs has the name of one of these, or the folder does not exist.

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
    >>> sk.batch.write_match_table(path, sk.batch.MatchReport(matched=(), failed=(), seconds=0.0))
    >>> path.read_text().split(",")[:3]
    ['source', 'target', 'score']
    """
    pairs = [pair for pair, _ in report.matched]
    check_columns(pairs)
    columns = ["source", "target", *_further(pairs), *_OF_PAIRS[2:]]
    _write(path, columns, (_match_row(pair, found) for pair, found in report.matched))


def check_columns(things: Sequence[Input | Pair]) -> None:
    """Refuse further columns that have the names of a table's own: best before the work."""
    taken = set[str]()
    for one in things:
        own = _OWN if isinstance(one, Input) else _OF_PAIRS
        taken |= {name for name in one.columns if name in own or _NUMBERED.fullmatch(name)}
    if taken:
        raise InvalidInputError(
            "columns",
            "not have the names of the table's own",
            ", ".join(map(repr, sorted(taken))),
            advice="name them otherwise",
        )


def _further(things: Iterable[Input | Pair]) -> list[str]:
    """Return the names of further columns."""
    return list(dict.fromkeys(name for one in things for name in one.columns))


def _write(
    path: str | os.PathLike[str], columns: Sequence[str], rows: Iterable[Mapping[str, Any]]
) -> None:
    """Write rows as they come; names of files may be bytes of no text."""
    with (
        atomic_path(path) as part,
        part.open("w", newline="", encoding="utf-8", errors="surrogateescape") as file,
    ):
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(rows)


def _match_row(pair: Pair, found: Matched) -> dict[str, Any]:
    own: Mapping[str, Any] = {
        "source": pair.source,
        "target": pair.target,
        "score": repr(found.score),
        "coverage": repr(found.coverage),
        "margin": repr(found.margin),
        "mirror_margin": repr(found.mirror_margin),
        "orientation": "" if found.orientation is None else repr(found.orientation),
        "confidence": repr(found.confidence),
        "mirrored": found.mirrored,
        "ambiguous": found.ambiguous,
        "convincing": found.convincing,
        "doubts": "; ".join(found.doubts),
        "map": found.key,
    }
    return {"source": pair.source, "target": pair.target, **pair.columns, **own}


def _row(one: Input, done: Completed, first: str) -> dict[str, Any]:
    record = done.record
    own: Mapping[str, Any] = {
        "name": one.name,
        "kind": record.kind,
        "points": record.points,
        "faces": record.faces,
        "area": repr(record.area),
        "components": record.components,
        "zero_modes": record.zero_modes,
        "level": record.level,
        "residual": f"{record.residual:.1e}",
        "problems": "; ".join(record.problems),
        "warnings": "; ".join(record.warnings),
        "same_as": "" if first == one.name else first,
        "shape": record.shape,
        "spectrum": record.spectrum,
    }
    values = {f"eigenvalue_{i}": repr(value) for i, value in enumerate(record.eigenvalues)}
    signature = {f"dna_{i}": repr(value) for i, value in enumerate(record.dna, start=1)}
    return {"name": one.name, **one.columns, **own, **values, **signature}
