"""Checks of values, at the door: constructors, readers and functions of the reference, once."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spectra_kit._core.types import Floats, Ints
from spectra_kit.errors import InvalidInputError


def quantity(n: int, noun: str) -> str:
    """Return `n` things in words: "1 entry", "1,234 unreferenced vertices"."""
    if n != 1:
        stem, ending = re.sub("(ex|try)$", "", noun), {"ex": "ices", "try": "tries"}
        noun = stem + ending.get(noun[len(stem) :], "s")
    return f"{n:,} {noun}"


def as_array(name: str, values: ArrayLike) -> NDArray[np.generic]:
    """Return `values` as an array of any kind."""
    try:
        return np.asarray(values)
    except ValueError as error:
        raise InvalidInputError(name, f"have rows of one length ({error})") from error


def real_array(
    name: str,
    values: ArrayLike,
    *,
    some_nan: bool = False,
    advice: str = "",
    remedies: tuple[str, ...] = (),
) -> Floats:
    """Return `values` as a finite C-ordered float64 array; `some_nan` may be NaN, but not all."""
    array = as_array(name, values)
    if array.dtype.kind not in "fiu":
        raise InvalidInputError(name, "hold real numbers", f"dtype {array.dtype}")
    floats = np.asarray(array, dtype=np.float64, order="C")
    bad = ~np.isfinite(floats)
    if some_nan and not (unknown := np.isnan(floats)).all():
        bad &= ~unknown
    if bad.any():
        first = tuple(int(i) for i in np.argwhere(bad)[0])
        raise InvalidInputError(
            name,
            "be finite",
            f"{quantity(bad.sum(), 'NaN or infinite value')}, the first at {first}",
            advice=advice or ("leave such rows out" if floats.ndim == 2 else ""),
            remedies=remedies,
        )
    return floats


def check_points(name: str, values: ArrayLike) -> Floats:
    """Return `values` as finite float64 points of shape (n, 3), n >= 1."""
    array = as_array(name, values)
    _check_three_columns(name, array, "n")
    if len(array) == 0:
        raise InvalidInputError(name, "hold at least one point", f"shape {array.shape}")
    return real_array(
        name,
        array,
        advice="{} leaves such points out, and tells which",
        remedies=("geometry.without_nan()",),
    )


def _check_three_columns(name: str, array: NDArray[np.generic], rows: str) -> None:
    if array.ndim != 2 or array.shape[1] != 3:
        turned = array.ndim == 2 and len(array) == 3
        hint = "did you pass its transpose?" if turned else ""
        if array.ndim == 2 and not turned and len(array):
            hint = _columns_advice(name, array.shape[1], rows)
        if array.ndim == 3 and array.shape[2] > 3 and rows == "n":  # an image, of voxels
            hint = f"of an image of labels, geometry.from_labels({name}) makes a surface of each"
        raise InvalidInputError(name, f"have shape ({rows}, 3)", array.shape, advice=hint)


def _columns_advice(name: str, columns: int, rows: str) -> str:
    if columns == 2 and rows == "n":
        return f"of planar ones, numpy.column_stack([{name}, numpy.zeros(len({name}))]) makes these"
    if columns > 3 and rows == "n":
        return f"if normals or colours follow the coordinates, {name}[:, :3] leaves them out"
    if columns == 4:  # both are common, and no array says which it is
        return (
            f"quads are taken as pyvista.PolyData.from_regular_faces(points, {name}), tetrahedra as"
            f" pyvista.UnstructuredGrid({{pyvista.CellType.TETRA: {name}}}, points)"
            ".extract_surface()"
        )
    if columns > 4:
        return f"polygons are taken as pyvista.PolyData.from_regular_faces(points, {name})"
    return ""


def check_indices(name: str, values: ArrayLike, n: int) -> Ints:
    """Return `values` as int64 indices into `n` points; any shape."""
    array = as_array(name, values)
    huge = array.dtype == object and all(isinstance(value, int) for value in array.flat)
    if array.dtype.kind not in "iu" and not huge:
        raise InvalidInputError(
            name, "hold integers", f"dtype {array.dtype}", advice="count from 0"
        )
    if array.size and (array.min() < 0 or array.max() >= n):
        worst = int(array.min()) if array.min() < 0 else int(array.max())
        hint = "indices count from 0" if array.min() >= 1 and array.max() == n else ""
        if name == "point_map" and worst == -1:
            hint = "leave out the points without a partner that -1 may mark"
        raise InvalidInputError(name, f"be in [0, {n})", worst, advice=hint)
    return np.asarray(array, dtype=np.int64, order="C")


def as_indices(name: str, values: ArrayLike, n: int) -> Ints:
    """Return point indices, given as such or as a boolean mask of shape (n,)."""
    array = np.asarray(values)
    if array.dtype == bool and array.shape == (n,):
        return np.flatnonzero(array)
    return check_indices(name, array if array.size else array.astype(np.int64), n)


def check_faces(name: str, values: ArrayLike, n: int) -> Ints:
    """Return `values` as int64 faces of shape (f, 3), f >= 1, indexing `n` points."""
    array = as_array(name, values)
    _check_three_columns(name, array, "f")
    if len(array) == 0:
        raise InvalidInputError(
            name,
            "hold at least one triangle",
            f"shape {array.shape}",
            advice="use PointCloud for bare points",
        )
    return check_indices(name, array, n)


def check_mass(name: str, values: ArrayLike, n: int) -> Floats:
    """Return `values` as n positive float64 weights."""
    if np.shape(values) != (n,):
        raise InvalidInputError(name, f"have shape ({n},)", np.shape(values))
    return positive_array(
        name,
        values,
        advice="drop unreferenced vertices with {} or duplicate points with {}",
        remedies=("mesh.without_unreferenced()", "cloud.without_duplicates()"),
    )


def positive_array(
    name: str, values: ArrayLike, *, advice: str, remedies: tuple[str, ...] = ()
) -> Floats:
    """Return `values` as a finite float64 array of positive entries."""
    array = real_array(name, values)
    if not (array > 0).all():
        raise InvalidInputError(
            name,
            "be positive",
            f"{quantity((array <= 0).sum(), 'entry')} <= 0 (smallest {array.min():.3g})",
            advice=advice,
            remedies=remedies,
        )
    return array


def check_count(name: str, value: int, *, low: int, high: int | None = None) -> int:
    """Return the integer `value` if ``low <= value <= high``."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise InvalidInputError(name, "be an integer", repr(value))
    if high is None and value >= 2**63:
        raise InvalidInputError(name, "fit into 64 bits", value)
    if value < low or (high is not None and value > high):
        bound = f"at least {low}" if high is None else f"in [{low}, {high}]"
        raise InvalidInputError(name, f"be {bound}", value)
    return int(value)


def check_positive(name: str, value: float) -> float:
    """Return `value` if it is a finite number above zero."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        raise InvalidInputError(name, "be a number", repr(value))
    if not (np.isfinite(value) and value > 0):
        raise InvalidInputError(name, "be positive and finite", repr(value))
    return float(value)


def check_weights(values: Mapping[str, float]) -> None:
    """Refuse the first of named weights that is negative or not finite."""
    for name, value in values.items():
        if not 0 <= value < np.inf:
            raise InvalidInputError(name, "be a finite weight >= 0", repr(value))
