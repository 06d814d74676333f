"""One row for each shape, or for each pair: what it is, and how far it can be trusted."""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from typing import Any

from spectra_kit._core.checked import checked
from spectra_kit._core.files import atomic_path
from spectra_kit._core.shown import printable
from spectra_kit.datasets.files import MapRecord, ShapeRecord
from spectra_kit.datasets.inputs import Input, Pair
from spectra_kit.datasets.run import BatchReport, Completed
from spectra_kit.errors import InvalidInputError
from spectra_kit.features import shape_dna_distances

_OF_RECORD = ("kind", "points", "faces", "area", "components", "boundary_edges",
              "euler_characteristic", "volume", "zero_modes", "level", "shape",
              "spectrum")  # fmt: skip
OF_SHAPES = ("name", *_OF_RECORD[:-2], "residual", "problems", "warnings", "same_as",
             *_OF_RECORD[-2:])  # fmt: skip
_JUDGED = tuple(one.name for one in fields(MapRecord) if one.name not in ("doubts", "key"))
OF_PAIRS = ("source", "target", *_JUDGED, "doubts", "map")
_RUN = re.compile(r"\s*[=+\-@\uff1d\uff0b\uff0d\uff20]")  # the last four are fullwidth
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_NUMBERED = re.compile(r"(eigenvalue|dna_by_area)_\d+")


@checked
def write_table(path: str | os.PathLike[str], report: BatchReport[Any, Any]) -> None:
    """Write what came of a run as CSV, a row for each shape, or for each pair.

    Parameters
    ----------
    path : path
        The file; it appears whole or not at all.
    report : BatchReport
        What was computed or matched. What failed has no row.

    Notes
    -----
    Columns of shapes: ``name`` and those of the manifest, which must not be named like others;
    ``kind``, ``points``, ``faces``, ``area`` and ``components``; of meshes ``boundary_edges``, 0
    where there are no holes, ``euler_characteristic`` and, of closed ones, the enclosed
    ``volume``, negative where faces look inwards; ``zero_modes``, ``level`` and ``residual`` tell
    how far the modes can be trusted; ``problems`` of the geometry and ``warnings`` of the solver,
    and of several components; ``same_as``, an earlier name of the very same geometry; the keys
    ``shape`` and ``spectrum`` of the store; ``eigenvalue_0`` and so on in 1/length^2, zero modes
    first, one for each component; and ``dna_by_area_1`` and so on, those behind the zero modes
    times the area, where the plan wants ShapeDNA: a shape in another unit, or of another size, has
    the same.

    Columns of pairs: ``source``, ``target`` and those of the table of pairs; ``score`` and
    ``coverage``, ``margin`` and ``mirror_margin`` over rivals, and ``orientation`` of the map, as
    `Match` has them; ``confidence``, ``mirrored``, ``ambiguous``, ``convincing``, and the
    ``doubts`` behind them; the key ``map`` of the store, for `load_match`.

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
    things = [one for one, _ in report.completed]
    if report.of == "pairs":
        check_columns(things, OF_PAIRS)
        columns = [*OF_PAIRS[:2], *further(things), *OF_PAIRS[2:]]
        write(path, columns, (_pair_row(*one) for one in report.completed))
        return
    check_columns(things)
    records = [done.record for _, done in report.completed]
    columns = [
        *(OF_SHAPES[0], *further(things), *OF_SHAPES[1:]),
        *(f"eigenvalue_{i}" for i in range(max((len(r.eigenvalues) for r in records), default=0))),
        *(f"dna_by_area_{i + 1}" for i in range(max((len(r.dna) for r in records), default=0))),
    ]
    first = dict[str, str]()
    rows = (
        _shape_row(one, done, first.setdefault(done.record.shape, one.name))
        for one, done in report.completed
    )
    write(path, columns, rows)


@checked
def write_distances(path: str | os.PathLike[str], report: BatchReport[Any, Any]) -> None:
    """Write how far shapes are apart by their ShapeDNA as CSV, a row and a column for each.

    Parameters
    ----------
    path : path
        The file; it appears whole or not at all.
    report : BatchReport
        What was computed, by a plan that wants ShapeDNA ("dna" among its descriptors).

    Notes
    -----
    `features.shape_dna_distances` of the eigenvalues times the area, as many as all shapes have,
    each divided by its index: of form, not of size, and dimensionless. Compare meshes of about one
    resolution: that of one shape moves its eigenvalues, too.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import spectra_kit as sk
    >>> folder = Path(tempfile.mkdtemp())
    >>> for i in range(2):
    ...     sk.geometry.write(sk.geometry.creature(600, seed=i), folder / f"{i}.off")
    >>> store = sk.datasets.SpectrumStore(folder / "store")
    >>> plan = sk.datasets.Plan(k=8, descriptors=("dna",))
    >>> report = sk.datasets.compute_all(sk.datasets.find_inputs([folder]), store, plan)
    >>> sk.datasets.write_distances(folder / "apart.csv", report)
    >>> len((folder / "apart.csv").read_text().splitlines())
    3
    """
    records = [done.record for _, done in report.completed if report.of == "shapes"]
    if len(records) < 2 or not all(one.dna for one in records):
        raise InvalidInputError(
            "report",
            "hold the ShapeDNA of two shapes at least",
            f"that of {sum(bool(one.dna) for one in records)} of {len(report.completed)}",
            advice='compute them by a Plan(descriptors=("dna",))',
        )
    count = min(len(one.dna) for one in records)
    apart = shape_dna_distances([one.dna[:count] for one in records])
    names = [one.name for one, _ in report.completed]
    table = (dict(zip(names, row, strict=True)) for row in apart.tolist())
    write(path, ["name", *names], ({"name": n} | row for n, row in zip(names, table, strict=True)))


def check_columns(things: Sequence[Input | Pair], own: Sequence[str] = OF_SHAPES) -> None:
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


def _shape_row(one: Input, done: Completed[ShapeRecord], first: str) -> dict[str, Any]:
    record = done.record
    own = {
        **{name: getattr(record, name) for name in _OF_RECORD},
        "residual": f"{record.residual:.1e}",
        "problems": "; ".join(record.problems),
        "warnings": "; ".join(record.warnings),
        "same_as": "" if first == one.name else first,
    }
    values = {f"eigenvalue_{i}": value for i, value in enumerate(record.eigenvalues)}
    signature = {f"dna_by_area_{i}": value for i, value in enumerate(record.dna, start=1)}
    return {"name": one.name, **one.columns, **own, **values, **signature}


def _pair_row(pair: Pair, done: Completed[MapRecord]) -> dict[str, Any]:
    record = done.record
    judged = {name: getattr(record, name) for name in _JUDGED}
    own = {**judged, "doubts": "; ".join(record.doubts), "map": record.key}
    return {"source": pair.source, "target": pair.target, **pair.columns, **own}
