"""The corpus on disk: folders of plain .npy files, written whole, read through memory maps.

::

    corpus/shard_0000/points.npy         (s, n, 3) float32
                      mass.npy           (s, n)    float32, each row sums to 1
                      eigenvectors.npy   (s, n, k) float16, M-orthonormal for that mass, so O(1)
                      eigenvalues.npy    (s, k)    float32 } the operators, in corpora that
                      starts.npy         (s, n+1)  int32   } have them: see `Operators`
                      columns.npy        (e,)      int32   }
                      entries.npy        (e,)      float32 }
                      labels.npz         one integer array of shape (s,) per label
    corpus/shard_0001/...

A sample of fewer than n points is padded: with copies of one of its points, which have no mass, are
zero in all modes, and are joined to nothing. A shard appears under its name only when it is
complete, so training may read a folder that generation still fills.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from spectra_kit._core.files import parsing, temporary_folder
from spectra_kit.errors import InvalidInputError

_DTYPES = {"points": np.float32, "mass": np.float32, "eigenvectors": np.float16}
_OPERATOR_DTYPES = {
    "eigenvalues": np.float32,
    "starts": np.int32,
    "columns": np.int32,
    "entries": np.float32,
}
_NAME = re.compile(r"shard_\d{4,}")


@dataclass(frozen=True, eq=False)
class Operators:
    """The stiffness matrices L of samples, by their entries above the diagonal, and eigenvalues.

    L is symmetric, and its rows sum to zero: what lies above the diagonal tells it all.

    Parameters
    ----------
    eigenvalues : ndarray of shape (s, k), float32
        Of ``L U = M U diag(eigenvalues)``.
    starts : ndarray of shape (s, n + 1), int32
        Where the entries of each row of each sample begin, and where those of the last row end.
    columns : ndarray of shape (e,), int32
        Of all entries, within their sample.
    entries : ndarray of shape (e,), float32
        Of all samples, one after the other.
    """

    eigenvalues: NDArray[np.float32]
    starts: NDArray[np.int32]
    columns: NDArray[np.int32]
    entries: NDArray[np.float32]

    def __post_init__(self) -> None:
        shapes = tuple(array.shape for array in vars(self).values())
        values, starts, columns, entries = shapes
        last = int(self.starts[-1, -1]) if len(starts) == 2 and all(starts) else 0
        if len(starts) != 2 or values[:1] != starts[:1] or (columns, entries) != 2 * ((last,),):
            raise InvalidInputError(
                "`eigenvalues`, `starts`, `columns` and `entries` must have shapes (s, k),"
                f" (s, n + 1), (e,) and (e,) with e = starts[-1, -1] = {last}, got {shapes}"
            )

    @classmethod
    def of(
        cls, matrices: Sequence[sparse.csr_array], eigenvalues: Sequence[ArrayLike], n: int
    ) -> Operators:
        """Return those of matrices on up to `n` points, with empty rows for those that lack."""
        upper = [sparse.csr_array(sparse.triu(matrix, 1)) for matrix in matrices]
        first = np.cumsum([0, *(matrix.nnz for matrix in upper)])
        starts = [
            start + np.pad(matrix.indptr, (0, n + 1 - len(matrix.indptr)), mode="edge")
            for start, matrix in zip(first[:-1], upper, strict=True)
        ]
        return cls(
            np.array(eigenvalues, dtype=np.float32),
            np.array(starts, dtype=np.int32),
            np.concatenate([matrix.indices for matrix in upper], dtype=np.int32),
            np.concatenate([matrix.data for matrix in upper], dtype=np.float32),
        )

    @classmethod
    def joined(cls, parts: Sequence[Operators]) -> Operators:
        """Return those of several, one after the other."""
        first = np.cumsum([0, *(len(part.entries) for part in parts)])
        starts = [part.starts + start for part, start in zip(parts, first[:-1], strict=True)]
        return cls(
            np.concatenate([part.eigenvalues for part in parts]),
            np.concatenate(starts, dtype=np.int32),
            np.concatenate([part.columns for part in parts]),
            np.concatenate([part.entries for part in parts]),
        )

    def __getitem__(self, samples: slice) -> Operators:
        """Return those of neighbouring samples, as views."""
        starts = self.starts[samples]
        ends = slice(int(starts[0, 0]), int(starts[-1, -1])) if len(starts) else slice(0)
        values, columns, entries = self.eigenvalues[samples], self.columns[ends], self.entries[ends]
        return Operators(values, starts - np.int32(ends.start or 0), columns, entries)

    def stiffness(self, i: int) -> sparse.csr_array:
        """Return L of sample i, shape (n, n), float64."""
        one, n = self[i : i + 1], self.starts.shape[1] - 1
        data = one.entries.astype(np.float64)
        upper = sparse.csr_array((data, one.columns, one.starts[0]), shape=(n, n))
        off = upper + upper.T
        return sparse.csr_array(off - sparse.diags_array(off.sum(axis=1)))


@dataclass(frozen=True, eq=False)
class Batch:
    """Samples as arrays.

    Parameters
    ----------
    points : ndarray of shape (b, n, 3), float32
        Coordinates, in any unit of length.
    mass : ndarray of shape (b, n), float32
        Weights that sum to one; zero for padding.
    eigenvectors : ndarray of shape (b, n, k), float16
        Ground truth, M-orthonormal for `mass`.
    operators : Operators, optional
        What they are the modes of.
    """

    points: NDArray[np.float32]
    mass: NDArray[np.float32]
    eigenvectors: NDArray[np.float16]
    operators: Operators | None = None

    def __post_init__(self) -> None:
        points, mass, modes = (getattr(self, name).shape for name in _DTYPES)
        if len(mass) != 2 or points != (*mass, 3) or len(modes) != 3 or modes[:2] != mass:
            raise _misshapen(self)
        if self.operators is not None:
            found = self.operators.starts.shape, self.operators.eigenvalues.shape
            wanted = (mass[0], mass[1] + 1), (modes[0], modes[2])
            if found != wanted:
                raise InvalidInputError(
                    "operators", f"have `starts` and `eigenvalues` of shapes {wanted}", found
                )

    def __getitem__(self, samples: slice) -> Batch:
        """Return neighbouring samples, as views."""
        arrays = {name: getattr(self, name)[samples] for name in _DTYPES}
        return Batch(**arrays, operators=self.operators and self.operators[samples])

    @classmethod
    def joined(cls, parts: Sequence[Batch]) -> Batch:
        """Return the samples of several; with operators, if all of them have some."""
        arrays = {name: np.concatenate([vars(part)[name] for part in parts]) for name in _DTYPES}
        operators = [part.operators for part in parts if part.operators is not None]
        every = Operators.joined(operators) if len(operators) == len(parts) else None
        return cls(**arrays, operators=every)


def _misshapen(batch: Batch) -> InvalidInputError:
    points, mass, modes = (getattr(batch, name).shape for name in _DTYPES)
    return InvalidInputError(
        "`points`, `mass` and `eigenvectors` must have shapes (s, n, 3), (s, n) and (s, n, k) with"
        f" s >= 1, got {points}, {mass} and {modes}"
    )


@dataclass(frozen=True, eq=False)
class Corpus:
    """The samples of a folder of shards, numbered through; made by `open_shards`.

    Parameters
    ----------
    shards : tuple of Batch
        Memory maps, one per shard.
    labels : dict of str to ndarray of shape (len(corpus),)
        Integer labels of all samples.
    """

    shards: tuple[Batch, ...]
    labels: dict[str, NDArray[np.int64]]

    def __post_init__(self) -> None:
        for name, label in self.labels.items():
            if label.shape != (len(self),):
                raise InvalidInputError(
                    f"label `{name}` must have one integer for each of {len(self)} samples,"
                    f" got {label.shape}"
                )

    @cached_property
    def _sizes(self) -> NDArray[np.int64]:
        return np.array([len(shard.mass) for shard in self.shards])

    @cached_property
    def _ends(self) -> NDArray[np.int64]:
        """Where each shard ends, in samples."""
        return np.cumsum(self._sizes)

    def __len__(self) -> int:
        return int(self._ends[-1])

    @property
    def n_points(self) -> int:
        """Points per sample."""
        return int(self.shards[0].mass.shape[1])

    @cached_property
    def fewest(self) -> int:
        """Points of the smallest sample, without padding."""
        counts = self.labels.get("n")
        if counts is None:  # as in shards of before, joined with others
            counts = np.concatenate([np.count_nonzero(s.mass, axis=1) for s in self.shards])
        return int(np.min(counts, initial=self.n_points))

    @property
    def k(self) -> int:
        """Modes per sample."""
        return int(self.shards[0].eigenvectors.shape[2])

    @property
    def has_operators(self) -> bool:
        """Whether all samples come with their operators."""
        return all(shard.operators is not None for shard in self.shards)

    def batch(self, indices: ArrayLike) -> Batch:
        """Read the samples `indices`, shape (b,), into memory, in that order."""
        chosen = np.asarray(indices)
        which = np.searchsorted(self._ends, chosen, side="right")
        places = zip(which, chosen - self._ends[which] + self._sizes[which], strict=True)
        return Batch.joined([self.shards[i][j : j + 1] for i, j in places])


def write_shard(
    folder: str | os.PathLike[str],
    index: int,
    points: ArrayLike,
    mass: ArrayLike,
    eigenvectors: ArrayLike,
    labels: Mapping[str, ArrayLike],
    operators: Operators | None = None,
) -> Path:
    """Write one shard: all of it, or nothing.

    Parameters
    ----------
    folder : path
        The corpus; made if missing.
    index : int
        Number of the shard. An existing shard is never overwritten.
    points : array_like of shape (s, n, 3)
        Coordinates, in any unit; stored as float32.
    mass : array_like of shape (s, n)
        Positive weights, or zero for padding; stored as float32.
    eigenvectors : array_like of shape (s, n, k)
        M-orthonormal for `mass`; stored as float16, which holds 3 digits of values of size one.
    labels : mapping of str to array_like of shape (s,)
        Integers that say what each sample is, e.g. its family and seed.
    operators : Operators, optional
        What the modes are those of, for a training that smooths.

    Returns
    -------
    Path
        The folder of the new shard.

    Raises
    ------
    InvalidInputError
        If shapes disagree, a mass does not sum to one, a value is not finite, or the shard exists.

    Examples
    --------
    >>> import tempfile
    >>> import numpy as np
    >>> from spectra_kit.neo.train.shards import open_shards, write_shard
    >>> corpus = tempfile.mkdtemp()
    >>> mass = np.full((2, 5), 0.2)
    >>> points, modes = np.zeros((2, 5, 3)), np.ones((2, 5, 1))
    >>> path = write_shard(corpus, 0, points, mass, modes, {"seed": [3, 4]})
    >>> open_shards(corpus).labels["seed"]
    array([3, 4])
    """
    given = {"points": points, "mass": mass, "eigenvectors": eigenvectors}
    arrays = {name: np.asarray(given[name], dtype) for name, dtype in _DTYPES.items()}
    batch = Batch(**arrays, operators=operators)
    names = {name: np.asarray(values, dtype=np.int64) for name, values in labels.items()}
    _check_values(_shard(batch, names))
    path = Path(folder) / f"shard_{index:04d}"
    path.parent.mkdir(parents=True, exist_ok=True)
    with temporary_folder(path.parent) as temporary:
        for name, array in _arrays(batch).items():
            np.save(temporary / f"{name}.npy", array)
        np.savez(temporary / "labels.npz", allow_pickle=False, **names)
        try:
            temporary.rename(path)
        except OSError as error:
            raise InvalidInputError(
                f"shard {index} of {folder} exists", advice=f"delete {path} or take another index"
            ) from error
    return path


def _shard(batch: Batch, labels: dict[str, NDArray[np.int64]]) -> Corpus:
    """Return the samples of a shard, at least one; a stream may begin with none."""
    if not len(batch.mass):
        raise _misshapen(batch)
    return Corpus((batch,), labels)


def _arrays(batch: Batch) -> dict[str, NDArray[Any]]:
    """Return what there is of samples, by the names of the files."""
    arrays = {name: getattr(batch, name) for name in _DTYPES}
    return arrays if batch.operators is None else arrays | vars(batch.operators)


def _check_values(corpus: Corpus) -> None:
    (shard,) = corpus.shards
    for name, array in _arrays(shard).items():
        if not (array.size and np.isfinite(array).all()):
            raise InvalidInputError(name, "be there and finite in the precision that is stored")
    sums = shard.mass.sum(axis=1, dtype=np.float64)
    if not ((shard.mass >= 0).all() and np.allclose(sums, 1, atol=1e-4)):
        raise InvalidInputError(
            "mass",
            "not be negative, and have rows that sum to 1",
            f"sums in [{sums.min():.6g}, {sums.max():.6g}]",
            advice="divide by the sum and multiply the eigenvectors by its root",
        )


def open_shards(folder: str | os.PathLike[str]) -> Corpus:
    """Open every complete shard of a corpus, in the order of their numbers, without reading it.

    Parameters
    ----------
    folder : path
        Where `write_shard` wrote.

    Returns
    -------
    Corpus
        Opening again later sees shards that were added since.

    Raises
    ------
    InvalidInputError
        If there is no shard, a file of one is missing, cut short or of another shape, or shards
        differ in points or modes per sample.
    """
    root = Path(folder)
    entries = root.iterdir() if root.is_dir() else iter(())
    paths = sorted(
        (path for path in entries if _NAME.fullmatch(path.name)),
        key=lambda path: int(path.name.removeprefix("shard_")),
    )
    if not paths:
        raise InvalidInputError(
            "folder", "hold shards", f"none in {root}", advice="generate a corpus first"
        )
    return join([_open_shard(path) for path in paths], name=f"the shards of {root}")


def _open_shard(path: Path) -> Corpus:
    """Map the arrays of one shard; their values are not read, and damage to them is not seen."""
    with parsing(path, "shard", remedy="delete it, and generate the corpus again: it is replaced"):
        dtypes: dict[str, Any] = dict(_DTYPES)
        if (path / "starts.npy").exists():
            dtypes |= _OPERATOR_DTYPES
        arrays = {name: np.load(path / f"{name}.npy", mmap_mode="r") for name in dtypes}
        with (path / "labels.npz").open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            labels = dict(file.items())
        for name, array in (arrays | labels).items():
            dtype = np.dtype(dtypes.get(name, np.int64))
            if array.dtype != dtype:
                raise TypeError(f"{name} must be {dtype}, got {array.dtype}")
        rest = [arrays.pop(name) for name in _OPERATOR_DTYPES if name in arrays]
        return _shard(Batch(**arrays, operators=Operators(*rest) if rest else None), labels)


def join(corpora: Sequence[Corpus], *, name: str = "corpora") -> Corpus:
    """Return the samples of several corpora as one; a corpus given twice counts twice.

    They must have equal numbers of points and modes per sample, and keep the labels that all of
    them have. `name` is what they are, in messages.
    """
    sizes = {(corpus.n_points, corpus.k) for corpus in corpora}
    if len(sizes) != 1:
        raise InvalidInputError(
            f"{name} must have the same (points, modes) per sample, got {sorted(sizes)}",
            advice="keep corpora of different sizes apart, and train on one at a time",
        )
    common = set.intersection(*(set(corpus.labels) for corpus in corpora))
    return Corpus(
        tuple(shard for corpus in corpora for shard in corpus.shards),
        {name: np.concatenate([c.labels[name] for c in corpora]) for name in sorted(common)},
    )
