"""`compute_all` and `complete`: from files to all that a plan wants of them, each once."""

from __future__ import annotations

import hashlib
import math
import os
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from spectra_kit._core.checked import checked
from spectra_kit._core.fingerprint import shape_digest
from spectra_kit._core.threads import ranges, single_threaded_blas, thread_count
from spectra_kit._core.validate import quantity
from spectra_kit._core.warn import hearing, warn
from spectra_kit._sparse.memory import memory_limit
from spectra_kit.datasets.files import ShapeRecord, remove, warn_of_damage
from spectra_kit.datasets.inputs import Input, refuse_twice
from spectra_kit.datasets.plan import Plan
from spectra_kit.datasets.run import BatchReport, Completed, Engine, Job, own_order, run
from spectra_kit.datasets.store import SpectrumStore
from spectra_kit.eigen import Spectrum, eigensolve_many
from spectra_kit.eigen.accuracy import warn_of_doubts
from spectra_kit.eigen.solve import is_on_device, points_of_a_pass
from spectra_kit.errors import (
    DamagedEntryWarning,
    IgnoredContentWarning,
    InvalidFileError,
    OutOfMemoryError,
    SpectraKitError,
    SpectraKitWarning,
    SplitSurfaceWarning,
)
from spectra_kit.geometry import Geometry, TriangleMesh, diagnose, read, without_nan
from spectra_kit.geometry.formats.gltf import buffer_files
from spectra_kit.operators import Laplacian

_ALIKE = 32  # inputs of similar size that stay side by side for a solver that takes several


@checked
def compute_all(
    inputs: Sequence[Input],
    store: SpectrumStore,
    plan: Plan,
    *,
    engine: Engine | None = None,
    strict: bool = False,
    progress: Callable[[int, int], object] | None = None,
) -> BatchReport[Input, ShapeRecord]:
    """Compute what a plan wants of all inputs, but for what the store has already.

    Interrupted, it loses what is in work; called again, it goes on. Several runs may share a store:
    each goes in an order of its own, and meets what others have done.

    Parameters
    ----------
    inputs : sequence of Input
        As `find_inputs` returns them.
    store : SpectrumStore
        Where all is kept.
    plan : Plan
        What is wanted.
    engine : Engine, optional
        Who works, such as a `DaskEngine`; by default this process, one shape after the other.
    strict : bool, default False
        Stop at the first failure, and raise it; go in the order of the inputs.
    progress : callable, optional
        Told how many inputs of how many are done.

    Returns
    -------
    BatchReport
        Results and failures.

    Raises
    ------
    StoreError
        If the store cannot be written: no other shape could be kept either.
    SpectraKitError
        Of the first input that fails, if it is `strict`; if the engine is lost.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import spectra_kit as sk
    >>> folder = Path(tempfile.mkdtemp())
    >>> sk.geometry.write(sk.geometry.creature(600), folder / "animal.off")
    >>> _ = (folder / "empty.off").write_text("")
    >>> inputs = sk.datasets.find_inputs([folder])
    >>> store = sk.datasets.SpectrumStore(folder / "store")
    >>> report = sk.datasets.compute_all(inputs, store, sk.datasets.Plan(k=12))
    >>> report.computed, [str(failed.error).split(": ")[-1] for failed in report.failed]
    (1, ['the file is empty'])
    """
    refuse_twice("inputs", [one.name for one in inputs])
    do, together = partial(_completed, plan=plan), partial(begin, plan=plan)

    def look(one: Input) -> Completed[ShapeRecord] | Job:
        job = Job(one.name, Path(store.path), (one.name, one.path), do, together)
        return known(store, one.name, one.path, plan) or job

    def order(todo: list[int]) -> list[int]:
        return todo if strict else _in_own_order(todo, inputs, plan)

    report = run("shapes", inputs, look, order, engine=engine, strict=strict, progress=progress)
    if cut := [one.name for one, done in report.completed if done.record.is_cut]:
        warn(
            f"{quantity(len(cut), 'shape')} of {len(inputs):,}, such as {cut[0]!r}: boundary edges"
            " lie along others, unjoined, and cut the surface",
            SplitSurfaceWarning,
            advice="join them with {}",
            remedies=("Plan(repair=True)",),
        )
    return report


