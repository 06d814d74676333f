"""Block Lanczos, reorthogonalised when that is needed, grown step by step."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtri

from spectra_kit._core.threads import in_threads, ranges
from spectra_kit._core.types import Floats

_POINTS = 8_192  # of one task: fixed, so that no sum depends on the threads
_CACHED = 4_096  # the same, of which three blocks stay in the cache
_ROUNDED = 1e-15  # what is left of other vectors in one that was orthogonalised against them
_CLEAN = 1e-14  # the same, at most, where nothing is to be gained
_NOTHING = 1e-10  # of the norm of the operator: a new block is no larger
_SEMI = 1e-10  # the same, at most
# Where these may be larger: the projection is still rounded as if the vectors were orthogonal
# (Simon, *The Lanczos algorithm with partial reorthogonalization*, 1984).
_SEMI_LOOSE = 1e-6
# Of the operator, by which the start is multiplied: four products save as many steps, whose vectors
# would have to be held, and others to be orthogonalised against them. More save less.
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
    it is felt, a new block is orthogonalised against all others; together with the last one, where
    that was not, which takes one look at these instead of two (Grimes, Lewis and Simon, *A shifted
    block Lanczos algorithm*, 1994). A `loose` space is for residuals above 1e-6. Vectors are rows
    here, whose products with a block are twice as fast; no bit of a sum depends on the number of
    threads.

    Where ``A M`` is symmetric in the inner product of an M, so is all of this: `weighed` takes rows
    x to M x, and the operator columns M x to A M x.
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
        weighed: Callable[[Floats], Floats] | None = None,
    ) -> None:
        self._operator, self._block, self._cuts = operator, block, ranges(n, _CACHED)
        self._weighed = weighed
        self._loose, self._apart = loose, _SEMI_LOOSE if loose else _SEMI
        self.size = 0  # vectors whose images are known; one more block is there
        self._basis = np.empty((most + block, n))
        self._projected = np.zeros((most + block, most + block))
        start = np.random.default_rng(seed).standard_normal((n, block))
        self._input = _orthonormal(start)
        for _ in range(_POWERS):
            self._input = _orthonormal(operator(self._input))
        self._basis[:block] = self._input.T
        if weighed is not None:
            self._images = np.empty((3 * block, n))  # M times the last two blocks, and the new one
            self._orthonormalise(self._basis[:block])
            self._images[block : 2 * block] = weighed(self._basis[:block])
            self._input = np.ascontiguousarray(self._images[block : 2 * block].T)
        self._norm, self._new = 0.0, 0.0  # of the operator there, and least of the last block
        self._loss = _ROUNDED  # of orthogonality of the last block, at most

    def step(self) -> None:
        """Apply the operator to the last block, and append what is new in the image.

        The image is orthogonalised twice, and made orthonormal by Cholesky factors twice. What is
        done to the same numbers is done to a range of points after the other, while it is at hand.
        """
        block, size, end = self._block, self.size, self.size + self._block
        W, last = self._basis[end : end + block], self._basis[size:end]
        recent = self._basis[max(size - block, 0) : end]
        # M times them, and times what is new.
        images, new = recent, W
        if self._weighed is not None:
            images, new = np.split(self._images[-block - len(recent) :], [-block])
        image = self._operator(self._input)

        def taken(a: int, b: int) -> Floats:
            W[:, a:b] = image[a:b].T
            return W[:, a:b] @ images[:, a:b].T

        inside = self._sum(taken)
        own = inside[:, -block:]
        self._projected[size:end, size:end] = (own + own.T) / 2
        self._norm = max(self._norm, float(np.linalg.norm(own)))
        unsure = self._loss * self._norm > self._apart * self._new
        # With the last block, unless it was orthogonalised when it came.
        both = unsure and self._loss > _CLEAN
        rows = self._basis[size if both else end : end + block]
        older = self._basis[:size] if unsure else recent[:-block]
        heavy = rows if new is W else self._images[block if both else 2 * block :]

        def less(a: int, b: int) -> Floats:
            W[:, a:b] -= inside @ recent[:, a:b]
            return products(a, b) if self._weighed is None else np.zeros(0)

        def products(a: int, b: int) -> Floats:
            found = np.zeros((len(rows), len(older) + 2 * block))
            found[:, : len(older)] = heavy[:, a:b] @ older[:, a:b].T
            found[-block:, len(older) :] = new[:, a:b] @ np.vstack([last[:, a:b], W[:, a:b]]).T
            return found

        if self._weighed is not None:
            self._sum(less)
            new[:] = self._weighed(W)
            less = products
        far, near, square = np.split(self._sum(less), [len(older), len(older) + block], axis=1)
        near, square = near[-block:], square[-block:]
        first = _root(square - far[-block:] @ far[-block:].T - near @ near.T)
        once = np.eye(block) if first is None else _inverse(first)

        def turned(a: int, b: int) -> Floats:
            rows[:, a:b] -= far @ older[:, a:b]
            part = W[:, a:b]
            part[:] = once @ (part - near @ last[:, a:b])
            return part @ part.T

        square = self._sum(turned)
        if self._weighed is not None:
            new[:] = self._weighed(W)
            square = inner(W, new)
            if both:
                images[-block:] = self._weighed(last)
        second = None if first is None else _root(square)
        R, again, self._new = np.zeros((block, block)), np.eye(block), 0.0
        if first is not None and second is not None:
            R, again = (first @ second).T, _inverse(second)
            self._new = 1 / float(np.linalg.norm(again @ once))
        largest = float(np.linalg.norm(R))
        self._norm = max(self._norm, largest)
        grows = largest if unsure else self._norm
        self._loss = (_ROUNDED if unsure else self._loss) * grows / (self._new or 1.0)
        if self._new <= _NOTHING * self._norm:  # the space is all but invariant: this is rounding
            Q, R = np.linalg.qr(W.T)
            R = R if first is None else R @ first.T
            others = self._basis[:end]
            for _ in range(2):
                weighty = Q if self._weighed is None else self._weighed(Q.T).T
                Q = np.linalg.qr(Q - others.T @ (others @ weighty))[0]
            W[:], again, self._loss = Q.T, np.eye(block), _ROUNDED
            if self._weighed is not None:
                self._orthonormalise(W)
                new[:] = self._weighed(W)

        def appended(a: int, b: int) -> None:
            W[:, a:b] = again @ W[:, a:b]
            if new is not W:
                new[:, a:b] = again @ new[:, a:b]
            self._input[a:b] = new[:, a:b].T

        in_threads(appended, self._cuts)
        if new is not W:
            self._images[:block] = self._images[block : 2 * block]
            self._images[block : 2 * block] = new
        self._projected[end : end + block, size:end] = R
        self._projected[size:end, end : end + block] = R.T
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

    def _orthonormalise(self, rows: Floats) -> None:
        """Make a few rows orthonormal in M."""
        assert self._weighed is not None
        for _ in range(2):
            root = np.asarray(np.linalg.cholesky(inner(rows, self._weighed(rows))), float)
            rows[:] = _inverse(root) @ rows

    def _sum(self, part: Callable[[int, int], Floats]) -> Floats:
        """Return the sum of what is found in ranges of points."""
        first, *others = in_threads(part, self._cuts)
        return np.asarray(sum(others, start=first))


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


def _orthonormal(columns: Floats) -> Floats:
    """Return a few columns made orthonormal, by Cholesky factors twice: LAPACK has one thread."""
    cuts = ranges(len(columns), _POINTS)
    for _ in range(2):
        first, *others = in_threads(partial(_squared, columns), cuts)
        root = _root(np.asarray(sum(others, start=first)))
        if root is None:
            return np.linalg.qr(columns)[0]
        right = np.ascontiguousarray(_inverse(root).T)
        columns = np.concatenate(in_threads(partial(_turned, columns, right), cuts))
    return columns


def _squared(columns: Floats, a: int, b: int) -> Floats:
    return np.asarray(columns[a:b].T @ columns[a:b])


def _turned(columns: Floats, right: Floats, a: int, b: int) -> Floats:
    return np.asarray(columns[a:b] @ right)


def _root(gram: Floats) -> Floats | None:
    """Return the Cholesky factor of the Gram matrix of some rows, of any lengths.

    Nothing where a row is zero, or not a number, or hardly lies outside of the others.
    """
    size = np.sqrt(gram.diagonal().clip(0))
    if not (size > 0).all():
        return None
    root, failed = dpotrf(gram / size / size[:, None], lower=True)  # without NumPy's 30 µs
    return None if failed else np.asarray(size[:, None] * root)


def _inverse(lower: Floats) -> Floats:
    """Return the inverse of a lower triangle."""
    return np.asarray(dtrtri(lower, lower=True)[0])
