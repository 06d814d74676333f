"""Spectrum slicing: many eigenpairs from Lanczos runs around several shifts, and counts."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from spectra_kit._core.clock import Clock
from spectra_kit._core.records import frozen
from spectra_kit._core.threads import in_threads, shares, single_threaded_blas, team
from spectra_kit._core.types import Floats
from spectra_kit._sparse.block_lanczos import BlockLanczos, combined, inner
from spectra_kit._sparse.elimination import Elimination
from spectra_kit._sparse.ldl import SparseLDL
from spectra_kit._sparse.pencil import Pencil
from spectra_kit._sparse.products import rows_of

_BLOCK = 8  # vectors of a step: solved together they cost a third; more need a larger space
#: The same where clusters are larger than a space of those finds: four times as much memory.
WIDE = 4 * _BLOCK
_ENOUGH = 64  # steps of a run: beyond, another factor costs less than their products
_STEPS = 88  # the same at most, where the modes below its shift are not yet all found
#: Vectors of a space at most.
MOST = _STEPS * _BLOCK
# Of its distance to the first shift have as many modes as Weyl's law says. On real models 0.6 to 2
# take one shift more at most, for 300 modes.
_GUESS = 0.8
_BELOW = 0.5  # share of the wanted modes below the first shift
_FIRST = 80  # the same, at most
# Vectors that find one mode more, once some have converged, and for each digit of the tolerance
# before that, on shapes of 1,000 to 8,000 points, for 30 to 400 modes; and how many steps more or
# fewer some shapes take.
_EACH, _DIGIT, _SPREAD = 2, 5, 2
# A look at what has converged grows with the cube of the vectors, a step with these and the points.
# Where the square of the vectors is so many times the points, it costs two steps.
_DEAR = 8
_LOOSE_EACH, _LOOSE_DIGIT = 1.5, 10  # nine times of ten, of 6 to 96 modes
_ONE_SIDED = 0.7  # of what the first run reached above its shift, others reach to either side
_SAFE = 0.8  # of what the last run reached, the next is asked for
_LEAST = 1e-3  # of the spacing: the same, where so many are equal
_DENSITY = 100  # modes whose distance tells where the next are
_ROUNDING = 1e-12  # residuals of the inverse, relative to its eigenvalues
_LOOSEST = 1e-2  # the same: its square is the error of an eigenvalue
_OWN = 0.5  # of the length of a vector, at least, lies outside of those before it
_NEARER = 2  # times the square of a residual is an error: what is not found is half as far as zero
_SHARED = 1e-6  # the same: its square, of what runs share, is rounding
_BORDER = 1e-7  # of the distance of two shifts: a narrower gap may be one within a cluster
_ACCURATE = 1e-10  # backward error of a solution, entry by entry
# Times as many modes below a shift as expected are too many for one run. With a guess of 2, which
# is too far, 1.1 to 2.5 take as many shifts on these.
_DENSER = 1.5
# The three with a loose tolerance, by which one run finds 96 modes of 1,024 points in the fewest
# steps: those below the shift, beyond which there are none, converge before those above it.
_AIM = 0.6, 0.58, 1.25
# Of the distance of two shifts, where the later one has no factor: off an eigenvalue, by less than
# a run notices, as it finds tens of them.
_NUDGE = 1e-3
# Shifts tried in a row that lead to nothing: a distance halved so often is a thousandth.
_CLOSER = 10


class Sliced(NamedTuple):
    """What `sliced_eigenpairs` found: the m <= k lowest eigenvalues, ascending, and their vectors.

    These are M-orthonormal, of shape (n, m). `errors` estimates how far the eigenvalues are off, by
    the squares of residuals; `shifts` counts the factors that were made; `seconds` are wall time by
    stage.
    """

    eigenvalues: Floats
    eigenvectors: Floats
    errors: Floats
    shifts: int
    seconds: dict[str, float]
    pencil: Pencil
    """Of ``D^-1/2 L D^-1/2`` and ``D^-1/2 M D^-1/2``, whose eigenvalues these are: to count them.
    D is the diagonal of M."""


def vectors_held(k: int) -> int:
    """Return how many vectors of n numbers `sliced_eigenpairs` holds for k modes, at most.

    A space, and three copies of what one finds beside what all found; or three copies of these.
    """
    space = min(MOST, 4 * k + 16 * _BLOCK) + _BLOCK
    return max(space + k + 3 * min(k, MOST // 4), 3 * k)


@single_threaded_blas()
def sliced_eigenpairs(
    stiffness: sparse.csr_array,
    mass: Floats | sparse.csr_array,
    k: int,
    *,
    below: float,
    spacing: float,
    tol: float = 0.0,
    most_shifts: int = 1000,
    seed: int = 0,
    block: int = _BLOCK,
    elimination: Elimination | None = None,
    power: float = 1.0,
) -> Sliced:
    """Return the k lowest eigenpairs of ``L u = lambda M u``; fewer if `most_shifts` are too few.

    Around one shift after the other: block Lanczos with ``(A - sigma)^-1``,
    ``A = M^-1/2 L M^-1/2``, or, where M is no diagonal, with ``(L - sigma M)^-1 M`` in its inner
    product, both scaled by its diagonal; until residuals are `tol` of its eigenvalues, or rounding.
    The inertia of a factor is the number of eigenvalues below its shift: two runs go on until what
    they found between them is all there is, or the later shift moves closer. They are put together
    at the widest gap of what both found, which keeps clusters whole. The first shift is amid the
    wanted eigenvalues, as far as the mean `spacing` of eigenvalues tells, which grow with this
    `power` of their number (Weyl: 1 on surfaces, 2/3 in volumes); all of them are above `below`.
    With larger blocks than usual, a run takes all modes that its space has room for.

    After Grimes, Lewis and Simon, *A shifted block Lanczos algorithm for solving sparse symmetric
    generalized eigenproblems*, 1994.
    """
    clock, loose, whole = Clock(), tol > _SHARED, isinstance(mass, sparse.csr_array)
    root = np.sqrt(mass.diagonal() if whole else mass)
    n = len(root)
    guess, share, denser = _AIM if loose else (_GUESS, _BELOW, _DENSER)
    room = min(_STEPS * block, n // 2) // 4  # modes that a space of so many vectors finds
    tol = min(max(tol, _ROUNDING), _LOOSEST)
    A, weights, weighed = _scaled(stiffness, root), np.ones(n), None
    if whole:
        weights = _scaled(mass, root)
        weighed = partial(_weighed, weights)
    values, errors = np.empty(k), np.empty(k)
    X = np.empty((k, n))  # rows are eigenvectors of A
    first, counted, found = 0, 0, 0  # modes below the last run, below its shift, and all
    last, ahead, reach, shifts, closer = below, min(math.ceil(share * k), _FIRST), 1.0, 0, 0
    pencil = Pencil(A, weights, elimination)
    sigma = below + (guess * ahead) ** power * spacing
    with team():
        while found < k and shifts < most_shifts and closer < _CLOSER:
            top = values[found - 1] if found else last
            factor = _factor(pencil, sigma)
            shifts += 1
            clock.stage("factor")
            if factor is None:
                sigma, closer = sigma + _NUDGE * (sigma - last), closer + 1
                continue
            number = factor.inertia.negative
            if number - found > (denser * ahead if block == _BLOCK else room):
                nearer = (ahead / (number - found)) ** power
                sigma, closer = top + (sigma - top) * nearer, closer + 1
                continue
            run = _Run(factor, sigma, tol, seed + shifts, block, weighed)
            above = min(ahead if found else k, k - number)
            cut = run.until(values[counted:found], number - counted, last, above)
            clock.stage("lanczos")
            if cut is None:
                sigma, closer = top + (sigma - top) / 2, closer + 1
                continue
            # From the widest gap on, the modes are those of this run.
            lower, upper = run.below[len(run.below) - (number - counted - cut) :], run.above
            begin, end = counted + cut, min(k, number + len(upper))
            pairs = run.pairs(np.concatenate([lower, upper])[: end - begin])
            values[begin:end], new, errors[begin:end] = pairs
            # What is farther than a run away is orthogonal where residuals are rounding.
            before = X[first if tol <= _ROUNDING else 0 : begin]
            heavy = new if weighed is None or not len(before) else weighed(new)
            X[begin:end] = new - combined(inner(heavy, before), before)
            clock.stage("pairs")
            gained, found = end > found, end
            if end < 2:
                break  # nothing to go by
            reached = min(len(run.below), len(upper)) if number else _ONE_SIDED * len(upper)
            reach = max(reach, _SAFE * reached)
            first, last, counted = begin, sigma, min(number, k)
            closer = 0 if gained else closer + 1
            ahead = math.ceil((k - found) / (2 * max(1, math.ceil((k - found) / (2 * reach)))))
            some = min(_DENSITY, found - 1)
            del run  # its space, before there is another
            step = np.ptp(values[found - 1 - some : found]) / some
            sigma = values[found - 1] + ahead * max(step, _LEAST * spacing)
    if loose and first > 0:
        own = X[:found]
        if weighed is None:
            Q, R = np.linalg.qr(own.T)
            own[:] = (Q * np.copysign(1.0, R.diagonal())).T
            if np.abs(R.diagonal()).min() < _OWN:  # two runs found the same: others were not found
                found = 0
        else:
            root_of = np.linalg.cholesky(inner(own, weighed(own)))
            own[:] = combined(np.linalg.inv(root_of), own)
    U = np.ascontiguousarray((X[:found] / root).T)
    return Sliced(values[:found], U, errors[:found], shifts, clock.seconds, pencil)


def _scaled(matrix: sparse.csr_array, root: Floats) -> sparse.csr_array:
    scaled = matrix.copy()
    scaled.data /= np.repeat(root, np.diff(scaled.indptr)) * root[scaled.indices]
    return scaled


def _weighed(mass: sparse.csr_array, rows: Floats) -> Floats:
    """Return M times long rows: spmm takes columns, and twice as long with the turning."""
    from spectra_kit._sparse._kernels import multiply_long

    out = np.empty(rows.shape)
    fixed = (*rows_of(mass), frozen(np.ascontiguousarray(rows)), out)
    in_threads(multiply_long, ((*fixed, *cut) for cut in shares(rows.shape[1])))
    return out


def vectors_for(modes: int, tol: float) -> float:
    """Return about how many vectors of a space find so many modes."""
    each, digit = (_LOOSE_EACH, _LOOSE_DIGIT) if tol > _SHARED else (_EACH, _DIGIT)
    return each * modes - digit * math.log10(min(max(tol, _ROUNDING), _LOOSEST))


def _factor(pencil: Pencil, sigma: float) -> SparseLDL | None:
    """Factorise at a shift; nothing where no factor without pivoting is accurate."""
    factor = pencil.factor(sigma)
    if factor is None:
        return None
    shifted, ones = pencil.shifted(sigma), np.ones(factor.n)
    # Two, as loops for several are needed anyhow: for one, others would have to be compiled.
    x = factor.solve(np.ones((factor.n, 2)))[:, 0]
    error = np.abs(shifted @ x - ones) / (abs(shifted) @ np.abs(x) + ones)
    return factor if error.max() <= _ACCURATE else None


class _Run:
    """Lanczos around one shift."""

    def __init__(
        self,
        factor: SparseLDL,
        sigma: float,
        tol: float,
        seed: int,
        block: int,
        weighed: Callable[[Floats], Floats] | None,
    ) -> None:
        self._factor, self._sigma, self._tol, self._block = factor, sigma, tol, block
        self._weighed = weighed
        self._loose = tol > _SHARED
        self._most = min(_STEPS, factor.n // (2 * block)) * block
        self._krylov = BlockLanczos(
            factor.solve,
            factor.n,
            block=block,
            most=self._most,
            seed=seed,
            loose=self._loose,
            weighed=weighed,
        )

    def until(self, known: Floats, number: int, last: float, above: int) -> int | None:
        """Go on until `above` modes have converged above the shift, and all below it.

        Where there are so many vectors that another shift is better, until the latter. `known` are
        found above the `last` shift, `number` of modes lie between the two. Returns how many of
        those known to take, None if that cannot be said.
        """
        krylov, cut, enough = self._krylov, None, _ENOUGH * self._block
        border = max(_BORDER, self._tol**2) * (self._sigma - last)
        below = max(number - len(known), 0)
        due = vectors_for(below + above, self._tol)
        dear = due**2 > _DEAR * self._factor.n
        if not self._loose:
            due += (_SPREAD if dear else -_SPREAD) * self._block
        while krylov.size < self._most:
            krylov.step()
            if krylov.size < min(due, enough, self._most):
                continue
            self._look()
            values = self._sigma + 1 / self._ritz.values[self.below]
            cut = _cut(known, values, number, border)
            missing = max(above - len(self.above), 0)
            if cut is not None and (not missing or krylov.size >= enough):
                break
            lacking = missing + max(below - len(self.below), 0)
            due = krylov.size + (_EACH * lacking if dear else 0)
        return cut

    def pairs(self, kept: NDArray[np.intp]) -> tuple[Floats, Floats, Floats]:
        """Return eigenvalues, eigenvectors as rows that are orthonormal to rounding, and errors.

        Those of eigenvalues of the inverse, relative to these, are as of eigenvalues, relative to
        their distances from the shift.
        """
        inverse = self._ritz.values[kept]
        errors = _NEARER * (self._ritz.residuals[kept] / inverse) ** 2 / np.abs(inverse)
        X = self._krylov.lifted(self._ritz.rotation[:, kept])
        if self._loose:
            return self._sigma + 1 / inverse, X, errors
        # One more product takes out what rounding left of frequencies.
        images = X if self._weighed is None else self._weighed(X)
        X = self._factor.solve_rows(images) / inverse[:, None]
        images = X if self._weighed is None else self._weighed(X)
        error = inner(X, images) - np.eye(len(kept))
        return self._sigma + 1 / inverse, X - combined(error / 2, X), errors

    def _look(self) -> None:
        """See which pairs have converged, without a hole up to the farthest from the shift."""
        self._ritz = ritz = self._krylov.ritz()
        good = ritz.residuals <= self._tol * np.abs(ritz.values)
        negative = int((ritz.values < 0).sum())
        # Close to the shift are the ends: eigenvalues of the inverse are largest there.
        self.below = np.arange(_leading(good[:negative]))[::-1]
        self.above = len(good) - 1 - np.arange(_leading(good[negative:][::-1]))


def _leading(good: NDArray[np.bool_]) -> int:
    """Return how many entries are true before the first that is not."""
    return len(good) if good.all() else int(good.argmin())


def _cut(known: Floats, found: Floats, number: int, narrow: float) -> int | None:
    """Return how many of the lower values to take so that with upper ones they are `number`.

    Both are ascending, what is `known` from the lower end of an interval on, what was `found` up to
    its upper end. None where they do not meet, or in no gap that is not `narrow`.
    """
    least, most = max(0, number - len(found)), min(len(known), number)
    if least > most:
        return None
    takes = np.arange(least, most + 1)
    below = np.concatenate([[-np.inf], known])[takes]
    above = np.append(found, np.inf)[len(found) - (number - takes)]
    best = int(np.argmax(above - below))
    return int(takes[best]) if above[best] - below[best] > narrow else None
