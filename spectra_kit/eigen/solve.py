"""From a geometry, an operator or many of them to spectra: what users call."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import chain
from typing import Annotated, Any, cast

import numpy as np
from scipy import sparse

from spectra_kit._core.checked import checked
from spectra_kit._core.many import about, of_similar_size
from spectra_kit._core.threads import ended_beside, in_threads, single_threaded
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_count
from spectra_kit.eigen.accuracy import warn_of_doubts
from spectra_kit.eigen.automatic import Automatic
from spectra_kit.eigen.base import Eigenpairs, Eigensolver, check_dimension_of
from spectra_kit.eigen.components import device_of, promise_of
from spectra_kit.eigen.run import is_whole, solve
from spectra_kit.eigen.spectrum import Spectrum
from spectra_kit.errors import InvalidInputError, SpectraKitError
from spectra_kit.geometry import GeometryLike
from spectra_kit.operators import laplacian as assemble
from spectra_kit.operators.laplacian import Laplacian

_MOST_POINTS = 2**18  # of a pass on a device
_BYTES = 200  # there, for each point and function: half as many were taken by clouds of 600 points


@checked
def spectrum(geometry: GeometryLike, k: int, solver: Eigensolver = Automatic()) -> Spectrum:  # noqa: B008
    """Compute the k lowest modes of a surface, by `laplacian` and `eigensolve`.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        With n points.
    k : int
        Number of modes, zero modes included.
    solver : Eigensolver, default Automatic()
        As in `eigensolve`. On its device the Laplacian of a cloud is made, too.

    Returns
    -------
    Spectrum
        Certified.

    Raises
    ------
    ConvergenceError, InvalidSpectrumError, OutOfMemoryError
        As of `eigensolve`.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> sk.spectrum(sk.geometry.sphere(subdivisions=3).geometry, 4).eigenvalues.round(1)
    array([0., 2., 2., 2.])
    """
    return eigensolve(assemble(geometry, device=device_of(solver)), k, solver)


@checked
def eigensolve(
    laplacian: Annotated[Laplacian, sparse.sparray],
    k: int,
    solver: Eigensolver = Automatic(),  # noqa: B008
    *,
    mass: Annotated[Floats, sparse.sparray] | None = None,
) -> Spectrum:
    """Compute the k lowest modes of a Laplacian with the backend of your choice, and certify them.

    Each connected component is solved on its own and the modes are merged: as many exact zero
    modes as components, however different their sizes, no coupling through rounding, and a learned
    backend sees the single surfaces it knows. Where constants have no energy and the modes span
    them up to rounding, the first mode is the constant itself, with eigenvalue 0.

    A shape beyond 1e9 or below 1e-9 in size is measured in a unit of its own, a power of two, which
    changes no digit; what is a function of the points sees them in it.

    Parameters
    ----------
    laplacian : Laplacian, or sparse array of shape (n, n)
        On n points; or a stiffness matrix, with its `mass`.
    k : int
        Number of modes, zero modes included; at most the number of free points.
    solver : Eigensolver, default Automatic()
        ``Automatic(accuracy=1e-3)`` takes what costs least for that accuracy; without it, all is
        exact. For those who know: `Arpack`, `Lanczos`, `Refined`, `Dense`; approximate: `Neo`,
        `Cascade`, `RayleighRitz`; or your own. Or its name in the `catalogue`: "arpack".
    mass : array_like of shape (n,), or sparse array of shape (n, n), optional
        Of a stiffness matrix: M, positive definite, lumped or not. Matrices have no points, so that
        their solver is to be an exact one: for others, make a ``Laplacian(K, M, points)``.

    Returns
    -------
    Spectrum
        Certified: residuals, orthonormality and the count of zero modes come with it.

    Raises
    ------
    ConvergenceError
        If an iterative backend stopped short; ``partial`` holds the certified modes it had, of
        which ``n_converged`` had converged, and those of the components solved before. Modes may
        be missing between them.
    InvalidSpectrumError
        If the backend returned pairs of the wrong shape, not M-orthonormal, or negative.
    OutOfMemoryError
        If the backend needs more memory than there is; ``partial`` holds the certified modes of
        the components solved before.

    Warns
    -----
    DoubtfulSpectrumWarning
        If eigenvalues of an approximate backend are proved to be more than 10 % too high, by
        smoothing its modes (`Certificate.excess`), or estimated to be (`Certificate.errors`). No
        warning is no proof that they are not. And if the estimates miss the solver's ``target``.

    Examples
    --------
    >>> from spectra_kit import eigensolve, robust_laplacian
    >>> from spectra_kit.geometry import sphere
    >>> spectrum = eigensolve(robust_laplacian(sphere(subdivisions=3).geometry), 9)
    >>> spectrum.eigenvalues.round(1)
    array([0., 2., 2., 2., 6., 6., 6., 6., 6.])
    >>> bool(spectrum.certificate.relative_residuals.max() < 1e-8)
    True
    """
    laplacian = _of_matrices(laplacian, mass, solver)
    check_modes(laplacian, k)
    check_dimension_of(solver, laplacian)
    spectrum = solve(laplacian, k, solver)
    warn_of_doubts(spectrum, solver)
    return spectrum


def _of_matrices(given: Laplacian | sparse.sparray, mass: object, solver: Eigensolver) -> Laplacian:
    """Return an operator as it is; of matrices, one whose points all lie in one place."""
    if isinstance(given, Laplacian):
        if mass is not None:
            raise InvalidInputError("mass", "be left out beside a Laplacian, which has its own")
        return given
    if mass is None:
        raise InvalidInputError(
            "laplacian",
            "be a Laplacian, or a matrix with its mass",
            "no mass",
            advice="write eigensolve(K, k, mass=M)",
        )
    if promise_of(solver) == "approximate":
        raise InvalidInputError(
            "solver",
            "be an exact one, of matrices alone",
            solver,
            advice="it looks at points, too: pass a Laplacian(K, M, points)",
        )
    return Laplacian(given, mass, np.zeros((given.shape[0], 3)))  # type: ignore[arg-type]


@checked
def eigensolve_many(
    laplacians: Sequence[Laplacian],
    k: int,
    solver: Eigensolver = Automatic(),  # noqa: B008
    *,
    batch: int | None = None,
) -> list[Spectrum]:
    """Compute the k lowest modes of each of many Laplacians, and certify them.

    The same as `eigensolve` of one after the other, up to rounding, but sooner with a solver that
    takes several at once, as `Neo` does: shapes of similar size share a forward pass, and on a
    device all that follows; batches are solved side by side, one thread each, those of a device one
    after the other, while the host certifies the last. Operators of several components, with fixed
    points or beyond 1e9 in size are solved each on its own. Other solvers take one after the other.

    Parameters
    ----------
    laplacians : sequence of Laplacian
        Of any sizes.
    k : int
        Number of modes, of all of them.
    solver : Eigensolver, default Automatic()
        As of `eigensolve`.
    batch : int, optional
        Points that share a forward pass, at most; a larger shape has one for itself. By default
        4,096, as many in work in each thread; on a device 262,144, or as many as half of what is
        free there takes.

    Returns
    -------
    list of Spectrum
        In the order of the operators, certified like those of `eigensolve`.

    Raises
    ------
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
    batch = points_of_a_pass(solver) if batch is None else check_count("batch", batch, low=1)
    for i, laplacian in enumerate(laplacians):
        with about(_name(i)):
            check_modes(laplacian, k)
            check_dimension_of(solver, laplacian)

    def one(i: int, begun: Callable[[], Eigenpairs] | None = None) -> Spectrum:
        with about(_name(i)):
            return solve(laplacians[i], k, solver, begun)

    def alone(i: int, begun: Callable[[], Eigenpairs] | None) -> tuple[int, Spectrum]:
        with single_threaded():
            return i, one(i, begun)

    def begun(group: Sequence[int]) -> list[tuple[int, Callable[[], Eigenpairs] | None]]:
        return list(zip(group, _begun(solver, [laplacians[i] for i in group], k), strict=True))

    def in_one_thread(*group: int) -> list[tuple[int, Spectrum]]:
        with single_threaded():
            return [alone(*own) for own in begun(group)]

    if hasattr(solver, "begin"):
        groups = _groups(laplacians, batch)
        if is_on_device(solver):  # which goes on while the host certifies
            found = list(ended_beside(begun, partial(in_threads, alone), groups))
        else:
            found = in_threads(in_one_thread, groups)
        solved = dict(chain.from_iterable(found))
    else:
        solved = {i: one(i) for i in range(len(laplacians))}
    for i in range(len(laplacians)):
        warn_of_doubts(solved[i], solver, where=_name(i))
    return [solved[i] for i in range(len(laplacians))]


