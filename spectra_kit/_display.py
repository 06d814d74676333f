"""How values show themselves in notebooks, and draw themselves by `viz`, which lies above them."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping
from html import escape
from importlib import import_module
from typing import Any

from spectra_kit._files import temporary_folder


def table(title: str, facts: Mapping[str, object]) -> str:
    """Return a table of names and values, as HTML."""
    rows = "".join(
        f"<tr><th>{escape(name)}</th><td>{escape(str(value))}</td></tr>"
        for name, value in facts.items()
    )
    return f"<table><caption>{escape(title)}</caption>{rows}</table>"


def draw(plot: str, *arguments: Any, **options: Any) -> Any:
    """Call a plot or a class of `viz`, which imports what it draws with: so not before it must."""
    return getattr(import_module("spectra_kit.viz"), plot)(*arguments, **options)


def drawn(caption: str, plot: str, *arguments: Any, **options: Any) -> str:
    """Return what a plot of `viz` draws, with a caption, as HTML."""
    with temporary_folder() as folder:
        draw(plot, path := folder / "picture.png", *arguments, **options)
        content = b64encode(path.read_bytes()).decode("ascii")
    return f'<img src="data:image/png;base64,{content}"><br>{escape(caption)}'
