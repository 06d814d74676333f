"""PCD of the Point Cloud Library, ASCII and binary: the fields x, y, z; others are skipped."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from spectra_kit._core.validate import quantity
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.formats import xyz
from spectra_kit.geometry.formats._arrays import Arrays, check_rest, whole
from spectra_kit.geometry.formats._text import text_of

_KINDS = {"F": "f", "I": "i", "U": "u"}


def read(path: Path) -> Arrays:
    """Return the points in the order of the file."""
    data = path.read_bytes()
    end = re.search(rb"^DATA[ \t]+(\w+)[ \t]*\r?\n", data, re.MULTILINE)
    if end is None:
        raise InvalidInputError("must have a PCD header that ends with DATA; it may be cut short")
    head = data[: end.start()].decode("latin-1").split("\n")
    header = {words[0]: words[1:] for line in head if (words := line.partition("#")[0].split())}
    try:
        names, kinds = [name.lower() for name in header["FIELDS"]], header["TYPE"]
        counts = [*map(whole, header.get("COUNT", ["1"] * len(names)))]
        columns = zip(names, kinds, map(whole, header["SIZE"]), counts, strict=True)
        fields = [(name, f"<{_KINDS[kind]}{size}", (count,)) for name, kind, size, count in columns]
        (n,) = map(whole, header["POINTS"])
        # Paddings may share a name.
        row = np.dtype([(f"{i}", kind, count) for i, (_, kind, count) in enumerate(fields)])
        axes = [names.index(axis) for axis in "xyz"]
    except (KeyError, ValueError, TypeError) as error:
        raise InvalidInputError(f"must have a whole PCD header ({error})") from error
    body, form = data[end.end() :], end[1].decode().lower()
    if form == "ascii":
        heading = " ".join(name for name, _, (count,) in fields for _ in range(count))
        text = text_of(body)
        points = np.asarray(xyz.line_by_line(f"{heading}\n".encode() + text) if text else [])
        if len(points) != n:
            raise InvalidInputError(f"announces {quantity(n, 'point')}, got {len(points):,}")
        return points, None
    if form != "binary":
        raise InvalidInputError(
            f"its points are packed ({form})",
            advice="hand over open3d.io.read_point_cloud(path), or unpack it once:"
            " pcl_convert_pcd_ascii_binary FILE OUT 1",
        )
    if n < 0 or len(body) < n * row.itemsize:
        raise InvalidInputError(
            f"announces {quantity(n, 'point')}, {n * row.itemsize:,} bytes, got {len(body):,}; the"
            " file may be cut short"
        )
    check_rest(body[n * row.itemsize :], is_row=len(body) >= (n + 1) * row.itemsize)
    table = np.frombuffer(body, row, n)
    return np.column_stack([table[f"{i}"][:, 0] for i in axes]).astype(np.float64), None
