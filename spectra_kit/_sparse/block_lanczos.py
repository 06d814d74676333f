"""Block Lanczos, reorthogonalised when that is needed, grown step by step."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from spectra_kit._core.threads import in_threads, ranges
from spectra_kit._core.types import Floats

_POINTS = 8_192  # of one task: fixed, so that no sum depends on the threads
_ROUNDED = 1e-15  # what is left of other vectors in one that was orthogonalised against them
_NOTHING = 1e-10  # of the norm of the operator: a new block is no larger
_SEMI = 1e-12  # the same, at most: residuals of Ritz pairs are no smaller than that
# Where these may be larger: the projection is still rounded as if the vectors were orthogonal
# (Simon, *The Lanczos algorithm with partial reorthogonalization*, 1984).
_SEMI_LOOSE = 1e-8
_WELL_APART = 1e-3  # diagonal of a Cholesky factor: what the Gram matrix rounds is below that
# Of the operator, by which a loose start is multiplied: four solves of a block save five steps.
_POWERS = 4


class KrylovPairs(NamedTuple):
    """Ritz pairs of a Krylov space: m values, ascending, and the norms of ``A x - value x``.

    `rotation`, of shape (m, m), leads from the basis to their vectors.
    """

    values: Floats
    residuals: Floats
    rotation: Floats


class BlockLanczos:
    """Krylov space of a symmetric operator and a few random vectors.

    The `operator` takes columns of shape (n, block) to the same. Eigenvalues of up to `block`
    copies are found with all of them. `most` vectors are allocated at once: whole steps, and one
    block less than n.

    Golub and Underwood, *The block Lanczos method for computing eigenvalues*, 1977. In exact
    arithmetic a block is orthogonal to all but the two before it. What rounding leaves of the
    others grows in each step by the norm of the operator over that of the new block at most: before
    it is felt, the last two blocks are orthogonalised against all others together, which takes one
    look at these instead of two (Grimes, Lewis and Simon, *A shifted block Lanczos algorithm*,
    1994). A `loose` space is for residuals above 1e-6. Vectors are rows here, whose products with a
    block are twice as fast; no bit of a sum depends on the number of threads.
    """

    def __init__(
        self,
        operator: Callable[[Floats], Floats],
        n: int,
        *,
        block: int,
        most: int,
        seed: int,
        loose: bool = False,
    ) -> None:
        self._operator, self._block = operator, block
        self._loose, self._apart = loose, _SEMI_LOOSE if loose else _SEMI
        self.size = 0  # vectors whose images are known; one more block is there
        self._basis = np.empty((most + block, n))
        self._projected = np.zeros((most + block, most + block))
        start = np.random.default_rng(seed).standard_normal((n, block))
        if loose:
            for _ in range(_POWERS):
                start = operator(start)
            self._basis[:block] = np.linalg.qr(start)[0].T
        else:
            self._basis[:block] = _orthonormal(start.T, loose)[0]
        self._norm, self._new = 0.0, 0.0  # of the operator in the space, and of the last block
        self._loss = _ROUNDED  # of orthogonality of the last block, at most

    def step(self) -> None:
        """Apply the operator to the last block, and append what is new in the image."""
        block, end = self._block, self.size + self._block
        last, following = slice(self.size, end), slice(end, end + block)
        before = max(self.size - block, 0)
        W = self._basis[following]
        W[:] = self._operator(np.ascontiguousarray(self._basis[last].T)).T
        inside = self._take_out(following, before, end)[:, -block:]
        self._projected[last, last] = (inside + inside.T) / 2
        self._norm = max(self._norm, float(np.linalg.norm(inside)))
        if self._loss * self._norm > self._apart * self._new:
            self._take_out(slice(self.size, end + block), 0, self.size)
            self._loss = _ROUNDED
        else:
            self._loss *= self._norm / self._new
        self._take_out(following, before, end)
        try:
            Q, R = _orthonormal(W, self._loose)
        except np.linalg.LinAlgError:
            Q, R = W, np.zeros((block, block))
        sizes = np.sort(R.diagonal())[::-1] if self._loose else np.linalg.svd(R, compute_uv=False)
        self._norm, self._new = max(self._norm, float(sizes[0])), float(sizes[-1])
        if self._new <= _NOTHING * self._norm:  # the space is all but invariant: this is rounding
            Q, R = np.linalg.qr(W.T)
            W[:] = Q.T
            self._take_out(following, 0, end)
            Q = np.linalg.qr(W.T)[0].T
        W[:] = Q
        self._projected[following, last], self._projected[last, following] = R, R.T
        self.size = end

    def ritz(self) -> KrylovPairs:
        """Return all Ritz pairs."""
        m = self.size
        values, rotation = np.linalg.eigh(self._projected[:m, :m])
        border = self._projected[m : m + self._block, m - self._block : m]
        norms = np.linalg.norm(border @ rotation[-self._block :], axis=0)
        return KrylovPairs(values, norms, rotation)

    def lifted(self, rotation: Floats) -> Floats:
        """Return vectors as rows, (s, n), whose coefficients are the columns of `rotation`."""
        return combined(rotation.T, self._basis[: self.size])

    def _take_out(self, rows: slice, first: int, last: int) -> Floats:
        """Subtract from rows of the basis what lies in others; return the coefficients."""
        W, others = self._basis[rows], self._basis[first:last]
        inside = inner(W, others)
        W -= combined(inside, others)
        return inside


def inner(A: Floats, B: Floats) -> Floats:
    """Return ``A B^T`` of long rows."""
    cuts = ranges(A.shape[1], _POINTS)
    if len(cuts) == 1:  # with less ado
        return np.asarray(A @ B.T)
    parts = in_threads(lambda a, b: A[:, a:b] @ B[:, a:b].T, cuts)
    return np.asarray(sum(parts[1:], start=parts[0]))


def combined(coefficients: Floats, A: Floats) -> Floats:
    """Return combinations of long rows."""
    cuts = ranges(A.shape[1], _POINTS)
    if len(cuts) == 1:
        return np.asarray(coefficients @ A)
    out = np.empty((len(coefficients), A.shape[1]))

    def fill(a: int, b: int) -> None:
        out[:, a:b] = coefficients @ A[:, a:b]

    in_threads(fill, cuts)
    return out


def _orthonormal(W: Floats, loose: bool) -> tuple[Floats, Floats]:
    """Return orthonormal rows Q and R with ``W = R^T Q``, by Cholesky factors of Gram matrices.

    Twice, unless they may be `loose` and are well apart in W.
    """
    if loose:
        once = np.linalg.cholesky(inner(W, W))
        if once.diagonal().min() > _WELL_APART * once.diagonal().max():
            return combined(np.linalg.inv(once), W), np.asarray(once.T, np.float64)
    size = np.linalg.norm(W, axis=1)
    if not (size > 0).all():
        raise np.linalg.LinAlgError("a row is zero, or not a number")
    first = np.linalg.cholesky(inner(W, W) / size / size[:, None])
    Q = combined(np.linalg.inv(first) / size, W)
    second = np.linalg.cholesky(inner(Q, Q))
    return combined(np.linalg.inv(second), Q), second.T @ (first.T * size)
