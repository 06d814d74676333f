"""One row for each shape: what it is, how far its modes can be trusted, and its eigenvalues."""

from __future__ import annotations

import csv
import os
from collections.abc import Mapping
from typing import Any

from spectra_kit._checked import checked
from spectra_kit._files import atomic_path
from spectra_kit.batch.inputs import Input
from spectra_kit.batch.run import BatchReport
from spectra_kit.errors import InvalidInputError
from spectra_kit.store import Completed

_OWN = ("name", "kind", "points", "faces", "area", "components", "zero_modes", "level", "residual",
        "problems", "warnings", "same_as", "shape", "spectrum")  # fmt: skip


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
    rows = [_row(one, done) for one, done in report.completed]
    first = dict[str, str]()
    for row in rows:
        row["same_as"] = first.setdefault(row["shape"], row["name"])
        if row["same_as"] == row["name"]:
            row["same_as"] = ""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    with atomic_path(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns or _OWN)
        writer.writeheader()
        writer.writerows(rows)


def _row(one: Input, done: Completed) -> dict[str, Any]:
    record = done.record
    own: Mapping[str, Any] = {
        "name": one.name,
        "kind": done.kind,
        "points": done.points,
        "faces": done.faces,
        "area": repr(done.area),
        "components": done.components,
        "zero_modes": done.zero_modes,
        "level": done.level,
        "residual": f"{done.residual:.1e}",
        "problems": "; ".join(record.problems),
        "warnings": "; ".join(record.warnings),
        "same_as": "",
        "shape": record.shape,
        "spectrum": record.spectrum,
    }
    if taken := [name for name in one.columns if name in own]:
        raise InvalidInputError(
            "columns", "not have the names of the table's own", ", ".join(map(repr, taken))
        )
    values = {f"eigenvalue_{i}": repr(float(v)) for i, v in enumerate(done.eigenvalues)}
    signature = (
        {}
        if done.dna is None
        else {f"dna_{i}": repr(float(v)) for i, v in enumerate(done.dna, start=1)}
    )
    return {"name": one.name, **one.columns, **own, **values, **signature}
