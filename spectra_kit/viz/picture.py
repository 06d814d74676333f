"""`Picture`: the file that a plot has written, shown by notebooks."""

from __future__ import annotations

from base64 import b64encode
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spectra_kit._checked import checked

_TYPES = {".png": "image/png", ".gif": "image/gif", ".svg": "image/svg+xml"}


@checked
@dataclass(frozen=True)
class Picture:
    """A picture on disk. A notebook shows it where it is the last line of a cell.

    Attributes
    ----------
    path : Path
        The file. PNG, GIF and SVG are shown as they are, others by their name.

    Examples
    --------
    >>> from pathlib import Path
    >>> from spectra_kit.viz import Picture
    >>> Picture(Path("modes.png")).path.name
    'modes.png'
    """

    path: Path

    def _repr_mimebundle_(self, include: Any = None, exclude: Any = None) -> dict[str, str]:
        """What a notebook shows; its own words for the object where that is nothing."""
        kind = _TYPES.get(self.path.suffix.lower())
        if kind is None or not self.path.is_file():
            return {}
        if kind == "image/svg+xml":
            return {kind: self.path.read_text(encoding="utf-8")}
        return {kind: b64encode(self.path.read_bytes()).decode("ascii")}