def _in_own_order(todo: list[int], inputs: Sequence[Input], plan: Plan) -> list[int]:
    """Return the places of inputs in an order of our own, those of one size side by side.

    Unless one by one is as good for the solver.
    """
    if not hasattr(plan.solver, "begin"):
        return own_order(todo)
    alike = sorted(todo, key=lambda i: _bytes(inputs[i].path))
    return [i for cut in own_order(ranges(len(alike), _ALIKE)) for i in alike[slice(*cut)]]


def _bytes(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0  # `read` says why


@checked
def complete(
    store: SpectrumStore, name: str, file: str | os.PathLike[str], plan: Plan
) -> Completed[ShapeRecord]:
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
    StoreError
        If the store cannot be written.
    SpectraKitError
        As of `geometry.read`, `Plan` and `eigensolve`; nothing is recorded for the name then.

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
    return _completed(store, name, Path(file), plan)


def _completed(store: SpectrumStore, name: str, path: Path, plan: Plan) -> Completed[ShapeRecord]:
    if (there := known(store, name, path, plan)) is not None:
        return there
    return finished(store, read_file(store, name, path, plan), plan)


class Looked(NamedTuple):
    """What a record keeps of the diagnosis of a geometry."""

    problems: tuple[str, ...]
    is_cut: bool
    boundary_edges: int | None
    euler_characteristic: int | None
    volume: float | None

    @classmethod
    def at(cls, shape: Geometry) -> Looked:
        """Look at a geometry."""
        found = diagnose(shape)
        is_cut = bool(found.seam_edges or found.hanging_vertices)
        facts: tuple[Any, ...] = (None, None, None)
        if found.n_faces:
            volume = None if math.isnan(found.volume) else found.volume
            facts = found.boundary_edges, found.euler_characteristic, volume
        return cls(tuple(map(str, found.problems)), is_cut, *facts)


class FileRead(NamedTuple):
    """A file that was read, and what the store has of it."""

    name: str
    digest: str
    old: ShapeRecord | None
    shape: Geometry
    looked: Looked
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
        shape, looked = _shape(store, path, plan, old if old and old.file == digest else None)
        key = store.key(shape, plan)
        is_new = key not in store
        if is_new:
            _check_memory(path, plan, shape.n)
    # Without the path, which is another on each machine.
    passed_over = (one for one in heard if isinstance(one, IgnoredContentWarning))
    told = tuple(str(one).removeprefix(f"{one.where}: ") for one in passed_over)
    looked = looked._replace(problems=looked.problems + told)
    return FileRead(name, digest, old, shape, looked, key, is_new, _damaged(heard), start)


def _damaged(heard: Iterable[SpectraKitWarning]) -> tuple[str, ...]:
    return tuple(str(one) for one in heard if isinstance(one, DamagedEntryWarning))


def finished(store: SpectrumStore, one: FileRead, plan: Plan) -> Completed[ShapeRecord]:
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
    if (parts := certificate.n_components) > 1:
        zero = quantity(certificate.n_zero_modes, "zero mode")
        doubts.append(f"{parts:,} components: {zero} first, and other modes live on one or several")
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
        warnings=tuple(dict.fromkeys(doubts)),
        **one.looked._asdict(),
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


def known(store: SpectrumStore, name: str, file: Path, plan: Plan) -> Completed[ShapeRecord] | None:
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
) -> tuple[Geometry, Looked]:
    """Return the geometry as it is looked at, and what was seen.

    If `old` is there, it knows that. A geometry is not read from its file again where the store
    has it.
    """
    if old is not None:
        try:
            seen = Looked(*(getattr(old, name) for name in Looked._fields))
            return store.shape(old.shape), seen
        except InvalidFileError as error:
            if Path(error.path).exists():
                warn_of_damage(error)
                remove(Path(error.path))
    shape = plan.prepared(without_nan(path).geometry if plan.repair else read(path))
    store.keep_shape(shape)
    return shape, Looked.at(shape)


