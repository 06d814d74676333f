"""The corpus: random surfaces, points on them, and the exact modes of these points.

Every sample follows from (seed, index) alone, so any number of processes writes the same corpus,
and an interrupted run continues where it stopped.
"""

from __future__ import annotations

import itertools
import json
import multiprocessing
import os
import signal
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from spectra_kit._files import atomic_path
from spectra_kit._validate import check_count
from spectra_kit.eigensolvers import Arpack, eigensolve
from spectra_kit.errors import ConvergenceError, InvalidInputError, InvalidSpectrumError
from spectra_kit.geometry.sampling import GaussianDensity, sample
from spectra_kit.geometry.shapes import PointCloud, TriangleMesh
from spectra_kit.operators import robust_laplacian
from spectra_kit.training.families import FAMILIES, draw_family, make_mesh
from spectra_kit.training.pool import open_pool, varied
from spectra_kit.training.shards import open_shards, write_shard

Floats = NDArray[np.float64]
FROM_POOL = -1  # the label `family` of samples that are real meshes
# Of eigenvalues. Spans then agree to 1e-8 with those to rounding; float16 holds 3 digits.
_TOLERANCE = 1e-4
_PATIENCE = 4  # rejections after which a sample tries another family or mesh of the pool
_THREAD_LIMITS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


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
        for name, share in (("nonuniform", self.nonuniform), ("pool_share", self.pool_share)):
            if not 0 <= share <= 1:
                raise InvalidInputError(f"`{name}` must be in [0, 1], got {share!r}")
        if self.pool_share and self.pool is None:
            raise InvalidInputError(
                f"`pool` must name the real meshes of which a share of {self.pool_share} is wanted,"
                " got None; give the path, or take pool_share=0"
            )

    def fingerprint(self) -> dict[str, object]:
        """Everything that decides the content of the shards, as JSON; a pool by its content."""
        values = asdict(self)
        path, split = values.pop("pool"), values.pop("pool_split")
        values["pool"] = open_pool(path, split).digest if self.pool_share else None
        weights = {name: weight for name, (_, weight) in FAMILIES.items()}
        return {"format": 2, **values, "families": weights if self.pool_share < 1 else {}}


@dataclass(frozen=True)
class CorpusReport:
    """What lies in a corpus, and what was turned down on the way.

    Parameters
    ----------
    samples : int
        Number of samples.
    families : dict of str to int
        Samples of each family, and of the ``pool``.
    rejected : dict of str to int
        Draws that were thrown away and drawn again: an empty ``mesh``, a cloud whose Laplacian
        falls apart into several ``components``, an eigensolve that failed (``solve``).
    """

    samples: int
    families: dict[str, int]
    rejected: dict[str, int]


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

    points: Floats
    mass: Floats
    eigenvectors: Floats
    labels: dict[str, int]


