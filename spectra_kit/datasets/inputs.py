"""What a run is about: files to compute, or pairs of shapes of a store to match, by name."""

from __future__ import annotations

import csv
import glob
import os
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import TypeVar

from spectra_kit._core.checked import checked
from spectra_kit._core.fingerprint import facts_digest
from spectra_kit._core.validate import check_count
from spectra_kit._core.version import VERSION
from spectra_kit.datasets.files import MARK, ShapeRecord
from spectra_kit.datasets.plan import Plan
from spectra_kit.datasets.store import SpectrumStore
from spectra_kit.errors import InvalidFileError, InvalidInputError
from spectra_kit.geometry.formats._room import format_of
from spectra_kit.geometry.formats.foreign import advice_for
from spectra_kit.geometry.formats.xyz import holds_points
from spectra_kit.geometry.io import ANYTHING, READERS, readable_files

_PATTERN = "*?["
_FIELD = re.compile(r"\{([A-Za-z_]\w*)\}")  # of a pattern
_FILE = "file"  # column of a manifest
_ENDS = ("source", "target")  # columns of a table of pairs
_ALL = "all"  # instead of such a table


@checked
@dataclass(frozen=True, kw_only=True)
class Input:
    """A file to compute, and what else is known of it.

    Parameters
    ----------
    name : str
        By which the store and the table know it.
    path : Path
        The file.
    columns : dict of str to str, optional
        Further columns of a manifest, for the table.
    """

    name: str
    path: Path
    columns: Mapping[str, str] = field(default_factory=dict)


