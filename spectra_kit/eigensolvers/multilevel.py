"""`Multilevel`: coarse to fine on nested subsets of the points; classical and exact."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from spectra_kit._checked import checked
from spectra_kit._clock import Clock
from spectra_kit._types import Floats
from spectra_kit._validate import check_count, check_positive
from spectra_kit.eigensolvers.base import Eigenpairs, Promise
from spectra_kit.eigensolvers.refined import Refined
from spectra_kit.eigensolvers.starts import block_size
from spectra_kit.levels import Coarse, CoarsePairs, coarse_iteration, coarse_ritz, coarsen
from spectra_kit.linalg.products import spmm
from spectra_kit.operators.laplacian import Laplacian
from spectra_kit.subspaces import GivenBasis, RandomBasis

_ROOM = 4  # points of a level, relative to the block: with fewer it has no low modes of its own
_SETTLED = 0.01  # change of the coarsest Ritz values in the last sweep; the next gains nothing


@checked
@dataclass(frozen=True, kw_only=True)
class Multilevel:
    """Solve on a small subset of the points, carry the modes to more points, and refine them.

    No learning, no prediction: it is what a learned start has to beat.

    Parameters
    ----------
    rtol : float, default 1e-6
        Stop when ``||L u - lambda M u||`` in the M^-1 norm is at most
        ``rtol * max(lambda, spacing)`` for every mode.
    coarsest : int, default 2048
        Points of the coarsest level, about; fewer where the mesh itself is small.
    ratio : int, default 12
        Points of a level relative to the one below it, at least.
    guard : float, default 0.5
        Ritz vectors beyond k, relative to k.
    degree : int, default 6
        Of the filter at the finest level: solves of each column in a sweep.
    max_sweeps : int, default 30
        At the finest level, before giving up.
    seed : int, default 0
        Of the random start at the coarsest level.

    Raises
    ------
    InvalidInputError
        If a parameter is out of range.
    ConvergenceError
        (from `eigensolve`) if the tolerance was not reached; ``partial`` holds all k modes as they
        are, and ``n_converged`` says how many reached it.

    Notes
    -----
    Nested subsets, Galerkin operators and moving-least-squares prolongations are those of
    `levels`; every level is solved by Chebyshev-filtered block shift-invert iterations on one
    sparse factor, the coarsest from random columns until it settles, those above it with one
    sweep, the finest like `Refined`. In the spirit of Nasikun and Hildebrandt, *The Hierarchical
    Subspace Iteration Method for Laplace-Beltrami Eigenproblems*, 2022.

    Examples
    --------
    >>> from spectra_kit import Multilevel, eigensolve, robust_laplacian
    >>> from spectra_kit.geometry import sphere
    >>> laplacian = robust_laplacian(sphere(subdivisions=4).geometry)
    >>> spectrum = eigensolve(laplacian, 25, Multilevel())
    >>> bool(spectrum.certificate.relative_residuals.max() <= 1e-6)
    True
    """

    promise: ClassVar[Promise] = "to tolerance"
    rtol: float = 1e-6
    coarsest: int = 2048
    ratio: int = 12
    guard: float = 0.5
    degree: int = 6
    max_sweeps: int = 30
    seed: int = 0

    def __post_init__(self) -> None:
        check_positive("rtol", self.rtol)
        check_count("coarsest", self.coarsest, low=100)
        check_count("ratio", self.ratio, low=2)
        _ = self._finest  # checks the other options

    @property
    def _finest(self) -> Refined:
        """What solves the finest level, from a random start where there is no other."""
        return Refined(
            start=RandomBasis(m=1, seed=self.seed),
            rtol=self.rtol,
            guard=self.guard,
            degree=self.degree,
            max_sweeps=self.max_sweeps,
            seed=self.seed,
        )

    def eigenpairs(self, laplacian: Laplacian, k: int) -> Eigenpairs:
        """See `Eigensolver.eigenpairs`."""
        block = block_size(k, self.guard)
        sizes = level_sizes(laplacian.n, block, coarsest=self.coarsest, ratio=self.ratio)
        if not sizes:
            return replace(self._finest, start=RandomBasis(m=block, seed=self.seed)).eigenpairs(
                laplacian, k
            )
        clock = Clock()
        levels: list[Coarse] = []
        for size in sizes:
            levels.append(coarsen(levels[-1] if levels else laplacian, size))
        clock.stage("coarsen")
        start = coarse_start(levels, k, block, seed=self.seed)
        if laplacian.kernel_dimension:
            start[:, 0] = 1.0  # what it is up to rounding
        clock.stage("coarse")
        pairs = replace(self._finest, start=GivenBasis(start)).eigenpairs(laplacian, k)
        return pairs._replace(seconds=clock.seconds | dict(pairs.seconds or {}))


def level_sizes(n: int, block: int, *, coarsest: int, ratio: int) -> list[int]:
    """Return how many points the levels below the finest have, from finer to coarser.

    The coarsest has 4 for each vector of the block at least and n / 4 at most; where that cannot
    be there is none. A finer one is added as long as it has at most n / ratio.

    Examples
    --------
    >>> from spectra_kit.eigensolvers.multilevel import level_sizes
    >>> level_sizes(600_000, 144, coarsest=2048, ratio=12)
    [24576, 2048]
    """
    size = min(max(coarsest, _ROOM * block), n // 4)
    if size < _ROOM * block:
        return []
    sizes = [size]
    while sizes[0] * ratio**2 <= n:
        sizes.insert(0, sizes[0] * ratio)
    return sizes


def coarse_start(levels: list[Coarse], k: int, block: int, *, seed: int) -> Floats:
    """Return k low modes and their guard on all points, (n, block)."""
    bottom = levels[-1]
    noise = np.random.default_rng(seed).standard_normal((bottom.n, block))
    pairs = coarse_ritz(bottom, noise, 1, guard=block - 1)  # what the level has room for
    pairs = coarse_iteration(bottom, pairs, k, rtol=_SETTLED, least=1)
    start = np.asarray(spmm(bottom.prolongation, pairs.eigenvectors))
    for level in levels[-2::-1]:
        # Ritz values and orthonormality carry over: the levels are nested.
        pairs = coarse_iteration(
            level, CoarsePairs(pairs.eigenvalues, start), k, max_sweeps=1, least=1
        )
        start = np.asarray(spmm(level.prolongation, pairs.eigenvectors))
    return start
