"""`Automatic`: who says how accurate the eigenvalues must be, need not choose a solver."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from spectra_kit._checked import checked
from spectra_kit._types import Floats
from spectra_kit._validate import check_count, check_positive, quantity
from spectra_kit.eigensolvers.arpack import Arpack
from spectra_kit.eigensolvers.base import Eigenpairs, Eigensolver, NotConvergedError, Promise
from spectra_kit.eigensolvers.cascade import Cascade
from spectra_kit.eigensolvers.chebyshev import Chebyshev
from spectra_kit.eigensolvers.refined import Refined
from spectra_kit.errors import InvalidInputError
from spectra_kit.linalg.memory import factor_gigabytes
from spectra_kit.operators.laplacian import Laplacian
from spectra_kit.subspaces import GivenBasis

_FEW = 15_000  # points up to which nothing costs less than Lanczos on a factor
_FEW_FOR_EACH = 160  # the same for each mode: coarse levels have to have room for them
_TIGHT = 1e-4  # an accuracy below which smoothing costs more than to be exact
# Smoothing steps that cost what going on with a factor does. Who changes over then has spent at
# most twice what the better of both takes (rent or buy).
_STEPS = 4
_MARGIN = 2.5  # times too low have estimates of the mean error been, at worst
_RTOL = 1e-8  # residuals whose errors are rounding
_GUARD = 0.5  # columns beyond k, relative to k, of what solves to a tolerance


@checked
@dataclass(frozen=True, kw_only=True)
class Automatic:
    """Say how accurate the eigenvalues must be: what costs least for that is chosen.

    The choice follows from measured costs: `Arpack` for few points and where the accuracy is high,
    `Cascade` elsewhere, `Chebyshev` in place of the first where no factor fits. Where the cascade
    estimates that it has missed the accuracy, `Refined` goes on from its modes with a factor, or
    without one `Chebyshev`. ``provenance.solver`` and ``provenance.reason`` tell what was chosen,
    and why.

    Parameters
    ----------
    accuracy : float, optional
        Relative error that the eigenvalues may have, in the mean over the wanted modes; below 1.
        Exact to rounding without it, where a factor fits.
    memory : float, default 4.0
        GiB that a sparse factor may take.
    device : str or torch.device, default "cpu"
        "cpu" or "cuda", for what runs there; never chosen for you.
    seed : int, default 0
        Of all random columns.

    Raises
    ------
    InvalidInputError
        If a parameter is out of range.

    Notes
    -----
    Components are chosen for one by one. If any is approximate, so is the spectrum:
    `Certificate.errors` estimates how far its eigenvalues are off. Otherwise they are counted, and
    none was missed; but where no factor fits, modes have residuals of 1e-8, and are not counted.

    An eigenvalue's error is of second order in its residual: with b columns on n points those at
    more than ``b / k`` times its value take no part, so that by Weyl's law residuals of
    ``rtol`` leave about ``rtol**2 k / (b - k)``.

    Examples
    --------
    >>> from spectra_kit import Automatic, eigensolve, robust_laplacian
    >>> from spectra_kit.geometry import sphere
    >>> laplacian = robust_laplacian(sphere(subdivisions=3).geometry)
    >>> eigensolve(laplacian, 9, Automatic(accuracy=1e-3)).provenance.choice
    'arpack: 642 points are few for 9 modes'
    """

    accuracy: float | None = None
    memory: float = 4.0
    device: str = "cpu"
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "device", str(self.device))
        if self.accuracy is not None and check_positive("accuracy", self.accuracy) >= 1:
            raise InvalidInputError(
                "accuracy",
                "be less than 1, a relative error",
                self.accuracy,
                advice="1e-3 is a thousandth; leave it out for exact eigenvalues",
            )
        check_positive("memory", self.memory)
        check_count("seed", self.seed, low=0)
        if self.device != "cpu":
            from spectra_kit.linalg.torch_device import check_device

            check_device(self.device)

    @property
    def promise(self) -> Promise:
        """See `Eigensolver`; what was chosen may promise more."""
        return "exact" if self.accuracy is None else "approximate"

    @property
    def _rtol(self) -> float:
        """Residuals that leave eigenvalues as accurate as that."""
        return min(max(math.sqrt(_GUARD * (self.accuracy or 0.0)), _RTOL), 0.1)

    def choose(self, n: int, k: int) -> tuple[Eigensolver, str]:
        """Return what solves for k modes on n points, and why it is this one."""
        needed, fits = factor_gigabytes(n), factor_gigabytes(n) <= self.memory
        if fits and n <= max(_FEW, _FEW_FOR_EACH * k):
            return Arpack(seed=self.seed), f"{n} points are few for {quantity(k, 'mode')}"
        if self.accuracy is not None and self.accuracy >= _TIGHT:
            cascade = Cascade(
                target=self.accuracy, max_steps=_STEPS, device=self.device, seed=self.seed
            )
            return cascade, f"errors of {self.accuracy:g} on {n} points need no factor"
        if fits:
            why = "exact" if self.accuracy is None else f"for errors of {self.accuracy:g}"
            return Arpack(seed=self.seed), f"{why}, and the factor fits into memory"
        why = f"a factor would take {needed:.1f} GiB, more than {self.memory:g}"
        return Chebyshev(rtol=self._rtol, device=self.device, seed=self.seed), why

    def eigenpairs(self, laplacian: Laplacian, k: int) -> Eigenpairs:
        """See `Eigensolver.eigenpairs`."""
        solver, reason = self.choose(laplacian.n, k)
        found = Eigenpairs(*solver.eigenpairs(laplacian, k))
        found = found._replace(solver=solver, reason=reason)
        missed = isinstance(solver, Cascade) and not self._is_met(found.errors)
        return self._further(laplacian, k, found) if missed else found

    def _is_met(self, errors: Floats | None) -> bool:
        """Whether eigenvalues of such errors are as accurate as asked for."""
        return errors is not None and bool(errors.mean() <= (self.accuracy or 0.0) / _MARGIN)

    def _further(self, laplacian: Laplacian, k: int, pairs: Eigenpairs) -> Eigenpairs:
        """Go on where smoothing stalls; what it left is kept where that does not converge."""
        left = "unknown errors" if pairs.errors is None else f"errors of {pairs.errors.mean():.1e}"
        steps = quantity(pairs.iterations or 0, "step")
        reason = f"{steps} of smoothing left {left}, more than {self.accuracy:g}"
        on_host = self.device == "cpu" and factor_gigabytes(laplacian.n) <= self.memory
        solver: Refined | Chebyshev = Refined() if on_host else Chebyshev(device=self.device)
        start = GivenBasis(pairs.eigenvectors)
        solver = replace(solver, start=start, rtol=self._rtol, guard=_GUARD, seed=self.seed)

        def told(more: Eigenpairs) -> Eigenpairs:
            seconds = dict(Counter(pairs.seconds) + Counter(more.seconds))
            return more._replace(seconds=seconds, solver=solver, reason=reason)

        try:
            return told(solver.eigenpairs(laplacian, k))
        except NotConvergedError as error:
            error.pairs = told(error.pairs or pairs)
            raise
        except MemoryError as error:
            raise NotConvergedError(
                f"{reason}, and what goes on does not fit into memory ({error})",
                pairs,
                np.zeros(k, dtype=bool),
                advice="use {}",
                remedies=("Chebyshev",),
            ) from error
