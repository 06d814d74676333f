"""Checks of maps between two spectra; the public functions pass their arguments through here."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spectra_kit._validate import check_count, check_indices, real_array
from spectra_kit.errors import InvalidInputError
from spectra_kit.spectrum import Spectrum

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def check_point_map(name: str, values: ArrayLike, n_source: int, n_target: int) -> Ints:
    """Return `values` as the source point of each target point: int64 of shape (n_target,)."""
    if np.shape(values) != (n_target,):
        backwards = " (it seems to run from source to target)" if n_source != n_target else ""
        hint = backwards if np.shape(values) == (n_source,) else ""
        raise InvalidInputError(
            f"`{name}` must have shape ({n_target},), the source point of each target point,"
            f" got {np.shape(values)}{hint}"
        )
    return check_indices(name, values, n_source)


def check_functional_map(
    name: str, values: ArrayLike, source: Spectrum, target: Spectrum
) -> Floats:
    """Return `values` as finite float64 of shape (k2, k1), within the modes of the spectra."""
    shape = np.shape(values)
    if len(shape) != 2 or not (1 <= shape[0] <= target.k and 1 <= shape[1] <= source.k):
        raise InvalidInputError(
            f"`{name}` must have shape (k2, k1) with k2 of the target's {target.k} modes and k1 of"
            f" the source's {source.k}, got {shape}; compute more modes or truncate the map"
        )
    return real_array(name, values)


def check_sizes(
    k: int | tuple[int, int] | None, source: Spectrum, target: Spectrum
) -> tuple[int, int]:
    """Return (k1, k2) from one number for both, one for each, or None for all modes."""
    k1, k2 = (source.k, target.k) if k is None else (k, k) if not isinstance(k, tuple) else k
    return (
        check_count("k of the source", k1, low=1, high=source.k),
        check_count("k of the target", k2, low=1, high=target.k),
    )


def check_components(source: Spectrum, target: Spectrum) -> None:
    """Refuse two surfaces whose kernels differ: their modes cannot correspond one to one."""
    a, b = source.n_zero_modes, target.n_zero_modes
    if a != b:
        raise InvalidInputError(
            "`source` and `target` must have the same number of components, got"
            f" {a} and {b} zero modes; match component by component"
            " (geometry.split_components)"
        )


def at_unit_area(spectrum: Spectrum) -> Spectrum:
    """Return the spectrum of the surface scaled to area 1."""
    area = spectrum.area
    return spectrum if abs(area - 1.0) < 1e-12 else spectrum.rescale(area**-0.5)
