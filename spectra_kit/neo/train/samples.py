"""Samples of a corpus: points of random surfaces, their operators, and their exact modes.

Points are drawn on the surface, as a cloud, or the vertices of a mesh. Every sample follows from
(seed, index) alone, so any number of processes makes the same corpus. `Samples` holds any number of
them, as they are kept on disk and read again.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_count
from spectra_kit._sparse.slicing import sliced_eigenpairs
from spectra_kit.eigen.base import NotConvergedError
from spectra_kit.eigen.dense import Dense
from spectra_kit.errors import ConvergenceError, InvalidInputError
from spectra_kit.geometry.sampling import GaussianDensity, sample
from spectra_kit.geometry.shapes import Geometry, TriangleMesh
from spectra_kit.neo.train.families import FAMILIES, draw_family, family_weights, make_mesh
from spectra_kit.neo.train.pool import open_pool, varied
from spectra_kit.neo.train.surfaces import at_resolution
from spectra_kit.operators.laplacian import Laplacian

FROM_POOL = -1  # the label `family` of samples that are real meshes
REASONS = ("mesh", "components", "solve")  # of rejection
# Of residuals. Spans then agree to 1e-5 with those to rounding, eigenvalues to 1e-4; float16 holds
# 3 digits, and networks learn to 3e-3.
_TOL = 5e-3
_SHIFTS, _GAPS = 8, 10  # to find modes around at most; and among which a count is made
_PATIENCE = 4  # rejections after which a sample tries another family or mesh of the pool
# Vertices of a mesh for each mode: those aimed at, where blocks have room, and those that must be
# left of them. On fewer, the modes are nearly all functions that there are, and those of a network
# all.
_AIMED_AT, _LEFT = 5, 3

#: What is kept of samples, and in which precision; of some corpora without the operators.
ARRAYS: dict[str, Any] = {"points": np.float32, "mass": np.float32, "eigenvectors": np.float16}
OPERATORS: dict[str, Any] = {
    "eigenvalues": np.float32,
    "starts": np.int32,
    "columns": np.int32,
    "entries": np.float32,
}
_OF_ALL = ("columns", "entries")  # which have no row for each sample


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples as arrays, in the precisions of a corpus on disk, to which they are rounded.

    A sample of fewer than n points is padded: with copies of one of its points, which have no
    mass, are zero in all modes, and are joined to nothing. The operators, stiffness matrices L, are
    kept by their entries above the diagonal: L is symmetric, and its rows sum to zero. They may be
    left out, all four arrays together.

    Parameters
    ----------
    points : ndarray of shape (s, n, 3), float32
        Coordinates, in any unit of length.
    mass : ndarray of shape (s, n), float32
        Weights that sum to one; zero for padding.
    eigenvectors : ndarray of shape (s, n, k), float16
        Exact modes, M-orthonormal for `mass`.
    labels : dict of str to ndarray of shape (s,), int64
        What each sample is; see `make_sample`.
    eigenvalues : ndarray of shape (s, k), float32, optional
        Of ``L U = M U diag(eigenvalues)``.
    starts : ndarray of shape (s, n + 1), int32, optional
        Where the entries of each row of each sample begin, and where those of the last row end.
    columns : ndarray of shape (e,), int32, optional
        Of all entries, within their sample.
    entries : ndarray of shape (e,), float32, optional
        Of all samples, one after the other.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.neo.train.samples import Samples
    >>> points, mass, modes = np.zeros((2, 5, 3)), np.full((2, 5), 0.2), np.ones((2, 5, 1))
    >>> two = Samples(points, mass, modes, {"seed": [3, 4]})
    >>> two[1:].labels["seed"], two.has_operators
    (array([4]), False)
    """

    points: NDArray[np.floating]
    mass: NDArray[np.floating]
    eigenvectors: NDArray[np.floating]
    labels: dict[str, NDArray[np.int64]] = field(default_factory=dict)
    eigenvalues: NDArray[np.floating] | None = None
    starts: NDArray[np.int32] | None = None
    columns: NDArray[np.int32] | None = None
    entries: NDArray[np.floating] | None = None

    def __post_init__(self) -> None:
        for name, array in self.arrays().items():
            object.__setattr__(self, name, np.asarray(array, (ARRAYS | OPERATORS)[name]))
        labels = {name: np.asarray(label, np.int64) for name, label in self.labels.items()}
        object.__setattr__(self, "labels", labels)
        found = {name: array.shape for name, array in self.arrays().items()}
        s, n, k, *_ = *found["eigenvectors"], 0, 0, 0
        plain = {"points": (s, n, 3), "mass": (s, n), "eigenvectors": (s, n, k)}
        e = 0 if self.starts is None or not self.starts.size else int(self.starts.flat[-1])
        whole = plain | {
            "eigenvalues": (s, k),
            "starts": (s, n + 1),
            "columns": (e,),
            "entries": (e,),
        }
        if not s or found not in (plain, whole):
            raise InvalidInputError(
                "samples", f"be one or more, in arrays of shapes {whole}, or the first three", found
            )
        for name, label in labels.items():
            if label.shape != (s,):
                raise InvalidInputError(
                    f"label `{name}` must have one integer for each of {s} samples,"
                    f" got {label.shape}"
                )

    def __len__(self) -> int:
        return len(self.mass)

    @property
    def has_operators(self) -> bool:
        """Whether they come with their operators."""
        return self.starts is not None

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return what there is of them, by name."""
        arrays = {name: getattr(self, name) for name in ARRAYS | OPERATORS}
        return {name: array for name, array in arrays.items() if array is not None}

    def __getitem__(self, part: slice) -> Samples:
        """Return neighbouring samples, as views."""
        cut = {name: array[part] for name, array in self.arrays().items() if name not in _OF_ALL}
        if self.starts is not None:
            starts = cut["starts"]
            ends = slice(int(starts[0, 0]), int(starts[-1, -1]))
            cut |= {name: getattr(self, name)[ends] for name in _OF_ALL}
            cut["starts"] = starts - np.int32(ends.start)
        return Samples(**cut, labels={name: label[part] for name, label in self.labels.items()})

    @classmethod
    def joined(cls, parts: Sequence[Samples]) -> Samples:
        """Return all samples of several: with operators and labels that every one of them has."""
        names = ARRAYS | OPERATORS if all(part.has_operators for part in parts) else ARRAYS
        given = [{name: getattr(part, name) for name in names} for part in parts]
        if "starts" in names:
            first = np.cumsum([0, *(len(arrays["entries"]) for arrays in given)])
            for arrays, start in zip(given, first.tolist(), strict=False):
                arrays["starts"] = arrays["starts"] + np.int32(start)
        arrays = {name: np.concatenate([one[name] for one in given]) for name in names}
        return cls(**arrays, labels=common_labels(parts))

    def stiffness(self, i: int) -> sparse.csr_array:
        """Return L of sample i, shape (n, n), float64."""
        n, one = self.mass.shape[1], self[i : i + 1].arrays()
        data = one["entries"].astype(np.float64)
        upper = sparse.csr_array((data, one["columns"], one["starts"][0]), shape=(n, n))
        off = upper + upper.T
        return sparse.csr_array(off - sparse.diags_array(off.sum(axis=1)))

    def label(self, i: int) -> dict[str, int]:
        """Return what sample i is."""
        return {name: int(label[i]) for name, label in self.labels.items()}


def common_labels(parts: Sequence[Samples]) -> dict[str, NDArray[np.int64]]:
    """Return the labels that all of several samples have, those of one after the other."""
    common = set.intersection(*(set(part.labels) for part in parts))
    return {name: np.concatenate([part.labels[name] for part in parts]) for name in sorted(common)}


@dataclass(frozen=True, kw_only=True)
class CorpusConfig:
    """What a corpus is made of; two runs with equal configurations write equal samples.

    Parameters
    ----------
    seed : int
        Use different ones for training and validation.
    n_points : int
        Points per sample: of a cloud all, of a mesh at most.
    k : int
        Modes per sample, the constant one included.
    shard_size : int
        Samples per shard.
    nonuniform : float
        Fraction of samples whose points crowd around one spot.
    pool : path, optional
        Real meshes to draw from as well; see `open_pool`.
    pool_split : str
        The split of the pool to draw from.
    pool_share : float
        Fraction of samples that are real meshes, each varied at random.
    mesh_share : float
        Fraction of samples, real or not, that are the vertices of a mesh with its operator.
        The others are clouds.
    weights : dict of str to float
        Weights of `FAMILIES` that are to be others.

    Examples
    --------
    >>> from spectra_kit.neo.train.samples import CorpusConfig
    >>> CorpusConfig(seed=0, n_points=1024, mesh_share=0.5, weights={"tube": 12.0}).fewest
    288
    """

    seed: int
    n_points: int = 2048
    k: int = 96
    shard_size: int = 128
    nonuniform: float = 0.1
    pool: str | os.PathLike[str] | None = None
    pool_split: str = "train"
    pool_share: float = 0.0
    mesh_share: float = 0.0
    weights: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_count("seed", self.seed, low=0)
        check_count("k", self.k, low=1)
        check_count("n_points", self.n_points, low=max(64, 2 * self.k))
        check_count("shard_size", self.shard_size, low=1)
        family_weights(self.weights)
        for name in ("nonuniform", "pool_share", "mesh_share"):
            if not 0 <= getattr(self, name) <= 1:
                raise InvalidInputError(name, "be in [0, 1]", getattr(self, name))
        if self.pool_share and self.pool is None:
            raise InvalidInputError(
                "pool",
                f"name the real meshes of which a share of {self.pool_share} is wanted",
                None,
                advice="give the path, or take pool_share=0",
            )

    @property
    def fewest(self) -> int:
        """Points of a sample, at least."""
        return min(_LEFT * self.k, self.n_points) if self.mesh_share else self.n_points

    def fingerprint(self) -> dict[str, object]:
        """Everything that decides the content of the shards, as JSON; a pool by its content."""
        values = asdict(self)
        path, split = values.pop("pool"), values.pop("pool_split")
        values["pool"] = open_pool(path, split).digest if self.pool_share else None
        weights = family_weights(values.pop("weights"))
        return {"format": 9, **values, "families": weights if self.pool_share < 1 else {}}


def make_sample(config: CorpusConfig, index: int) -> Samples:
    """Make sample number `index` of a corpus.

    Parameters
    ----------
    config : CorpusConfig
        Of the whole corpus.
    index : int
        From 0; any order.

    Returns
    -------
    Samples
        This one; points centred in the unit box, eigenvalues of a surface of area one. Labels:
        ``family`` (place in `FAMILIES`, or `FROM_POOL`), ``pool`` (number of the mesh in the pool,
        or -1), ``mesh`` (0 for a cloud, 1 for a mesh), ``index``, ``nonuniform`` (0 or 1), ``n``
        points, and how often each reason of rejection came up before.
    """
    laplacian, values, modes, labels = exact_sample(config, index)
    rest = config.n_points - laplacian.n
    stiffness = laplacian.stiffness
    rows = np.repeat(np.arange(laplacian.n), np.diff(stiffness.indptr))
    above = stiffness.indices > rows
    counts = np.bincount(rows[above], minlength=config.n_points)
    return Samples(
        np.concatenate([laplacian.points, np.repeat(laplacian.points[-1:], rest, axis=0)])[None],
        np.append(laplacian.mass, np.zeros(rest))[None],
        np.concatenate([modes.astype(np.float16), np.zeros((rest, config.k), np.float16)])[None],
        {name: np.array([label]) for name, label in labels.items()},
        values[None],
        np.append(0, np.cumsum(counts))[None],
        stiffness.indices[above],
        stiffness.data[above],
    )


def exact_sample(
    config: CorpusConfig, index: int
) -> tuple[Laplacian, Floats, Floats, dict[str, int]]:
    """Make a sample in double precision: operator of area one, eigenvalues, modes and labels."""
    rejected = {f"rejected_{reason}": 0 for reason in REASONS}
    while True:
        made = _attempted(config, index, sum(rejected.values()))
        if not isinstance(made, str):
            laplacian, values, modes, labels = made
            return laplacian, values, modes, labels | rejected
        rejected[f"rejected_{made}"] += 1


def sample_mesh(config: CorpusConfig, labels: Mapping[str, int]) -> TriangleMesh:
    """Make the surface again that a sample with these labels lies on, in its own pose and unit.

    Of a mesh it is the mesh itself.
    """
    attempt = sum(labels[f"rejected_{reason}"] for reason in REASONS)
    return make_surface(config, labels, labels["index"], attempt)


def draw_source(config: CorpusConfig, index: int, attempt: int) -> dict[str, int]:
    """Draw what an attempt at a sample is to be: labels ``family``, ``pool`` and ``mesh``."""
    # What to draw hardly depends on the attempt: rejections would thin out the hard ones. Nor is
    # it the stream of the mesh, whose first numbers would then follow from its family.
    rng = np.random.default_rng((config.seed, index, attempt // _PATIENCE, 2))
    if config.pool is not None and config.pool_share and rng.random() < config.pool_share:
        n = len(open_pool(config.pool, config.pool_split))
        source = {"family": FROM_POOL, "pool": int(rng.integers(n))}
    else:
        source = {"family": draw_family(rng, config.weights), "pool": -1}
    return {**source, "mesh": int(rng.random() < config.mesh_share)}


def make_surface(
    config: CorpusConfig, source: Mapping[str, int], index: int, attempt: int
) -> TriangleMesh:
    """Make the surface of an attempt at a sample, in its own pose and unit.

    Raises `InvalidInputError` if the drawn parameters leave none: rare, the next have others.
    """
    seed = (config.seed, index, attempt)
    if config.pool is None or source["family"] != FROM_POOL:
        mesh = make_mesh(list(FAMILIES)[source["family"]], seed)
    else:
        real = open_pool(config.pool, config.pool_split).mesh(source["pool"])
        mesh = varied(real, np.random.default_rng(seed), own_vertices=bool(source["mesh"]))
    if not source["mesh"]:
        return mesh
    rng = np.random.default_rng((*seed, 3))
    fewest = min(_AIMED_AT * config.k, config.n_points)
    return at_resolution(mesh, rng, fewest=fewest, most=config.n_points)


def _attempted(
    config: CorpusConfig, index: int, attempt: int
) -> tuple[Laplacian, Floats, Floats, dict[str, int]] | str:
    """Make a sample, or tell the reason why it is rejected."""
    from spectra_kit.operators._cover import plain_cover  # numba is slow to import

    source = draw_source(config, index, attempt)
    rng = np.random.default_rng((config.seed, index, attempt, 1))
    nonuniform = not source["mesh"] and rng.random() < config.nonuniform
    sigma = rng.uniform(0.15, 0.5) if nonuniform else 0.0
    try:
        surface = make_surface(config, source, index, attempt)
        geometry: Geometry = surface
        if not source["mesh"]:
            geometry = sample(
                surface,
                config.n_points,
                seed=int(rng.integers(2**32)),
                density=GaussianDensity(sigma=sigma) if nonuniform else "uniform",
            )
    except InvalidInputError:
        return "mesh"
    if geometry.n < config.fewest:  # what decimation left
        return "mesh"
    points = geometry.points - geometry.points.mean(axis=0)
    points = points / np.abs(points).max()
    try:
        cover = plain_cover(geometry.with_points(points))
        laplacian = Laplacian(cover.stiffness, cover.mass / cover.mass.sum(), points)
        if laplacian.n_components > 1:
            return "components"
        values, vectors = _modes(laplacian, config.k)
    except (InvalidInputError, ConvergenceError, NotConvergedError):
        return "solve"
    labels = {**source, "index": index, "nonuniform": int(nonuniform), "n": len(points)}
    return laplacian, np.maximum(values, 0.0), vectors, labels


def _modes(laplacian: Laplacian, k: int) -> tuple[Floats, Floats]:
    """Return the k lowest modes, ascending, by blocks around one shift, as loose as labels may be.

    A count in the widest of the last gaps tells if they are all; if not, LAPACK finds them. Not by
    `eigensolve`: certificate and count would be a third of the work.
    """
    if laplacian.n >= _AIMED_AT * k:
        spacing = laplacian.eigenvalue_spacing
        found = sliced_eigenpairs(
            laplacian.stiffness,
            laplacian.mass,
            k,
            below=-0.1 * spacing,
            spacing=spacing,
            tol=_TOL,
            most_shifts=_SHIFTS,
            seed=0,
        )
        values = found.eigenvalues
        if len(values) == k:
            last = max(k - _GAPS, 1)
            j = last + int(np.diff(values[last - 1 :]).argmax())
            factor = found.pencil.factor(values[j - 1 : j + 1].mean())
            if factor is not None and factor.inertia.negative == j:
                return values, found.eigenvectors
    exact = Dense().eigenpairs(laplacian, k)
    order = np.argsort(exact.eigenvalues)
    return exact.eigenvalues[order], exact.eigenvectors[:, order]
