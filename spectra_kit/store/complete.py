"""`complete`: from a file to all that a plan wants of it, unless the store has that already."""

from __future__ import annotations

import hashlib
import os
import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from spectra_kit._checked import checked
from spectra_kit._fingerprint import shape_digest
from spectra_kit._types import Floats
from spectra_kit._validate import Brief
from spectra_kit.errors import (
    DamagedEntryWarning,
    InvalidFileError,
    OutOfMemoryError,
    SpectraKitWarning,
)
from spectra_kit.geometry import Geometry, TriangleMesh, diagnose, read
from spectra_kit.linalg.threads import single_threaded_blas
from spectra_kit.store.files import ShapeRecord, remove, warn_of_damage
from spectra_kit.store.plan import Plan
from spectra_kit.store.store import SpectrumStore


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class Completed(Brief):
    """What a store holds of a file, now.

    Attributes
    ----------
    record : ShapeRecord
        Keys of everything.
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
    eigenvalues : ndarray of shape (k,)
        In 1/length^2.
    dna : ndarray of shape (c,) or None
        ShapeDNA, where the plan wants it.
    computed : bool
        Whether a spectrum was solved for, or everything was there.
    replaced : tuple of str
        What was damaged and computed again.
    seconds : float
        That it took.
    """

    record: ShapeRecord
    kind: str
    points: int
    faces: int
    area: float
    components: int
    zero_modes: int
    level: str
    residual: float
    eigenvalues: Floats
    dna: Floats | None
    computed: bool
    replaced: tuple[str, ...]
    seconds: float


@checked
def complete(
    store: SpectrumStore,
    name: str,
    file: str | os.PathLike[str],
    plan: Plan,
    *,
    memory: float | None = None,
) -> Completed:
    """Compute what a plan wants of a file, unless the store has it already.

    What the store has is read whole, so that damage is found. BLAS gets one thread: results depend
    on their number by rounding, and many shapes are worked on side by side.

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
    memory : float, optional
        GiB that there are: what will need more (`Plan.gigabytes`) is refused before it is tried.

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
    >>> store, plan = sk.store.SpectrumStore(folder / "store"), sk.store.Plan(k=12)
    >>> sk.store.complete(store, "animal", folder / "animal.off", plan).computed
    True
    >>> sk.store.complete(store, "animal", folder / "animal.off", plan).computed
    False
    """
    start, path = time.perf_counter(), Path(file)
    with warnings.catch_warnings(record=True) as caught, single_threaded_blas():
        warnings.simplefilter("always")
        digest = _digest(path)
        old = _old_record(store, name, plan)
        shape, problems = _shape(store, path, plan, old if old and old.file == digest else None)
        key = store.key(shape, plan)
        there = key in store
        if not there and memory is not None and plan.gigabytes(shape.n) > memory:
            raise OutOfMemoryError(
                f"{path}: the modes of {shape.n:,} points need about"
                f" {plan.gigabytes(shape.n):.1f} GiB, and there are {memory:.1f}",
                advice=("raise {}", "lower {}"),
                remedies=("memory_limit", "nworkers"),
            )
        spectrum = store.spectrum(shape, plan)
        signatures = {kind: store.descriptor(shape, plan, kind) for kind in plan.descriptors}
    replaced = _told(caught, DamagedEntryWarning)
    computed = not there or any(key in text for text in replaced)
    doubts = _told(caught, SpectraKitWarning, but=DamagedEntryWarning)
    for one in caught:
        if not issubclass(one.category, SpectraKitWarning):
            warnings.warn_explicit(one.message, one.category, one.filename, one.lineno)
    record = ShapeRecord(
        name=name,
        file=digest,
        facts=plan.facts,
        shape=shape_digest(shape),
        spectrum=key,
        descriptors={kind: store.descriptor_key(key, kind) for kind in plan.descriptors},
        problems=problems,
        warnings=doubts if computed or old is None else old.warnings,
    )
    if record != old:
        store.keep_record(record)
    certificate = spectrum.certificate
    assert certificate is not None  # `eigensolve` certifies
    return Completed(
        record=record,
        kind="mesh" if isinstance(shape, TriangleMesh) else "cloud",
        points=shape.n,
        faces=len(shape.faces) if isinstance(shape, TriangleMesh) else 0,
        area=spectrum.area,
        components=certificate.n_components,
        zero_modes=certificate.n_zero_modes,
        level=certificate.level,
        residual=float(certificate.relative_residuals.max()),
        eigenvalues=spectrum.eigenvalues,
        dna=signatures.get("dna"),
        computed=computed,
        replaced=replaced,
        seconds=time.perf_counter() - start,
    )


def is_known(store: SpectrumStore, name: str, file: Path, plan: Plan) -> bool:
    """Whether the store seems to have all of a file; what it has is not read."""
    try:
        record = store.record(name, plan)
    except InvalidFileError:
        return False
    return record is not None and record.spectrum in store and record.file == _digest(file)


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
    shape = plan.prepared(read(path))
    store.keep_shape(shape)
    return shape, tuple(map(str, diagnose(shape).problems))


def _digest(path: Path) -> str:
    """Hash of the bytes of a file."""
    if not path.is_file():
        return ""  # `read` says why there are none
    with path.open("rb") as file:
        return hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=16)).hexdigest()


def _told(
    caught: Sequence[warnings.WarningMessage],
    kind: type[Warning],
    but: type[Warning] | tuple[()] = (),
) -> tuple[str, ...]:
    messages = (one.message for one in caught)
    return tuple(str(m) for m in messages if isinstance(m, kind) and not isinstance(m, but))
