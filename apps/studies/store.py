"""`Store`: what was measured, a line of JSON each, in a file that survives a crash."""

from __future__ import annotations

import fcntl
import hashlib
import json
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import IO, Any

import spectra_kit
from spectra_kit._core.version import VERSION
from spectra_kit.errors import InvalidInputError

Record = dict[str, Any]

_PACKAGE = Path(spectra_kit.__file__).parent
_SHOWN = ("cli/", "show/", "neo/train/")  # where no measured number comes from


class Store:
    """Records by their keys, in a folder, which is made if missing.

    ``measurements.jsonl`` grows by a line for each record; a last line that a crash cut short is
    dropped, a whole one that is no record refused. ``files`` holds what records name as "files".
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._path = folder / "measurements.jsonl"
        self._records: dict[str, Record] = {}
        (folder / "files").mkdir(parents=True, exist_ok=True)
        whole = self._repaired() if self._path.exists() else b""
        for number, line in enumerate(whole.decode(errors="replace").splitlines(), start=1):
            try:
                record = json.loads(line)
                self._records[record["key"]] = {**record, "status": record["status"]}
            except (ValueError, TypeError, KeyError, RecursionError) as error:
                raise InvalidInputError(
                    f"line {number} of {self._path} must be a measurement, got something else"
                    f" ({error}); remove the line"
                ) from error

    def get(self, key: str) -> Record | None:
        """Return what was measured before, if the files that belong to it are there."""
        record = self._records.get(key)
        if record is None:
            return None
        there = all((self.folder / name).exists() for name in record.get("files", ()))
        return record if there else None

    def add(self, key: str, record: Record) -> Record:
        """Append a record and return it."""
        record = {"key": key, **record, "time": datetime.now(UTC).isoformat(timespec="seconds")}
        line = json.dumps(record) + "\n"
        with self._alone() as file:
            file.write(line.encode())
        self._records[key] = json.loads(line)  # as it will be read
        return self._records[key]

    def _repaired(self) -> bytes:
        """Return the whole lines; drop what a crash has cut short, to be measured again."""
        with self._alone() as file:
            data = file.read()
            whole = data[: data.rfind(b"\n") + 1]
            if len(whole) < len(data):
                file.truncate(len(whole))
        return whole

    @contextmanager
    def _alone(self) -> Iterator[IO[bytes]]:
        """Open the file, to read and to append, while no other run does: two may share a folder."""
        with self._path.open("a+b") as file:
            fcntl.flock(file, fcntl.LOCK_EX)  # until it is closed
            file.seek(0)
            yield file


@cache
def code_digest(sources: tuple[str, ...] = (), package: Path = _PACKAGE) -> str:
    """Version and hash of the package's sources that numbers come from.

    Given by patterns of paths in the package; by default everything but what shows or trains.
    """
    found = hashlib.blake2b(digest_size=8)
    for path in _sources(sources, package):
        found.update(path.relative_to(package).as_posix().encode() + b"\0" + path.read_bytes())
    return f"{VERSION}+{found.hexdigest()}"


def _sources(patterns: tuple[str, ...], package: Path) -> Iterable[Path]:
    for pattern in patterns or ("**/*.py",):
        found = sorted(package.glob(pattern))
        if not found:  # moved, and nobody would measure again what depends on it
            raise InvalidInputError("sources", "match files of the package", repr(pattern))
        for path in found:
            if patterns or not path.relative_to(package).as_posix().startswith(_SHOWN):
                yield path
