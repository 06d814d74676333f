"""The packages in ``docs/api/index.rst``: a line of each, which the repository shows, too.

There it leads to the source, on the site to the page of the package. The build brings the first
sentences of the docstrings up to date.
"""

from __future__ import annotations

import importlib
import re
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sphinx.application import Sphinx

PAGE = Path(__file__).parents[1] / "api" / "index.rst"
_LINE = re.compile(r"^- `spectra_kit\.(\w+) <\S+>`__: .*$", re.M)


def _line(found: re.Match[str]) -> str:
    module = importlib.import_module(f"spectra_kit.{found[1]}")
    assert module.__file__ is not None
    assert module.__doc__ is not None
    place = Path(module.__file__)
    name = place.parent.name if place.stem == "__init__" else place.name
    first = module.__doc__.partition("\n")[0]
    return f"- `spectra_kit.{found[1]} <../../spectra_kit/{name}>`__: {first}"


def whole(page: str) -> str:
    """Return the page with what the packages say of themselves today."""
    return _LINE.sub(_line, page)


def _link_to_pages(app: Sphinx, page: str, source: list[str]) -> None:
    if page == "api/index":
        source[0] = re.sub(r"<\.\./\.\./spectra_kit/(\w+)(\.py)?>`__", r"<\1.html>`__", source[0])


def setup(app: Sphinx) -> dict[str, bool]:
    before = PAGE.read_text()
    if (now := whole(before)) != before:
        PAGE.write_text(now)
    app.connect("source-read", _link_to_pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
