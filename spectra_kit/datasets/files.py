"""The files of a store: what they hold, how they are read, and what may be wrong with them."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

from numpy.typing import NDArray

from spectra_kit._core.arrays_file import read_arrays, write_arrays
from spectra_kit._core.checked import checked
from spectra_kit._core.files import atomic_path, parsing
from spectra_kit._core.fingerprint import BLANK, facts_digest, has_seal, sealed
from spectra_kit._core.version import VERSION
from spectra_kit._core.warn import warn
from spectra_kit.errors import (
    DamagedEntryWarning,
    InvalidFileError,
    InvalidInputError,
    StoreError,
)

Kind = Literal["shapes", "spectra", "descriptors", "operators", "maps", "records"]

FORMAT_VERSION = 1
_LISTS = ("eigenvalues", "dna", "problems", "warnings")  # of a record
MARK = "store.json"  #: A folder that holds this is a store.
SUFFIX: Mapping[Kind, str] = {
    "shapes": ".npz",
    "spectra": ".npz",
    "descriptors": ".npz",
    "operators": ".npz",
    "maps": ".npz",
    "records": ".json",
}
REMEDY = "spectra-kit store verify --remove takes it out, and the next run computes it again"


class StoredEntry(NamedTuple):
    """A file of a store.

    Attributes
    ----------
    kind : {"shapes", "spectra", "descriptors", "operators", "maps", "records"}
        What it holds: a geometry, its modes, a signature, an operator, a map between two, or which
        of these belong to a name.
    key : str
        Hash of all that its content follows from.
    path : Path
        Where it is.
    size : int
        Bytes.
    """

    kind: Kind
    key: str
    path: Path
    size: int


class Damage(NamedTuple):
    """A file of a store that is not what it was.

    Attributes
    ----------
    path : Path
        The file.
    reason : str
        What is wrong with it.
    """

    path: Path
    reason: str


@checked
@dataclass(frozen=True, kw_only=True)
class ShapeRecord:
    """What a store holds for a name: all that a table tells, so that none reads the entries.

    Attributes
    ----------
    name : str
        As it was given.
    file : str
        Hash of the bytes that were read.
    facts : dict
        What was computed, and how: see `Plan`.
    shape, spectrum : str
        Keys of the geometry and of its modes.
    descriptors, operators : dict of str to str
        Keys of the signatures, and of the operators.
    sizes : dict of str to int
        Bytes of all these entries, by their keys.
    kind : {"mesh", "cloud"}
        Of the geometry as it was looked at.
    points, faces : int
        Of it.
    area : float
        In the squared unit of the file.
    components, zero_modes : int
        Of the operator, and of the modes.
    level : str
        How far the modes can be trusted: see `Certificate.level`.
    residual : float
        Largest relative residual.
    eigenvalues : tuple of float
        In 1/length^2.
    dna : tuple of float
        ShapeDNA, where the plan wants it.
    problems, warnings : tuple of str
        What was found about the geometry and passed over in its file, and what operator and solver
        warned of.
    is_cut : bool
        Whether boundary edges of a mesh lie along others, so that the surface is cut there.
    boundary_edges, euler_characteristic : int or None
        Of a mesh: see `Diagnosis`. None of clouds, and where a record of before November 2026 does
        not tell.
    volume : float or None
        That a closed mesh encloses, in the cubed unit of the file.
    """

    name: str
    file: str
    facts: Mapping[str, object]
    shape: str
    spectrum: str
    descriptors: Mapping[str, str]
    operators: Mapping[str, str]
    sizes: Mapping[str, int]
    kind: Literal["mesh", "cloud"]
    points: int
    faces: int
    area: float
    components: int
    zero_modes: int
    level: str
    residual: float
    eigenvalues: tuple[float, ...]
    dna: tuple[float, ...] = ()
    problems: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    is_cut: bool = False
    boundary_edges: int | None = None
    euler_characteristic: int | None = None
    volume: float | None = None


@checked
@dataclass(frozen=True, kw_only=True)
class MapRecord:
    """What a store holds for a pair.

    Attributes
    ----------
    score, coverage, margin, mirror_margin : float
        How good the map is: see `Match`.
    orientation : float or None
        Of it.
    confidence : float
        How likely it is right.
    mirrored, ambiguous, convincing : bool
        What it is believed to be.
    doubts : tuple of str
        What speaks against it.
    key : str
        Of the map: see `load_match`.
    """

    score: float
    coverage: float
    margin: float
    mirror_margin: float
    orientation: float | None
    confidence: float
    mirrored: bool
    ambiguous: bool
    convincing: bool
    doubts: tuple[str, ...]
    key: str


def check_or_mark(root: Path) -> None:
    """Refuse a folder that is no store that can be read, or is to become none; mark a new one."""
    mark = root / MARK
    # Others may be about to make it, whose temporary files begin with a dot.
    free = not root.exists() or (
        root.is_dir() and all(path.name.startswith(".") for path in root.iterdir())
    )
    if mark.exists():
        _check_format(mark)
        return
    if not free:
        raise InvalidInputError(
            "path",
            "be a store, an empty folder or a new one",
            str(root),
            advice="name another folder",
        )
    content = {"format": "spectra_kit store", "version": FORMAT_VERSION}
    with writing(mark):
        root.mkdir(parents=True, exist_ok=True)
        with atomic_path(mark) as part:
            part.write_text(json.dumps(content) + "\n")


def _check_format(mark: Path) -> None:
    with parsing(mark, "mark of a store", remedy="restore it, or name another folder"):
        content = json.loads(mark.read_text())
        if content["format"] != "spectra_kit store":
            raise KeyError("format")
        version = int(content["version"])
    if version > FORMAT_VERSION:
        raise InvalidFileError(
            mark,
            f"the store has format version {version}, this spectra_kit reads up to"
            f" {FORMAT_VERSION}; upgrade it",
        )


def place(root: str | os.PathLike[str], kind: Kind, key: str) -> Path:
    """Return where an entry is or would be: in one of 256 folders, none of which gets large."""
    return Path(f"{root}/{kind}/{key[:2]}/{key}{SUFFIX[kind]}")


def places(root: str | os.PathLike[str], kind: Kind) -> Iterator[Path]:
    """Yield the files of a kind, also those that are being written, in the order of their names."""
    for folder in sorted((Path(root) / kind).glob("??")):
        yield from sorted(folder.glob(f"*{SUFFIX[kind]}"))


def state(path: Path) -> os.stat_result | None:
    """Return what the system knows of a file; None where it is gone, as others may take it."""
    try:
        return path.stat()
    except FileNotFoundError:
        return None


def record_facts(name: str, facts: Mapping[str, object]) -> dict[str, object]:
    """Return what the key of a record is a hash of."""
    return {"name": name, "facts": facts}


def damage(error: InvalidFileError) -> str:
    """Return the words for what is damaged and made again."""
    return f"{error.path} is damaged and made again: {error.problem}"


def warn_of_damage(error: InvalidFileError) -> None:
    """Say that what is damaged is made again."""
    warn(damage(error), DamagedEntryWarning)


def warn_of_omission(error: InvalidFileError) -> None:
    """Say that what is damaged is left out."""
    warn(f"{error.path} is damaged and left out: {error.problem}", DamagedEntryWarning)


def write(path: Path, facts: Mapping[str, object], **arrays: NDArray[Any]) -> None:
    """Write arrays, and the facts that they follow from.

    These are not flushed to the disk, which takes as long as half of a small shape's solution: all
    have checksums, which are looked at when they are read. Spectra, which are mapped, are flushed.
    """
    header = {"format": "spectra_kit arrays", "facts": facts, "arrays": [*arrays]}
    write_arrays(path, header, arrays, flush=False)


def read(
    path: Path, *, whole: bool = True, named: bool = True
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return what an entry follows from, by which it is `named`, and as a `whole` its arrays."""

    def choose(header: dict[str, Any]) -> Iterable[str]:
        return header["arrays"] if whole else ()

    header, arrays = read_arrays(path, "entry of a store", choose, remedy=REMEDY)
    with parsing(path, "entry of a store", remedy=REMEDY):
        facts = dict(header["facts"])
        if named:
            _check_name(path, facts)
    return facts, arrays


