"""Markdown of tables and numbers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

NONE = "-"


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table, its columns aligned; the first to the left.

    Parameters
    ----------
    header : sequence of str
        Titles of c columns.
    rows : iterable of sequence of str
        With c cells each.

    Returns
    -------
    str
        Without a newline at its end.

    Examples
    --------
    >>> from spectra_kit.benchmarks.geodesics.markdown import table
    >>> print(table(["mesh", "n"], [["bunny", "7"]]))
    | mesh  |  n |
    | :---- | -: |
    | bunny |  7 |
    """
    lines = [list(header), *map(list, rows)]
    width = [max(2, *(len(line[i]) for line in lines)) for i in range(len(header))]

    def text(cells: Sequence[str]) -> str:
        padded = [
            cell.rjust(w) if i else cell.ljust(w)
            for i, (cell, w) in enumerate(zip(cells, width, strict=True))
        ]
        return "| " + " | ".join(padded) + " |"

    rule = ["-" * (w - 1) + ":" if i else ":" + "-" * (w - 1) for i, w in enumerate(width)]
    return "\n".join([text(lines[0]), text(rule), *map(text, lines[1:])])


def number(value: float | None, form: str) -> str:
    """Return a value in a format, or a dash for one that is missing."""
    return NONE if value is None else format(value, form)
