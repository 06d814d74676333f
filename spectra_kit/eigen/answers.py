"""What backends answer: of checked form, ascending, the constant exact; and what to ask of each."""

from __future__ import annotations

import numpy as np

from spectra_kit._core.threads import blas_threads_for
from spectra_kit._core.types import Ints
from spectra_kit._sparse.host import less
from spectra_kit._sparse.ritz import ritz_rotation
from spectra_kit.eigen.base import Eigenpairs, Eigensolver, NotConvergedError
from spectra_kit.eigen.small_parts import small_components
from spectra_kit.eigen.spectrum import Spectrum
from spectra_kit.errors import InvalidSpectrumError
from spectra_kit.operators.laplacian import Laplacian

#: Eigenvalues down to -this times the spacing are rounding, and become 0.
NEGATIVE = 1e-6
_ALONE = 0.99  # of the constant in one mode: the others hardly turn when it comes out
_CONSTANT = 1e-6  # modes that span the constant but for this share of it span it, up to rounding


def none(n: int) -> Eigenpairs:
    """Return no pairs, on n points."""
    return Eigenpairs(np.empty(0), np.empty((n, 0)), errors=np.empty(0))


def of_checked_form(pairs: Eigenpairs, solver: Eigensolver, shape: tuple[int, int]) -> Eigenpairs:
    """Return the pairs as arrays; refuse what has another shape or no real numbers."""
    n, k = shape
    values, vectors = np.asarray(pairs.eigenvalues), np.asarray(pairs.eigenvectors)
    if values.shape != (k,) or vectors.shape != shape:
        raise InvalidSpectrumError(
            f"{solver!r} must return shapes ({k},) and ({n}, {k}),"
            f" got {values.shape} and {vectors.shape}"
        )
    if pairs.errors is not None and np.shape(pairs.errors) != (k,):
        raise InvalidSpectrumError(
            f"{solver!r} must return errors of shape ({k},), got {np.shape(pairs.errors)}"
        )
    if values.dtype.kind not in "fiu" or vectors.dtype.kind not in "fiu":
        raise InvalidSpectrumError(
            f"{solver!r} must return real numbers, got {values.dtype} and {vectors.dtype}"
        )
    return pairs._replace(eigenvalues=values, eigenvectors=vectors)


def ascending(pairs: Eigenpairs) -> Eigenpairs:
    """Return the pairs ascending and none negative, eigenvectors without a copy where they are."""
    values, vectors, errors = pairs.eigenvalues, pairs.eigenvectors, pairs.errors
    if not (values[1:] >= values[:-1]).all():
        order = np.argsort(values, kind="stable")
        values, vectors = values[order], vectors[:, order]
        errors = None if errors is None else np.asarray(errors)[order]
    return pairs._replace(
        eigenvalues=np.maximum(values, 0.0),
        eigenvectors=vectors,
        errors=None if errors is None else np.array(errors),  # the solver may keep its own
    )


def modes_wanted(laplacian: Laplacian, parts: list[Ints], k: int, *, all_parts: bool) -> Ints:
    """Return how many modes of each component may be among the k lowest of all, at most.

    Where constants alone are as many, they are the lowest, one of each component; the first ones
    are taken, as of all that are equal. Otherwise, unless `all_parts` are to be solved, the
    eigenvalues of small ones tell which of them have nothing below the k-th lowest that is known.
    """
    constant = laplacian.constant_components
    if constant.sum() >= k:
        return np.where(constant & (constant.cumsum() <= k), 1, 0)
    most = np.array([min(len(part), k) for part in parts])
    if all_parts or len(parts) == 1:
        return most
    known = [np.zeros(constant.sum())]  # from below
    others = np.zeros(len(parts))  # the lowest that is not the constant's, less a margin
    for alike in small_components(laplacian, parts):
        values, i = alike.eigenvalues(), alike.which
        values[constant[i], 0] = np.inf  # is among those known
        off = NEGATIVE * alike.norms
        known.append((values + off[:, None]).ravel())
        others[i] = values.min(axis=1) - off
    lowest = np.sort(np.concatenate(known))
    if len(lowest) >= k:
        above = others > lowest[k - 1]
        most[above] = constant[above]
    return most


def component_indices(laplacian: Laplacian) -> list[Ints]:
    """Return the free points of each component, ascending."""
    labels = laplacian.component_labels
    order = np.argsort(labels, kind="stable")[len(laplacian.fixed) :]
    return np.split(order, np.flatnonzero(np.diff(labels[order])) + 1)


def open_modes(error: NotConvergedError, partial: Spectrum) -> int:
    """How many of the modes rescued are among those that had not converged."""
    if error.pairs is None or error.converged is None:
        return 0
    values = np.asarray(error.pairs.eigenvalues)[~error.converged]
    return int((values <= partial.eigenvalues[-1]).sum())


def with_exact_constant(laplacian: Laplacian, pairs: Eigenpairs) -> Eigenpairs:
    """Take the rounding out of the zero mode of a connected Neumann operator.

    Its error is relative to the largest eigenvalue, which beside a much larger component would
    make it look like a mode of its own. Where further eigenvalues are as good as zero, rounding
    mixes their modes with the constant: these are turned until one of them is the constant, the
    others solved for once more.
    """
    constant = 1 / np.sqrt(laplacian.area)
    with blas_threads_for(pairs.eigenvectors.size):
        cosines = constant * laplacian._row_sums.dot(pairs.eigenvectors)
    if not laplacian.kernel_dimension or not abs(cosines @ cosines - 1) <= _CONSTANT:
        return pairs
    sizes = np.abs(cosines)
    first, *more = np.flatnonzero(sizes >= min(_CONSTANT, sizes.max()))
    values, vectors = pairs.eigenvalues.copy(), less(pairs.eigenvectors, constant * cosines)
    errors = None if pairs.errors is None else np.array(pairs.errors)
    if more:
        near = [first, *more]
        # The first axis goes to the constant, the others span what else these modes span.
        axes = np.linalg.qr(cosines[near, None], mode="complete")[0]
        rest = vectors[:, near] @ axes[:, 1:]
        raised, others = ritz_rotation(laplacian.stiffness, laplacian._weights, rest)
        # Of loose modes, quotients are further off than what told their values.
        if errors is not None and cosines[first] ** 2 > _ALONE:
            raised = np.minimum(raised, np.sort(values[near])[1:])
        values[more], vectors[:, more] = raised, others
        if errors is not None:  # each of these may be as far off as any that it is made of
            errors[more] = errors[near].max()
    values[first], vectors[:, first] = -1.0, constant  # which comes first
    if errors is not None:
        errors[first] = 0.0
    return pairs._replace(eigenvalues=values, eigenvectors=vectors, errors=errors)
