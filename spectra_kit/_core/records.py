"""How values show themselves in notebooks, and draw themselves by `show`, which lies above them."""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Mapping
from html import escape
from importlib import import_module
from typing import Any

from spectra_kit._core.files import temporary_folder

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
