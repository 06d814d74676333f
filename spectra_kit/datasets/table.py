"""One row for each shape: what it is, and how far it can be trusted."""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from spectra_kit._core.checked import checked
from spectra_kit._core.files import atomic_path
from spectra_kit._core.shown import printable
from spectra_kit.datasets.completion import Completed
from spectra_kit.datasets.inputs import Input, Named, Pair
from spectra_kit.datasets.run import BatchReport
from spectra_kit.errors import InvalidInputError

_OF_RECORD = ("kind", "points", "faces", "area", "components", "zero_modes", "level", "shape",
              "spectrum")  # fmt: skip
_OWN = ("name", *_OF_RECORD[:-2], "residual", "problems", "warnings", "same_as", *_OF_RECORD[-2:])
_RUN = re.compile(r"\s*[=+\-@\uff1d\uff0b\uff0d\uff20]")  # the last four are fullwidth
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_NUMBERED = re.compile(r"(eigenvalue|dna)_\d+")


@checked
def write_table(path: str | os.PathLike[str], report: BatchReport[Input, Completed]) -> None:
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
        If it is the report of `match_all`, a column of the manifest has the name of one of these,
        or the folder does not exist.

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
    >>> inputs = sk.datasets.find_inputs([folder])
    >>> store = sk.datasets.SpectrumStore(folder / "store")
    >>> report = sk.datasets.compute_all(inputs, store, sk.datasets.Plan(k=3))
    >>> sk.datasets.write_table(folder / "table.csv", report)
    >>> (folder / "table.csv").read_text().splitlines()[0].split(",")[-2:]
    ['eigenvalue_1', 'eigenvalue_2']
    """
    inputs = things_of(report, Input, "compute_all")
    check_columns(inputs)
    records = [done.record for _, done in report.completed]
    columns = [
        *("name", *further(inputs), *_OWN[1:]),
        *(f"eigenvalue_{i}" for i in range(max((len(r.eigenvalues) for r in records), default=0))),
        *(f"dna_{i + 1}" for i in range(max((len(r.dna) for r in records), default=0))),
    ]
    first = dict[str, str]()
    rows = (
        _row(one, done, first.setdefault(done.record.shape, one.name))
        for one, done in report.completed
    )
    write(path, columns, rows)


def things_of(report: BatchReport[Named, Any], kind: type[Named], made_by: str) -> list[Named]:
    """Return what the rows are of; refuse the report of another kind of run."""
    things = [one for one, _ in report.completed]
    if not all(isinstance(one, kind) for one in things):
        raise InvalidInputError("report", f"be what `{made_by}` returned", "that of other things")
    return things


def check_columns(things: Sequence[Input | Pair], own: Sequence[str] = _OWN) -> None:
    """Refuse further columns that have the names of a table's own: best before the work."""
    if taken := {name for name in further(things) if name in own or _NUMBERED.fullmatch(name)}:
        raise InvalidInputError(
            "columns",
            "not have the names of the table's own",
            ", ".join(map(repr, sorted(taken))),
            advice="name them otherwise",
        )


def further(things: Iterable[Input | Pair]) -> list[str]:
    """Return the names of further columns."""
    return list(dict.fromkeys(name for one in things for name in one.columns))


def write(
    path: str | os.PathLike[str], columns: Sequence[str], rows: Iterable[Mapping[str, Any]]
) -> None:
    """Write rows as they come; names of files may be bytes of no text."""
    with (
        atomic_path(path) as part,
        part.open("w", newline="", encoding="utf-8", errors="surrogateescape") as file,
    ):
        writer = csv.writer(file)
        writer.writerow(map(_cell, columns))
        # Shapes of more parts have fewer columns of ShapeDNA, and manifests have their own.
        writer.writerows([_cell(row.get(name, "")) for name in columns] for row in rows)


def _cell(value: object) -> object:
    """Return a value as nothing that a spreadsheet would run: texts that it would, quoted."""
    text = printable(value, lines=True) if isinstance(value, str) else ""
    return f"'{text}" if _RUN.match(text) and not _NUMBER.fullmatch(text) else text or value


def _row(one: Input, done: Completed, first: str) -> dict[str, Any]:
    record = done.record
    own = {
        **{name: getattr(record, name) for name in _OF_RECORD},
        "residual": f"{record.residual:.1e}",
        "problems": "; ".join(record.problems),
        "warnings": "; ".join(record.warnings),
        "same_as": "" if first == one.name else first,
    }
    values = {f"eigenvalue_{i}": value for i, value in enumerate(record.eigenvalues)}
    signature = {f"dna_{i}": value for i, value in enumerate(record.dna, start=1)}
    return {"name": one.name, **one.columns, **own, **values, **signature}
