"""`eigensolve`: the only caller of a backend, and the only place where its answer is checked."""

from __future__ import annotations

import hashlib
import math
import time
from importlib.metadata import version

import numpy as np
from numpy.typing import NDArray

from spectra_kit._validate import check_count
from spectra_kit.eigensolvers.arpack import Arpack
from spectra_kit.eigensolvers.base import Eigenpairs, Eigensolver, NotConvergedError
from spectra_kit.errors import ConvergenceError, InvalidInputError, InvalidSpectrumError
from spectra_kit.operators.laplacian import Laplacian
from spectra_kit.spectrum import Provenance, Spectrum

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_ORTHONORMAL = 1e-6  # a spectrum further from M-orthonormal is refused
_NEGATIVE = 1e-6  # eigenvalues down to -this times the spacing are rounding, and become 0


def eigensolve(laplacian: Laplacian, k: int, solver: Eigensolver = Arpack()) -> Spectrum:  # noqa: B008
    """Compute the k lowest modes of a Laplacian with the backend of your choice, and certify them.

    Each connected component is solved on its own and the modes are merged: as many exact zero
    modes as components, no coupling through rounding, and a learned backend sees the single
    surfaces it knows.

    Parameters
    ----------
    laplacian : Laplacian
        On n points.
    k : int
        Number of modes, zero modes included; at most the number of free points.
    solver : Eigensolver, default Arpack()
        `Arpack`, `Lobpcg`, `Dense`, `RayleighRitz`, `Neo`, or your own.

    Returns
    -------
    Spectrum
        Certified: residuals, orthonormality and the count of zero modes come with it.

    Raises
    ------
    InvalidInputError
        If `k` is not an integer in [1, n_free].
    ConvergenceError
        If an iterative backend stopped short; ``partial`` holds the certified modes it had.
    InvalidSpectrumError
        If the backend returned pairs of the wrong shape, not M-orthonormal, or negative.

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
    if not isinstance(laplacian, Laplacian):
        raise InvalidInputError(
            f"`laplacian` must be a Laplacian, got {type(laplacian).__name__};"
            " build one with robust_laplacian(geometry)"
        )
    n_free = len(laplacian.free)
    if check_count("k", k, low=1) > n_free:
        raise InvalidInputError(
            f"`k` must be at most the number of free points, {n_free}, got {k}; ask for fewer modes"
            " or sample more points"
        )
    start = time.perf_counter()
    stages: dict[str, float] = {}
    try:
        values, vectors = _solve_components(laplacian, k, solver, stages)
    except NotConvergedError as error:
        partial = None
        if error.pairs is not None and len(error.pairs.eigenvalues):
            partial = _pack(laplacian, error.pairs, solver, stages, start)
        raise ConvergenceError(f"{solver!r}: {error}", partial=partial) from error
    return _pack(laplacian, Eigenpairs(values, vectors), solver, stages, start)


def _solve_components(
    laplacian: Laplacian, k: int, solver: Eigensolver, stages: dict[str, float]
) -> tuple[Floats, Floats]:
    """Solve each component and merge the k lowest pairs of all, eigenvectors padded with zeros."""
    if laplacian.n_components == 1 and not len(laplacian.fixed):
        pairs = _solve_connected(laplacian, k, solver, stages)
        return pairs.eigenvalues, pairs.eigenvectors

    parts = _component_indices(laplacian)
    areas = np.array([laplacian.mass[part].sum() for part in parts])
    # Weyl: a component's share of the low modes is about its share of the area.
    wanted = [
        min(len(part), k, math.ceil(1.1 * k * share) + 6)
        for part, share in zip(parts, areas / areas.sum(), strict=True)
    ]
    solved: list[Eigenpairs | None] = [None] * len(parts)
    while True:
        for i, part in enumerate(parts):
            if solved[i] is None:
                try:
                    solved[i] = _solve_connected(
                        laplacian.restricted(part), wanted[i], solver, stages
                    )
                except NotConvergedError as error:
                    raise _padded_error(error, part, laplacian.n) from error
        found = [p for p in solved if p is not None]
        cut = np.sort(np.concatenate([p.eigenvalues for p in found]))[k - 1 : k]
        # A component whose last mode is below the cut may hold more modes below it: ask for more.
        short = [
            i
            for i, p in enumerate(found)
            if wanted[i] < min(len(parts[i]), k) and (not len(cut) or p.eigenvalues.max() < cut[0])
        ]
        if not short:
            break
        for i in short:
            wanted[i] = min(len(parts[i]), k, 2 * wanted[i])
            solved[i] = None
    return _merge(found, parts, laplacian.n, k)


def _component_indices(laplacian: Laplacian) -> list[Ints]:
    """Return the free points of each component, ascending."""
    labels = laplacian.component_labels
    order = np.argsort(labels, kind="stable")[len(laplacian.fixed) :]
    return np.split(order, np.flatnonzero(np.diff(labels[order])) + 1)


def _merge(pairs: list[Eigenpairs], parts: list[Ints], n: int, k: int) -> tuple[Floats, Floats]:
    """Return the k lowest of all pairs on all n points."""
    values = np.concatenate([p.eigenvalues for p in pairs])
    owner = np.repeat(np.arange(len(pairs)), [len(p.eigenvalues) for p in pairs])
    column = np.concatenate([np.arange(len(p.eigenvalues)) for p in pairs])
    lowest = np.argsort(values, kind="stable")[:k]
    vectors = np.zeros((n, k))
    for j, source in enumerate(lowest):
        part = owner[source]
        vectors[parts[part], j] = pairs[part].eigenvectors[:, column[source]]
    return values[lowest], vectors


def _padded_error(error: NotConvergedError, part: Ints, n: int) -> NotConvergedError:
    """Return `error` with its eigenvectors on all n points."""
    if error.pairs is None:
        return error
    vectors = np.zeros((n, len(error.pairs.eigenvalues)))
    vectors[part] = error.pairs.eigenvectors
    return NotConvergedError(str(error), Eigenpairs(error.pairs.eigenvalues, vectors))


def _solve_connected(
    laplacian: Laplacian, k: int, solver: Eigensolver, stages: dict[str, float]
) -> Eigenpairs:
    """Call the backend on one component and check the form of its answer."""
    start = time.perf_counter()
    pairs = Eigenpairs(*solver.eigenpairs(laplacian, k))
    values, vectors = np.asarray(pairs.eigenvalues), np.asarray(pairs.eigenvectors)
    if values.shape != (k,) or vectors.shape != (laplacian.n, k):
        raise InvalidSpectrumError(
            f"{solver!r} must return shapes ({k},) and ({laplacian.n}, {k}),"
            f" got {values.shape} and {vectors.shape}"
        )
    for stage, seconds in (pairs.seconds or {"solve": time.perf_counter() - start}).items():
        stages[stage] = stages.get(stage, 0.0) + seconds
    return Eigenpairs(values, vectors, pairs.seconds)


def _pack(
    laplacian: Laplacian,
    pairs: Eigenpairs,
    solver: Eigensolver,
    stages: dict[str, float],
    start: float,
) -> Spectrum:
    """Sort, check and certify `pairs`."""
    solved = time.perf_counter()
    order = np.argsort(pairs.eigenvalues, kind="stable")
    values, vectors = pairs.eigenvalues[order], pairs.eigenvectors
    if not np.array_equal(order, np.arange(len(order))):
        vectors = vectors[:, order]
    if len(values) and values[0] < -_NEGATIVE * laplacian.eigenvalue_spacing:
        raise InvalidSpectrumError(
            f"{solver!r} returned a negative eigenvalue ({values[0]:.3e}); is the stiffness"
            " positive semi-definite?"
        )
    spectrum = Spectrum(np.maximum(values, 0.0), vectors, laplacian.mass).certify(laplacian)
    assert spectrum.certificate is not None
    if (error := spectrum.certificate.orthonormality_error) > _ORTHONORMAL:
        raise InvalidSpectrumError(
            f"{solver!r} returned modes that are not M-orthonormal: |U^T M U - I| is {error:.2e}"
        )
    certified = time.perf_counter()
    other = max(solved - start - sum(stages.values()), 0.0)
    provenance = Provenance(
        solver=repr(solver),
        operator=laplacian.operator,
        seed=getattr(solver, "seed", None),
        seconds={
            "assembly": laplacian.seconds,
            **stages,
            "other": other,
            "certify": certified - solved,
        },
        input_hash=_fingerprint(laplacian),
        version=version("spectra_kit"),
    )
    return Spectrum(
        spectrum.eigenvalues, spectrum.eigenvectors, spectrum.mass, spectrum.certificate, provenance
    )


def _fingerprint(laplacian: Laplacian) -> str:
    """Return a hash of all that defines the eigenproblem."""
    digest = hashlib.blake2b(digest_size=16)
    L = laplacian.stiffness
    for array in (L.indptr, L.indices, L.data, laplacian.mass, laplacian.points, laplacian.fixed):
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()
