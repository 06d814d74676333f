"""One sample of a corpus: a random surface, points on it, and the exact modes of these points.

Every sample follows from (seed, index) alone, so any number of processes makes the same corpus.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from spectra_kit._validate import check_count
from spectra_kit.eigensolvers import Arpack, eigensolve
from spectra_kit.errors import ConvergenceError, InvalidInputError, InvalidSpectrumError
from spectra_kit.geometry.sampling import GaussianDensity, sample
from spectra_kit.geometry.shapes import PointCloud, TriangleMesh
from spectra_kit.operators import delaunay_laplacian
from spectra_kit.training.families import FAMILIES, draw_family, make_mesh
from spectra_kit.training.pool import open_pool, varied

FROM_POOL = -1  # the label `family` of samples that are real meshes
REASONS = ("mesh", "components", "solve")  # of rejection
LABELS = ("family", "pool", "index", "nonuniform", *(f"rejected_{reason}" for reason in REASONS))
# Of eigenvalues. Spans then agree to 1e-7 with those to rounding; float16 holds 3 digits.
_TOLERANCE = 1e-4
_PATIENCE = 4  # rejections after which a sample tries another family or mesh of the pool


@dataclass(frozen=True, kw_only=True)
class CorpusConfig:
    """What a corpus is made of; two runs with equal configurations write equal samples.

    Parameters
    ----------
    seed : int
        Use different ones for training and validation.
    n_points : int
        Points per sample.
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

    Raises
    ------
    InvalidInputError
        If a count is too small, a fraction is not in [0, 1], there are not clearly more points
        than modes, or a share of a pool is asked for without the pool.
    """

    seed: int
    n_points: int = 2048
    k: int = 96
    shard_size: int = 128
    nonuniform: float = 0.1
    pool: str | os.PathLike[str] | None = None
    pool_split: str = "train"
    pool_share: float = 0.0

    def __post_init__(self) -> None:
        check_count("seed", self.seed, low=0)
        check_count("k", self.k, low=1)
        check_count("n_points", self.n_points, low=max(64, 2 * self.k))
        check_count("shard_size", self.shard_size, low=1)
        for name in ("nonuniform", "pool_share"):
            if not 0 <= getattr(self, name) <= 1:
                raise InvalidInputError(name, "be in [0, 1]", getattr(self, name))
        if self.pool_share and self.pool is None:
            raise InvalidInputError(
                "pool",
                f"name the real meshes of which a share of {self.pool_share} is wanted",
                None,
                advice="give the path, or take pool_share=0",
            )

    def fingerprint(self) -> dict[str, object]:
        """Everything that decides the content of the shards, as JSON; a pool by its content."""
        values = asdict(self)
        path, split = values.pop("pool"), values.pop("pool_split")
        values["pool"] = open_pool(path, split).digest if self.pool_share else None
        weights = {name: weight for name, (_, weight) in FAMILIES.items()}
        return {"format": 5, **values, "families": weights if self.pool_share < 1 else {}}


@dataclass(frozen=True, eq=False)
class Sample:
    """One cloud with its exact modes.

    Parameters
    ----------
    points : ndarray of shape (n, 3)
        Centred, in the unit box.
    mass : ndarray of shape (n,)
        Sums to one.
    eigenvectors : ndarray of shape (n, k)
        M-orthonormal for `mass`, by ascending eigenvalue.
    labels : dict of str to int
        What the sample is; see `make_sample`.
    """

    points: NDArray[np.floating]
    mass: NDArray[np.floating]
    eigenvectors: NDArray[np.floating]
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
        ``pool`` (number of the mesh in the pool, or -1), ``index``, ``nonuniform`` (0 or 1) and
        how often each reason of rejection came up before.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.training.samples import CorpusConfig, make_sample
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

    Examples
    --------
    >>> from spectra_kit.training.samples import CorpusConfig, make_sample, sample_mesh
    >>> config = CorpusConfig(seed=0, n_points=256, k=8)
    >>> mesh = sample_mesh(config, make_sample(config, 3).labels)
    >>> bool(mesh.area > 0)
    True
    """
    attempt = sum(labels[f"rejected_{reason}"] for reason in REASONS)
    return make_surface(config, labels, labels["index"], attempt)


def draw_source(config: CorpusConfig, index: int, attempt: int) -> dict[str, int]:
    """Draw what an attempt at a sample is to be: the labels ``family`` and ``pool``."""
    # What to draw hardly depends on the attempt: rejections would thin out the hard ones. Nor is
    # it the stream of the mesh, whose first numbers would then follow from its family.
    rng = np.random.default_rng((config.seed, index, attempt // _PATIENCE, 2))
    if config.pool is not None and config.pool_share and rng.random() < config.pool_share:
        n = len(open_pool(config.pool, config.pool_split))
        return {"family": FROM_POOL, "pool": int(rng.integers(n))}
    return {"family": draw_family(rng), "pool": -1}


def make_surface(
    config: CorpusConfig, source: Mapping[str, int], index: int, attempt: int
) -> TriangleMesh:
    """Make the surface of an attempt at a sample, in its own pose and unit.

    Raises `InvalidInputError` if the drawn parameters leave none: rare, the next have others.
    """
    seed = (config.seed, index, attempt)
    if config.pool is None or source["family"] != FROM_POOL:
        return make_mesh(list(FAMILIES)[source["family"]], seed)
    mesh = open_pool(config.pool, config.pool_split).mesh(source["pool"])
    return varied(mesh, np.random.default_rng(seed))


def _attempted(config: CorpusConfig, index: int, attempt: int) -> Sample | str:
    """Make a sample, or tell the reason why it is rejected."""
    source = draw_source(config, index, attempt)
    rng = np.random.default_rng((config.seed, index, attempt, 1))
    nonuniform = rng.random() < config.nonuniform
    sigma = rng.uniform(0.15, 0.5) if nonuniform else 0.0
    try:
        mesh = make_surface(config, source, index, attempt)
        cloud = sample(
            mesh,
            config.n_points,
            seed=int(rng.integers(2**32)),
            density=GaussianDensity(sigma=sigma) if nonuniform else "uniform",
        )
    except InvalidInputError:
        return "mesh"
    points = cloud.points - cloud.points.mean(axis=0)
    points = points / np.abs(points).max()
    try:
        laplacian = delaunay_laplacian(PointCloud(points))
        if laplacian.n_components > 1:
            return "components"
        spectrum = eigensolve(laplacian, config.k, Arpack(tol=_TOLERANCE))
    except (InvalidInputError, InvalidSpectrumError, ConvergenceError):
        return "solve"
    area = spectrum.mass.sum()
    labels = {**source, "index": index, "nonuniform": int(nonuniform)}
    return Sample(points, spectrum.mass / area, spectrum.eigenvectors * np.sqrt(area), labels)