def _digest(path: Path) -> str:
    """Hash of the bytes of a file, and of those that hold its arrays."""
    if not path.is_file():
        return ""  # `read` says why there are none
    found = hashlib.blake2b(digest_size=16)
    for part in (path, *(buffer_files(path) if path.suffix.lower() == ".gltf" else ())):
        with part.open("rb") as file:
            found.update(f"{part.stat().st_size} ".encode())  # where one ends and the next begins
            hashlib.file_digest(file, lambda: found)  # adds its blocks
    return found.hexdigest()


# --- several at once ---


def begin(
    store: SpectrumStore, files: Iterable[tuple[str, Path]], plan: Plan
) -> Iterator[Callable[[], Completed[ShapeRecord]]]:
    """Yield what is left to do for each of many named files, with the result of `complete`.

    Shapes are solved for together where that is sooner than one by one.
    """
    most = _points_together(plan.solver)
    rest, reads, points = list[Callable[[], Completed[ShapeRecord]]](), dict[str, FileRead](), 0
    for name, path in files:
        one = _read(store, name, path, plan) if most else None
        if one is None:
            rest.append(partial(_completed, store, name, path, plan))
        else:
            if one.key in reads:  # of two names of one shape, one is solved for
                one = one._replace(is_new=False)
            elif one.is_new:
                reads[one.key] = one
            points += one.shape.n
            rest.append(partial(finished, store, one, plan))
        if points >= most:
            _solve(store, reads.values(), plan)
            yield from rest
            rest, reads, points = [], {}, 0
    _solve(store, reads.values(), plan)
    yield from rest


def _read(store: SpectrumStore, name: str, path: Path, plan: Plan) -> FileRead | None:
    """Return a file that was read; None where nothing is left to do, or this fails.

    `complete` tells which, when it is its turn.
    """
    with suppress(SpectraKitError, OSError, MemoryError):
        if known(store, name, path, plan) is None:
            return read_file(store, name, path, plan)
    return None


def _points_together(solver: Any) -> int:
    """Return how many points are worth solving for together; 0 if none are.

    A pass of several shapes costs a processor what it costs one by one, but can be done beside
    other passes; an accelerator idles while it has one small shape.
    """
    if not hasattr(solver, "begin"):
        return 0
    if is_on_device(solver):
        return 2 * points_of_a_pass(solver)
    return 2 * points_of_a_pass(solver) * thread_count() if thread_count() > 1 else 0


def _solve(store: SpectrumStore, reads: Collection[FileRead], plan: Plan) -> None:
    """Keep the spectra of those that can be solved for together.

    Whoever asks for another solves for it alone, and is told why that fails.
    """
    if not reads:
        return
    with hearing(), single_threaded_blas(), suppress(SpectraKitError, MemoryError):
        made = _operators([one.shape for one in reads], plan)
        able = [(shape, own) for shape, own in made if plan.k <= len(own.free)]
        solved = eigensolve_many([own for _, own in able], plan.k, plan.solver)
        for (shape, _), spectrum in zip(able, solved, strict=True):
            store.keep_spectrum(shape, plan, spectrum)


def _operators(shapes: Sequence[Geometry], plan: Plan) -> list[tuple[Geometry, Laplacian]]:
    """Return all shapes that have an operator, with it."""
    with suppress(SpectraKitError, MemoryError):
        return [*zip(shapes, plan.laplacians(shapes), strict=True)]
    made = []
    for shape in shapes:
        with suppress(SpectraKitError):
            made.append((shape, plan.laplacian(shape)))
    return made