_REASONS = ("mesh", "components", "solve")


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
    >>> cloud = make_sample(CorpusConfig(seed=0, n_points=256, k=8), 3)
    >>> gram = cloud.eigenvectors.T @ (cloud.mass[:, None] * cloud.eigenvectors)
    >>> bool(np.allclose(gram, np.eye(8), atol=1e-9))
    True
    """
    rejected = dict.fromkeys(_REASONS, 0)
    for attempt in itertools.count():
        # What to draw does not depend on the attempt: rejections would thin out the hard ones.
        source = _draw_source(config, (config.seed, index, attempt // _PATIENCE))
        drawn = _draw_cloud(config, source, (config.seed, index, attempt))
        if drawn is None:
            rejected["mesh"] += 1
            continue
        points, nonuniform = drawn
        try:
            solved = _modes(points, config.k)
        except (InvalidInputError, InvalidSpectrumError, ConvergenceError):
            rejected["solve"] += 1
            continue
        if solved is None:
            rejected["components"] += 1
            continue
        mass, eigenvectors = solved
        labels = {**source, "index": index, "nonuniform": int(nonuniform)}
        labels |= {f"rejected_{reason}": count for reason, count in rejected.items()}
        area = mass.sum()
        return Sample(points, mass / area, eigenvectors * np.sqrt(area), labels)
    raise AssertionError("itertools.count ended")


def _draw_source(config: CorpusConfig, seed: tuple[int, ...]) -> dict[str, int]:
    """Draw the labels ``family`` and ``pool``."""
    rng = np.random.default_rng(seed)
    if config.pool is not None and rng.random() < config.pool_share:
        n = len(open_pool(config.pool, config.pool_split))
        return {"family": FROM_POOL, "pool": int(rng.integers(n))}
    return {"family": draw_family(rng), "pool": -1}


def _make_mesh(config: CorpusConfig, source: dict[str, int], seed: tuple[int, ...]) -> TriangleMesh:
    if config.pool is None or source["family"] != FROM_POOL:
        return make_mesh(list(FAMILIES)[source["family"]], seed)
    mesh = open_pool(config.pool, config.pool_split).mesh(source["pool"])
    return varied(mesh, np.random.default_rng(seed))


def _draw_cloud(
    config: CorpusConfig, source: dict[str, int], seed: tuple[int, ...]
) -> tuple[Floats, bool] | None:
    """Points (n, 3) in the unit box, and whether they crowd; None if the surface is empty."""
    rng = np.random.default_rng((*seed, 1))
    nonuniform = rng.random() < config.nonuniform
    sigma = rng.uniform(0.15, 0.5) if nonuniform else 0.0
    try:
        mesh = _make_mesh(config, source, seed)
        cloud = sample(
            mesh,
            config.n_points,
            seed=int(rng.integers(2**32)),
            density=GaussianDensity(sigma=sigma) if nonuniform else "uniform",
        )
    except InvalidInputError:
        return None
    points = cloud.points - cloud.points.mean(axis=0)
    return points / np.abs(points).max(), nonuniform


def _modes(points: Floats, k: int) -> tuple[Floats, Floats] | None:
    """Mass and exact eigenvectors of a cloud; None if its Laplacian has several components."""
    laplacian = robust_laplacian(PointCloud(points))
    if laplacian.n_components > 1:
        return None
    spectrum = eigensolve(laplacian, k, Arpack(tol=_TOLERANCE))
    return spectrum.mass, spectrum.eigenvectors


def generate(
    folder: str | os.PathLike[str],
    n: int,
    *,
    config: CorpusConfig,
    workers: int = 1,
    progress: bool = True,
) -> CorpusReport:
    """Generate a corpus of `n` samples, or what is missing of it.

    Parameters
    ----------
    folder : path
        Made if missing. Shards that it already holds are kept.
    n : int
        Samples in all, existing ones included.
    config : CorpusConfig
        Must equal the one that the folder was begun with.
    workers : int, default 1
        Processes, each of one thread; 1 works in this process. The result does not depend on it.
    progress : bool, default True
        Show a progress bar on a terminal.

    Returns
    -------
    CorpusReport
        Counts over the whole folder.

    Raises
    ------
    InvalidInputError
        If the folder was begun with another configuration, or a shard in it has another length
        than `n` asks for.

    Notes
    -----
    Shards appear one by one and whole: training may start on the first, and Ctrl-C loses at most
    the one in work. With ``workers > 1`` a script must guard its top level with
    ``if __name__ == "__main__"``, because the processes are spawned.

    Examples
    --------
    >>> import tempfile
    >>> config = CorpusConfig(seed=1, n_points=128, k=4, shard_size=2)
    >>> generate(tempfile.mkdtemp(), 3, config=config, progress=False).samples
    3
    """
    check_count("n", n, low=1)
    check_count("workers", workers, low=1)
    root = Path(folder)
    root.mkdir(parents=True, exist_ok=True)
    _claim(root, config)
    shards = range(-(-n // config.shard_size))
    sizes = {i: min(config.shard_size, n - i * config.shard_size) for i in shards}
    missing = [i for i in shards if not _is_there(root, i, sizes[i])]
    indices = [i * config.shard_size + j for i in missing for j in range(sizes[i])]
    with _mapped(partial(make_sample, config), indices, workers) as samples:
        bar = iter(
            tqdm(samples, total=len(indices), unit="sample", disable=None if progress else True)
        )
        for i in missing:
            _write(root, i, list(itertools.islice(bar, sizes[i])))
    return report(root)


def report(folder: str | os.PathLike[str]) -> CorpusReport:
    """Count the samples of a corpus and the draws that were rejected for them.

    Parameters
    ----------
    folder : path
        Where `generate` wrote.

    Returns
    -------
    CorpusReport
        Of the complete shards.
    """
    labels = open_shards(folder).labels
    names = (*FAMILIES, "pool")  # FROM_POOL = -1 counts from the end
    counts = np.bincount(labels["family"] % len(names), minlength=len(names))
    return CorpusReport(
        samples=len(labels["family"]),
        families={name: int(c) for name, c in zip(names, counts, strict=True)},
        rejected={reason: int(labels[f"rejected_{reason}"].sum()) for reason in _REASONS},
    )


def _claim(root: Path, config: CorpusConfig) -> None:
    """Write the fingerprint of a new corpus, or compare it with that of an old one."""
    path = root / "corpus.json"
    ours = config.fingerprint()
    if not path.exists():
        with atomic_path(path) as temporary:
            temporary.write_text(json.dumps(ours, indent=1))
        return
    theirs = json.loads(path.read_text())
    differing = sorted(key for key in ours if ours[key] != theirs.get(key))
    if differing:
        raise InvalidInputError(
            f"`folder` {root} was begun with another configuration: {differing} differ;"
            " take that one, or another folder"
        )


def _is_there(root: Path, index: int, size: int) -> bool:
    path = root / f"shard_{index:04d}" / "mass.npy"
    if not path.exists():
        return False
    there = len(np.load(path, mmap_mode="r"))
    if there != size:
        raise InvalidInputError(
            f"shard {index} of {root} holds {there} samples where `n` asks for {size};"
            " delete it, or ask for a multiple of the shard size"
        )
    return True


def _write(root: Path, index: int, samples: list[Sample]) -> None:
    write_shard(
        root,
        index,
        np.stack([sample.points for sample in samples]),
        np.stack([sample.mass for sample in samples]),
        np.stack([sample.eigenvectors for sample in samples]),
        {name: [sample.labels[name] for sample in samples] for name in samples[0].labels},
    )


@contextmanager
def _mapped(make: partial[Sample], indices: list[int], workers: int) -> Iterator[Iterable[Sample]]:
    """Yield the samples in order, made here or by `workers` processes."""
    if workers == 1 or len(indices) < 2:
        yield map(make, indices)
        return
    before = {name: os.environ.get(name) for name in _THREAD_LIMITS}
    # Spawned processes read these when they load their own BLAS: one thread each.
    os.environ.update(dict.fromkeys(_THREAD_LIMITS, "1"))
    try:
        pool = multiprocessing.get_context("spawn").Pool(workers, initializer=_ignore_interrupt)
    finally:
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value
    with pool:  # leaving the block ends the processes, also on Ctrl-C
        yield pool.imap(make, indices, chunksize=2)


def _ignore_interrupt() -> None:
    """Leave Ctrl-C to the parent, which ends its workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
