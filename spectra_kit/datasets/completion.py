"""`complete`: from a file to all that a plan wants of it, unless the store has that already."""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from spectra_kit._core.checked import checked
from spectra_kit._core.fingerprint import shape_digest
from spectra_kit._core.threads import single_threaded_blas
from spectra_kit._core.validate import Brief, hearing
from spectra_kit._sparse.memory import memory_limit
from spectra_kit.datasets.files import ShapeRecord, remove, warn_of_damage
from spectra_kit.datasets.plan import Plan
from spectra_kit.datasets.store import SpectrumStore
from spectra_kit.eigen import Spectrum
from spectra_kit.eigen.accuracy import warn_of_doubts
from spectra_kit.errors import (
    DamagedEntryWarning,
    IgnoredContentWarning,
    InvalidFileError,
    OutOfMemoryError,
    SpectraKitWarning,
    SplitSurfaceWarning,
)
from spectra_kit.geometry import Geometry, TriangleMesh, diagnose, read, without_nan
from spectra_kit.geometry.formats.gltf import buffer_files

_BLOCK = 1 << 20  # bytes that are hashed at a time


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class Completed(Brief):
    """What a store holds of a file, now.

    Attributes
    ----------
    record : ShapeRecord
        What is known of it, and the keys of everything.
    computed : bool
        Whether a spectrum was solved for, or was there.
    replaced : tuple of str
        What was damaged and computed again.
    renewed : bool
        Whether its name stood for other bytes before, of a file that has changed since or of
        another: what was known of these is known by this name no more.
    seconds : float
        That it took, with what was solved for at the same time.
    """

    record: ShapeRecord
    computed: bool
    replaced: tuple[str, ...]
    renewed: bool
    seconds: float


@checked
def complete(
    store: SpectrumStore, name: str, file: str | os.PathLike[str], plan: Plan
) -> Completed:
    """Compute what a plan wants of a file, unless the store has it already.

    What the store has is not read, but for its record; an entry whose size is not what it was is
    made again, and `SpectrumStore.verify` finds whatever else is damaged. BLAS gets one thread:
    results depend on their number by rounding, and many shapes are worked on side by side.

    Parameters
    ----------
    store : SpectrumStore
        Where it is kept.
    name : str
        Under which name.
    file : path
        Of any format that `geometry.read` knows.
    plan : Plan
        What is wanted.

    Returns
    -------
    Completed
        Keys and numbers.

    Raises
    ------
    InvalidFileError, InvalidInputError, ConvergenceError, InvalidSpectrumError, OutOfMemoryError
        As of `geometry.read`, `Plan` and `eigensolve`; nothing is recorded for the name then.
    StoreError
        If the store cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import spectra_kit as sk
    >>> folder = Path(tempfile.mkdtemp())
    >>> sk.geometry.write(sk.geometry.creature(600), folder / "animal.off")
    >>> store, plan = sk.datasets.SpectrumStore(folder / "store"), sk.datasets.Plan(k=12)
    >>> sk.datasets.complete(store, "animal", folder / "animal.off", plan).computed
    True
    >>> sk.datasets.complete(store, "animal", folder / "animal.off", plan).computed
    False
    """
    path = Path(file)
    if (there := known(store, name, path, plan)) is not None:
        return there
    return finished(store, read_file(store, name, path, plan), plan)


@dataclass(frozen=True, kw_only=True, eq=False)
class FileRead:
    """A file that was read, and what the store has of it."""

    name: str
    digest: str
    old: ShapeRecord | None
    shape: Geometry
    problems: tuple[str, ...]
    key: str
    is_new: bool
    damaged: tuple[str, ...]
    start: float


def read_file(store: SpectrumStore, name: str, path: Path, plan: Plan) -> FileRead:
    """Read a file, or find its geometry in the store."""
    start = time.perf_counter()
    with hearing() as heard, single_threaded_blas():
        digest = _digest(path)
        old = _old_record(store, name, plan)
        shape, problems = _shape(store, path, plan, old if old and old.file == digest else None)
        key = store.key(shape, plan)
        is_new = key not in store
        if is_new:
            _check_memory(path, plan, shape.n)
    return FileRead(
        name=name,
        digest=digest,
        old=old,
        shape=shape,
        problems=(*problems, *_passed_over(heard)),
        key=key,
        is_new=is_new,
        damaged=_damaged(heard),
        start=start,
    )


def _passed_over(heard: Iterable[SpectraKitWarning]) -> tuple[str, ...]:
    """Return what reading has told, without the path, which is another on each machine."""
    told = (one for one in heard if isinstance(one, IgnoredContentWarning))
    return tuple(str(one).removeprefix(f"{one.where}: ") for one in told)


def _damaged(heard: Iterable[SpectraKitWarning]) -> tuple[str, ...]:
    return tuple(str(one) for one in heard if isinstance(one, DamagedEntryWarning))


