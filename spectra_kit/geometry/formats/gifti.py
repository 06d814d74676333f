"""GIfTI surfaces, read and written by nibabel, which `brain` installs."""

from __future__ import annotations

import base64
import re
import zlib
from collections.abc import Mapping
from colorsys import hsv_to_rgb
from pathlib import Path
from typing import Any
from xml.parsers.expat import ExpatError

import numpy as np

from spectra_kit._core.optional import optional
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.formats._arrays import Arrays
from spectra_kit.geometry.formats._room import MULTIPLE, room
from spectra_kit.geometry.formats.foreign import held_by, read_by
from spectra_kit.geometry.shapes import TriangleMesh


def read(path: Path) -> Arrays:
    """Return the point set and the triangles."""
    return held_by(image_of(path), "nibabel.load(path)")


def image_of(path: Path) -> Any:
    """Return a file as nibabel has it, if its arrays unpack to what `room` allows."""
    nibabel = optional("nibabel", extra="brain", needed_by="reading GIfTI")
    data = path.read_bytes()
    if b"ExternalFileBinary" in data:
        raise InvalidInputError(
            "its arrays lie in another file", advice="hand over nibabel.load(path)"
        )
    with read_by("nibabel", ExpatError):
        left = room(len(data)) * (b"GZipBase64Binary" in data)
        for packed in re.findall(rb"<Data>([^<]*)</Data>", data) if left else ():
            left -= len(zlib.decompressobj().decompress(base64.b64decode(packed), left + 1))
            if left < 0:
                raise InvalidInputError(
                    f"its arrays unpack to more than {MULTIPLE} times its size",
                    advice="if that is right, hand over nibabel.load(path)",
                )
        return nibabel.gifti.GiftiImage.from_bytes(data)


def write(mesh: TriangleMesh, path: Path, fields: Mapping[str, Any] | None = None) -> None:
    """Write a surface in the numbers of four bytes that the format has, and `fields` as shapes."""
    save(path, {"NIFTI_INTENT_POINTSET": mesh.points, "NIFTI_INTENT_TRIANGLE": mesh.faces}, fields)


def save(
    path: Path,
    parts: Mapping[str, Any],
    fields: Mapping[str, Any] | None = None,
    labels: Mapping[int, str] | None = None,
) -> None:
    """Write arrays by their intent, and behind them those that have a name: of `labels`, or any."""
    gifti = optional("nibabel", extra="brain", needed_by="writing GIfTI").gifti

    def array(values: Any, intent: str, **meta: str) -> Any:
        kind = np.int32 if np.asarray(values).dtype.kind in "iu" else np.float32
        if kind is np.int32 and np.abs(values).max(initial=0) > np.iinfo(kind).max:
            raise InvalidInputError(
                "values", "fit into the 32 bits of GIfTI", f"integers up to {np.abs(values).max()}"
            )
        return gifti.GiftiDataArray(
            np.asarray(values, kind), intent=intent, meta=gifti.GiftiMetaData(meta)
        )

    arrays = [array(values, intent) for intent, values in parts.items()]
    intent = "NIFTI_INTENT_SHAPE" if labels is None else "NIFTI_INTENT_LABEL"
    arrays += [array(values, intent, Name=name) for name, values in (fields or {}).items()]
    table = gifti.GiftiLabelTable()
    for key, name in (labels or {}).items():
        # Hues a golden section apart stay distinct, however many; what has no label is clear.
        colour = hsv_to_rgb(key * 0.618034 % 1, 0.6, 0.9)
        table.labels.append(gifti.GiftiLabel(key, *colour, alpha=float(key >= 0)))
        table.labels[-1].label = name
    path.write_bytes(gifti.GiftiImage(darrays=arrays, labeltable=table).to_bytes())
