"""What a store is looked after by: all that is damaged, and all that nobody will ask for again."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spectra_kit._core.files import temporary_folder
from spectra_kit._core.version import VERSION
from spectra_kit.datasets import files
from spectra_kit.datasets.files import Damage, Kind, StoredEntry
from spectra_kit.errors import InvalidFileError

if TYPE_CHECKING:
    from spectra_kit.datasets.store import SpectrumStore

_LEFT = 24 * 3600  # seconds after which what a writer has left was left by one that is gone


def verify(
    store: SpectrumStore, *, remove: bool, progress: Callable[[int, int], object] | None
) -> list[Damage]:
    """See `SpectrumStore.verify`."""
    found, entries = [], list(store.entries())
    for i, entry in enumerate(entries):
        try:
            _read_whole(store, entry)
        except InvalidFileError as error:
            if _is_there(entry):
                found.append(Damage(entry.path, str(error.problem)))
                if remove:
                    files.remove(entry.path)
        if progress is not None:
            progress(i + 1, len(entries))
    return found


def _read_whole(store: SpectrumStore, entry: StoredEntry) -> None:
    """Raise if an entry is damaged, or under another name than its content has."""
    reading: Mapping[Kind, Callable[[str], object]] = {
        "shapes": store.shape,
        "spectra": store.load,
        "descriptors": store.load_descriptor,
        "operators": store.load_operator,
        "maps": store.load_map,
        "records": lambda _: files.read_record(entry.path),
    }
    reading[entry.kind](entry.key)


def clean(store: SpectrumStore, *, unnamed: bool) -> list[Path]:
    """See `SpectrumStore.clean`."""
    before = _now(Path(store.path)) - _LEFT
    gone, used, named, kept = list[Path](), set[str](), set[str](), set[str]()
    # Listed before what they follow from: what a run makes meanwhile is no orphan.
    maps, descriptors = ([*store.entries(kind)] for kind in ("maps", "descriptors"))
    for entry in store.entries("records"):
        try:
            record = files.read_record(entry.path)
        except InvalidFileError as error:
            if unnamed:  # nobody knows what it has named
                raise
            files.warn_of_omission(error)
            continue
        if record is None:
            continue
        if record.facts["release"] == VERSION:
            used.add(record.shape)
            named |= {record.spectrum, *record.operators.values()}
        else:
            gone.append(entry.path)
    for entry, facts in _with_facts(chain(store.entries("spectra"), store.entries("operators"))):
        wanted = not unnamed or entry.key in named or not _older(entry.path, before)
        if wanted and facts["release"] == VERSION:
            used.add(str(facts["shape"]))
            kept.add(entry.key)
        else:
            gone.append(entry.path)
    for entry, facts in _with_facts(descriptors):
        if facts["spectrum"] not in kept:
            gone.append(entry.path)
    for entry, facts in _with_facts(maps):
        if facts["release"] != VERSION or not {facts["source"], facts["target"]} <= kept:
            gone.append(entry.path)
    for entry in store.entries("shapes"):
        if entry.key not in used and _older(entry.path, before):
            gone.append(entry.path)
    for kind in files.SUFFIX:
        left = (path for path in files.places(store.path, kind) if path.name.startswith("."))
        gone += [path for path in left if _older(path, before)]
    for path in gone:
        files.remove(path)
    return gone


def _with_facts(entries: Iterable[StoredEntry]) -> Iterator[tuple[StoredEntry, dict[str, Any]]]:
    """Yield entries with what they follow from, but for those that others take out meanwhile."""
    for entry in entries:
        try:
            facts = files.read_facts(entry.path)
        except InvalidFileError:
            if _is_there(entry):
                raise
        else:
            yield entry, facts


def _now(folder: Path) -> float:
    """Return the time by the clock that the files of a folder have theirs from: another's maybe."""
    with files.writing(folder), temporary_folder(folder) as new:
        return new.stat().st_mtime


def _is_there(entry: StoredEntry) -> bool:
    return files.state(entry.path) is not None


def _older(path: Path, moment: float) -> bool:
    state = files.state(path)
    return state is not None and state.st_mtime < moment
