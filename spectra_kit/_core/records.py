"""How records show themselves in notebooks."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape


def table(title: str, facts: Mapping[str, object]) -> str:
    """Return a table of names and values, as HTML."""
    rows = "".join(
        f"<tr><th>{escape(name)}</th><td>{escape(str(value))}</td></tr>"
        for name, value in facts.items()
    )
    return f"<table><caption>{escape(title)}</caption>{rows}</table>"
