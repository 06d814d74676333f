"""Checks that several descriptors share."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_indices, positive_array, quantity, real_array
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import InvalidInputError


def outside_kernel(spectrum: Spectrum) -> Spectrum:
    """Return the modes outside the kernel, of which there must be at least one."""
    modes = spectrum.nonzero()
    if modes.k == 0:
        raise InvalidInputError(
            "spectrum",
            "have modes outside its kernel",
            f"{quantity(spectrum.k, 'zero mode')} alone",
            advice="compute more than there are components",
        )
    return modes


def check_grid(name: str, values: ArrayLike) -> Floats:
    """Return `values` as a finite float64 vector that is not empty."""
    array = real_array(name, values)
    if array.ndim != 1 or len(array) == 0:
        hint = f"; write [{array}] for a single one" if array.ndim == 0 else ""
        raise InvalidInputError(
            name, "be a vector of at least one number", f"shape {array.shape}{hint}"
        )
    return array


def check_energies(values: ArrayLike) -> Floats:
    """Return `values` as a vector of energies."""
    if isinstance(values, tuple) and len(values) == 2 and np.ndim(values[0]) > np.ndim(values[1]):
        raise InvalidInputError(
            "energies",
            "be a vector",
            "a tuple of two as `wave_energies` returns it",
            advice="write `energies, width = wave_energies(spectrum)` and pass both",
        )
    return check_grid("energies", values)


def check_times(values: ArrayLike) -> Floats:
    """Return `values` as a vector of positive times."""
    advice = "times are in length^2, `heat_times` suggests some"
    return positive_array("times", check_grid("times", values), advice=advice)


def check_sources(name: str, values: ArrayLike, spectrum: Spectrum) -> Ints:
    """Return `values` as a vector of at least one index of a point."""
    if np.shape(values) == (0,):  # before the dtype: an empty list is one of floats to NumPy
        raise InvalidInputError(name, "name at least one point", "none")
    indices = check_indices(name, values, spectrum.n)
    if indices.ndim != 1:
        hint = f"; write [{indices}] for a single one" if indices.ndim == 0 else ""
        raise InvalidInputError(name, "be a vector", f"shape {indices.shape}{hint}")
    return indices
