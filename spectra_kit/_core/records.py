"""What records share: they are read-only, and show themselves in terminals and notebooks.

And draw themselves, by `show`, which lies above them.
"""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Mapping
from dataclasses import fields
from html import escape
from importlib import import_module
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.files import temporary_folder

Array = TypeVar("Array", bound=NDArray[np.generic])

_HANDFUL = 4  # numbers that the repr of an array may show

#: Characters that a terminal obeys, also as bytes of no text.
_OBEYED = re.compile("[\x00-\x1f\x7f-\x9f\udc80-\udc9f]")


def printable(text: str, *, lines: bool = False) -> str:
    """Return a text, a name maybe, with what a terminal would obey as it is written in Python.

    Ends of `lines`, and tabs, stay where the text may have some.
    """

    def written(found: re.Match[str]) -> str:
        sign = found.group()
        return sign if lines and sign in "\n\t" else f"\\x{ord(sign) & 0xFF:02x}"

    return _OBEYED.sub(written, text)


def table(title: str, facts: Mapping[str, object]) -> str:
    """Return a table of names and values, as HTML."""
    rows = "".join(
        f"<tr><th>{escape(name)}</th><td>{escape(str(value))}</td></tr>"
        for name, value in facts.items()
    )
    return f"<table><caption>{escape(title)}</caption>{rows}</table>"


def draw(plot: str, *arguments: Any, **options: Any) -> Any:
    """Call a plot or a class of `show`, which imports what it draws with: so not before it must."""
    return getattr(import_module("spectra_kit.show"), plot)(*arguments, **options)


def drawn(caption: str, plot: str, *arguments: Any, **options: Any) -> str:
    """Return what a plot of `show` draws, with a caption, as HTML."""
    with temporary_folder() as folder:
        draw(plot, path := folder / "picture.png", *arguments, **options)
        content = b64encode(path.read_bytes()).decode("ascii")
    return f'<img src="data:image/png;base64,{content}"><br>{escape(caption)}'


def frozen(array: Array) -> Array:
    """Return a read-only view of `array` (no copy; a list, and the like, becomes one)."""
    view = cast(Array, np.asarray(array)).view()
    view.flags.writeable = False
    return view


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
