"""What a corpus is like: its surfaces, their topology, and their spectra."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from spectra_kit._types import Floats
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import PointCloud, TriangleMesh
from spectra_kit.operators import delaunay_laplacian
from spectra_kit.training.corpus import CorpusReport, claim, count, read_fingerprint
from spectra_kit.training.samples import CorpusConfig, sample_mesh
from spectra_kit.training.shards import open_shards


@dataclass(frozen=True)
class Topology:
    """Parts, boundary and genus of a mesh.

    Parameters
    ----------
    parts : int
        Connected components.
    closed : bool
        Every edge has two faces.
    boundary : bool
        Some edge has one face only.
    genus : int or None
        Handles of all parts together, where the mesh is closed and has two sides.
    """

    parts: int
    closed: bool
    boundary: bool
    genus: int | None


def topology(mesh: TriangleMesh) -> Topology:
    """Find parts, boundary and genus; corners a millionth apart count as one.

    Examples
    --------
    >>> from spectra_kit.geometry import torus
    >>> from spectra_kit.training.survey import topology
    >>> topology(torus().geometry)
    Topology(parts=1, closed=True, boundary=False, genus=1)
    """
    size = float(np.ptp(mesh.points, axis=0).max()) or 1.0
    rounded = mesh.with_points(np.round(mesh.points / (1e-6 * size)) + 0.0)
    whole = rounded.with_merged_vertices()
    proper = (whole.faces != np.roll(whole.faces, 1, axis=1)).all(axis=1)
    whole = TriangleMesh(whole.points, whole.faces[proper]).without_unreferenced()
    edges, faces_of_edge = whole.unique_edges
    parts, closed = int(whole.component_labels.max()) + 1, bool((faces_of_edge == 2).all())
    twice = 2 * parts - (whole.n - len(edges) + len(whole.faces))  # Euler: 2 - 2 g for each part
    genus = twice // 2 if closed and twice >= 0 and twice % 2 == 0 else None
    return Topology(parts, closed, bool((faces_of_edge == 1).any()), genus)


@dataclass(frozen=True, eq=False)
class Survey:
    """Statistics of a corpus.

    Parameters
    ----------
    counts : CorpusReport
        Of all samples.
    nonuniform : float
        Fraction of all samples whose points crowd.
    topologies : tuple of Topology
        Of the surfaces of some samples.
    eigenvalues : ndarray of shape (s, k)
        Of the same samples, times their area, so without unit.
    """

    counts: CorpusReport
    nonuniform: float
    topologies: tuple[Topology, ...]
    eigenvalues: Floats

    def as_json(self) -> dict[str, Any]:
        """Return everything that can be told in numbers, fractions of the surveyed samples."""
        genus = [t.genus for t in self.topologies if t.genus is not None]
        weyl = self.eigenvalues[:, 1:] / (4 * np.pi * np.arange(1, self.eigenvalues.shape[1]))
        return {
            "samples": self.counts.samples,
            "families": self.counts.families,
            "rejected": self.counts.rejected,
            "nonuniform": self.nonuniform,
            "surveyed": len(self.topologies),
            "closed": float(np.mean([t.closed for t in self.topologies])),
            "boundary": float(np.mean([t.boundary for t in self.topologies])),
            "several_parts": float(np.mean([t.parts > 1 for t in self.topologies])),
            "genus": {str(g): genus.count(g) for g in sorted(set(genus))},
            "lambda_1_area": _spread(self.eigenvalues[:, 1]),
            "weyl_ratio": {f"mode {i + 1}": _spread(weyl[:, i]) for i in _some(weyl.shape[1])},
        }


def survey(
    folder: str | os.PathLike[str],
    *,
    pool: str | os.PathLike[str] | None = None,
    pool_split: str = "train",
    n: int = 200,
    seed: int = 0,
) -> Survey:
    """Look at a corpus: all of its labels, and surfaces and spectra of `n` random samples.

    Parameters
    ----------
    folder : path
        Where `generate` wrote.
    pool, pool_split : path and str
        As in the configuration of the corpus, if real meshes are in it.
    n : int, default 200
        Samples whose surfaces are made again and whose spectra are measured; a tenth of a second
        each.
    seed : int, default 0
        Of the choice.

    Returns
    -------
    Survey

    Raises
    ------
    InvalidInputError
        If the folder is no corpus, or one of another pool or of another format.

    Notes
    -----
    Eigenvalues are the Rayleigh quotients of the stored modes.

    Examples
    --------
    >>> import tempfile
    >>> from spectra_kit.training.corpus import generate
    >>> from spectra_kit.training.samples import CorpusConfig
    >>> from spectra_kit.training.survey import survey
    >>> folder = tempfile.mkdtemp()
    >>> counts = generate(folder, 2, config=CorpusConfig(seed=1, n_points=128, k=4))
    >>> survey(folder).eigenvalues.shape
    (2, 4)
    """
    config = read_config(folder, pool=pool, pool_split=pool_split)
    corpus = open_shards(folder)
    chosen = np.random.default_rng(seed).permutation(len(corpus))[:n]
    batch = corpus.batch(chosen)
    values = np.array(
        [
            _eigenvalues(points.astype(np.float64), modes.astype(np.float64))
            for points, modes in zip(batch.points, batch.eigenvectors, strict=True)
        ]
    )
    labels = [{name: int(label[i]) for name, label in corpus.labels.items()} for i in chosen]
    return Survey(
        counts=count(corpus.labels),
        nonuniform=float(corpus.labels["nonuniform"].mean()),
        topologies=tuple(topology(sample_mesh(config, label)) for label in labels),
        eigenvalues=values,
    )


def read_config(
    folder: str | os.PathLike[str],
    *,
    pool: str | os.PathLike[str] | None = None,
    pool_split: str = "train",
) -> CorpusConfig:
    """Read the configuration that a corpus was made with; a pool is known by its content only."""
    path = Path(folder) / "corpus.json"
    if not path.is_file():
        raise InvalidInputError(f"`folder` must hold a corpus with its corpus.json, got {folder}")
    stored = read_fingerprint(path)
    names = ("seed", "n_points", "k", "shard_size", "nonuniform", "pool_share")
    values = {name: stored[name] for name in names if name in stored}
    config = CorpusConfig(pool=pool, pool_split=pool_split, **values)
    claim(Path(folder), config)
    return config


def _eigenvalues(points: Floats, modes: Floats) -> Floats:
    """Eigenvalues (k,) times area of a cloud whose modes (n, k) are known."""
    laplacian = delaunay_laplacian(PointCloud(points))
    energy = np.sum(modes * (laplacian.stiffness @ modes), axis=0)
    norm = np.sum(modes * (laplacian.mass[:, None] * modes), axis=0)
    return np.asarray(energy / norm * laplacian.area)


def _spread(values: Floats) -> dict[str, float]:
    low, middle, high = np.quantile(values, [0.05, 0.5, 0.95])
    ends = {"min": values.min(), "5%": low, "median": middle, "95%": high, "max": values.max()}
    return {name: float(value) for name, value in ends.items()}


def _some(k: int) -> list[int]:
    """A few places of k, ever further apart."""
    return [i for i in (0, 1, 3, 9, 19, 39, 59, 79) if i < k] + [k - 1]
