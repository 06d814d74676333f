"""``L u = b`` with u given at some points, by a factor that a `Laplacian` keeps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from spectra_kit._core.records import latest
from spectra_kit._core.types import Bools, Floats, Ints
from spectra_kit._core.validate import as_indices, real_array
from spectra_kit._sparse.grounded import held_at_zero
from spectra_kit._sparse.ldl import SparseLDL
from spectra_kit._sparse.pencil import Pencil
from spectra_kit.errors import InvalidInputError, OutOfMemoryError

if TYPE_CHECKING:
    from spectra_kit.operators.laplacian import Laplacian

_SUM = 1e-9  # share of the magnitudes below which a sum is rounding
_ACCURATE = 1e-7  # relative residual up to which a solution is one


def solution(
    laplacian: Laplacian,
    name: str,
    rhs: ArrayLike | None,
    fixed: ArrayLike | None,
    values: ArrayLike | None,
) -> Floats:
    """Return what `Laplacian.solve` does, of a right-hand side by the `name` of an argument."""
    if fixed is None and values is not None:
        raise InvalidInputError("values", "come with the points that have them, `fixed`")
    if fixed is None and rhs is None:
        raise InvalidInputError(name, "be given where no point is held", None)
    at = np.empty(0, np.int64) if fixed is None else as_indices("fixed", fixed, laplacian.n)
    if fixed is not None and (at.ndim != 1 or len(np.unique(at)) < max(at.size, 1)):
        raise InvalidInputError("fixed", "be a vector of points, each once", f"shape {at.shape}")
    given = real_array("values", 0.0 if values is None else values)
    b = columns(name, rhs, laplacian.n) if rhs is not None else None
    shape = given.shape[1:2] if b is None else b.shape[1:]
    expected = (len(at), *shape)
    if given.ndim and (given.shape != expected or not given.size):
        raise InvalidInputError("values", f"be a number or have shape {expected}", given.shape)
    held = np.zeros((laplacian.n, *shape))
    held[at] = given
    problem = latest(laplacian, DirichletProblem, np.union1d(at, laplacian.fixed))
    if b is None and len(first := problem.kernel.first):
        raise InvalidInputError(
            "fixed",
            "name a point of each component",
            f"none of that of point {first[0]}",
            advice="hold one there, or leave that part out",
        )
    return problem.solve(name, np.zeros_like(held) if b is None else b, held)


def columns(name: str, values: ArrayLike, n: int) -> Floats:
    """Return `values` as finite float64 of shape (n,) or (n, c)."""
    array = real_array(name, values)
    if array.ndim not in (1, 2) or len(array) != n or not array.size:
        raise InvalidInputError(name, f"have shape ({n},) or ({n}, c)", array.shape)
    return array


def factorised(laplacian: Laplacian, sigma: float, held: Bools) -> SparseLDL:
    """Factorise ``L - sigma M``, with rows and columns of points cleared but for a one."""
    try:
        pencil = Pencil(laplacian.stiffness, laplacian._weights, laplacian._elimination)
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


class Kernel:
    """Functions without energy: constants on some components, (k, n) of means there."""

    def __init__(self, laplacian: Laplacian) -> None:
        constant = laplacian.constant_components
        numbers = np.append(np.where(constant, np.cumsum(constant) - 1, -1), -1)
        labels = numbers[laplacian.component_labels]  # the last is of fixed points
        self._points = np.flatnonzero(labels >= 0)
        self._labels, mass = labels[self._points], laplacian._row_sums[self._points]
        shares = mass / np.bincount(self._labels, mass)[self._labels]
        shape = (int(constant.sum()), laplacian.n)
        self._means = sparse.csr_array((shares, (self._labels, self._points)), shape)
        #: The first point of each component.
        self.first: Ints = self._points[np.unique(self._labels, return_index=True)[1]]

    def means(self, values: Floats) -> Floats:
        """Return the mean, by mass, on the component of each point; zero elsewhere."""
        found = np.zeros_like(values)
        found[self._points] = (self._means @ values)[self._labels]
        return found


class DirichletProblem:
    """``L u = b`` off `fixed` points, which include those of the operator."""

    def __init__(self, laplacian: Laplacian, fixed: Ints) -> None:
        more = len(fixed) > len(laplacian.fixed)
        holding = laplacian.dirichlet(fixed) if more else laplacian
        self._stiffness, self._mass = laplacian.stiffness, laplacian.mass
        self._free = holding.free
        # One point of each component with constants is held, too: where b sums to zero, the
        # equation that is dropped follows from the others.
        self.kernel, self._held = Kernel(holding), np.zeros(laplacian.n, dtype=bool)
        self._held[fixed] = self._held[self.kernel.first] = True
        self._factor = factorised(laplacian, 0.0, self._held)

    def solve(self, name: str, b: Floats, given: Floats) -> Floats:
        """Return u, (n,) or (n, c) as b, with the values `given` at fixed points, zero elsewhere.

        `InvalidInputError` where b does not sum to zero as it must, or L is singular.
        """
        mass = self._mass.reshape(-1, *[1] * (b.ndim - 1))
        excess, size = (self.kernel.means(f / mass) for f in (b, np.abs(b)))
        for bad in np.argwhere(np.abs(excess) > _SUM * size)[:1]:
            raise InvalidInputError(
                name,
                "sum to zero (a density: times mass) on each component without a fixed point",
                f"{excess[*bad]:.3g} for each unit of mass on that of point {bad[0]}",
                advice="subtract mass * (rhs.sum() / mass.sum()) there, or of a density its mean by"
                " mass; or hold a point there",
            )
        b = b - mass * excess - self._stiffness @ given
        x = self._factor.solve(np.where(self._held.reshape(mass.shape), 0.0, b))
        x -= self.kernel.means(x)
        unit = np.abs(b).max(axis=0)
        unit = np.where(unit > 0, unit, 1.0)  # in which squares are numbers
        left = (b / unit - self._stiffness @ (x / unit), b / unit)
        residual, norm = (np.linalg.norm(part[self._free], axis=0) for part in left)
        if not (residual <= _ACCURATE * norm).all():
            raise _singular(f"a residual of {np.max(residual / norm):.1e} of its right side")
        return np.asarray(given + x)
