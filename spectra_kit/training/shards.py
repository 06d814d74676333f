"""The corpus on disk: folders of plain .npy files, written whole, read through memory maps.

::

    corpus/shard_0000/points.npy         (s, n, 3) float32
                      mass.npy           (s, n)    float32, each row sums to 1
                      eigenvectors.npy   (s, n, k) float16, M-orthonormal for that mass, so O(1)
                      labels.npz         one integer array of shape (s,) per label
    corpus/shard_0001/...

A shard appears under its name only when it is complete, so training may read a folder that
generation still fills.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spectra_kit._files import parsing, temporary_folder
from spectra_kit.errors import InvalidInputError

_DTYPES = {"points": np.float32, "mass": np.float32, "eigenvectors": np.float16}
_NAME = re.compile(r"shard_\d{4,}")


@dataclass(frozen=True, eq=False)
class Batch:
    """Samples as arrays.

    Parameters
    ----------
    points : ndarray of shape (b, n, 3), float32
        Coordinates, in any unit of length.
    mass : ndarray of shape (b, n), float32
        Weights that sum to one.
    eigenvectors : ndarray of shape (b, n, k), float16
        Ground truth, M-orthonormal for `mass`.
    """

    points: NDArray[np.float32]
    mass: NDArray[np.float32]
    eigenvectors: NDArray[np.float16]

    def __post_init__(self) -> None:
        points, mass, modes = (array.shape for array in vars(self).values())
        if len(mass) != 2 or points != (*mass, 3) or len(modes) != 3 or modes[:2] != mass:
            raise _misshapen(self)


def _misshapen(batch: Batch) -> InvalidInputError:
    points, mass, modes = (array.shape for array in vars(batch).values())
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
    def _ends(self) -> NDArray[np.int64]:
        """Where each shard ends, in samples."""
        return np.cumsum([len(shard.mass) for shard in self.shards])

    def __len__(self) -> int:
        return int(self._ends[-1])

    @property
    def n_points(self) -> int:
        """Points per sample."""
        return int(self.shards[0].mass.shape[1])

    @property
    def k(self) -> int:
        """Modes per sample."""
        return int(self.shards[0].eigenvectors.shape[2])

    def batch(self, indices: ArrayLike) -> Batch:
        """Read the samples `indices`, shape (b,), into memory, in that order."""
        chosen = np.asarray(indices)
        which = np.searchsorted(self._ends, chosen, side="right")
        backwards = chosen - self._ends[which]  # counted from the end of the shard
        places = [(self.shards[i], j) for i, j in zip(which, backwards, strict=True)]
        return Batch(
            *(np.stack([getattr(shard, name)[i] for shard, i in places]) for name in _DTYPES)
        )


def write_shard(
    folder: str | os.PathLike[str],
    index: int,
    points: ArrayLike,
    mass: ArrayLike,
    eigenvectors: ArrayLike,
    labels: Mapping[str, ArrayLike],
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
        Positive weights; stored as float32.
    eigenvectors : array_like of shape (s, n, k)
        M-orthonormal for `mass`; stored as float16, which holds 3 digits of values of size one.
    labels : mapping of str to array_like of shape (s,)
        Integers that say what each sample is, e.g. its family and seed.

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
    >>> from spectra_kit.training.shards import open_shards, write_shard
    >>> corpus = tempfile.mkdtemp()
    >>> mass = np.full((2, 5), 0.2)
    >>> points, modes = np.zeros((2, 5, 3)), np.ones((2, 5, 1))
    >>> path = write_shard(corpus, 0, points, mass, modes, {"seed": [3, 4]})
    >>> open_shards(corpus).labels["seed"]
    array([3, 4])
    """
    given = {"points": points, "mass": mass, "eigenvectors": eigenvectors}
    batch = Batch(**{name: np.asarray(given[name], dtype) for name, dtype in _DTYPES.items()})
    names = {name: np.asarray(values, dtype=np.int64) for name, values in labels.items()}
    _check_values(_shard(batch, names))
    path = Path(folder) / f"shard_{index:04d}"
    path.parent.mkdir(parents=True, exist_ok=True)
    with temporary_folder(path.parent) as temporary:
        for name, array in vars(batch).items():
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


def _check_values(corpus: Corpus) -> None:
    (shard,) = corpus.shards
    for name, array in vars(shard).items():
        if not (array.size and np.isfinite(array).all()):
            raise InvalidInputError(name, "be there and finite in the precision that is stored")
    sums = shard.mass.sum(axis=1, dtype=np.float64)
    if not ((shard.mass > 0).all() and np.allclose(sums, 1, atol=1e-4)):
        raise InvalidInputError(
            "mass",
            "be positive with rows that sum to 1",
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
        arrays = {name: np.load(path / f"{name}.npy", mmap_mode="r") for name in _DTYPES}
        with (path / "labels.npz").open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            labels = dict(file.items())
        for name, array in (arrays | labels).items():
            dtype = np.dtype(_DTYPES.get(name, np.int64))
            if array.dtype != dtype:
                raise TypeError(f"{name} must be {dtype}, got {array.dtype}")
        try:
            return _shard(Batch(**arrays), labels)
        except InvalidInputError as error:
            raise ValueError(error) from error


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
