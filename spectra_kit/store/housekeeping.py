"""What a store is looked after by: all that is damaged, and all that nobody will ask for again."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spectra_kit._fingerprint import facts_digest
from spectra_kit._version import VERSION
from spectra_kit.errors import InvalidFileError
from spectra_kit.spectra import Spectrum
from spectra_kit.store import files
from spectra_kit.store.files import Damage, StoredEntry

if TYPE_CHECKING:
    from spectra_kit.store.store import SpectrumStore

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
    facts: Mapping[str, object] | None = None
    if entry.kind == "records":
        if (record := files.read_record(entry.path)) is not None:
            facts = files.record_facts(record.name, record.facts)
    elif entry.kind == "shapes":
        store.shape(entry.key)
    elif entry.kind == "spectra":
        Spectrum.load(entry.path)
        facts = files.read_facts(entry.path)
    else:
        facts = files.read(entry.path)[0]["facts"]
    if facts is not None and facts_digest(facts) != entry.key:
        raise InvalidFileError(entry.path, files.misnamed())


def clean(store: SpectrumStore, *, unnamed: bool) -> list[Path]:
    """See `SpectrumStore.clean`."""
    before = time.time() - _LEFT
    gone, used, named, kept = list[Path](), set[str](), set[str](), set[str]()
    # Listed before what they follow from: what a run makes meanwhile is no orphan.
    maps, descriptors = ([*store.entries(kind)] for kind in ("maps", "descriptors"))
    for entry in store.entries("records"):
        if (record := files.read_record(entry.path)) is None:
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


def _is_there(entry: StoredEntry) -> bool:
    return files.state(entry.path) is not None


def _older(path: Path, time: float) -> bool:
    state = files.state(path)
    return state is not None and state.st_mtime < time
