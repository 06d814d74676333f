"""Batches: samples of a corpus in the pose, size and number of points that a step asks for."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from spectra_kit.subspaces.frame import POSES, canonical_frame
from spectra_kit.training.config import TrainConfig
from spectra_kit.training.shards import Corpus

Tensors = tuple[Tensor, Tensor, Tensor]


def training_batch(corpus: Corpus, config: TrainConfig, step: int) -> Tensors:
    """Return points (B, N, 3), mass (B, N) and modes (B, N, k) of a step, float32.

    Every sample comes once per epoch, in an order drawn from (seed, epoch); the points and the
    pose are drawn from (seed, step).
    """
    n = len(corpus)
    places = np.arange(step * config.batch, (step + 1) * config.batch)
    orders = {
        int(epoch): np.random.default_rng((config.seed, 0, int(epoch))).permutation(n)
        for epoch in np.unique(places // n)
    }
    chosen = [orders[int(place // n)][place % n] for place in places]
    batch = corpus.batch(chosen)
    rng = np.random.default_rng((config.seed, 1, step))
    points, mass, modes = [], [], []
    for x, w, U in zip(batch.points, batch.mass, batch.eigenvectors, strict=True):
        if config.network.frame == "principal":
            posed = _pose_principal(x, w, rng, config)
        else:
            posed = _pose_random(x, w, rng)
        keep = np.sort(rng.choice(len(x), config.points, replace=False))
        points.append(posed[keep])
        mass.append(w[keep])
        modes.append(U[keep])
    return _tensors(points, mass, modes)


def validation_batch(corpus: Corpus, config: TrainConfig, indices: range) -> Tensors:
    """Return points, mass and modes of whole samples, posed as the network expects them.

    Without a canonical frame each batch has its own random rotations, the same every time.
    """
    batch = corpus.batch(indices)
    rng = np.random.default_rng((config.seed, 2, indices.start))
    points = [
        canonical_frame(x, w).pose(x)
        if config.network.frame == "principal"
        else _pose_random(x, w, rng)
        for x, w in zip(batch.points, batch.mass, strict=True)
    ]
    return _tensors(points, batch.mass, batch.eigenvectors)


def random_rotation(rng: np.random.Generator) -> NDArray[np.float64]:
    """Return a rotation (3, 3), uniform on SO(3) (a normal quaternion, Shoemake 1992)."""
    w, x, y, z = (q := rng.standard_normal(4)) / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _pose_principal(
    points: NDArray[np.float32],
    mass: NDArray[np.float32],
    rng: np.random.Generator,
    config: TrainConfig,
) -> NDArray[np.float64]:
    posed = canonical_frame(points, mass).pose(points)
    if rng.random() < config.flips:
        posed = posed * POSES[rng.integers(4)]
    a, b, c = config.jitter * rng.standard_normal(3)
    # The orthogonal polar factor of a rotation's first-order expansion: small, never a shear.
    left, _, right = np.linalg.svd(np.array([[1, -c, b], [c, 1, -a], [-b, a, 1]]))
    posed = posed @ (left @ right)
    shrink = 1 - config.jitter * rng.random()
    return np.asarray(shrink * posed / np.abs(posed).max())


def _pose_random(
    points: NDArray[np.float32], mass: NDArray[np.float32], rng: np.random.Generator
) -> NDArray[np.float64]:
    weights = mass.astype(np.float64) / mass.sum()
    centred = points - weights @ points
    posed = centred @ random_rotation(rng).T
    return np.asarray(posed / np.abs(posed).max())


def _tensors(points: ArrayLike, mass: ArrayLike, modes: ArrayLike) -> Tensors:
    x, w, U = (torch.from_numpy(np.asarray(array)).float() for array in (points, mass, modes))
    return x, w, U