def is_on_device(solver: Eigensolver) -> bool:
    """Whether a solver works elsewhere than on the host."""
    return device_of(solver) != "cpu"


def points_of_a_pass(solver: Eigensolver) -> int:
    """Return how many points may share a pass of a solver: a device idles while it has few."""
    device = device_of(solver)
    if not device.startswith("cuda"):
        return 4096 if device == "cpu" else _MOST_POINTS
    import torch

    free, _ = torch.cuda.mem_get_info(device)
    free += torch.cuda.memory_reserved(device) - torch.cuda.memory_allocated(device)
    functions = getattr(getattr(solver, "subspace", None), "n_functions", 1000)
    return min(_MOST_POINTS, max(4096, free // (_BYTES * functions)))


def _groups(laplacians: Sequence[Laplacian], batch: int) -> list[tuple[int, ...]]:
    alone = {i for i, laplacian in enumerate(laplacians) if not is_whole(laplacian)}
    return of_similar_size([laplacian.n for laplacian in laplacians], batch, alone)


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


def check_modes(laplacian: Laplacian, k: int) -> None:
    """Refuse to look for more modes than there can be."""
    n_free = len(laplacian.free)
    if check_count("k", k, low=1) > n_free:
        raise InvalidInputError(
            "k",
            f"be at most the number of free points, {n_free}",
            k,
            advice="ask for fewer modes or sample more points",
        )
