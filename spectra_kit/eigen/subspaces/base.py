"""What a subspace is, and how two of them are joined."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats
from spectra_kit.eigen.subspaces.given import restricted
from spectra_kit.errors import InvalidInputError


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
    >>> from spectra_kit import Union
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
