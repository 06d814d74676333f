"""`eigensolve_many`: the modes of many operators, what they share computed at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import chain
from typing import Any, cast

from spectra_kit._core.checked import checked
from spectra_kit._core.threads import in_threads, single_threaded
from spectra_kit._core.validate import check_count
from spectra_kit.eigen.automatic import Automatic
from spectra_kit.eigen.base import Eigenpairs, Eigensolver
from spectra_kit.eigen.doubts import warn_of_doubts
from spectra_kit.eigen.solve import check_modes, is_whole, solve
from spectra_kit.eigen.spectrum import Spectrum
from spectra_kit.errors import SpectraKitError
from spectra_kit.operators.laplacian import Laplacian

_PADDED = 0.8  # of the largest of a batch: the smallest has as many points, or more


@checked
def eigensolve_many(
    laplacians: Sequence[Laplacian],
    k: int,
    solver: Eigensolver = Automatic(),  # noqa: B008
    *,
    batch: int = 4096,
) -> list[Spectrum]:
    """Compute the k lowest modes of each of many Laplacians, and certify them.

    The same as `eigensolve` of one after the other, up to rounding, but sooner with a solver that
    takes several at once, as `Neo` does: shapes of similar size share a forward pass, and batches
    are solved side by side, one thread each. Operators of several components, with fixed points or
    beyond 1e9 in size are solved each on its own. Other solvers take one after the other.

    Parameters
    ----------
    laplacians : sequence of Laplacian
        Of any sizes.
    k : int
        Number of modes, of all of them.
    solver : Eigensolver, default Automatic()
        As of `eigensolve`.
    batch : int, default 4096
        Points that share a forward pass, at most; a larger shape has one for itself. As many are
        in work in each thread. An accelerator wants more: 65536.

    Returns
    -------
    list of Spectrum
        In the order of the operators, certified like those of `eigensolve`.

    Raises
    ------
    InvalidInputError
        If `k` is not an integer in [1, n_free] of each, before anything is solved.
    ConvergenceError, InvalidSpectrumError, OutOfMemoryError
        As of `eigensolve`, for the first that fails.

    Warns
    -----
    DoubtfulSpectrumWarning
        As `eigensolve` does, for each.

    Notes
    -----
    Messages begin with the place of the operator that they are about: ``laplacians[3]``, which is
    the attribute ``where`` of errors and warnings, too. Results depend on `batch` by rounding
    alone, and not on the number of threads.

    Examples
    --------
    >>> from spectra_kit import Neo, eigensolve_many, robust_laplacian
    >>> from spectra_kit.geometry import creature
    >>> laplacians = [robust_laplacian(creature(1500, seed=seed)) for seed in range(3)]
    >>> spectra = eigensolve_many(laplacians, 16, Neo())
    >>> [spectrum.k for spectrum in spectra]
    [16, 16, 16]
    """
    check_count("k", k, low=1)
    check_count("batch", batch, low=1)
    for i, laplacian in enumerate(laplacians):
        with _about(i):
            check_modes(laplacian, k)

    def one(i: int, begun: Callable[[], Eigenpairs] | None = None) -> Spectrum:
        with _about(i):
            return solve(laplacians[i], k, solver, begun)

    def together(*group: int) -> list[tuple[int, Spectrum]]:
        with single_threaded():
            rest = _begun(solver, [laplacians[i] for i in group], k)
            return [(i, one(i, begun)) for i, begun in zip(group, rest, strict=True)]

    if hasattr(solver, "begin"):
        solved = dict(chain.from_iterable(in_threads(together, _groups(laplacians, batch))))
    else:
        solved = {i: one(i) for i in range(len(laplacians))}
    for i in range(len(laplacians)):
        warn_of_doubts(solved[i], solver, where=_name(i))
    return [solved[i] for i in range(len(laplacians))]


def _groups(laplacians: Sequence[Laplacian], batch: int) -> list[tuple[int, ...]]:
    """Return which operators go together, largest first: of similar size, or one on its own."""
    groups: list[list[int]] = []
    for i in sorted(range(len(laplacians)), key=lambda i: -laplacians[i].n):
        if groups and is_whole(laplacians[i]):
            largest, count = laplacians[groups[-1][0]], len(groups[-1]) + 1
            near = laplacians[i].n >= _PADDED * largest.n and count * largest.n <= batch
            if near and is_whole(largest):
                groups[-1].append(i)
                continue
        groups.append([i])
    return [tuple(group) for group in groups]


def _begun(
    solver: Any, laplacians: Sequence[Laplacian], k: int
) -> Sequence[Callable[[], Eigenpairs] | None]:
    """Return what is left to do for each, where the solver has begun with all of them."""
    if is_whole(laplacians[0]):
        try:
            return cast("list[Callable[[], Eigenpairs]]", solver.begin(laplacians, k))
        except (SpectraKitError, MemoryError):
            pass  # on its own, each fails or succeeds for itself
    return [None] * len(laplacians)


def _name(i: int) -> str:
    return f"laplacians[{i}]"


@contextmanager
def _about(i: int) -> Iterator[None]:
    """Let an error inside say which operator it is about."""
    try:
        yield
    except SpectraKitError as error:
        error.where = _name(i)
        raise
