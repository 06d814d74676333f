"""`HeatStep`: one implicit step of heat flow, as accurate where it is coldest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components, dijkstra

from spectra_kit._core.checked import checked
from spectra_kit._core.clock import Clock
from spectra_kit._core.types import Floats, Ints32
from spectra_kit._sparse.elimination import Elimination
from spectra_kit._sparse.incomplete_cholesky import incomplete_factor
from spectra_kit._sparse.ldl import SparseLDL
from spectra_kit.errors import ConvergenceError, InvalidInputError

_DROP = 1e-4  # of the incomplete factor: some 13 iterations, and three times the entries of L
_ACCURACY = 1e-10  # componentwise backward error
_DECAY = 0.8  # of log u per sqrt(t), a little less than it is: to choose exponents
_LIFT = 1000  # a direct solution is at most 2**1000, and may fall to
_FLOOR = 1e-290  # before digits are lost
_STEP = 64  # between exponents, a power of two: squares of values from 1 to 2**64 are in range


@checked
@dataclass(frozen=True, eq=False, repr=False)
class Heat:
    """Heat at n points, after one step: ``values * 2**exponents``, which float64 may not hold.

    Attributes
    ----------
    values : ndarray of shape (n,)
        Positive; 0 where no heat can come.
    exponents : ndarray of shape (n,), int32
        Powers of two.
    method : str
        What solved the step.
    iterations : int
        0 for a direct solution.
    backward_error : float
        Largest ``|b - A u|_i / (|b| + |A| |u|)_i`` over the points i. Componentwise, as the
        direction of the flow matters everywhere, and u spans hundreds of orders of magnitude.
    seconds : float
        Without the factor.
    """

    values: Floats
    exponents: Ints32
    method: str
    iterations: int
    backward_error: float
    seconds: float

    @property
    def log(self) -> Floats:
        """Natural logarithm, minus infinity where no heat can come, shape (n,)."""
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(self.values) + np.log(2.0) * self.exponents)

    def moved(self, move: Callable[[NDArray[Any]], NDArray[Any]]) -> Heat:
        """Return the same on points in another order or number.

        `move` takes an array (n,) on these points to one (m,) on the others, such as by an index;
        it is called with values and with exponents.
        """
        return replace(self, values=move(self.values), exponents=move(self.exponents))

    def spread(self, inside: NDArray[np.bool_]) -> Heat:
        """Return the same on all points, of which these are those `inside`; the others are cold."""
        inside = np.asarray(inside, dtype=bool)
        if inside.ndim != 1 or inside.sum() != len(self.values):
            raise InvalidInputError(
                "inside",
                f"be a vector with {len(self.values)} points in it",
                f"{int(inside.sum())} of shape {inside.shape}",
            )

        place = np.maximum(np.cumsum(inside) - 1, 0)
        return self.moved(lambda values: np.where(inside, values[place], 0).astype(values.dtype))

    def plus(self, other: Heat) -> Heat:
        """Return the sum of two heats, with iterations and seconds of both and the larger error."""
        low = np.iinfo(np.int32).min // 4
        exponents = np.maximum(*(np.where(h.values > 0, h.exponents, low) for h in (self, other)))
        exponents = np.where(exponents > low, exponents, 0)
        values = sum(
            np.ldexp(h.values, np.minimum(h.exponents - exponents, 0)) for h in (self, other)
        )
        method = self.method if self.method == other.method else f"{self.method}, {other.method}"
        return Heat(
            np.asarray(values),
            exponents.astype(np.int32),
            method,
            self.iterations + other.iterations,
            max(self.backward_error, other.backward_error),
            self.seconds + other.seconds,
        )


class HeatStep:
    """The system ``(M + t L) u = b`` of one implicit Euler step, factorised for any b >= 0.

    L (`stiffness`) has no positive entries off its diagonal beyond rounding, as a Delaunay
    Laplacian, which keeps u positive; points that are not `inside` are kept at zero. What follows
    needs the direction in which u decays, so u must be right relative to itself at
    every point, ``exp(-d / sqrt(t))`` and all. A complete Cholesky factor of such a matrix gives
    that, as nothing cancels; conjugate gradients, which stop at a norm, do not. An incomplete one
    does so too: ``A = F - R`` with R >= 0 is a regular splitting, and the iteration
    ``F u' = b + R u`` rises to u from below, point by point (Meijerink and van der Vorst, *An
    Iterative Solution Method for Linear Systems of Which the Coefficient Matrix is a Symmetric
    M-Matrix*, 1977). Where triangles are much smaller than sqrt(t) it is slow, and BiCGStab goes
    on from there. With exponents beside the values, found by a search along the edges, nothing
    underflows however far away a point is.
    """

    def __init__(
        self,
        stiffness: sparse.csr_array,
        mass: Floats,
        points: Floats,
        *,
        duration: float,
        inside: NDArray[np.bool_] | None = None,
        direct: bool,
        elimination: Elimination | None = None,
    ) -> None:
        self._inside = inside
        if inside is not None:
            elimination = None
            stiffness = sparse.csr_array(stiffness[inside][:, inside])
            mass, points = mass[inside], points[inside]
        # In units of the mean mass: the same numbers whatever the unit of length.
        self._unit = float(mass.mean())
        self._mass, self._points = mass / self._unit, points
        self._matrix = _raised(duration / self._unit * stiffness, self._mass)
        self._root = float(np.sqrt(duration))
        self._complete = self._factor(elimination) if direct else None
        if not direct:
            _ = self._incomplete

    def _factor(self, elimination: Elimination | None) -> SparseLDL:
        try:
            return SparseLDL(self._matrix, elimination=elimination)
        except InvalidInputError as error:
            raise InvalidInputError(
                "time_coefficient",
                "leave heat that is not the same all over, to rounding",
                f"a heat step without a factor ({error})",
                advice="lower it, or look at the geometry with `diagnose`",
            ) from error

    @cached_property
    def _incomplete(self) -> tuple[sparse.csr_array, Floats]:
        """L by rows and 1 / D of ``(I + L) D (I + L)^T``."""
        above = sparse.triu(self._matrix, 1, format="csr")
        above.sort_indices()
        broken, upper, inverse = incomplete_factor(above, self._matrix.diagonal(), _DROP, 0.0)
        if broken >= 0:
            raise InvalidInputError(
                "geometry",
                "have a Laplacian without positive entries off its diagonal",
                f"one whose heat step has no incomplete factor (row {broken})",
                advice="use `intrinsic_delaunay`, or solver=Direct()",
            )
        return sparse.csr_array(upper.T.tocsr()), inverse

    @cached_property
    def _labels(self) -> NDArray[np.int32]:
        """Connected components of the points that are not kept at zero."""
        return np.asarray(connected_components(self._matrix, directed=False)[1])

    @cached_property
    def _costs(self) -> sparse.csr_array:
        """How much ``-log u`` may grow along each edge, at most."""
        from spectra_kit.geodesics._kernels import edge_costs

        A = self._matrix
        costs = edge_costs(
            A.indptr, A.indices, A.data, A.diagonal(), self._points, _DECAY / self._root
        )
        return sparse.csr_array((costs, A.indices, A.indptr), shape=A.shape)

    def solve(self, sides: Sequence[Floats]) -> list[Heat]:
        """Return u for each b (n,) of `sides`, not negative and not zero.

        By a complete factor all at once: what that takes is shared out evenly among their seconds.
        `ConvergenceError` where the iteration does not reach its accuracy, as it may not where
        triangles differ in size by orders of magnitude.
        """
        if not sides:
            return []
        inside, clock = self._inside, Clock()
        sides = [(rhs if inside is None else rhs[inside]) / self._unit for rhs in sides]
        largest = [(rhs / self._mass).max() for rhs in sides]  # of u, by the maximum principle
        sides = [rhs / most for rhs, most in zip(sides, largest, strict=True)]
        direct: Sequence[Heat | None] = [None] * len(sides)
        if self._complete is not None:
            lifted = [np.ldexp(rhs, _LIFT) for rhs in sides]
            solved = np.ascontiguousarray(self._complete.solve(np.column_stack(lifted)).T)
            direct = [self._in_range(rhs, u) for rhs, u in zip(lifted, solved, strict=True)]
        share = clock.total / len(sides)
        found = [heat or self._iterate(rhs) for heat, rhs in zip(direct, sides, strict=True)]
        found = [
            replace(heat, values=most * heat.values, seconds=heat.seconds + share)
            for heat, most in zip(found, largest, strict=True)
        ]
        return found if inside is None else [heat.spread(inside) for heat in found]

    def _in_range(self, lifted: Floats, u: Floats) -> Heat | None:
        """Return what a direct solution says, of no time, or None if it underflows."""
        from spectra_kit.geodesics._kernels import residual

        if not (u > _FLOOR).all():
            reached = np.isin(self._labels, self._labels[lifted > 0])
            if not (u[reached] > _FLOOR).all():
                return None
            u = np.where(reached, u, 0.0)
        if not np.isfinite(u).all():
            return None
        A = self._matrix
        share = residual(A.indptr, A.indices, A.data, lifted, u, np.empty_like(u))
        # Neighbours with one exponent are quicker to compare: there are few different ones.
        exponents = np.frexp(u)[1] & -_STEP
        return Heat(np.ldexp(u, -exponents), exponents - _LIFT, "Cholesky", 0, share, 0.0)

    def _iterate(self, rhs: Floats) -> Heat:
        from spectra_kit.geodesics._heat_iteration import iterate

        clock = Clock()
        cost = dijkstra(self._costs, indices=np.flatnonzero(rhs), min_only=True)
        guess = np.where(np.isfinite(cost), np.rint(cost / -np.log(2)), 0.0).astype(np.int32)
        x, exponents, iterations, share = iterate(
            self._matrix, *self._incomplete, rhs, guess, accuracy=_ACCURACY
        )
        heat = Heat(x, exponents, "incomplete Cholesky", iterations, share, clock.total)
        if share <= _ACCURACY and (x >= 0).all():
            return heat
        raise ConvergenceError(
            f"the heat step must be right to {_ACCURACY:g} at every point, got {share:.1e}"
            f" after {iterations} iterations; triangles differ too much in size, or"
            " `time_coefficient` is large: use solver=Direct()",
            partial=heat,
        )


def _raised(matrix: sparse.csr_array, diagonal: Floats) -> sparse.csr_array:
    """Return ``matrix + diag(diagonal)``, in the pattern of `matrix` if that holds its diagonal."""
    rows = np.repeat(np.arange(len(diagonal), dtype=np.int32), np.diff(matrix.indptr))
    own = np.flatnonzero(rows == matrix.indices)
    if len(own) < len(diagonal):
        summed = sparse.csr_array(matrix + sparse.diags_array(diagonal))
        summed.sort_indices()
        return summed
    entries = matrix.data.copy()
    entries[own] += diagonal
    return sparse.csr_array((entries, matrix.indices, matrix.indptr), matrix.shape)
