"""FreeSurfer's triangles, which any extension may name: their first three bytes tell.

By hand, as nibabel makes room for what a file announces before it knows how much there is, and
takes one that is cut short, or counts too little, for whole.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from spectra_kit._core.validate import quantity
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.formats._arrays import Arrays, check_rest

MARK = b"\xff\xff\xfe"
_QUADS = (b"\xff\xff\xff", b"\xff\xff\xfd")
_TAGS = (1, 2, 3, 4, 5, 20, 21)  # of what may follow: where it lies in the scanner, how it was made


def read(path: Path) -> Arrays:
    """Return vertices, in millimetres around the centre of the volume, and faces."""
    data = path.read_bytes()
    if data[:3] in _QUADS:
        raise InvalidInputError(
            "holds quads, or values at vertices: FreeSurfer marks both alike",
            advice="nibabel.freesurfer.read_geometry(path) takes quads, read_overlay(path) values",
        )
    if data[:3] != MARK:
        raise InvalidInputError(f"must begin with {MARK!r}, got {data[:3]!r}")
    start = data.find(b"\n", data.find(b"\n", 3) + 1) + 1  # behind two lines of comment
    counts = np.frombuffer(data[start : start + 8], ">i4") if start else np.empty(0)
    if len(counts) < 2 or counts.min() < 1:
        raise InvalidInputError("must announce its vertices and faces; the file may be damaged")
    n, f = map(int, counts)
    middle, end = start + 8 + 12 * n, start + 8 + 12 * n + 12 * f
    if len(data) < end:
        raise InvalidInputError(
            f"announces {quantity(n, 'vertex')} and {quantity(f, 'face')}, {end:,} bytes, got"
            f" {len(data):,}; the file may be cut short"
        )
    points = np.frombuffer(data[start + 8 : middle], ">f4").reshape(n, 3).astype(np.float64)
    faces = np.frombuffer(data[middle:end], ">i4").reshape(f, 3)
    _check_end(data[end:], n)
    return points, faces


def _check_end(rest: bytes, n: int) -> None:
    """Refuse more rows than are announced; tags are no part of the surface."""
    first = np.frombuffer(rest[:12], ">i4") if len(rest) >= 12 else np.array([-1])
    if (first >= 0).all() and (first < n).all() and not (first[0] in _TAGS and first[1] < 2):
        check_rest(rest, is_row=True)
