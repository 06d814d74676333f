"""`Refined` and `Polished`: from any subspace to any accuracy."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from spectra_kit._checked import checked
from spectra_kit._types import Floats, Ints
from spectra_kit._validate import check_count, check_positive, quantity
from spectra_kit.eigensolvers.base import Accuracy, Eigenpairs, NotConvergedError
from spectra_kit.eigensolvers.dense import Dense
from spectra_kit.eigensolvers.lobpcg import Lobpcg
from spectra_kit.eigensolvers.rayleigh_ritz import basis_with_kernel
from spectra_kit.errors import InvalidInputError
from spectra_kit.linalg.shift_invert import Refinement, shift_invert_iteration
from spectra_kit.operators.laplacian import Laplacian
from spectra_kit.subspaces import AmbientFourier, Subspace, restricted

Method = Literal["shift-invert", "chebyshev", "lobpcg"]

_DENSE_RATIO = 5  # below this multiple of the block the trial space is most of the whole space
_SMALLEST_RTOL = 1e-14  # residuals below this are rounding, whatever the operator
#: Methods that have a use for an option.
_OPTIONS: dict[str, tuple[Method, ...]] = {
    "guard": ("shift-invert", "chebyshev"),
    "degree": ("shift-invert",),
}
_LARGEST_RTOL = 0.1  # beyond it a residual says nothing


def plane_waves(k: int) -> AmbientFourier:
    """Return a start for k modes that costs less than what it saves.

    The m functions grow with k, and the bandwidth like the frequency of mode k.
    """
    return AmbientFourier(m=max(64, round(2.7 * k)), bandwidth=0.7 * max(k, 24) ** 0.5)


@checked
@dataclass(frozen=True, kw_only=True)
class Refined:
    """Start from any subspace and iterate until every mode has the residual asked for.

    Parameters
    ----------
    start : Subspace, optional
        Where to begin: a `NeoSubspace`, `GivenBasis(previous.eigenvectors)`, `RandomBasis`; some
        2.7 k plane waves (`AmbientFourier`) without it. The better it is, the fewer sweeps.
    rtol : float, default 1e-8
        From 1e-14 to 0.1. Stop when ``||L u - lambda M u||`` in the M^-1 norm is at most
        ``rtol * max(lambda, spacing)`` for every mode.
    method : {"shift-invert", "chebyshev", "lobpcg"}, default "shift-invert"
        Filtered block iterations on one sparse factor; the same without a factor, in torch on
        `device`; or `Lobpcg`.
    guard : float, default 0.5
        Ritz vectors beyond k, relative to k. More converge in fewer, dearer sweeps.
    degree : int, default 4
        Of the filter in "shift-invert" (alone): solves of each column in a sweep.
    max_sweeps : int, default 30
        Sweeps (iterations of LOBPCG) before giving up.
    device : str, default "cpu"
        Of "chebyshev".
    seed : int, default 0
        Of all random columns.

    Raises
    ------
    InvalidInputError
        If a parameter is out of range, or changed for a method that has no use for it.
    ConvergenceError
        (from `eigensolve`) if the tolerance was not reached, because of `max_sweeps` or because
        it is below rounding; ``partial`` holds all k modes as they are (of "lobpcg", those that
        converged), and its certificate says how far each one came.

    Notes
    -----
    A residual says that a mode is one of the operator's, not that no other was missed. So random
    columns join every start, and modes are found of which it holds nothing; what they may still
    miss is found by a count of the eigenvalues, which `eigensolve` makes. But "chebyshev", which is
    taken to avoid a factor, is not counted: there it is unlikely that a mode is missed, not
    excluded, the certificate says so, and `verify` proves it.

    See `linalg.shift_invert.shift_invert_iteration` for the method. ``provenance.iterations``
    holds the sweeps it took, the certificate the residual of each mode.

    Examples
    --------
    >>> from spectra_kit import Refined, eigensolve, robust_laplacian
    >>> from spectra_kit.geometry import sphere
    >>> laplacian = robust_laplacian(sphere(subdivisions=4).geometry)
    >>> spectrum = eigensolve(laplacian, 25, Refined(rtol=1e-6))
    >>> bool(spectrum.certificate.relative_residuals.max() <= 1e-6)
    True
    """

    accuracy: ClassVar[Accuracy] = "to tolerance"
    start: Subspace | None = None
    rtol: float = 1e-8
    method: Method = "shift-invert"
    guard: float = 0.5
    degree: int = 4
    max_sweeps: int = 30
    device: str = "cpu"
    seed: int = 0

    def __post_init__(self) -> None:
        _check_start(self.start)
        if not _SMALLEST_RTOL <= check_positive("rtol", self.rtol) <= _LARGEST_RTOL:
            raise InvalidInputError(
                f"`rtol` must be at least {_SMALLEST_RTOL:g}, the rounding of float64, and at most"
                f" {_LARGEST_RTOL:g}, got {self.rtol:g}"
            )
        if self.device != "cpu" and self.method != "chebyshev":
            raise InvalidInputError(
                f"`device` must be 'cpu' for method {self.method!r}, got {self.device!r};"
                " on an accelerator use method='chebyshev'"
            )
        for name, methods in _OPTIONS.items():
            default = type(self).__dataclass_fields__[name].default
            if self.method not in methods and getattr(self, name) != default:
                raise InvalidInputError(
                    f"`{name}` must be left at {default} for method {self.method!r}, which has no"
                    f" use for it, got {getattr(self, name)!r}"
                )
        _check_block(self.guard, self.degree, self.seed)
        check_count("max_sweeps", self.max_sweeps, low=1)

    @property
    def factor_free(self) -> bool:
        """See `Eigensolver`."""
        return self.method == "chebyshev"

    def eigenpairs(self, laplacian: Laplacian, k: int) -> Eigenpairs:
        """See `Eigensolver.eigenpairs`."""
        if self.method == "lobpcg":
            return self._by_lobpcg(laplacian, k)
        block = block_size(k, self.guard)
        if _DENSE_RATIO * block >= laplacian.n:
            return Dense().eigenpairs(laplacian, k)
        if self.method == "chebyshev":
            return self._checked(*_filter_on_device(self, laplacian, k, block), laplacian)
        pairs, reached = _iterate(self, laplacian, k, rtol=self.rtol, sweeps=self.max_sweeps)
        return self._checked(pairs, reached.residuals, reached.stalled, laplacian)

    def _checked(
        self, pairs: Eigenpairs, residuals: Floats, stalled: bool, laplacian: Laplacian
    ) -> Eigenpairs:
        """Return `pairs` if all are within the tolerance; else raise with what they are."""
        relative = residuals / np.maximum(pairs.eigenvalues, laplacian.eigenvalue_spacing)
        good = relative <= self.rtol
        if good.all():
            return pairs
        assert pairs.iterations is not None
        why = (
            "where rounding stops them; loosen `rtol`"
            if stalled
            else "raise `max_sweeps`, loosen `rtol`, or use Arpack"
        )
        raise NotConvergedError(
            f"{int(good.sum())} of {quantity(len(good), 'mode')} reached rtol = {self.rtol:g} in"
            f" {pairs.iterations} sweeps (largest relative residual {relative.max():.1e}); {why}",
            pairs,
            good,
        )

    def _by_lobpcg(self, laplacian: Laplacian, k: int) -> Eigenpairs:
        """Leave it to `Lobpcg`, in the words of this class."""
        solver = Lobpcg(
            start=_start(self, k),
            rtol=self.rtol,
            max_steps=self.max_sweeps,
            seed=self.seed,
        )
        try:
            return solver.eigenpairs(laplacian, k)
        except NotConvergedError as error:
            message = str(error).replace("`max_steps`", "`max_sweeps`")
            raise NotConvergedError(message, error.pairs, error.converged) from error

    def restricted(self, rows: Ints) -> Refined:
        """Return this solver for the points `rows` of its Laplacian alone."""
        return replace(self, start=restricted(self.start, rows))


@checked
@dataclass(frozen=True, kw_only=True)
class Polished:
    """A predicted subspace and a fixed number of sweeps over it: cheap, no promise.

    The certificate says what was reached; `Refined` goes on until it is enough.

    Parameters
    ----------
    start : Subspace, optional
        The prediction, of at least k dimensions; some 2.7 k plane waves without it.
    sweeps : int, default 1
        Filters to apply.
    guard : float, default 0.5
        Ritz vectors beyond k, relative to k.
    degree : int, default 4
        Of the filter: solves of each column in a sweep. 1 is a plain shift-invert iteration.
    seed : int, default 0
        Of all random columns.

    Raises
    ------
    InvalidInputError
        If a parameter is out of range, or the start spans fewer than k dimensions.

    Examples
    --------
    >>> from spectra_kit import Arpack, Polished, eigensolve, robust_laplacian
    >>> from spectra_kit.geometry import creature
    >>> laplacian = robust_laplacian(creature(3000, seed=0))
    >>> exact, polished = (eigensolve(laplacian, 60, s) for s in (Arpack(), Polished()))
    >>> bool(abs(polished.eigenvalues[1:] / exact.eigenvalues[1:] - 1).mean() < 1e-3)
    True
    """

    accuracy: ClassVar[Accuracy] = "approximate"
    start: Subspace | None = None
    sweeps: int = 1
    guard: float = 0.5
    degree: int = 4
    seed: int = 0

    def __post_init__(self) -> None:
        _check_start(self.start)
        check_count("sweeps", self.sweeps, low=1)
        _check_block(self.guard, self.degree, self.seed)

    def eigenpairs(self, laplacian: Laplacian, k: int) -> Eigenpairs:
        """See `Eigensolver.eigenpairs`."""
        if _DENSE_RATIO * block_size(k, self.guard) >= laplacian.n:
            return Dense().eigenpairs(laplacian, k)
        return _iterate(self, laplacian, k, rtol=0.0, sweeps=self.sweeps, least_rank=k)[0]

    def restricted(self, rows: Ints) -> Polished:
        """Return this solver for the points `rows` of its Laplacian alone."""
        return replace(self, start=restricted(self.start, rows))


def block_size(k: int, guard: float) -> int:
    """Return how many Ritz vectors to iterate on for k wanted ones."""
    return k + max(8, round(guard * k))


def _iterate(
    solver: Refined | Polished,
    laplacian: Laplacian,
    k: int,
    *,
    rtol: float,
    sweeps: int,
    least_rank: int = 0,
) -> tuple[Eigenpairs, Refinement]:
    """Predict, then sweep."""
    begin = time.perf_counter()
    block = block_size(k, solver.guard)
    basis = basis_with_kernel(_start(solver, k), laplacian)
    predicted = time.perf_counter()
    refinement = shift_invert_iteration(
        laplacian.stiffness,
        laplacian.mass,
        basis,
        k,
        tolerance=lambda values: rtol * np.maximum(values, laplacian.eigenvalue_spacing),
        spacing=laplacian.eigenvalue_spacing,
        block=block,
        degree=solver.degree,
        max_sweeps=sweeps,
        least_rank=least_rank,
        seed=solver.seed,
    )
    pairs = Eigenpairs(
        refinement.eigenvalues,
        refinement.eigenvectors,
        {"subspace": predicted - begin, **refinement.seconds},
        refinement.sweeps,
    )
    return pairs, refinement


def _filter_on_device(
    solver: Refined, laplacian: Laplacian, k: int, block: int
) -> tuple[Eigenpairs, Floats, bool]:
    """Refine without a factor, in torch; return the pairs, their residuals, whether it stalled."""
    import torch

    from spectra_kit.linalg.chebyshev import chebyshev_eigenpairs
    from spectra_kit.linalg.torch_device import (
        check_device,
        device_clock,
        device_memory,
        sparse_tensor,
        torch_threads_for,
    )
    from spectra_kit.neo import NeoSubspace

    with device_memory():
        clock = device_clock(check_device(solver.device))
        start = _start(solver, k)
        if isinstance(start, NeoSubspace) and start.device == solver.device:
            columns = start.tensor(laplacian.points, laplacian.mass)  # it stays where it is
            clock.stage("subspace")
        else:
            basis = basis_with_kernel(start, laplacian)
            clock.stage("subspace")
            columns = torch.from_numpy(np.array(basis)).to(solver.device)
        stiffness = sparse_tensor(laplacian.stiffness, solver.device)
        mass = torch.from_numpy(np.array(laplacian.mass)).to(solver.device)
        clock.stage("transfer")
        with torch_threads_for(block * laplacian.n):
            found = chebyshev_eigenpairs(
                stiffness,
                mass,
                columns,
                k,
                rtol=solver.rtol,
                spacing=laplacian.eigenvalue_spacing,
                block=block,
                max_sweeps=solver.max_sweeps,
                seed=solver.seed,
            )
        clock.stage("filter")
        values, vectors, residuals = (
            np.asarray(t.cpu().numpy())
            for t in (found.eigenvalues, found.eigenvectors, found.residuals)
        )
        clock.stage("transfer")
    pairs = Eigenpairs(values, vectors, clock.seconds, found.sweeps)
    return pairs, residuals, found.stalled


def _start(solver: Refined | Polished, k: int) -> Subspace:
    return plane_waves(k) if solver.start is None else solver.start


def _check_start(start: object) -> None:
    if start is not None and not callable(start):
        raise InvalidInputError(
            f"`start` must be a subspace (a function of points and mass), got {start!r};"
            " wrap columns that you have in GivenBasis(columns)"
        )


def _check_block(guard: float, degree: int, seed: int) -> None:
    check_positive("guard", guard)
    check_count("degree", degree, low=1)
    check_count("seed", seed, low=0)
