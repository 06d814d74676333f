"""`Refined`: from any subspace to any accuracy."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from spectra_kit._core.checked import checked
from spectra_kit._core.clock import Clock
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_count, check_positive, quantity
from spectra_kit._sparse.shift_invert import shift_invert_iteration
from spectra_kit.eigen.base import (
    Eigenpairs,
    NotConvergedError,
    Promise,
    basis_with_kernel,
    block_size,
    plane_waves,
)
from spectra_kit.eigen.dense import Dense
from spectra_kit.eigen.subspaces.base import OnPoints, RandomBasis, Subspace
from spectra_kit.errors import InvalidInputError
from spectra_kit.operators.laplacian import Laplacian

_DENSE_RATIO = 5  # below this multiple of the block the trial space is most of the whole space
_SMALLEST_RTOL = 1e-14  # residuals below this are rounding, whatever the operator
_LARGEST_RTOL = 0.1  # beyond it a residual says nothing


@checked
@dataclass(frozen=True, kw_only=True)
class Refined(OnPoints):
    """Start from any subspace and iterate until every mode has the residual asked for.

    Parameters
    ----------
    start : Subspace, optional
        Where to begin: a `NeoSubspace`, `GivenBasis(previous.eigenvectors)`, `RandomBasis`; some
        2.7 k plane waves (`AmbientFourier`) without it. The better it is, the fewer sweeps.
    rtol : float, default 1e-8
        From 1e-14 to 0.1. Stop when ``||L u - lambda M u||`` in the M^-1 norm is at most
        ``rtol * max(lambda, spacing)`` for every mode.
    guard : float, default 0.5
        Ritz vectors beyond k, relative to k. More converge in fewer, dearer sweeps.
    degree : int, default 4
        Of the filter: solves of each column in a sweep.
    max_sweeps : int, default 30
        Sweeps before giving up.
    seed : int, default 0
        Of all random columns.

    Raises
    ------
    ConvergenceError
        (from `eigensolve`) if the tolerance was not reached, because of `max_sweeps` or because
        it is below rounding; ``partial`` holds all k modes as they are, and its certificate says
        how far each one came.

    Notes
    -----
    A residual says that a mode is one of the operator's, not that no other was missed. So random
    columns join every start, and modes are found of which it holds nothing; what they may still
    miss is found by a count of the eigenvalues, which `eigensolve` makes.

    See `_sparse.shift_invert.shift_invert_iteration` for the method. Without a sparse factor,
    `Cascade` goes on from a subspace. ``provenance.iterations`` holds the sweeps it took, the
    certificate the residual of each mode.

    Examples
    --------
    >>> from spectra_kit import Refined, eigensolve, robust_laplacian
    >>> from spectra_kit.geometry import sphere
    >>> laplacian = robust_laplacian(sphere(subdivisions=4).geometry)
    >>> spectrum = eigensolve(laplacian, 25, Refined(rtol=1e-6))
    >>> bool(spectrum.certificate.relative_residuals.max() <= 1e-6)
    True
    """

    promise: ClassVar[Promise] = "to tolerance"
    start: Subspace | None = None
    rtol: float = 1e-8
    guard: float = 0.5
    degree: int = 4
    max_sweeps: int = 30
    seed: int = 0

    def __post_init__(self) -> None:
        if not _SMALLEST_RTOL <= check_positive("rtol", self.rtol) <= _LARGEST_RTOL:
            raise InvalidInputError(
                "rtol",
                f"be at least {_SMALLEST_RTOL:g}, the rounding of float64, and at most"
                f" {_LARGEST_RTOL:g}",
                f"{self.rtol:g}",
            )
        check_positive("guard", self.guard)
        check_count("degree", self.degree, low=1)
        check_count("max_sweeps", self.max_sweeps, low=1)
        check_count("seed", self.seed, low=0)

    def eigenpairs(self, laplacian: Laplacian, k: int) -> Eigenpairs:
        """See `Eigensolver.eigenpairs`."""
        if _DENSE_RATIO * block_size(k, self.guard) >= laplacian.n:
            return Dense().eigenpairs(laplacian, k)
        clock, spacing = Clock(), laplacian.eigenvalue_spacing
        start: Subspace = plane_waves(k) if self.start is None else self.start
        if self.start is None and not laplacian.points.any():  # of matrices that have none
            start = RandomBasis(m=block_size(k, self.guard), seed=self.seed)
        basis = basis_with_kernel(start, laplacian)
        clock.stage("subspace")
        elimination = laplacian._elimination
        clock.stage("factor")
        found = shift_invert_iteration(
            laplacian.stiffness,
            laplacian._weights,
            basis,
            k,
            tolerance=lambda values: self.rtol * np.maximum(values, spacing),
            spacing=spacing,
            block=block_size(k, self.guard),
            degree=self.degree,
            max_sweeps=self.max_sweeps,
            seed=self.seed,
            elimination=elimination,
        )
        seconds = dict(Counter(clock.seconds) + Counter(found.seconds))
        pairs = Eigenpairs(found.eigenvalues, found.eigenvectors, seconds, found.sweeps)
        return _within(self.rtol, laplacian, pairs, found.residuals, stalled=found.stalled)


def _within(
    rtol: float, laplacian: Laplacian, pairs: Eigenpairs, residuals: Floats, *, stalled: bool
) -> Eigenpairs:
    """Return `pairs` if all are within the tolerance; else raise with what they are."""
    relative = residuals / np.maximum(pairs.eigenvalues, laplacian.eigenvalue_spacing)
    good = relative <= rtol
    if good.all():
        return pairs
    assert pairs.iterations is not None
    found = (
        f"{int(good.sum())} of {quantity(len(good), 'mode')} reached rtol = {rtol:g} in"
        f" {pairs.iterations} sweeps (largest relative residual {relative.max():.1e})"
    )
    if stalled:
        found += "; rounding stops the others"
        raise NotConvergedError(found, pairs, good, advice="loosen {}", remedies=("rtol",))
    raise NotConvergedError(
        found,
        pairs,
        good,
        advice=("raise {}", "loosen {}", "use {}"),
        remedies=("max_sweeps", "rtol", "Arpack"),
    )
