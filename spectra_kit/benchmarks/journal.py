"""`Journal`: measurements in a file that grows line by line and survives a crash."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from spectra_kit._files import atomic_path
from spectra_kit.errors import InvalidInputError

Record = dict[str, Any]


class Journal:
    """Records by their keys.

    Parameters
    ----------
    path : Path
        A ``.jsonl`` file, there or not; a last line that a crash cut short is dropped.
    retry : bool, default False
        Forget what had failed or was stopped.

    Raises
    ------
    InvalidInputError
        If a whole line is no record.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from spectra_kit.benchmarks.journal import Journal
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "journal.jsonl"
    ...     record = Journal(path).add({"n": 3}, {"status": "ok"})
    ...     Journal(path).get({"n": 3})["status"]
    'ok'
    """

    def __init__(self, path: Path, *, retry: bool = False) -> None:
        self._path = path
        self._records: dict[str, Record] = {}
        text = path.read_text(errors="replace") if path.exists() else ""
        if text and not text.endswith("\n"):  # cut short by a crash: measured again
            text = text[: text.rfind("\n") + 1]
            with atomic_path(path) as part:
                part.write_text(text)
        for number, line in enumerate(text.splitlines(), start=1):
            try:
                record = json.loads(line)
                key, good = record.pop("key"), record["status"] == "ok"
            except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
                raise InvalidInputError(
                    f"line {number} of {path} must be a measurement, got something else"
                    f" ({error}); remove the line"
                ) from error
            if good or not retry:
                self._records[_digest(key)] = record

    def get(self, key: Record) -> Record | None:
        """Return what was measured before."""
        return self._records.get(_digest(key))

    def add(self, key: Record, record: Record) -> Record:
        """Append a record and return it."""
        record = {**record, "time": datetime.now(UTC).isoformat(timespec="seconds")}
        with self._path.open("a") as file:
            file.write(json.dumps({"key": key, **record}) + "\n")
        self._records[_digest(key)] = record
        return record


def _digest(key: Record) -> str:
    return json.dumps(key, sort_keys=True)
