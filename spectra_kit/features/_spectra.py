"""What the features by a spectrum share: the spectrum itself, weights of its modes, and checks."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spectra_kit._core.threads import blas_threads_for
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_indices, quantity, real_array
from spectra_kit.eigen import Spectrum, eigensolve
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import PointCloud, TriangleMesh
from spectra_kit.operators import Laplacian, laplacian

#: What may be done to a surface without changing an embedding, but for discretisation.
Change = Literal["rotation", "scale", "isometry", "sampling"]
#: What has a spectrum, or gets one.
Solvable = TriangleMesh | PointCloud | Laplacian | Spectrum

DAMPED = 4 * np.log(10)  # exp(-DAMPED) = 1e-4
_MODES = 96  # as many as of `datasets.Plan`


class Isometric:
    """What an embedding by a spectrum does not change with."""

    @property
    def invariant_to(self) -> frozenset[Change]:
        """Rotation, scale, isometry and sampling."""
        return frozenset({"rotation", "scale", "isometry", "sampling"})


def solved(surface: Solvable) -> Spectrum:
    """Return a spectrum as it is; of anything else its 96 lowest modes, or all if it has fewer."""
    if isinstance(surface, Spectrum):
        return surface
    operator = surface if isinstance(surface, Laplacian) else laplacian(surface)
    return eigensolve(operator, min(_MODES, operator.n))


def outside_kernel(spectrum: Spectrum) -> Spectrum:
    """Return the modes outside the kernel, of which there must be at least one."""
    modes = spectrum.nonzero()
    if modes.k == 0:
        raise InvalidInputError(
            "surface",
            "have modes outside its kernel",
            f"{quantity(spectrum.k, 'zero mode')} alone",
            advice="compute more than there are components",
        )
    return modes


def weyl(k: float | Ints, dimension: int = 2) -> Any:
    """Return what Weyl's law expects of eigenvalue number k where area, or volume, is one."""
    return 4 * np.pi * k if dimension == 2 else (6 * np.pi**2 * k) ** (2 / 3)


def squares(spectrum: Spectrum, weights: Floats) -> Floats:
    """Return ``sum_i w_i u_i(x)^2``, shape (n, w), for weights of shape (w, k)."""
    with blas_threads_for(spectrum.eigenvectors.size):
        return np.asarray(spectrum.eigenvectors**2 @ weights.T)


def seen_from(spectrum: Spectrum, points: NDArray[np.int64], weights: Floats) -> Floats:
    """Return ``sum_i w_i u_i(x) u_i(p)``, shape (n, points, w), for weights of shape (w, k)."""
    U = spectrum.eigenvectors
    filtered = (U[points, None, :] * weights).reshape(-1, spectrum.k)
    with blas_threads_for(U.size):
        seen = U @ filtered.T
    return np.asarray(seen).reshape(spectrum.n, len(points), len(weights))


def seen_from_landmarks(
    spectrum: Spectrum, landmarks: ArrayLike, weights: Floats, logarithm: bool
) -> Floats:
    """Return `seen_from` as columns, all weights of the first landmark first; of both signs."""
    if logarithm:
        raise InvalidInputError("logarithm", "be False, with landmarks", True)
    points = check_sources("landmarks", landmarks, spectrum)
    return seen_from(spectrum, points, weights).reshape(spectrum.n, -1)


def shares(exponents: Floats) -> Floats:
    """Return ``exp(e) / sum exp(e)`` along the rows, where all of them may underflow."""
    weights = np.exp(exponents - exponents.max(axis=1, keepdims=True))
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def check_grid(name: str, values: ArrayLike) -> Floats:
    """Return `values` as a finite float64 vector that is not empty."""
    array = real_array(name, values)
    if array.ndim != 1 or len(array) == 0:
        hint = f"; write [{array}] for a single one" if array.ndim == 0 else ""
        raise InvalidInputError(
            name, "be a vector of at least one number", f"shape {array.shape}{hint}"
        )
    return array


def check_sources(name: str, values: ArrayLike, spectrum: Spectrum) -> Ints:
    """Return `values` as a vector of at least one index of a point."""
    if np.shape(values) == (0,):  # before the dtype: an empty list is one of floats to NumPy
        raise InvalidInputError(name, "name at least one point", "none")
    indices = check_indices(name, values, spectrum.n)
    if indices.ndim != 1:
        hint = f"; write [{indices}] for a single one" if indices.ndim == 0 else ""
        raise InvalidInputError(name, "be a vector", f"shape {indices.shape}{hint}")
    return indices
