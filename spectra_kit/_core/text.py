"""Texts of others, names maybe, as a terminal may be shown them."""

from __future__ import annotations

import re

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
