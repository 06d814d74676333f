"""`SpectrumStore`: spectra of many shapes in a folder, each computed once."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from spectra_kit._core.checked import checked
from spectra_kit._core.files import parsing
from spectra_kit._core.fingerprint import facts_digest, shape_digest
from spectra_kit._core.types import Floats
from spectra_kit._core.version import VERSION
from spectra_kit.datasets import files, housekeeping
from spectra_kit.datasets.files import Damage, Kind, ShapeRecord, StoredEntry
from spectra_kit.datasets.operators import (
    OperatorName,
    gradient_of,
    operator_facts,
    packed,
    stiffness_of,
)
from spectra_kit.datasets.plan import Descriptor, Plan
from spectra_kit.eigen import Spectrum, eigensolve
from spectra_kit.eigen.spectrum import plain
from spectra_kit.eigen.spectrum_file import write_spectrum_file
from spectra_kit.errors import InvalidFileError, InvalidInputError
from spectra_kit.features import DESCRIPTORS
from spectra_kit.geometry import Geometry, PointCloud, TriangleMesh
from spectra_kit.operators import TangentGradient

Found = TypeVar("Found")


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
    InvalidInputError
        If there is something else at `path`.
    InvalidFileError
        If the store is of a newer format.
    StoreError
        If the folder cannot be made.

    Notes
    -----
    Entries are the npz files of `Spectrum.save`, uncompressed and aligned, because these can be
    mapped into memory and read by NumPy alone. There is no index beside them: the names are the
    index, to list them is to list folders, and no lock is needed, which databases in a single file
    need and shared file systems do not always keep.

    Examples
    --------
    >>> import tempfile
    >>> import spectra_kit as sk
    >>> store = sk.datasets.SpectrumStore(tempfile.mkdtemp())
    >>> animal, plan = sk.geometry.creature(600), sk.datasets.Plan(k=12)
    >>> modes = store.spectrum(animal, plan)
    >>> store.load(store.key(animal, plan), mmap=True)
    Spectrum(n=600, k=12, ...
    """

    path: str | os.PathLike[str]

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", Path(self.path))
        files.check_or_mark(Path(self.path))

    def key(self, shape: Geometry, plan: Plan) -> str:
        """Return the hash of all that a spectrum follows from.

        Parameters
        ----------
        shape : TriangleMesh or PointCloud
            As it is looked at: see `Plan.prepared`.
        plan : Plan
            What is computed.

        Returns
        -------
        str
            32 hexadecimal digits.

        Examples
        --------
        >>> import tempfile
        >>> import spectra_kit as sk
        >>> store, animal = sk.datasets.SpectrumStore(tempfile.mkdtemp()), sk.geometry.creature(600)
        >>> store.key(animal, sk.datasets.Plan(k=12)) == store.key(animal, sk.datasets.Plan(k=13))
        False
        """
        return facts_digest(_spectrum_facts(shape_digest(shape), plan))

    def __contains__(self, key: object) -> bool:
        """Whether there is a spectrum of a key, whole or damaged."""
        return isinstance(key, str) and self._place("spectra", key).exists()

    def load(self, key: str, *, mmap: bool = False) -> Spectrum | None:
        """Return the spectrum of a key if it is there.

        Parameters
        ----------
        key : str
            As `key` returns it, and `records` tell.
        mmap : bool, default False
            Map the arrays instead of reading them, without the checks that reading makes. Of
            float32, NumPy makes a copy.

        Returns
        -------
        Spectrum or None
            Without the times in its provenance.

        Raises
        ------
        InvalidFileError
            If the entry is damaged.

        Examples
        --------
        >>> import tempfile
        >>> import spectra_kit as sk
        >>> sk.datasets.SpectrumStore(tempfile.mkdtemp()).load("0" * 32) is None
        True
        """
        path = self._place("spectra", key)
        if not path.exists():
            return None
        files.read_facts(path)  # that it is the one of this key
        return Spectrum.load(path, mmap=mmap)

    def spectrum(self, shape: Geometry, plan: Plan) -> Spectrum:
        """Return the spectrum of a shape; compute and keep it if it is not there.

        Parameters
        ----------
        shape : TriangleMesh or PointCloud
            As it is looked at: see `Plan.prepared`.
        plan : Plan
            What to compute.

        Returns
        -------
        Spectrum
            Without the times in its provenance.

        Raises
        ------
        InvalidInputError, ConvergenceError, InvalidSpectrumError, OutOfMemoryError
            As of `Plan.laplacian` and `eigensolve`; nothing is kept then.
        StoreError
            If it cannot be written.

        Warns
        -----
        DamagedEntryWarning
            If there was an entry, and it was damaged: it is computed again.

        Examples
        --------
        >>> import tempfile
        >>> import spectra_kit as sk
        >>> store = sk.datasets.SpectrumStore(tempfile.mkdtemp())
        >>> store.spectrum(sk.geometry.creature(600), sk.datasets.Plan(k=12)).k
        12
        """
        key = self.key(shape, plan)

        def solved() -> Spectrum:
            made = eigensolve(plan.laplacian(shape), plan.k, plan.solver)
            return self.keep_spectrum(shape, plan, made)

        return _known(lambda: self.load(key), solved)

    def keep_spectrum(self, shape: Geometry, plan: Plan, made: Spectrum) -> Spectrum:
        """Keep a spectrum that was computed as a plan says, and its shape.

        Parameters
        ----------
        shape : TriangleMesh or PointCloud
            As it is looked at: see `Plan.prepared`.
        plan : Plan
            By which it was computed.
        made : Spectrum
            Of `Plan.laplacian`, by the solver of the plan.

        Returns
        -------
        Spectrum
            As all others will see it: in the precision of the plan, without the times in its
            provenance.

        Raises
        ------
        StoreError
            If it cannot be written.

        Examples
        --------
        >>> import tempfile
        >>> import spectra_kit as sk
        >>> store = sk.datasets.SpectrumStore(tempfile.mkdtemp())
        >>> animal, plan = sk.geometry.creature(600), sk.datasets.Plan(k=12, solver=sk.Dense())
        >>> made = sk.eigensolve(plan.laplacian(animal), plan.k, plan.solver)
        >>> store.keep_spectrum(animal, plan, made).k
        12
        >>> store.key(animal, plan) in store
        True
        """
        facts = _spectrum_facts(shape_digest(shape), plan)
        self.keep_shape(shape)
        made = made.described(made.certificate, replace(made.provenance, seconds={}))
        vectors = made.eigenvectors.astype(plan.precision)
        arrays = {"eigenvalues": made.eigenvalues, "eigenvectors": vectors, "mass": made.mass}
        certificate = plain(made.certificate) if made.certificate else None
        with self._new("spectra", facts_digest(facts)) as path:
            write_spectrum_file(path, arrays, certificate, vars(made.provenance), facts=facts)
        return replace(made, eigenvectors=vectors)

    def descriptor(self, shape: Geometry, plan: Plan, name: Descriptor) -> Floats:
        """Return a signature of a shape; compute and keep it, and the spectrum, if it is not there.

        Parameters
        ----------
        shape : TriangleMesh or PointCloud
            As it is looked at: see `Plan.prepared`.
        plan : Plan
            What to compute.
        name : {"hks", "wks", "gps", "dna"}
            Which.

        Returns
        -------
        ndarray of shape (n, c), or (c,) of ShapeDNA
            In the precision of the plan.

        Raises
        ------
        InvalidInputError, ConvergenceError, InvalidSpectrumError, OutOfMemoryError, StoreError
            As of `spectrum`.

        Examples
        --------
        >>> import tempfile
        >>> import spectra_kit as sk
        >>> store = sk.datasets.SpectrumStore(tempfile.mkdtemp())
        >>> store.descriptor(sk.geometry.creature(600), sk.datasets.Plan(k=12), "hks").shape
        (600, 16)
        """
        facts = _descriptor_facts(self.key(shape, plan), name)
        key = facts_digest(facts)
        path = self._place("descriptors", key)

        def known() -> Floats | None:
            return self.load_descriptor(key) if path.exists() else None

        def described() -> Floats:
            values = DESCRIPTORS[name](self.spectrum(shape, plan)).astype(plan.precision)
            with self._new("descriptors", key) as place:
                files.write(place, facts, values=values)
            return values

        return _known(known, described)

    def descriptor_key(self, spectrum: str, name: Descriptor) -> str:
        """Return the hash of all that a signature follows from: the key of a spectrum, and a name.

        Parameters
        ----------
        spectrum : str
            As `key` returns it.
        name : {"hks", "wks", "gps", "dna"}
            Which.

        Returns
        -------
        str
            32 hexadecimal digits.

        Examples
        --------
        >>> import tempfile
        >>> import spectra_kit as sk
        >>> len(sk.datasets.SpectrumStore(tempfile.mkdtemp()).descriptor_key("0" * 32, "hks"))
        32
        """
        return facts_digest(_descriptor_facts(spectrum, name))

    def load_descriptor(self, key: str) -> Floats:
        """Return a signature.

        Parameters
        ----------
        key : str
            As `descriptor_key` returns it, and `records` tell.

        Returns
        -------
        ndarray of shape (n, c), or (c,) of ShapeDNA
            In the precision in which it was kept.

        Raises
        ------
        InvalidFileError
            If there is none, or it is damaged.

        Examples
        --------
        >>> import tempfile
        >>> import spectra_kit as sk
        >>> store, animal = sk.datasets.SpectrumStore(tempfile.mkdtemp()), sk.geometry.creature(600)
        >>> _ = store.descriptor(animal, sk.datasets.Plan(k=12), "hks")
        >>> key = store.descriptor_key(store.key(animal, sk.datasets.Plan(k=12)), "hks")
        >>> store.load_descriptor(key).shape
        (600, 16)
        """
        path = self._place("descriptors", key)
        _, arrays = files.read_named(path)
        with parsing(path, "signature of a store", remedy=files.REMEDY):
            values: Floats = arrays["values"]
        return values

    def keep_operator(self, shape: Geometry, plan: Plan, name: OperatorName) -> str:
        """Keep an operator of a shape, assembled unless it is there, and return its key.

        Parameters
        ----------
        shape : TriangleMesh or PointCloud
            As it is looked at: see `Plan.prepared`.
        plan : Plan
            Which Laplacian, and in which precision.
        name : {"stiffness", "gradient"}
            Which.

        Returns
        -------
        str
            For `load_operator`.

        Raises
        ------
        InvalidInputError
            As of `Plan.laplacian`, and of `tangent_gradient` with outward normals.
        StoreError
            If it cannot be written.

        Examples
        --------
        >>> import tempfile
        >>> import spectra_kit as sk
        >>> store, plan = sk.datasets.SpectrumStore(tempfile.mkdtemp()), sk.datasets.Plan()
        >>> key = store.keep_operator(sk.geometry.creature(600), plan, "stiffness")
        >>> store.load_operator(key).shape
        (600, 600)
        """
        facts = operator_facts(shape_digest(shape), plan, name)
        key = facts_digest(facts)
        path = self._place("operators", key)

        def kept() -> str:
            with self._new("operators", key) as place:
                files.write(place, facts, **packed(shape, plan, name))
            return key

        return _known(lambda: (self.load_operator(key), key)[1] if path.exists() else None, kept)

    def load_operator(self, key: str) -> csr_array | TangentGradient:
        """Return an operator.

        Parameters
        ----------
        key : str
            As `keep_operator` returns it, and `records` tell.

        Returns
        -------
        csr_array of shape (n, n), or TangentGradient
            The stiffness; or frames and gradients.

        Raises
        ------
        InvalidFileError
            If there is none, or it is damaged.

        Examples
        --------
        >>> import tempfile
        >>> import spectra_kit as sk
        >>> store, plan = sk.datasets.SpectrumStore(tempfile.mkdtemp()), sk.datasets.Plan()
        >>> key = store.keep_operator(sk.geometry.creature(600), plan, "gradient")
        >>> store.load_operator(key).frames.shape
        (600, 3, 3)
        """
        path = self._place("operators", key)
        facts, arrays = files.read_named(path)
        with parsing(path, "operator of a store", remedy=files.REMEDY):
            stiffness = facts["kept"] == "stiffness"
            return stiffness_of(arrays) if stiffness else gradient_of(arrays)

    def keep_shape(self, shape: Geometry) -> str:
        """Keep a geometry, and return its key.

        Parameters
        ----------
        shape : TriangleMesh or PointCloud
            In any unit.

        Returns
        -------
        str
            For `shape`.

        Raises
        ------
        StoreError
            If it cannot be written.

        Examples
        --------
        >>> import tempfile
        >>> import spectra_kit as sk
        >>> store = sk.datasets.SpectrumStore(tempfile.mkdtemp())
        >>> store.shape(store.keep_shape(sk.geometry.creature(600))).n
        600
        """
        key = shape_digest(shape)
        arrays = {"points": shape.points}
        if isinstance(shape, TriangleMesh):
            arrays["faces"] = shape.faces.astype(np.int32 if shape.n < 2**31 else np.int64)
        if not self._place("shapes", key).exists():
            with self._new("shapes", key) as path:
                files.write(path, {}, **arrays)
        return key

    def shape(self, key: str) -> Geometry:
        """Return a geometry.

        Parameters
        ----------
        key : str
            As `keep_shape` returns it, and `records` tell.

        Returns
        -------
        TriangleMesh or PointCloud
            The very points and faces.

        Raises
        ------
        InvalidFileError
            If there is none, or it is damaged.

        Examples
        --------
        >>> import tempfile
        >>> import spectra_kit as sk
        >>> store = sk.datasets.SpectrumStore(tempfile.mkdtemp())
        >>> store.shape(store.keep_shape(sk.PointCloud([[0, 0, 0], [1, 0, 0]]))).points[1]
        array([1., 0., 0.])
        """
        path = self._place("shapes", key)
        _, arrays = files.read(path)
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
        """Keep a map between two shapes, and return its key.

        Parameters
        ----------
        source, target : str
            Keys of their spectra.
        how : mapping
            What else the map follows from, as JSON can say it; the release is added.
        arrays : mapping of str to ndarray
            What it is.

        Returns
        -------
        str
            For `load_map`.

        Raises
        ------
        InvalidInputError
            If JSON cannot say `how`.
        StoreError
            If it cannot be written.

        Examples
        --------
        >>> import tempfile
        >>> import numpy as np
        >>> import spectra_kit as sk
        >>> store = sk.datasets.SpectrumStore(tempfile.mkdtemp())
        >>> key = store.keep_map("0" * 32, "1" * 32, {"k": 5}, {"point_map": np.arange(3)})
        >>> store.load_map(key)[1]["point_map"]
        array([0, 1, 2])
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
        """Return whether there is a map of a key, whole or damaged.

        Parameters
        ----------
        key : str
            As `keep_map` returns it.

        Returns
        -------
        bool
            Without a look into it.
        """
        return self._place("maps", key).exists()

    def load_map(self, key: str) -> tuple[dict[str, Any], dict[str, NDArray[Any]]] | None:
        """Return the facts and the arrays of a map if it is there.

        Parameters
        ----------
        key : str
            As `keep_map` returns it.

        Returns
        -------
        facts : dict
            ``source``, ``target``, ``how`` and ``release``; tuples are lists now.
        arrays : dict of str to ndarray
            As they were kept.

        Raises
        ------
        InvalidFileError
            If the entry is damaged.

        Examples
        --------
        >>> import tempfile
        >>> import spectra_kit as sk
        >>> sk.datasets.SpectrumStore(tempfile.mkdtemp()).load_map("0" * 32) is None
        True
        """
        if not self.has_map(key):
            return None
        return files.read_named(self._place("maps", key))

    def record(self, name: str, plan: Plan) -> ShapeRecord | None:
        """Return what is known of a name under a plan.

        Parameters
        ----------
        name : str
            As it was given.
        plan : Plan
            What was computed.

        Returns
        -------
        ShapeRecord or None
            None where there is nothing.

        Raises
        ------
        InvalidFileError
            If the record is damaged.

        Examples
        --------
        >>> import tempfile
        >>> import spectra_kit as sk
        >>> store = sk.datasets.SpectrumStore(tempfile.mkdtemp())
        >>> store.record("cat.off", sk.datasets.Plan()) is None
        True
        """
        key = facts_digest(files.record_facts(name, plan.facts))
        return files.read_record(self._place("records", key))

    def keep_record(self, record: ShapeRecord) -> None:
        """Keep what belongs to a name, in the place of what was known of it under that plan.

        Parameters
        ----------
        record : ShapeRecord
            What to keep.

        Raises
        ------
        StoreError
            If it cannot be written.

        Examples
        --------
        >>> import tempfile
        >>> import spectra_kit as sk
        >>> store, plan = sk.datasets.SpectrumStore(tempfile.mkdtemp()), sk.datasets.Plan()
        >>> store.keep_record(
        ...     sk.datasets.ShapeRecord(
        ...         name="cat.off", file="", facts=plan.facts, shape="", spectrum="",
        ...         descriptors={}, operators={}, sizes={}, kind="cloud", points=0, faces=0,
        ...         area=0.0, components=0, zero_modes=0, level="residuals", residual=0.0,
        ...         eigenvalues=(),
        ...     )
        ... )
        >>> store.record("cat.off", plan).name
        'cat.off'
        """
        key = facts_digest(files.record_facts(record.name, record.facts))
        with self._new("records", key) as path:
            files.write_record(path, record)

    def sizes(self, record: ShapeRecord) -> dict[str, int]:
        """Return the bytes of those entries of a record that are there.

        Parameters
        ----------
        record : ShapeRecord
            As `record` returns it.

        Returns
        -------
        dict of str to int
            By key.

        Examples
        --------
        >>> import tempfile
        >>> from pathlib import Path
        >>> import spectra_kit as sk
        >>> folder = Path(tempfile.mkdtemp())
        >>> sk.geometry.write(sk.geometry.creature(600), folder / "animal.off")
        >>> store, plan = sk.datasets.SpectrumStore(folder / "store"), sk.datasets.Plan(k=12)
        >>> record = sk.datasets.complete(store, "animal", folder / "animal.off", plan).record
        >>> store.sizes(record) == record.sizes
        True
        """
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

        Parameters
        ----------
        record : ShapeRecord
            As `record` returns it.

        Returns
        -------
        bool
            Without a look into the entries.

        Examples
        --------
        >>> import tempfile
        >>> from pathlib import Path
        >>> import spectra_kit as sk
        >>> folder = Path(tempfile.mkdtemp())
        >>> sk.geometry.write(sk.geometry.creature(600), folder / "animal.off")
        >>> store, plan = sk.datasets.SpectrumStore(folder / "store"), sk.datasets.Plan(k=12)
        >>> store.holds(sk.datasets.complete(store, "animal", folder / "animal.off", plan).record)
        True
        """
        kept = (*record.descriptors.values(), *record.operators.values())
        sizes = self.sizes(record)
        return sizes == record.sizes and sizes.keys() == {record.shape, record.spectrum, *kept}

    def records(self, plan: Plan | None = None) -> Iterator[ShapeRecord]:
        """Yield what is known of each name, in the order of the names' hashes.

        Parameters
        ----------
        plan : Plan, optional
            Only what was computed by it.

        Yields
        ------
        ShapeRecord
            One for each name and plan.

        Warns
        -----
        DamagedEntryWarning
            If a record is damaged: it is left out.

        Examples
        --------
        >>> import tempfile
        >>> import spectra_kit as sk
        >>> list(sk.datasets.SpectrumStore(tempfile.mkdtemp()).records())
        []
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
        """Yield all entries, or those of a kind, in the order of their keys.

        Parameters
        ----------
        kind : {"shapes", "spectra", "descriptors", "operators", "maps", "records"}, optional
            Which.

        Yields
        ------
        StoredEntry
            Whatever it holds, whole or damaged.

        Examples
        --------
        >>> import tempfile
        >>> import spectra_kit as sk
        >>> store = sk.datasets.SpectrumStore(tempfile.mkdtemp())
        >>> modes = store.spectrum(sk.geometry.creature(600), sk.datasets.Plan(k=12))
        >>> [entry.kind for entry in store.entries()]
        ['shapes', 'spectra']
        """
        for one in files.SUFFIX if kind is None else (kind,):
            for path in files.places(self.path, one):
                state = None if path.name.startswith(".") else files.state(path)
                if state is not None:
                    yield StoredEntry(one, path.stem, path, state.st_size)

    def verify(
        self, *, remove: bool = False, progress: Callable[[int, int], object] | None = None
    ) -> list[Damage]:
        """Read everything, and name what is damaged.

        Parameters
        ----------
        remove : bool, default False
            Take it out, too: whoever needs it computes it again.
        progress : callable, optional
            Told how many entries of how many are read.

        Returns
        -------
        list of Damage
            Empty where all is well.

        Raises
        ------
        StoreError
            If it cannot be taken out.

        Examples
        --------
        >>> import tempfile
        >>> import spectra_kit as sk
        >>> store = sk.datasets.SpectrumStore(tempfile.mkdtemp())
        >>> key = store.keep_shape(sk.geometry.creature(600))
        >>> path = next(store.entries()).path
        >>> _ = path.write_bytes(path.read_bytes()[:-1000])
        >>> len(store.verify(remove=True)), len(list(store.entries()))
        (1, 0)
        """
        return housekeeping.verify(self, remove=remove, progress=progress)

    def clean(self, *, unnamed: bool = False) -> list[Path]:
        """Remove what nothing will ask for again.

        These are entries of other releases, geometries that belong to no entry that stays, and
        what writers have left. Geometries and leftovers of the last day stay, as somebody may be
        about to need them.

        Parameters
        ----------
        unnamed : bool, default False
            Also remove what no record names and is older than a day: results of files that have
            changed since, and those that were asked for without a name (`spectrum`).

        Returns
        -------
        list of Path
            What was removed.

        Raises
        ------
        InvalidFileError
            If an entry is damaged, or a record is and what is unnamed shall go: `verify` first.
        StoreError
            If something cannot be removed.

        Examples
        --------
        >>> import tempfile
        >>> import spectra_kit as sk
        >>> sk.datasets.SpectrumStore(tempfile.mkdtemp()).clean()
        []
        """
        return housekeeping.clean(self, unnamed=unnamed)

    # --- files ---

    def _place(self, kind: Kind, key: str) -> Path:
        return files.place(self.path, kind, key)

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


def map_facts(source: str, target: str, how: Mapping[str, object]) -> dict[str, object]:
    """Return all that a map between the shapes of two spectra follows from."""
    return {"source": source, "target": target, "how": how, "release": VERSION}


def _known(known: Callable[[], Found | None], make: Callable[[], Found]) -> Found:
    """Return what is known, else what is made; also where it is damaged, which is told."""
    try:
        found = known()
    except InvalidFileError as error:
        files.warn_of_damage(error)
        found = None
    return make() if found is None else found
