"""`eigensolve`: the only caller of a backend, and the only place where its answer is checked."""

from __future__ import annotations

import hashlib
import math
import time
import traceback
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from spectra_kit._validate import check_count
from spectra_kit._version import VERSION
from spectra_kit.eigensolvers.arpack import Arpack
from spectra_kit.eigensolvers.base import Eigenpairs, Eigensolver, NotConvergedError
from spectra_kit.errors import (
    ConvergenceError,
    InvalidInputError,
    InvalidSpectrumError,
    OutOfMemoryError,
)
from spectra_kit.operators.laplacian import Laplacian
from spectra_kit.spectrum import Provenance, Spectrum
from spectra_kit.subspaces import restricted

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_ORTHONORMAL = 1e-6  # a spectrum further from M-orthonormal is refused
_NEGATIVE = 1e-6  # eigenvalues down to -this times the spacing are rounding, and become 0
_CONSTANT = 1e-6  # a first mode this close to the constant is the constant, up to rounding


def eigensolve(laplacian: Laplacian, k: int, solver: Eigensolver = Arpack()) -> Spectrum:  # noqa: B008
    """Compute the k lowest modes of a Laplacian with the backend of your choice, and certify them.

    Each connected component is solved on its own and the modes are merged: as many exact zero
    modes as components, however different their sizes, no coupling through rounding, and a learned
    backend sees the single surfaces it knows. Where constants have no energy, a first mode that is
    constant up to rounding is replaced by the constant itself, with eigenvalue 0.

    Parameters
    ----------
    laplacian : Laplacian
        On n points.
    k : int
        Number of modes, zero modes included; at most the number of free points.
    solver : Eigensolver, default Arpack()
        `Arpack`, `Multilevel`, `Refined`, `Lobpcg`, `Dense`; approximate: `Neo`, `Polished`,
        `RayleighRitz`; or your own.

    Returns
    -------
    Spectrum
        Certified: residuals, orthonormality and the count of zero modes come with it.

    Raises
    ------
    InvalidInputError
        If `k` is not an integer in [1, n_free].
    ConvergenceError
        If an iterative backend stopped short; ``partial`` holds the certified modes it had, and
        those of the components solved before. Modes may be missing between them.
    InvalidSpectrumError
        If the backend returned pairs of the wrong shape, not M-orthonormal, or negative.
    OutOfMemoryError
        If the backend needs more memory than there is; ``partial`` holds the certified modes of
        the components solved before.

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
    if isinstance(solver, type) or not callable(getattr(solver, "eigenpairs", None)):
        raise InvalidInputError(
            f"`solver` must have a method eigenpairs(laplacian, k), got {solver!r};"
            " pass an instance, such as Arpack()"
        )
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
    name = repr(solver)  # before the work: a name that can't be told must not cost the result
    tally = _Tally()
    try:
        pairs = _solve_components(laplacian, k, solver, tally)
    except NotConvergedError as error:
        partial = _rescued(laplacian, k, solver, name, tally, start)
        raise ConvergenceError(f"{name}: {error}", partial=partial) from error
    except MemoryError as error:
        traceback.clear_frames(error.__traceback__)  # its arrays make room for what is rescued
        try:
            partial = _rescued(laplacian, k, solver, name, tally, start)
        except MemoryError:
            partial = None
        raise OutOfMemoryError(
            f"{name}: {k} modes on {laplacian.n} points do not fit into memory ({error}); ask for"
            " fewer, sample fewer points, or take a backend that needs less, such as"
            " Refined(method='chebyshev') or Lobpcg(preconditioner='amg')",
            partial=partial,
        ) from error
    return _pack(laplacian, pairs, solver, name, tally, start)


@dataclass
class _Tally:
    """What was solved so far, and what the solver reports about it, summed over the components."""

    parts: list[Ints] = field(default_factory=list)  # the points of each component
    solved: dict[int, Eigenpairs] = field(default_factory=dict)  # by component
    seconds: dict[str, float] = field(default_factory=dict)
    iterations: int | None = None

    def add(self, pairs: Eigenpairs, seconds: float) -> None:
        """Count one component, which took so many `seconds` where its solver does not say."""
        for stage, spent in (pairs.seconds or {"solve": seconds}).items():
            self.seconds[stage] = self.seconds.get(stage, 0.0) + spent
        if pairs.iterations is not None:
            self.iterations = (self.iterations or 0) + pairs.iterations


def _solve_components(
    laplacian: Laplacian, k: int, solver: Eigensolver, tally: _Tally
) -> Eigenpairs:
    """Solve each component and merge the k lowest pairs of all, eigenvectors padded with zeros."""
    whole = laplacian.n_components == 1 and not len(laplacian.fixed)
    parts = tally.parts = [laplacian.free] if whole else _component_indices(laplacian)
    areas = np.array([laplacian.mass[part].sum() for part in parts])
    # Weyl: a component's share of the low modes is about its share of the area.
    wanted = [
        min(len(part), k, math.ceil(1.1 * k * share) + 6)
        for part, share in zip(parts, areas / areas.sum(), strict=True)
    ]
    due = list(range(len(parts)))
    while due:
        for i in due:
            part = laplacian if whole else laplacian.restricted(parts[i])
            own = solver if whole else restricted(solver, parts[i])
            try:
                tally.solved[i] = _solve_connected(part, wanted[i], own, tally)
            except NotConvergedError as error:
                if error.pairs is not None:
                    tally.solved[i] = error.pairs
                raise
        found = [tally.solved[i].eigenvalues for i in range(len(parts))]
        cut = np.sort(np.concatenate(found))[k - 1 : k]
        # A component whose last mode is below the cut may hold more modes below it: ask for more.
        due = [
            i
            for i, values in enumerate(found)
            if wanted[i] < min(len(parts[i]), k) and (not len(cut) or values.max() < cut[0])
        ]
        for i in due:
            wanted[i] = min(len(parts[i]), k, 2 * wanted[i])
    merged = tally.solved[0] if whole else _merge(tally, laplacian.n, k)
    tally.solved.clear()  # gigabytes, while the merged ones are certified
    return merged


def _component_indices(laplacian: Laplacian) -> list[Ints]:
    """Return the free points of each component, ascending."""
    labels = laplacian.component_labels
    order = np.argsort(labels, kind="stable")[len(laplacian.fixed) :]
    return np.split(order, np.flatnonzero(np.diff(labels[order])) + 1)


def _merge(tally: _Tally, n: int, k: int) -> Eigenpairs:
    """Return the k lowest pairs (or all there are) of the components solved, on all n points."""
    pairs = list(tally.solved.values())
    parts = [tally.parts[i] for i in tally.solved]
    if not pairs:
        return Eigenpairs(np.empty(0), np.empty((n, 0)))
    values = np.concatenate([p.eigenvalues for p in pairs])
    owner = np.repeat(np.arange(len(pairs)), [len(p.eigenvalues) for p in pairs])
    column = np.concatenate([np.arange(len(p.eigenvalues)) for p in pairs])
    lowest = np.argsort(values, kind="stable")[:k]
    vectors = np.zeros((n, len(lowest)))
    for j, source in enumerate(lowest):
        part = owner[source]
        vectors[parts[part], j] = pairs[part].eigenvectors[:, column[source]]
    return Eigenpairs(values[lowest], vectors)


def _rescued(
    laplacian: Laplacian, k: int, solver: Eigensolver, name: str, tally: _Tally, start: float
) -> Spectrum | None:
    """Certify what was solved before a failure, if anything was."""
    pairs = _merge(tally, laplacian.n, k)
    return _pack(laplacian, pairs, solver, name, tally, start) if len(pairs.eigenvalues) else None


def _solve_connected(
    laplacian: Laplacian, k: int, solver: Eigensolver, tally: _Tally
) -> Eigenpairs:
    """Call the backend on one component, check the form of its answer, and sort it."""
    start = time.perf_counter()
    if laplacian.n == 1:  # an isolated point: nothing to solve
        value = laplacian.stiffness.diagonal() / laplacian.mass
        return Eigenpairs(value, 1 / np.sqrt(laplacian.mass)[:, None])
    try:
        pairs = Eigenpairs(*solver.eigenpairs(laplacian, k))
    except NotConvergedError as error:
        nothing = Eigenpairs(np.empty(0), np.empty((laplacian.n, 0)))
        tally.add(error.pairs or nothing, time.perf_counter() - start)
        raise
    values, vectors = np.asarray(pairs.eigenvalues), np.asarray(pairs.eigenvectors)
    if values.shape != (k,) or vectors.shape != (laplacian.n, k):
        raise InvalidSpectrumError(
            f"{solver!r} must return shapes ({k},) and ({laplacian.n}, {k}),"
            f" got {values.shape} and {vectors.shape}"
        )
    tally.add(pairs, time.perf_counter() - start)
    order = np.argsort(values, kind="stable")
    if not np.array_equal(order, np.arange(k)):
        values, vectors = values[order], vectors[:, order]
    if values[0] < -_NEGATIVE * laplacian.eigenvalue_spacing:
        raise InvalidSpectrumError(
            f"{solver!r} returned a negative eigenvalue ({values[0]:.3e}); is the stiffness"
            " positive semi-definite?"
        )
    return _with_exact_constant(laplacian, np.maximum(values, 0.0), vectors)


def _with_exact_constant(laplacian: Laplacian, values: Floats, vectors: Floats) -> Eigenpairs:
    """Take the rounding out of the zero mode of a connected Neumann operator.

    Its error is relative to the largest eigenvalue, which beside a much larger component would
    make it look like a mode of its own.
    """
    constant = 1 / np.sqrt(laplacian.area)
    cosine = constant * (laplacian.mass @ vectors[:, 0])
    if laplacian.kernel_dimension and abs(abs(cosine) - 1) < _CONSTANT:
        values, vectors = values.copy(), vectors.copy()
        values[0], vectors[:, 0] = 0.0, np.sign(cosine) * constant
    return Eigenpairs(values, vectors)


def _pack(
    laplacian: Laplacian,
    pairs: Eigenpairs,
    solver: Eigensolver,
    name: str,
    tally: _Tally,
    start: float,
) -> Spectrum:
    """Check and certify `pairs`, and say where they come from."""
    solved = time.perf_counter()
    order = np.argsort(pairs.eigenvalues, kind="stable")
    vectors = pairs.eigenvectors
    if not np.array_equal(order, np.arange(len(order))):
        vectors = vectors[:, order]
    values = np.maximum(pairs.eigenvalues[order], 0.0)
    spectrum = Spectrum(values, vectors, laplacian.mass).certify(laplacian)
    assert spectrum.certificate is not None
    if (error := spectrum.certificate.orthonormality_error) > _ORTHONORMAL:
        raise InvalidSpectrumError(
            f"{name} returned modes that are not M-orthonormal: |U^T M U - I| is {error:.2e}"
        )
    certified = time.perf_counter()
    other = max(solved - start - sum(tally.seconds.values()), 0.0)
    provenance = Provenance(
        solver=name,
        operator=laplacian.operator,
        seed=None if (seed := getattr(solver, "seed", None)) is None else int(seed),
        seconds={
            "assembly": laplacian.seconds,
            **tally.seconds,
            "other": other,
            "certify": certified - solved,
        },
        input_hash=_fingerprint(laplacian),
        version=VERSION,
        iterations=tally.iterations,
    )
    return Spectrum(
        spectrum.eigenvalues, spectrum.eigenvectors, spectrum.mass, spectrum.certificate, provenance
    )


def _fingerprint(laplacian: Laplacian) -> str:
    """Return a hash of all that defines the eigenproblem."""
    digest = hashlib.blake2b(digest_size=16)
    L = laplacian.stiffness
    for integers in (L.indptr, L.indices, laplacian.fixed):  # whatever width scipy chose for them
        digest.update(np.ascontiguousarray(integers, dtype=np.int64).data)
    for floats in (L.data, laplacian.mass, laplacian.points):
        digest.update(np.ascontiguousarray(floats).data)
    return digest.hexdigest()