def _check_name(path: Path, facts: Mapping[str, object]) -> None:
    """Refuse what is whole, but under the name of something else."""
    if facts_digest(facts) != path.stem:
        raise ValueError("its content has another hash than its name")


def write_record(path: Path, record: ShapeRecord) -> None:
    """Write what is known of a name, with a checksum: the first of its fields."""
    with atomic_path(path, flush=False) as part:
        part.write_bytes(sealed(json.dumps({"sha256": BLANK, **vars(record)}).encode() + b"\n"))


def read_record(path: Path) -> ShapeRecord | None:
    """Return what is known of a name; None where it is gone, as others may take it.

    Those of other releases, which no run asks for, may have no checksum.
    """
    with parsing(path, "record of a store", remedy=REMEDY):
        try:
            data = path.read_bytes()
        except FileNotFoundError:
            return None
        content = json.loads(data)
        seal = content.pop("sha256", None)
        if (seal is not None or content["facts"]["release"] == VERSION) and not has_seal(
            data, seal
        ):
            raise ValueError("its content has another checksum than it says, or none")
        lists = {name: tuple(content[name]) for name in _LISTS}
        if "is_cut" not in content:  # until November 2026 records told it in words alone
            content["is_cut"] = any("unjoined" in text for text in lists["problems"])
        record = ShapeRecord(**{**content, **lists})
        _check_name(path, record_facts(record.name, record.facts))
        return record


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Tell what a disk or its owner does not allow."""
    try:
        yield
    except OSError as error:
        raise StoreError(
            f"cannot write {path}: {(error.strerror or str(error)).lower()}",
            advice="what is there stays whole; make room or get the right to write, and go on",
        ) from error


def remove(path: Path) -> None:
    """Remove a file, if it is there."""
    with writing(path):
        path.unlink(missing_ok=True)
