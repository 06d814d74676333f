"""``L u = b`` with u given at some points, by a factor that a `Laplacian` keeps."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.types import Bools, Floats, Ints
from spectra_kit._core.validate import real_array
from spectra_kit._sparse.grounded import held_at_zero
from spectra_kit._sparse.ldl import SparseLDL
from spectra_kit._sparse.pencil import Pencil
from spectra_kit.errors import InvalidInputError, OutOfMemoryError

if TYPE_CHECKING:
    from spectra_kit.operators.laplacian import Laplacian

Made = TypeVar("Made")
_SUM = 1e-9  # share of the magnitudes below which a sum is rounding
_ACCURATE = 1e-7  # relative residual up to which a solution is one


def solution(
    laplacian: Laplacian,
    name: str,
    rhs: ArrayLike | None,
    fixed: Ints | None,
    values: ArrayLike | None,
) -> Floats:
    """Return what `Laplacian.solve` does, of a right-hand side by the `name` of an argument."""
    if fixed is None and values is not None:
        raise InvalidInputError("values", "come with the points that have them, `fixed`")
    if fixed is None and rhs is None:
        raise InvalidInputError(name, "be given where no point is held", None)
    at = np.empty(0, dtype=np.int64) if fixed is None else fixed
    if fixed is not None and (at.ndim != 1 or len(np.unique(at)) < max(at.size, 1)):
        raise InvalidInputError("fixed", "be a vector of points, each once", f"shape {at.shape}")
    given = real_array("values", 0.0 if values is None else values)
    if not given.size and at.size:
        raise InvalidInputError(
            "values", f"be a number or have shape ({len(at)}, ...)", given.shape
        )
    shape = (laplacian.n, *given.shape[1:2])
    b = np.zeros(shape) if rhs is None else columns(name, rhs, laplacian.n)
    expected = (len(at), *b.shape[1:])
    if given.ndim and given.shape != expected:
        raise InvalidInputError("values", f"be a number or have shape {expected}", given.shape)
    held = np.zeros_like(b)
    held[at] = given
    system = kept(laplacian, HeldSystem, np.union1d(at, laplacian.fixed))
    if rhs is None and len(first := system.loose.first):
        raise InvalidInputError(
            "fixed",
            "name a point of each component",
            f"none of that of point {first[0]}",
            advice="hold one there, or leave that part out",
        )
    return by_columns(b, lambda sides: system.solve(name, sides, _rows(held)))


def columns(name: str, values: ArrayLike, n: int) -> Floats:
    """Return `values` as finite float64 of shape (n,) or (n, c)."""
    array = real_array(name, values)
    if array.ndim not in (1, 2) or len(array) != n or not array.size:
        raise InvalidInputError(name, f"have shape ({n},) or ({n}, c)", array.shape)
    return array


def by_columns(values: Floats, solve: Callable[[Floats], Floats]) -> Floats:
    """Return what `solve` makes of the columns of `values`, which it takes and returns as rows."""
    return np.ascontiguousarray(solve(_rows(values)).T).reshape(values.shape)


def _rows(values: Floats) -> Floats:
    return np.ascontiguousarray(values.reshape(len(values), -1).T)


def kept(laplacian: Laplacian, kind: Callable[[Laplacian, Any], Made], key: Any) -> Made:
    """Return what was made with this key the last time, or make it: one of each kind is kept."""
    slot, place = f"_{kind.__name__}", vars(laplacian)
    before = place.get(slot)  # once: other threads may put theirs there
    if before is not None and np.array_equal(before[0], key):
        return before[1]  # type: ignore[no-any-return]
    del before
    place.pop(slot, None)  # there may not be room for two
    made = kind(laplacian, key)
    place[slot] = key, made
    return made


def factorised(laplacian: Laplacian, sigma: float, held: Bools) -> SparseLDL:
    """Factorise ``L - sigma M``, with rows and columns of points cleared but for a one."""
    try:
        pencil = Pencil(laplacian.stiffness, laplacian.mass, laplacian._elimination)
        matrix = held_at_zero(pencil.shifted(sigma), held)
        parts = matrix.data, matrix.diagonal(), pencil.elimination
        return SparseLDL.of_entries(*parts, definite=True)
    except OutOfMemoryError as error:
        found = str(error).partition(";")[0]
        raise OutOfMemoryError(found, advice="take a coarser geometry") from error
    except InvalidInputError as error:
        raise _singular(str(error)) from error


def _singular(found: str) -> InvalidInputError:
    return InvalidInputError(
        "laplacian",
        "be positive definite off the points that are held",
        found,
        advice="that of triangles that are all but flat is near to singular:"
        " delaunay_laplacian(mesh, mollify_factor=1e-3) makes one that is not",
    )


class Loose:
    """Components on which constants have no energy, and the means of functions (n,) there."""

    def __init__(self, laplacian: Laplacian) -> None:
        constant = laplacian.constant_components
        numbers = np.full(len(constant) + 1, -1)  # the last is of fixed points
        numbers[:-1][constant] = np.arange(constant.sum())
        labels = numbers[laplacian.component_labels]
        self.points: Ints = np.flatnonzero(labels >= 0)
        self._labels, mass = labels[self.points], laplacian.mass[self.points]
        self._shares = mass / np.bincount(self._labels, mass)[self._labels]
        #: The first point of each.
        self.first: Ints = self.points[np.unique(self._labels, return_index=True)[1]]

    def means(self, values: Floats) -> Floats:
        """Return the mean, by mass, on the component of each point, (n,); zero elsewhere."""
        found = np.zeros(len(values))
        at = self._labels
        found[self.points] = np.bincount(at, self._shares * values[self.points])[at]
        return found


class HeldSystem:
    """``L u = b`` off `fixed` points, which include those of the operator."""

    def __init__(self, laplacian: Laplacian, fixed: Ints) -> None:
        more = len(fixed) > len(laplacian.fixed)
        holding = laplacian.dirichlet(fixed) if more else laplacian
        self._stiffness, self._mass = laplacian.stiffness, laplacian.mass
        self._free = holding.free
        # One point of each loose component is held, too: where b sums to zero, the equation that
        # is dropped follows from the others.
        self.loose, self._held = Loose(holding), np.zeros(laplacian.n, dtype=bool)
        self._held[fixed] = self._held[self.loose.first] = True
        self._factor = factorised(laplacian, 0.0, self._held)

    def solve(self, name: str, sides: Floats, given: Floats) -> Floats:
        """Return u for each b (n,), with the values `given` at fixed points, zero elsewhere."""
        moved = [
            self._balanced(name, b) - self._stiffness @ g for b, g in zip(sides, given, strict=True)
        ]
        solved = self._factor.solve(np.where(self._held, 0.0, moved).T).T
        found = zip(moved, given, solved, strict=True)
        return np.stack([g + self._accurate(b, x) for b, g, x in found])

    def _balanced(self, name: str, b: Floats) -> Floats:
        """Return b less its rounding where it must sum to zero, if it does."""
        excess, size = (self.loose.means(f / self._mass) for f in (b, np.abs(b)))
        for bad in np.flatnonzero(np.abs(excess) > _SUM * size)[:1]:
            raise InvalidInputError(
                name,
                "sum to zero (a density: times mass) on each component without a fixed point",
                f"{excess[bad]:.3g} for each unit of mass on that of point {bad}",
                advice="subtract mass * (rhs.sum() / mass.sum()) there, or of a density its mean by"
                " mass; or hold a point there",
            )
        return np.asarray(b - self._mass * excess)

    def _accurate(self, b: Floats, x: Floats) -> Floats:
        """Return what the factor made of b, if it is a solution, with mean zero where loose."""
        x = x - self.loose.means(x)
        unit = float(np.abs(b).max()) or 1.0  # in which squares are numbers
        left = (b / unit - self._stiffness @ (x / unit), b / unit)
        residual, norm = (np.linalg.norm(part[self._free]) for part in left)
        if not residual <= _ACCURATE * norm:
            raise _singular(f"a residual of {residual / norm:.1e} of its right side")
        return x
