"""`SpectrumStore`: spectra of many shapes in a folder, each computed once."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray
from scipy.sparse import csr_array

from spectra_kit._core.checked import checked
from spectra_kit._core.files import parsing, temporary_folder
from spectra_kit._core.fingerprint import facts_digest, shape_digest
from spectra_kit._core.types import Floats
from spectra_kit._core.version import VERSION
from spectra_kit.datasets import files
from spectra_kit.datasets.files import Damage, Kind, ShapeRecord, StoredEntry
from spectra_kit.datasets.plan import Descriptor, OperatorName, Plan
from spectra_kit.eigen import Spectrum, eigensolve
from spectra_kit.eigen.spectrum_file import write_spectrum_file
from spectra_kit.errors import InvalidFileError, InvalidInputError
from spectra_kit.features import DESCRIPTORS
from spectra_kit.geometry import Geometry, GeometryLike, PointCloud, TriangleMesh
from spectra_kit.operators import TangentGradient, tangent_gradient

Found = TypeVar("Found")
_INDICES = ("indptr", "indices")  # of operators, beside the values
_LEFT = 24 * 3600  # seconds after which what a writer has left was left by one that is gone


@checked
@dataclass(frozen=True)
class SpectrumStore:
    """Spectra of many shapes in a folder: whatever was computed once is read from there.

    An entry is a file, named by a hash of all that its content follows from: points and faces,
    operator, solver with the hash of its weights, options, release. So it is whole or absent, never
    out of date, and equal whoever wrote it; many processes, on many machines that share the folder,
    may read and write at once. Times are not kept: they would make equal entries differ.

    Parameters
    ----------
    path : path
        The folder; made if it is missing.

    Raises
    ------
    InvalidFileError
        If the store is of a newer format; from methods that load, if an entry is damaged.
    StoreError
        If the folder cannot be made; from methods that keep, if an entry cannot be written.

    Notes
    -----
    Entries are the npz files of `Spectrum.save`, uncompressed and aligned, because these can be
    mapped into memory and read by NumPy alone. There is no index beside them: the names are the
    index, to list them is to list folders, and no lock is needed, which databases in a single file
    need and shared file systems do not always keep.

    Shapes are kept and asked for as they are looked at: see `Plan.prepared`. A damaged entry that
    is asked for by its shape is computed again, with a `DamagedEntryWarning`.

    Examples
    --------
    >>> import tempfile
    >>> import spectra_kit as sk
    >>> store = sk.datasets.SpectrumStore(tempfile.mkdtemp())
    >>> animal, plan = sk.geometry.creature(600), sk.datasets.Plan(k=12)
    >>> modes = store.spectrum(animal, plan)
    >>> store.load(store.key(animal, plan), mmap=True)
    Spectrum(n=600, k=12, ...
    >>> store.descriptor(animal, plan, "hks").shape
    (600, 16)
    >>> [entry.kind for entry in store.entries()]
    ['shapes', 'spectra', 'descriptors']
    """

    path: str | os.PathLike[str]

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", Path(self.path))
        files.check_or_mark(Path(self.path))

    def key(self, shape: GeometryLike, plan: Plan) -> str:
        """Return the hash of all that a spectrum follows from: 32 hexadecimal digits."""
        return facts_digest(_spectrum_facts(shape_digest(shape), plan))

    def __contains__(self, key: object) -> bool:
        """Whether there is a spectrum of a key, whole or damaged."""
        return isinstance(key, str) and self._place("spectra", key).exists()

    def load(self, key: str, *, mmap: bool = False) -> Spectrum | None:
        """Return the spectrum of a key, None if it is not there.

        With `mmap` its arrays are mapped instead of read, without the checks that reading makes. Of
        float32, NumPy makes a copy.
        """
        path = self._place("spectra", key)
        if not path.exists():
            return None
        files.read(path, whole=False)  # that it is the one of this key
        return Spectrum.load(path, mmap=mmap)

    def spectrum(self, shape: GeometryLike, plan: Plan) -> Spectrum:
        """Return the spectrum of a shape; compute and keep it if it is not there.

        As of `eigensolve`, but without the times in its provenance. An error leaves nothing behind.
        """
        known = self._known("spectra", self.key(shape, plan), self.load)
        if known is not None:
            return known
        made = eigensolve(plan.laplacian(shape), plan.k, plan.solver)
        return self.keep_spectrum(shape, plan, made)

    def keep_spectrum(self, shape: GeometryLike, plan: Plan, made: Spectrum) -> Spectrum:
        """Keep a spectrum that was computed as a plan says, and its shape.

        Return it as all others will see it: in the precision of the plan, without the times in its
        provenance.
        """
        facts = _spectrum_facts(shape_digest(shape), plan)
        self.keep_shape(shape)
        made = made.described(made.certificate, replace(made.provenance, seconds={}))
        vectors = made.eigenvectors.astype(plan.precision, copy=False)
        arrays = made._arrays | {"eigenvectors": vectors}
        with self._new("spectra", facts_digest(facts)) as path:
            write_spectrum_file(path, arrays, made.certificate, made.provenance, facts=facts)
        return made if vectors is made.eigenvectors else replace(made, eigenvectors=vectors)

    def descriptor(self, shape: GeometryLike, plan: Plan, name: Descriptor) -> Floats:
        """Return a signature of a shape; compute and keep it, and the spectrum, if it is not there.

        Of shape (n, c), or (c,) of ShapeDNA, in the precision of the plan.
        """
        facts = _descriptor_facts(self.key(shape, plan), name)
        key = facts_digest(facts)
        known = self._known("descriptors", key, self.load_descriptor)
        if known is not None:
            return known
        values: Floats = DESCRIPTORS[name](self.spectrum(shape, plan)).astype(plan.precision)
        with self._new("descriptors", key) as path:
            files.write(path, facts, values=values)
        return values

    def descriptor_key(self, spectrum: str, name: Descriptor) -> str:
        """Return the hash of all that a signature follows from: a spectrum's key, and a name."""
        return facts_digest(_descriptor_facts(spectrum, name))

    def load_descriptor(self, key: str) -> Floats:
        """Return the signature of a key: of shape (n, c), or (c,) of ShapeDNA."""
        path = self._place("descriptors", key)
        _, arrays = files.read(path)
        with parsing(path, "signature of a store", remedy=files.REMEDY):
            values: Floats = arrays["values"]
        return values

    def keep_operator(self, shape: GeometryLike, plan: Plan, name: OperatorName) -> str:
        """Keep an operator of a shape, assembled unless it is there, and return its key."""
        facts = _operator_facts(shape_digest(shape), plan, name)
        key = facts_digest(facts)
        if self._known("operators", key, self.load_operator) is None:
            with self._new("operators", key) as path:
                files.write(path, facts, **_packed(shape, plan, name))
        return key

    def load_operator(self, key: str) -> csr_array | TangentGradient:
        """Return the operator of a key: the stiffness; or frames with the gradients in them."""
        path = self._place("operators", key)
        facts, arrays = files.read(path)
        with parsing(path, "operator of a store", remedy=files.REMEDY):
            if facts["kept"] == "stiffness":
                return _matrix(arrays, "data")
            return TangentGradient(arrays["frames"], _matrix(arrays, "x"), _matrix(arrays, "y"))

    def keep_shape(self, shape: GeometryLike) -> str:
        """Keep a geometry, and return its key."""
        key = shape_digest(shape)
        arrays = {"points": shape.points}
        if isinstance(shape, TriangleMesh):
            arrays["faces"] = shape.faces.astype(np.int32 if shape.n < 2**31 else np.int64)
        if not self._place("shapes", key).exists():
            with self._new("shapes", key) as path:
                files.write(path, {}, **arrays)
        return key

    def shape(self, key: str) -> Geometry:
        """Return the geometry of a key: the very points and faces."""
        path = self._place("shapes", key)
        _, arrays = files.read(path, named=False)
        with parsing(path, "geometry of a store", remedy=files.REMEDY):
            if "faces" in arrays:
                shape: Geometry = TriangleMesh(arrays["points"], arrays["faces"])
            else:
                shape = PointCloud(arrays["points"])
            if shape_digest(shape) != key:
                raise ValueError("its content has another hash than its name")
        return shape

    def keep_map(
        self,
        source: str,
        target: str,
        how: Mapping[str, object],
        arrays: Mapping[str, NDArray[Any]],
    ) -> str:
        """Keep the arrays of a map between two shapes, and return its key.

        `source` and `target` are the keys of their spectra, `how` is what else the map follows
        from, as JSON can say it; the release is added.
        """
        facts = map_facts(source, target, how)
        try:
            key = facts_digest(facts)
        except TypeError as error:
            raise InvalidInputError("how", "be what JSON can say", f"more ({error})") from error
        with self._new("maps", key) as path:
            files.write(path, facts, **arrays)
        return key

    def has_map(self, key: str) -> bool:
        """Return whether there is a map of a key, whole or damaged."""
        return self._place("maps", key).exists()

    def load_map(self, key: str) -> tuple[dict[str, Any], dict[str, NDArray[Any]]] | None:
        """Return the facts and the arrays of a map, None if it is not there.

        The facts are ``source``, ``target``, ``how`` and ``release``; tuples are lists now.
        """
        if not self.has_map(key):
            return None
        return files.read(self._place("maps", key))

    def record(self, name: str, plan: Plan) -> ShapeRecord | None:
        """Return what is known of a name under a plan, None where that is nothing."""
        key = facts_digest(files.record_facts(name, plan.facts))
        return files.read_record(self._place("records", key))

    def keep_record(self, record: ShapeRecord) -> None:
        """Keep what belongs to a name, in the place of what was known of it under that plan."""
        key = facts_digest(files.record_facts(record.name, record.facts))
        with self._new("records", key) as path:
            files.write_record(path, record)

    def sizes(self, record: ShapeRecord) -> dict[str, int]:
        """Return the bytes of those entries of a record that are there, by key."""
        kinds: tuple[tuple[Kind, Iterable[str]], ...] = (
            ("shapes", [record.shape]),
            ("spectra", [record.spectrum]),
            ("descriptors", record.descriptors.values()),
            ("operators", record.operators.values()),
        )
        found = ((key, files.state(self._place(kind, key))) for kind, keys in kinds for key in keys)
        return {key: state.st_size for key, state in found if state is not None}

    def holds(self, record: ShapeRecord) -> bool:
        """Return whether all entries of a record are there, as many bytes as they had.

        Nobody looks into them: see `verify`.
        """
        kept = (*record.descriptors.values(), *record.operators.values())
        sizes = self.sizes(record)
        return sizes == record.sizes and sizes.keys() == {record.shape, record.spectrum, *kept}

    def records(self, plan: Plan | None = None) -> Iterator[ShapeRecord]:
        """Yield what is known of each name, by one `plan` or by all, in the order of the hashes.

        A damaged record is left out, with a `DamagedEntryWarning`.
        """
        for entry in self.entries("records"):
            try:
                record = files.read_record(entry.path)
            except InvalidFileError as error:
                files.warn_of_omission(error)
            else:
                if record is not None and (plan is None or record.facts == plan.facts):
                    yield record

    def entries(self, kind: Kind | None = None) -> Iterator[StoredEntry]:
        """Yield all entries, or those of a `kind`, whole or damaged, in the order of their keys."""
        for one in files.SUFFIX if kind is None else (kind,):
            for path in files.places(self.path, one):
                state = None if path.name.startswith(".") else files.state(path)
                if state is not None:
                    yield StoredEntry(one, path.stem, path, state.st_size)

    def verify(
        self, *, remove: bool = False, progress: Callable[[int, int], object] | None = None
    ) -> list[Damage]:
        """Read everything, and name what is damaged.

        With `remove` it is taken out, too: whoever needs it computes it again. `progress` is told
        how many entries of how many are read.
        """
        found, entries = [], list(self.entries())
        reading: Mapping[Kind, Callable[[str], object]] = {
            "shapes": self.shape,
            "spectra": self.load,
            "descriptors": self.load_descriptor,
            "operators": self.load_operator,
            "maps": self.load_map,
            "records": lambda key: files.read_record(self._place("records", key)),
        }
        for i, entry in enumerate(entries):
            try:
                reading[entry.kind](entry.key)
            except InvalidFileError as error:
                if files.state(entry.path) is not None:  # others may have taken it out
                    found.append(Damage(entry.path, str(error.problem)))
                    if remove:
                        files.remove(entry.path)
            if progress is not None:
                progress(i + 1, len(entries))
        return found

    def clean(self, *, unnamed: bool = False) -> list[Path]:
        """Remove what nothing will ask for again, and return where it was.

        These are entries of other releases, geometries that belong to no entry that stays, and what
        writers have left. Geometries and leftovers of the last day stay, as somebody may be about
        to need them. With `unnamed` also goes what no record names and is older than a day: results
        of files that have changed since, and those that were asked for without a name (`spectrum`).
        A damaged record stops that, as nobody knows what it has named: `verify` first.
        """
        before = _now(Path(self.path)) - _LEFT
        gone, used, named, kept = list[Path](), set[str](), set[str](), set[str]()
        # Listed before what they follow from: what a run makes meanwhile is no orphan.
        maps, descriptors = ([*self.entries(kind)] for kind in ("maps", "descriptors"))
        for entry in self.entries("records"):
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
        for entry, facts in _with_facts(chain(self.entries("spectra"), self.entries("operators"))):
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
        for entry in self.entries("shapes"):
            if entry.key not in used and _older(entry.path, before):
                gone.append(entry.path)
        for kind in files.SUFFIX:
            left = (path for path in files.places(self.path, kind) if path.name.startswith("."))
            gone += [path for path in left if _older(path, before)]
        for path in gone:
            files.remove(path)
        return gone

    # --- files ---

    def _place(self, kind: Kind, key: str) -> Path:
        return files.place(self.path, kind, key)

    def _known(self, kind: Kind, key: str, load: Callable[[str], Found | None]) -> Found | None:
        """Return an entry that is there and whole; that it is damaged is told."""
        if not self._place(kind, key).exists():
            return None
        try:
            return load(key)
        except InvalidFileError as error:
            files.warn_of_damage(error)
            return None

    @contextmanager
    def _new(self, kind: Kind, key: str) -> Iterator[Path]:
        """Yield the place of an entry that is about to be written."""
        path = self._place(kind, key)
        with files.writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            yield path


def _spectrum_facts(shape: str, plan: Plan) -> dict[str, object]:
    return {"shape": shape, **plan.solved}


def _descriptor_facts(spectrum: str, name: str) -> dict[str, object]:
    return {"spectrum": spectrum, "descriptor": name}


def _operator_facts(shape: str, plan: Plan, name: OperatorName) -> dict[str, object]:
    own = ("release", "precision", *(("operator", "boundary") if name == "stiffness" else ()))
    return {"shape": shape, "kept": name, **{key: plan.solved[key] for key in own}}


def map_facts(source: str, target: str, how: Mapping[str, object]) -> dict[str, object]:
    """Return all that a map between the shapes of two spectra follows from."""
    return {"source": source, "target": target, "how": how, "release": VERSION}


def _with_facts(entries: Iterable[StoredEntry]) -> Iterator[tuple[StoredEntry, dict[str, Any]]]:
    """Yield entries with what they follow from, but for those that others take out meanwhile."""
    for entry in entries:
        try:
            facts, _ = files.read(entry.path, whole=False)
        except InvalidFileError:
            if files.state(entry.path) is not None:  # `exists` takes any failure for its absence
                raise
        else:
            yield entry, facts


def _now(folder: Path) -> float:
    """Return the time by the clock that the files of a folder have theirs from: another's maybe."""
    with files.writing(folder), temporary_folder(folder) as new:
        return new.stat().st_mtime


def _older(path: Path, moment: float) -> bool:
    state = files.state(path)
    return state is not None and state.st_mtime < moment


# --- operators as arrays ---


def _packed(shape: Geometry, plan: Plan, name: OperatorName) -> dict[str, NDArray[Any]]:
    """Assemble an operator of a shape, and return its arrays."""
    if name == "stiffness":
        matrix = csr_array(plan.laplacian(shape).stiffness)
        return {"data": matrix.data.astype(plan.precision), **_pattern(matrix)}
    frames, x, y = tangent_gradient(shape, oriented=True)
    values = {"x": x.data, "y": y.data, "frames": frames}
    assert np.array_equal(x.indices, y.indices)  # both of the same triangles
    return {name: array.astype(plan.precision) for name, array in values.items()} | _pattern(x)


def _pattern(matrix: csr_array) -> dict[str, NDArray[Any]]:
    kind: DTypeLike = np.int32 if matrix.nnz < 2**31 else np.int64
    return {name: getattr(matrix, name).astype(kind) for name in _INDICES}


def _matrix(arrays: Mapping[str, NDArray[Any]], values: str) -> csr_array:
    n = len(arrays["indptr"]) - 1
    return csr_array((arrays[values], arrays["indices"], arrays["indptr"]), shape=(n, n))