@checked
@dataclass(frozen=True, kw_only=True)
class Pair:
    """Two shapes of a store to match, and what else is known of them.

    Parameters
    ----------
    source, target : str
        Their names in the store.
    columns : dict of str to str, optional
        For the table.
    """

    source: str
    target: str
    columns: Mapping[str, str] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Both names."""
        return f"{self.source} to {self.target}"


Named = TypeVar("Named", Input, Pair)


@checked
def find_inputs(sources: Sequence[str | os.PathLike[str]]) -> list[Input]:
    """Return what files, patterns, folders and manifests name.

    Parameters
    ----------
    sources : sequence of path-like
        Files of any format that `geometry.read` knows; patterns with ``*``, ``?``, ``[]`` and
        ``**``, where ``{subject}`` is any part of a name, and becomes a column of the table;
        folders, of which all such files are taken, those of folders inside, too, but for txt, csv
        and asc, which may be anything: a pattern such as ``*.txt`` takes them; and
        manifests: CSV files whose column ``file`` names files, relative to the manifest; others
        whose first line is of numbers, or names columns x, y and z, are clouds. A column
        ``name`` names them otherwise, further ones are handed on to the table. Links to folders are
        followed; one to nothing is a file that cannot be read.

    Returns
    -------
    list of Input
        In the order of the sources, those of a pattern or a folder in that of their names. Each is
        named by its path as it was given, with ``/`` between folders; no two by the same.

    Raises
    ------
    InvalidFileError
        If a manifest is not there, or is no table with a column ``file``.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import spectra_kit as sk
    >>> folder = Path(tempfile.mkdtemp())
    >>> for i in range(2):
    ...     sk.geometry.write(sk.geometry.creature(600, seed=i), folder / f"animal{i}.off")
    >>> [one.path.name for one in sk.datasets.find_inputs([folder])]
    ['animal0.off', 'animal1.off']
    """
    found = [one for source in sources for one in _inputs_of(os.fspath(source))]
    if not found:
        raise InvalidInputError("sources", "name a file at least", "none")
    refuse_twice("sources", [one.name for one in found])
    return found


@checked
def find_pairs(
    pairs: str | os.PathLike[str], store: SpectrumStore, plan: Plan | None = None
) -> list[Pair]:
    """Return the pairs that are to be matched.

    Parameters
    ----------
    pairs : "all" or path-like
        All shapes of the store with all others, each two once: the one whose name comes first is
        the source. Or a CSV file with columns ``source`` and ``target``, names in the store;
        further columns are handed on to the table.
    store : SpectrumStore
        Whose shapes.
    plan : Plan, optional
        By which they were computed, where the store has several.

    Returns
    -------
    list of Pair
        In the order of the names, or of the file.

    Raises
    ------
    InvalidFileError
        If the file is not there, or is no table with such columns.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import spectra_kit as sk
    >>> folder = Path(tempfile.mkdtemp())
    >>> store, plan = sk.datasets.SpectrumStore(folder / "store"), sk.datasets.Plan(k=12)
    >>> for i in range(3):
    ...     sk.geometry.write(sk.geometry.creature(600, seed=i), folder / f"{i}.off")
    ...     _ = sk.datasets.complete(store, f"animal{i}", folder / f"{i}.off", plan)
    >>> [pair.name for pair in sk.datasets.find_pairs("all", store)]
    ['animal0 to animal1', 'animal0 to animal2', 'animal1 to animal2']
    """
    return pairs_of(pairs, store, None if plan is None else plan.facts)


@checked
def shard(inputs: Sequence[Named], part: int, parts: int) -> list[Named]:
    """Return one of several parts of the inputs, for runs that share a store and nothing else.

    Parameters
    ----------
    inputs : sequence of Input or Pair
        All of them.
    part, parts : int
        Which, counted from 1, and of how many.

    Returns
    -------
    list of Input or Pair
        Chosen by a hash of the names: what is added later moves none from one part to another.

    Examples
    --------
    >>> from pathlib import Path
    >>> import spectra_kit as sk
    >>> every = [sk.datasets.Input(name=f"{i}.off", path=Path(f"{i}.off")) for i in range(100)]
    >>> sum(len(sk.datasets.shard(every, part, 4)) for part in (1, 2, 3, 4))
    100
    """
    check_count("parts", parts, low=1)
    check_count("part", part, low=1, high=parts)
    return [one for one in inputs if int(facts_digest({"name": one.name}), 16) % parts == part - 1]


def refuse_twice(argument: str, names: Sequence[str]) -> None:
    """Refuse things of one name: results are kept and told by names."""
    if len(set(names)) == len(names):
        return
    twice = [name for name, count in Counter(names).items() if count > 1]
    raise InvalidInputError(
        argument,
        "have names of their own",
        f"{len(twice):,} several times, such as {twice[0]!r}",
        advice="leave one out, or name them in a manifest",
    )


def _inputs_of(source: str) -> Iterator[Input]:
    path = Path(source)
    if path.is_dir():
        yield from _some(source, readable_files(found := [*_inside(path)]), found, "hold")
    elif (_FIELD.search(source) or any(sign in source for sign in _PATTERN)) and not path.exists():
        columns = _matched(source)
        files = readable_files(columns, named=format_of(path) in READERS)
        for one in _some(source, files, [*columns], "match"):
            yield replace(one, columns=columns[one.path])
    elif path.suffix.lower() == ".csv" and not (path.is_file() and holds_points(path)):
        yield from _listed(path)
    else:
        yield Input(name=path.as_posix(), path=path)  # to read it will tell what is wrong with it


def _matched(pattern: str) -> dict[Path, dict[str, str]]:
    """Return the files that a pattern matches, with its ``{fields}``."""
    found = [Path(path) for path in glob.glob(_FIELD.sub("*", pattern), recursive=True)]
    if not _FIELD.search(pattern):
        return {path: {} for path in found}
    written, known = "", set[str]()
    for i, piece in enumerate(_FIELD.split(Path(pattern).as_posix())):
        if i % 2 == 0:  # between fields; which files there are, glob tells
            signs = re.split(r"(\*\*/|\*+|\?|\[[^]]*\])", piece)
            written += "".join(
                re.escape(sign) if j % 2 == 0 else "(?:.*/)?" if sign == "**/" else ".*"
                for j, sign in enumerate(signs)
            )
        else:
            written += f"(?P={piece})" if piece in known else f"(?P<{piece}>[^/]+?)"
            known.add(piece)
    matches = ((path, re.fullmatch(written, path.as_posix())) for path in found)
    return {path: one.groupdict() for path, one in matches if one}


def _inside(folder: Path, above: frozenset[tuple[int, int]] = frozenset()) -> Iterator[Path]:
    """Yield what is in a folder and those inside, linked ones too, but for stores.

    A link to one of the folders `above` leads nowhere else.
    """
    state = folder.stat()
    one = (state.st_dev, state.st_ino)
    if one in above or (folder / MARK).exists():  # what a store holds is not for reading
        return
    for path in folder.iterdir():
        if path.is_dir():
            yield from _inside(path, above | {one})
        else:
            yield path


def _some(source: str, paths: list[Path], found: list[Path], verb: str) -> Iterator[Input]:
    if not paths:
        is_folder = verb == "hold"
        known = ", ".join(sorted({*READERS} - {*(ANYTHING if is_folder else ())}))
        other = min((path for path in found if path.suffix), default=None)
        advice = f"of {other.name!r}: {advice_for(other)}" if other else ""
        if is_folder and other and format_of(other) in ANYTHING:
            advice = f"of tables of points: the pattern {source}/*{format_of(other)}"
        expected = f"{verb} meshes or clouds ({known})"
        raise InvalidInputError(repr(source), expected, "none", advice=advice)
    yield from (Input(name=path.as_posix(), path=path) for path in paths)


def _listed(manifest: Path) -> Iterator[Input]:
    """Return what a manifest names."""
    for row in rows_of(manifest, "manifest", (_FILE,)):
        path = Path(row[_FILE])
        others = {key: cell for key, cell in row.items() if key not in (_FILE, "name")}
        yield Input(
            name=row.get("name") or path.as_posix(), path=manifest.parent / path, columns=others
        )


def rows_of(path: Path, what: str, needed: Sequence[str]) -> Iterator[dict[str, str]]:
    """Return the rows of a CSV file that has some columns, and no empty cell in them."""
    if not path.is_file():
        raise InvalidFileError(path, "there is no such file")
    with path.open(newline="", encoding="utf-8-sig") as file:  # as spreadsheets write it
        try:
            table = csv.DictReader(file, strict=True)
            rows, columns = list(table), list(table.fieldnames or ())
        except (csv.Error, UnicodeDecodeError) as error:
            raise InvalidFileError(path, f"not a table of commas in UTF-8 ({error})") from error
    last = columns[-1] if columns else ""
    if not last.strip() and columns.count(last) == 1 and not any(row[last] for row in rows):
        rows = [{name: cell for name, cell in row.items() if name != last} for row in rows]
        columns.pop()  # spreadsheets end each line with a comma
    header = [name.strip() for name in columns]
    if rows and not (all(header) and len(set(header)) == len(header)):
        problem = InvalidInputError(
            what, "name each column, and otherwise than the others", ", ".join(map(repr, header))
        )
        raise InvalidFileError(path, problem)
    names = " and ".join(map(repr, needed))
    if not rows or not set(needed) <= set(rows[0]):
        got = ", ".join(map(str, rows[0])) if rows else "no row"
        kind = "a column" if len(needed) == 1 else "columns"
        raise InvalidFileError(path, InvalidInputError(what, f"have {kind} {names}", got))
    for number, row in enumerate(rows, start=2):
        if None in row or None in row.values() or not all(row[name] for name in needed):
            raise InvalidFileError(
                path, f"line {number} has not a cell for each column, or none for {names}"
            )
        yield row


# --- pairs of a store ---


def pairs_of(
    pairs: str | os.PathLike[str], store: SpectrumStore, facts: Mapping[str, object] | None
) -> list[Pair]:
    """Return the pairs that are to be matched: see `find_pairs`."""
    if os.fspath(pairs) == _ALL:
        names = sorted(records_of(store, facts))
        if len(names) < 2:
            raise InvalidInputError("store", "hold two shapes to match", len(names))
        return [Pair(source=a, target=b) for a, b in combinations(names, 2)]
    return [
        Pair(
            source=row["source"],
            target=row["target"],
            columns={key: cell for key, cell in row.items() if key not in _ENDS},
        )
        for row in rows_of(Path(pairs), "pairs", _ENDS)
    ]


def records_of(store: SpectrumStore, facts: Mapping[str, object] | None) -> dict[str, ShapeRecord]:
    """Return what a store holds of each name under a plan, or under the only one it has."""
    meant = only_plan(store) if facts is None else _of_spectra(facts)
    return {one.name: one for one in store.records() if _of_spectra(one.facts) == meant}


def only_plan(store: SpectrumStore, k: int | None = None) -> Mapping[str, object]:
    """Return by what a store's spectra were computed, those with k modes if that is told.

    Those of other releases do not count, nor what else was kept beside them.
    """
    plans = list[Mapping[str, object]]()
    for one in store.records():
        meant = _of_spectra(one.facts)
        if meant not in plans and k in (None, meant["k"]) and meant["release"] == VERSION:
            plans.append(meant)
    if not plans:
        kind = "spectra" if k is None else f"spectra of {k} modes"
        raise InvalidInputError("store", f"hold {kind}", "none", advice="compute them first")
    if len(plans) > 1:
        modes = sorted({str(one["k"]) for one in plans})
        differ = [name for name in plans[0] if any(one[name] != plans[0][name] for one in plans)]
        raise InvalidInputError(
            "store",
            "hold spectra of one plan, or be told of which",
            f"those of {len(plans)}, which differ in {', '.join(differ)} ({' and '.join(modes)}"
            " modes)",
            advice="name it by {}",
            remedies=("plan",),
        )
    return plans[0]


def _of_spectra(facts: Mapping[str, object]) -> dict[str, object]:
    """Return those facts of a plan that decide spectra."""
    return {name: fact for name, fact in facts.items() if name not in ("descriptors", "operators")}