def finished(store: SpectrumStore, one: FileRead, plan: Plan) -> Completed:
    """Compute and keep what is missing of a file that was read."""
    shape, key = one.shape, one.key
    with hearing() as heard, single_threaded_blas():
        spectrum = store.spectrum(shape, plan)
        signatures = {kind: store.descriptor(shape, plan, kind) for kind in plan.descriptors}
        operators: dict[str, str] = {
            kind: store.keep_operator(shape, plan, kind) for kind in plan.operators
        }
    replaced = (*one.damaged, *_damaged(heard))
    doubts = [*_doubts(spectrum, plan)]
    if not isinstance(shape, TriangleMesh):  # of which `problems` tell
        doubts += [str(told) for told in heard if isinstance(told, SplitSurfaceWarning)]
    if one.old is not None and one.old.spectrum == key:  # which may not be computed again
        doubts += one.old.warnings
    certificate = spectrum.certificate
    assert certificate is not None  # `eigensolve` certifies
    store.keep_shape(shape)  # where somebody has cleaned meanwhile
    descriptors: dict[str, str] = {
        kind: store.descriptor_key(key, kind) for kind in plan.descriptors
    }
    record = ShapeRecord(
        name=one.name,
        file=one.digest,
        facts=plan.facts,
        shape=shape_digest(shape),
        spectrum=key,
        descriptors=descriptors,
        operators=operators,
        sizes={},
        kind="mesh" if isinstance(shape, TriangleMesh) else "cloud",
        points=shape.n,
        faces=len(shape.faces) if isinstance(shape, TriangleMesh) else 0,
        area=spectrum.area,
        components=certificate.n_components,
        zero_modes=certificate.n_zero_modes,
        level=certificate.level,
        residual=float(certificate.relative_residuals.max()),
        eigenvalues=tuple(spectrum.eigenvalues.tolist()),
        dna=tuple(signatures["dna"].tolist()) if "dna" in signatures else (),
        problems=one.problems,
        warnings=tuple(dict.fromkeys(doubts)),
    )
    record = replace(record, sizes=store.sizes(record))
    if record != one.old:
        store.keep_record(record)
    return Completed(
        record=record,
        computed=one.is_new or any(key in text for text in replaced),
        replaced=replaced,
        renewed=one.old is not None and one.old.file != one.digest,
        seconds=time.perf_counter() - one.start,
    )


def known(store: SpectrumStore, name: str, file: Path, plan: Plan) -> Completed | None:
    """Return what a store has of a file, if that is all: entries of the sizes that they had."""
    start = time.perf_counter()
    try:
        record = store.record(name, plan)
        if record is None or record.file != _digest(file) or not store.holds(record):
            return None
    except (InvalidFileError, OSError):
        return None  # `complete` makes it good, or tells
    seconds = time.perf_counter() - start
    return Completed(record=record, computed=False, replaced=(), renewed=False, seconds=seconds)


def _check_memory(path: Path, plan: Plan, n: int) -> None:
    """Refuse what will need more memory than there is."""
    needed, there = plan.gigabytes(n), memory_limit()
    if there is not None and needed > there:
        raise OutOfMemoryError(
            f"{path}: the modes of {n:,} points need about {needed:.1f} GiB, and there are"
            f" {there:.1f}",
            advice=("raise {}", "lower {}"),
            remedies=("memory_limit", "nworkers"),
        )


def _doubts(spectrum: Spectrum, plan: Plan) -> tuple[str, ...]:
    """Return what `eigensolve` warns of, also where it was not called now."""
    with hearing() as heard:
        warn_of_doubts(spectrum, plan.solver)
    return tuple(map(str, heard))


def _old_record(store: SpectrumStore, name: str, plan: Plan) -> ShapeRecord | None:
    try:
        return store.record(name, plan)
    except InvalidFileError as error:
        warn_of_damage(error)
        return None


def _shape(
    store: SpectrumStore, path: Path, plan: Plan, old: ShapeRecord | None
) -> tuple[Geometry, tuple[str, ...]]:
    """Return the geometry as it is looked at, and its problems; `old` knows both, if it is there.

    A geometry is not read from its file again where the store has it.
    """
    if old is not None:
        try:
            return store.shape(old.shape), old.problems
        except InvalidFileError as error:
            if Path(error.path).exists():
                warn_of_damage(error)
                remove(Path(error.path))
    shape = plan.prepared(without_nan(path).geometry if plan.repair else read(path))
    store.keep_shape(shape)
    return shape, tuple(map(str, diagnose(shape).problems))


def _digest(path: Path) -> str:
    """Hash of the bytes of a file, and of those that hold its arrays."""
    if not path.is_file():
        return ""  # `read` says why there are none
    found = hashlib.blake2b(digest_size=16)
    for part in (path, *(buffer_files(path) if path.suffix.lower() == ".gltf" else ())):
        with part.open("rb") as file:
            found.update(f"{part.stat().st_size} ".encode())  # where one ends and the next begins
            while block := file.read(_BLOCK):
                found.update(block)
    return found.hexdigest()
