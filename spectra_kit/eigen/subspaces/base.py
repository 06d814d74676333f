"""What a subspace is; those that are not predicted: given columns, random ones, and unions."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, fields, replace
from typing import Protocol, Self, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spectra_kit._core.checked import checked
from spectra_kit._core.records import Rebuilt, frozen
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_count, check_indices, real_array
from spectra_kit.errors import InvalidInputError

Solver = TypeVar("Solver")


@runtime_checkable
class Subspace(Protocol):
    """A function of points and mass whose columns span a guess at the low eigenfunctions.

    No Laplacian goes in. `RayleighRitz` makes an eigensolver of any subspace, and the raw basis
    serves as point features.
    """

    def __call__(self, points: Floats, mass: Floats) -> NDArray[np.floating]:
        """Return a basis of shape (n, m) for `points` (n, 3), in length, and `mass` (n,)."""
        ...


@checked
@dataclass(frozen=True, eq=False, repr=False)
class GivenBasis(Rebuilt):
    """Columns on known points: the modes of a previous frame of an animation, a coarse solve.

    Parameters
    ----------
    columns : array_like of shape (n, m)
        One row for each point of the Laplacian that it will be used with, in its order.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.eigen.subspaces import GivenBasis
    >>> GivenBasis(np.eye(4))(np.zeros((4, 3)), np.ones(4)).shape
    (4, 4)
    """

    columns: Floats

    def __init__(self, columns: ArrayLike) -> None:
        array = real_array("columns", columns)
        if array.ndim != 2 or array.size == 0:
            raise InvalidInputError("columns", "have shape (n, m)", array.shape)
        object.__setattr__(self, "columns", frozen(array))

    def __call__(self, points: Floats, mass: Floats) -> Floats:
        """See `Subspace`."""
        if len(points) != len(self.columns):
            raise InvalidInputError(
                "columns",
                f"have a row for each of {len(points)} points",
                len(self.columns),
                advice="are they of another sampling?",
            )
        return self.columns

    def __repr__(self) -> str:
        digest = hashlib.blake2b(np.ascontiguousarray(self.columns).data, digest_size=6)
        return f"GivenBasis(<{self.columns.shape}, blake2b={digest.hexdigest()!r}>)"

    def restricted(self, rows: Ints) -> GivenBasis:
        """Return the columns on the points `rows` alone."""
        indices = check_indices("rows", rows, len(self.columns))
        if indices.ndim != 1 or not len(indices):
            raise InvalidInputError(
                "rows", "be a vector of at least one point", f"shape {indices.shape}"
            )
        return GivenBasis(self.columns[indices])


@checked
@dataclass(frozen=True, kw_only=True)
class RandomBasis:
    """White noise: the start that knows nothing.

    Parameters
    ----------
    m : int, default 64
        Number of columns.
    seed : int, default 0
        Same seed, same columns.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.eigen.subspaces import RandomBasis
    >>> RandomBasis(m=5)(np.zeros((9, 3)), np.ones(9)).shape
    (9, 5)
    """

    m: int = 64
    seed: int = 0

    def __post_init__(self) -> None:
        check_count("m", self.m, low=1)
        check_count("seed", self.seed, low=0)

    def __call__(self, points: Floats, mass: Floats) -> Floats:
        """See `Subspace`."""
        return np.random.default_rng(self.seed).standard_normal((len(points), self.m))


@checked
@dataclass(frozen=True, init=False)
class Union:
    """The sum of several subspaces: their bases side by side.

    Parameters
    ----------
    *parts : Subspace
        At least one.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.eigen.subspaces import Union
    >>> from spectra_kit.eigen.subspaces import AmbientFourier
    >>> points = np.random.default_rng(0).standard_normal((50, 3))
    >>> both = Union(AmbientFourier(m=10, seed=0), AmbientFourier(m=12, seed=1))
    >>> both(points, np.ones(50)).shape
    (50, 22)
    """

    parts: tuple[Subspace, ...]

    def __init__(self, *parts: Subspace) -> None:
        if not parts:
            raise InvalidInputError("parts", "hold at least one subspace", "none")
        object.__setattr__(self, "parts", parts)

    def __repr__(self) -> str:
        return f"Union({', '.join(map(repr, self.parts))})"

    def __call__(self, points: Floats, mass: Floats) -> NDArray[np.floating]:
        """See `Subspace`."""
        return np.hstack([part(points, mass) for part in self.parts])

    def restricted(self, rows: NDArray[np.int64]) -> Union:
        """Return this union for the points `rows` alone."""
        return Union(*(restricted(part, rows) for part in self.parts))


class OnPoints:
    """Mixin of a frozen dataclass of subspaces: restricted, it holds the restricted ones."""

    def restricted(self, rows: Ints) -> Self:
        """Return the same for the points `rows` of its Laplacian alone."""
        held = {f.name: getattr(self, f.name) for f in fields(self)}  # type: ignore[arg-type]
        changed = {name: restricted(value, rows) for name, value in held.items()}
        return replace(self, **changed)  # type: ignore[type-var]


@checked
def restricted(part: Solver, rows: Ints) -> Solver:
    """Return `part` (a subspace or a solver) for the points `rows` alone.

    Parameters
    ----------
    part : Subspace or Eigensolver
        What is a function of the points needs no change; what is tied to them has a method of this
        name.
    rows : ndarray of int
        The points, in the order of the restricted Laplacian.

    Returns
    -------
    Subspace or Eigensolver
        Of the type of `part`.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.eigen.subspaces import GivenBasis
    >>> from spectra_kit.eigen.subspaces import restricted
    >>> restricted(GivenBasis(np.eye(4)), np.array([2, 3])).columns.shape
    (2, 4)
    """
    method = getattr(part, "restricted", None)
    return part if method is None else method(rows)
