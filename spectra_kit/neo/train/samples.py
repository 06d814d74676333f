"""One sample of a corpus: points of a random surface, their operator, and its exact modes.

Points are drawn on the surface, as a cloud, or the vertices of a mesh. Every sample follows from
(seed, index) alone, so any number of processes makes the same corpus.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from spectra_kit._core.validate import check_count, hearing
from spectra_kit.eigen.base import NotConvergedError
from spectra_kit.eigen.lanczos import cheapest
from spectra_kit.errors import ConvergenceError, InvalidInputError
from spectra_kit.geometry.sampling import GaussianDensity, sample
from spectra_kit.geometry.shapes import Geometry, TriangleMesh
from spectra_kit.neo.train.families import FAMILIES, check_weights, draw_family, make_mesh
from spectra_kit.neo.train.meshes import at_resolution
from spectra_kit.neo.train.pool import open_pool, varied
from spectra_kit.operators import delaunay_laplacian

FROM_POOL = -1  # the label `family` of samples that are real meshes
REASONS = ("mesh", "components", "solve")  # of rejection
_REJECTED = tuple(f"rejected_{reason}" for reason in REASONS)
LABELS = ("family", "pool", "mesh", "index", "nonuniform", "n", *_REJECTED)
# Of eigenvalues. Spans then agree to 1e-7 with those to rounding; float16 holds 3 digits.
_TOL = 1e-4
_PATIENCE = 4  # rejections after which a sample tries another family or mesh of the pool
# Vertices of a mesh for each mode: those aimed at, and those that must be left of them. On fewer,
# the modes are nearly all functions that there are, and those of a network all.
_AIMED_AT, _LEFT = 5, 3


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

    Raises
    ------
    InvalidInputError
        If a count is too small, a fraction is not in [0, 1], there are not clearly more points
        than modes, a share of a pool is asked for without the pool, or a weight is negative or of
        no family.

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
        check_weights(self.weights)
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
        changed = values.pop("weights")
        weights = {name: weight for name, (_, weight) in FAMILIES.items()} | changed
        return {"format": 7, **values, "families": weights if self.pool_share < 1 else {}}


@dataclass(frozen=True, eq=False)
class Sample:
    """One cloud or mesh with its operator and exact modes.

    Parameters
    ----------
    points : ndarray of shape (n, 3)
        Centred, in the unit box.
    mass : ndarray of shape (n,)
        Sums to one.
    eigenvectors : ndarray of shape (n, k)
        M-orthonormal for `mass`, by ascending eigenvalue.
    eigenvalues : ndarray of shape (k,)
        Of a surface of area one.
    stiffness : sparse array of shape (n, n)
        L, of which ``L U = M U diag(eigenvalues)``.
    labels : dict of str to int
        What the sample is; see `make_sample`.
    """

    points: NDArray[np.floating]
    mass: NDArray[np.floating]
    eigenvectors: NDArray[np.floating]
    eigenvalues: NDArray[np.floating]
    stiffness: sparse.csr_array
    labels: dict[str, int]


def make_sample(config: CorpusConfig, index: int) -> Sample:
    """Make sample number `index` of a corpus.

    Parameters
    ----------
    config : CorpusConfig
        Of the whole corpus.
    index : int
        From 0; any order.

    Returns
    -------
    Sample
        Points centred in the unit box. Labels: ``family`` (place in `FAMILIES`, or `FROM_POOL`),
        ``pool`` (number of the mesh in the pool, or -1), ``mesh`` (0 for a cloud, 1 for a mesh),
        ``index``, ``nonuniform`` (0 or 1), ``n`` points, and how often each reason of rejection
        came up before.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.neo.train.samples import CorpusConfig, make_sample
    >>> cloud = make_sample(CorpusConfig(seed=0, n_points=256, k=8), 3)
    >>> gram = cloud.eigenvectors.T @ (cloud.mass[:, None] * cloud.eigenvectors)
    >>> bool(np.allclose(gram, np.eye(8), atol=1e-9))
    True
    """
    rejected = {f"rejected_{reason}": 0 for reason in REASONS}
    while True:
        made = _attempted(config, index, sum(rejected.values()))
        if isinstance(made, Sample):
            return replace(made, labels=made.labels | rejected)
        rejected[f"rejected_{made}"] += 1


def sample_mesh(config: CorpusConfig, labels: Mapping[str, int]) -> TriangleMesh:
    """Make the surface again that a sample with these labels lies on, in its own pose and unit.

    Of a mesh it is the mesh itself.

    Examples
    --------
    >>> from spectra_kit.neo.train.samples import CorpusConfig, make_sample, sample_mesh
    >>> config = CorpusConfig(seed=0, n_points=256, k=8)
    >>> mesh = sample_mesh(config, make_sample(config, 3).labels)
    >>> bool(mesh.area > 0)
    True
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


def _attempted(config: CorpusConfig, index: int, attempt: int) -> Sample | str:
    """Make a sample, or tell the reason why it is rejected."""
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
        with hearing():  # of parts, which are rejected
            laplacian = delaunay_laplacian(geometry.with_points(points))
        if laplacian.n_components > 1:
            return "components"
        # Not by `eigensolve`: certificate and count of modes would be a third of the work.
        pairs = cheapest(laplacian.n, config.k, tol=_TOL).eigenpairs(laplacian, config.k)
    except (InvalidInputError, ConvergenceError, NotConvergedError):
        return "solve"
    area, order = laplacian.area, np.argsort(pairs.eigenvalues)
    return Sample(
        points,
        laplacian.mass / area,
        pairs.eigenvectors[:, order] * np.sqrt(area),
        np.maximum(pairs.eigenvalues[order], 0.0) * area,
        laplacian.stiffness,
        {**source, "index": index, "nonuniform": int(nonuniform), "n": len(points)},
    )
