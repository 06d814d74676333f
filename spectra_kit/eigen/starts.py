"""Where iterations begin: plane waves, and how many columns to iterate on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spectra_kit.eigen.multigrid.coarse import Coarse
from spectra_kit.eigen.subspaces.ambient_fourier import AmbientFourier
from spectra_kit.eigen.subspaces.base import Subspace
from spectra_kit.errors import InvalidInputError
from spectra_kit.operators.laplacian import Laplacian


def plane_waves(k: int) -> AmbientFourier:
    """Return a start for k modes that costs less than what it saves.

    The m functions grow with k, and the bandwidth like the frequency of mode k.
    """
    return AmbientFourier(m=max(64, round(2.7 * k)), bandwidth=0.7 * max(k, 24) ** 0.5)


def block_size(k: int, guard: float) -> int:
    """Return how many Ritz vectors to iterate on for k wanted ones."""
    return k + max(8, round(guard * k))


def basis_with_kernel(subspace: Subspace, operator: Laplacian | Coarse) -> NDArray[np.floating]:
    """Return the basis of `subspace`, of checked form, led by the constant where that is a mode."""
    mass = operator.mass if isinstance(operator, Laplacian) else operator.lumped
    basis = np.asarray(subspace(operator.points, mass))
    if basis.ndim != 2 or len(basis) != operator.n or basis.dtype.kind != "f":
        raise InvalidInputError(
            "subspace",
            f"return a real array of shape ({operator.n}, m)",
            f"{basis.shape} of {basis.dtype}",
        )
    first = basis[:, :1]  # none, of a basis without columns
    if not operator.kernel_dimension or (first[:1].any() and np.ptp(first) == 0):
        return basis  # most begin with the constant
    return np.column_stack([np.ones(operator.n, basis.dtype), basis])
