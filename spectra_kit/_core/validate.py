"""Checks at the border: public constructors and readers pass their arrays through here, once."""

from __future__ import annotations

import re
import sys
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import fields
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spectra_kit._core.records import table
from spectra_kit._core.types import Floats, Ints
from spectra_kit.errors import Advice, InvalidInputError, SpectraKitWarning

Array = TypeVar("Array", bound=NDArray[np.generic])


_HANDFUL = 4  # numbers that the repr of an array may show


def quantity(n: int, noun: str) -> str:
    """Return `n` things in words: "1 entry", "1,234 unreferenced vertices"."""
    if n != 1:
        stem, ending = re.sub("(ex|try)$", "", noun), {"ex": "ices", "try": "tries"}
        noun = stem + ending.get(noun[len(stem) :], "s")
    return f"{n:,} {noun}"


def frozen(array: Array) -> Array:
    """Return a read-only view of `array` (no copy; a list, and the like, becomes one)."""
    view = cast(Array, np.asarray(array)).view()
    view.flags.writeable = False
    return view


def as_array(name: str, values: ArrayLike) -> NDArray[np.generic]:
    """Return `values` as an array of any kind."""
    try:
        return np.asarray(values)
    except ValueError as error:
        raise InvalidInputError(name, f"have rows of one length ({error})") from error


def real_array(
    name: str, values: ArrayLike, *, advice: str = "", remedies: tuple[str, ...] = ()
) -> Floats:
    """Return `values` as a finite C-ordered float64 array."""
    array = as_array(name, values)
    if array.dtype.kind not in "fiu":
        raise InvalidInputError(name, "hold real numbers", f"dtype {array.dtype}")
    floats = np.asarray(array, dtype=np.float64, order="C")
    bad = ~np.isfinite(floats)
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
            hint = f"of an image, pyvista.wrap(1.0 * {name}).contour([0.5]) is the surface"
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


class Brief:
    """Mixin of a dataclass that holds arrays: it shows their form, not their entries."""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if "__repr__" not in vars(cls):  # `dataclass`, which comes later, leaves it where it is
            cls.__repr__ = Brief.__repr__  # type: ignore[method-assign]

    def __repr__(self) -> str:
        shown = ", ".join(f"{name}={form}" for name, form in Brief._facts(self).items())
        return f"{type(self).__qualname__}({shown})"

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        return table(type(self).__qualname__, self._facts())

    if not TYPE_CHECKING:  # which knows the names

        def __getattr__(self, name: str) -> Any:
            """Name what there is: the mesh of one record is the geometry of another."""
            if name.startswith("_"):  # asked for by copy, pickle and notebooks
                raise AttributeError(name)
            known = ", ".join(f.name for f in fields(self))
            told = f"{type(self).__qualname__} has no attribute {name!r}; it has {known}"
            raise AttributeError(told, name=name, obj=self)

    def _facts(self) -> Mapping[str, object]:
        """What there is to show, by name."""
        return {f.name: _form(getattr(self, f.name)) for f in fields(self) if f.repr}  # type: ignore[arg-type]


def _form(value: object) -> str:
    """Return the repr of a value, or the shape of an array that is not a handful of numbers."""
    if isinstance(value, np.ndarray) and value.size > _HANDFUL:
        return f"<{value.dtype} {value.shape}>"
    if isinstance(value, tuple) and value and isinstance(value[0], Brief):
        return f"<{len(value)} of {type(value[0]).__qualname__}>"
    if hasattr(value, "nnz"):
        return f"<sparse {value.shape}, {value.nnz} entries>"  # type: ignore[attr-defined]
    return repr(dict(value) if isinstance(value, Mapping) else value)


class Rebuilt(Brief):
    """Mixin of a frozen dataclass: pickling and copying go through its constructor.

    So a copy is validated and read-only like the original, and leaves cached values behind.
    """

    def __post_init__(self) -> None:
        """Make its arrays read-only; classes that check more do so in its place."""
        for name, value in list(vars(self).items()):
            if isinstance(value, np.ndarray | list):
                object.__setattr__(self, name, frozen(np.asarray(value)))

    def __reduce__(self) -> tuple[Any, ...]:
        values = {f.name: getattr(self, f.name) for f in fields(self)}  # type: ignore[arg-type]
        plain = {k: dict(v) if isinstance(v, Mapping) else v for k, v in values.items()}
        return _rebuild, (type(self), plain)


def _rebuild(cls: type[Any], values: dict[str, Any]) -> Any:
    return cls(**values)


_heard: ContextVar[list[SpectraKitWarning] | None] = ContextVar("_heard", default=None)


@contextmanager
def hearing() -> Iterator[list[SpectraKitWarning]]:
    """Collect what `warn` says inside, instead of saying it: in this thread, and in no other.

    `warnings.catch_warnings` changes what all threads of a process do.
    """
    heard: list[SpectraKitWarning] = []
    token = _heard.set(heard)
    try:
        yield heard
    finally:
        _heard.reset(token)


def warn(
    message: str,
    category: type[SpectraKitWarning],
    *,
    advice: Advice = "",
    remedies: tuple[str, ...] = (),
    where: str = "",
) -> None:
    """Warn at the line that called the package, however deep inside the reason was found."""
    if (heard := _heard.get()) is not None:
        made = category(message, advice=advice, remedies=remedies)
        made.where = where
        heard.append(made)
        return
    level, frame = 1, sys._getframe()
    while frame.f_back and frame.f_globals["__name__"].partition(".")[0] == "spectra_kit":
        level, frame = level + 1, frame.f_back
    told = category(message, advice=advice, remedies=remedies)
    told.where = where
    warnings.warn(told, stacklevel=level)
