"""What records share: they are read-only, and show themselves in terminals and notebooks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from html import escape
from typing import TYPE_CHECKING, Any, Generic, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

Array = TypeVar("Array", bound=NDArray[np.generic])
Value = TypeVar("Value")
Thing = TypeVar("Thing")

_HANDFUL = 4  # numbers that the repr of an array may show


def table(title: str, facts: Mapping[str, object]) -> str:
    """Return a table of names and values, as HTML."""
    rows = "".join(
        f"<tr><th>{escape(name)}</th><td>{escape(str(value))}</td></tr>"
        for name, value in facts.items()
    )
    return f"<table><caption>{escape(title)}</caption>{rows}</table>"


def frozen(array: Array) -> Array:
    """Return a read-only view of `array` (no copy; a list, and the like, becomes one)."""
    view = cast(Array, np.asarray(array)).view()
    view.flags.writeable = False
    return view


class cached(Generic[Value]):  # noqa: N801
    """A property that is computed once.

    As `functools.cached_property`, without the lock that all instances share before Python 3.12:
    who asks two of them in two threads waits for nothing.
    """

    def __init__(self, make: Callable[[Any], Value]) -> None:
        self._make = make

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, thing: object, owner: type | None = None) -> Value:
        if thing is None:  # asked of the class, by what lists its attributes
            return cast(Value, self)
        found: Value = vars(thing).setdefault(self._name, self._make(thing))
        return found


def latest(thing: Thing, kind: Callable[[Thing, Any], Value], key: Any) -> Value:
    """Return what was made with this key the last time, or make it: one of each kind is kept."""
    slot, place = f"_{kind.__name__}", vars(thing)
    before = place.get(slot)  # once: other threads may put theirs there
    if before is not None and np.array_equal(before[0], key):
        return cast(Value, before[1])
    del before
    place.pop(slot, None)  # there may not be room for two
    made = kind(thing, key)
    place[slot] = key, made
    return made


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


def known(kind: type[Thing], **values: Any) -> Thing:
    """Return a record of values that need no check: its fields, and cached properties of it.

    Arrays become read-only.
    """
    made = object.__new__(kind)
    for name, value in values.items():
        vars(made)[name] = frozen(value) if isinstance(value, np.ndarray) else value
    return made


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
