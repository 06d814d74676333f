"""How texts show themselves in terminals, and values in notebooks: drawn by `show`, which is above.

Nothing here takes time to import: a command line reads its names before anything else.
"""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Callable
from html import escape
from typing import Any

from spectra_kit._core.files import temporary_folder


def _nobody() -> Any:
    raise RuntimeError("spectra_kit says who draws as it is imported")


#: Imports `show`, and returns it. The package sets this, since `show` lies above what it draws.
plots: Callable[[], Any] = _nobody

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


def draw(plot: str, *arguments: Any, **options: Any) -> Any:
    """Call a plot or a class of `show`, which imports what it draws with: so not before it must."""
    return getattr(plots(), plot)(*arguments, **options)


def drawn(caption: str, plot: str, *arguments: Any, **options: Any) -> str:
    """Return what a plot of `show` draws, with a caption, as HTML."""
    with temporary_folder() as folder:
        draw(plot, *arguments, path=(path := folder / "picture.png"), **options)
        content = b64encode(path.read_bytes()).decode("ascii")
    return f'<img src="data:image/png;base64,{content}"><br>{escape(caption)}'
