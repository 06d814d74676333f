"""`Automatic`: who says how accurate the eigenvalues must be, need not choose a solver."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_count, check_positive, quantity
from spectra_kit.eigen.accuracy import is_hard
from spectra_kit.eigen.base import (
    Eigenpairs,
    Eigensolver,
    NotConvergedError,
    Promise,
    set_device,
)
from spectra_kit.eigen.cascade import Cascade
from spectra_kit.eigen.dense import Dense
from spectra_kit.eigen.lanczos import Arpack, Lanczos, cheapest, or_densely
from spectra_kit.eigen.refined import Refined
from spectra_kit.eigen.subspaces.base import GivenBasis
from spectra_kit.errors import InvalidInputError
from spectra_kit.operators.laplacian import Laplacian

_FEW = 15_000  # points up to which nothing costs less than Lanczos on a factor
_FEW_FOR_EACH = 160  # the same for each mode: coarse levels have to have room for them
# Times as many points, if it need not be exact: on six shapes of 80,000 to 430,000 points, for 96
# modes and two threads, smoothing took 1.1 times as long for errors of 1e-2 and 1.2 times for 1e-3
# (0.76 to 2.0), which are larger; it takes half the memory.
_LOOSELY = 16
_RESIDUAL = 1e-2  # of shift-inverted operators: errors of eigenvalues are about its square
_TIGHT = 1e-4  # an accuracy below which smoothing costs more than to be exact
# Smoothing steps that cost what going on with a factor does. Who changes over then has spent at
# most twice what the better of both takes (rent or buy).
_STEPS = 4
_MANY = 100  # the same where nothing else goes on
_ROUNDING = 1e-12  # relative errors that pass for none
# Times too low that estimates of the mean error may be. Of surfaces 2.5 was the worst measured; of
# plates a thousand times thinner than long 8, beside potentials that jump from point to point 17.
_MARGIN = 2.5
_RTOL = 1e-8  # residuals whose errors are rounding


@checked
@dataclass(frozen=True, kw_only=True)
class Automatic:
    """Say how accurate the eigenvalues must be: what costs least for that is chosen.

    The choice follows from measured costs: on hundreds of points `Dense`; where they are few, or
    the accuracy is high, `Arpack`, from 40 modes on `Lanczos`, as loosely as the accuracy allows;
    `Cascade` elsewhere, and where no factor fits. Where the cascade estimates that it has missed
    the accuracy, `Refined` goes on from its modes with a factor.
    ``provenance.solver`` and ``provenance.reason`` tell what was chosen, and why.

    Parameters
    ----------
    accuracy : float, optional
        Relative error that the eigenvalues may have, in the mean over the wanted modes; below 1.
        Exact to rounding without it; to 1e-12, where a factor does not fit.
    memory : float, default 8.0
        GiB that an exact solution of one component may take: a factor, and the vectors of Lanczos.
        Of those below 16,385 points as many are solved at once as there are threads.
    device : str, default "cpu"
        "cpu" or "cuda", for what runs there; never chosen for you.
    seed : int, default 0
        Of all random columns.

    Raises
    ------
    ConvergenceError
        (from `eigensolve`) if errors are estimated to be larger, and nothing goes on; ``partial``
        holds what there is.

    Notes
    -----
    An estimate is no proof. Of smoothed modes it may be ten times too low and more, and the
    accuracy be missed, where a coarse level does not see what holds the modes: on plates and rods
    far thinner than its points are apart. Leave the accuracy out for these. Beside a potential, and
    where masses or weak edges span many decades, estimates are held against counts of the
    eigenvalues, if a factor fits into memory; what these refute is solved exactly.

    Components are chosen for one by one. If any is approximate, so is the spectrum:
    `Certificate.errors` estimates how far its eigenvalues are off. Otherwise they are counted, and
    none was missed.

    What goes on does so until relative residuals, which bound errors, are at most the accuracy.

    Examples
    --------
    >>> from spectra_kit import Automatic, eigensolve, robust_laplacian
    >>> from spectra_kit.geometry import sphere
    >>> laplacian = robust_laplacian(sphere(subdivisions=3).geometry)
    >>> eigensolve(laplacian, 9, Automatic(accuracy=1e-3)).provenance.choice
    'arpack: an exact solution is quickest for 9 modes of 642 points'
    """

    accuracy: float | None = None
    memory: float = 8.0
    device: str = "cpu"
    seed: int = 0

    def __post_init__(self) -> None:
        set_device(self)
        if self.accuracy is not None and check_positive("accuracy", self.accuracy) >= 1:
            raise InvalidInputError(
                "accuracy",
                "be less than 1, a relative error",
                self.accuracy,
                advice="1e-3 is a thousandth; leave it out for exact eigenvalues",
            )
        check_positive("memory", self.memory)
        check_count("seed", self.seed, low=0)

    @property
    def promise(self) -> Promise:
        """See `Eigensolver`; what was chosen may promise more."""
        return "exact" if self.accuracy is None else "approximate"

    def choose(self, n: int, k: int, dimension: int = 2) -> tuple[Eigensolver, str]:
        """Return what begins to solve for k modes on the n points of a component, and why.

        The points of a volume, of dimension 3, take larger factors.
        """
        needed = Lanczos.memory(n, k, dimension)
        fits = needed <= self.memory
        few = max(_FEW, _FEW_FOR_EACH * k)
        exact = cheapest(n, k, seed=self.seed)
        loose = exact
        rough = self.accuracy is not None and self.accuracy >= _TIGHT
        if rough and isinstance(exact, Lanczos):
            loose = replace(exact, tol=_RESIDUAL)
            few *= _LOOSELY if self.device == "cpu" and dimension == 2 else 1
        if fits and n <= few:
            what = "an exact solution" if loose is exact else "Lanczos"
            return loose, f"{what} is quickest for {quantity(k, 'mode')} of {n} points"
        if rough:
            why = f"errors of {self.accuracy:g} on {n} points need no factor"
        elif not fits:
            why = f"an exact solution would take {needed:.1f} GiB, more than {self.memory:g}"
        else:
            why = "exact" if self.accuracy is None else f"for errors of {self.accuracy:g}"
            return loose, f"{why}, and the factor fits into memory"
        cascade = Cascade(
            target=self.accuracy or _ROUNDING,
            max_steps=_STEPS if fits and self.device == "cpu" else _MANY,
            device=self.device,
            seed=self.seed,
        )
        return cascade, why

    def eigenpairs(self, laplacian: Laplacian, k: int) -> Eigenpairs:
        """See `Eigensolver.eigenpairs`."""
        solver, reason = self.choose(laplacian.n, k, laplacian.dimension)
        if isinstance(solver, Dense | Arpack | Lanczos):
            return or_densely(solver, laplacian, k, reason, seed=self.seed)
        found = Eigenpairs(*solver.eigenpairs(laplacian, k))
        if found.solver is None or found.solver is solver:
            found = found._replace(solver=solver, reason=reason)
        if not isinstance(found.solver, Cascade) or self._is_met(found.errors):
            return found
        left = "unknown errors" if found.errors is None else f"errors of {found.errors.mean():.1e}"
        steps = quantity(found.iterations or 0, "step")
        missed = f"{steps} of smoothing left {left}, more than {self.accuracy or _ROUNDING:g}"
        if found.solver.max_steps == _MANY:
            raise self._stopped(missed, found)
        return self._further(laplacian, k, found, missed)

    def _is_met(self, errors: Floats | None) -> bool:
        """Whether eigenvalues of such errors are as accurate as asked for."""
        wanted = (self.accuracy or _ROUNDING) / _MARGIN
        return errors is not None and bool(errors.mean() <= wanted)

    def _further(self, laplacian: Laplacian, k: int, found: Eigenpairs, reason: str) -> Eigenpairs:
        """Go on with a factor; what smoothing left is kept where that does not converge."""
        rtol = min(max(self.accuracy or 0.0, _RTOL), 0.1)
        start = GivenBasis(found.eigenvectors)
        solver: Eigensolver = Refined(start=start, rtol=rtol, seed=self.seed)
        if is_hard(laplacian):  # where sweeps may end between modes, and counts tell nothing
            solver = cheapest(laplacian.n, k, seed=self.seed)

        def told(more: Eigenpairs) -> Eigenpairs:
            seconds = dict(Counter(found.seconds) + Counter(more.seconds))
            return more._replace(seconds=seconds, solver=more.solver or solver, reason=reason)

        try:
            return told(Eigenpairs(*solver.eigenpairs(laplacian, k)))
        except NotConvergedError as error:
            error.pairs = told(error.pairs or found)
            raise
        except MemoryError as error:
            why = f"{reason}, and what goes on does not fit into memory ({error})"
            raise self._stopped(why, found) from error

    def _stopped(self, why: str, found: Eigenpairs) -> NotConvergedError:
        """Return an error that carries what smoothing left."""
        none = np.zeros(len(found.eigenvalues), dtype=bool)
        return NotConvergedError(why, found, none, advice="raise {}", remedies=("accuracy",))
