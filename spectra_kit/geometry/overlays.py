"""Values and labels at the vertices of cortical surfaces, as FreeSurfer and GIfTI keep them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spectra_kit._core.checked import checked
from spectra_kit._core.files import atomic_path
from spectra_kit._core.optional import optional
from spectra_kit._core.records import Rebuilt
from spectra_kit._core.types import Ints
from spectra_kit._core.validate import as_array
from spectra_kit.errors import InvalidFileError, InvalidInputError
from spectra_kit.geometry.formats import gifti
from spectra_kit.geometry.formats.foreign import read_by
from spectra_kit.geometry.io import taken_of

_MORPH = b"\xff\xff\xff"  # how FreeSurfer's values begin, whatever they are called
_MORPHS = (".area", ".curv", ".sulc", ".thickness")
_SURFACE, _SOME, _LABELS = (1008, 1009), 1001, 1002  # intents of GIfTI


@checked
@dataclass(frozen=True, eq=False)
class Overlay(Rebuilt):
    """What a file tells of the n vertices of a surface.

    Parameters
    ----------
    values : ndarray of shape (n,) or (n, d)
        Thickness, curvature, activity, in the unit of the file; or labels, integers.
    names : dict of int to str
        What labels are called; empty where the values are none.
    """

    values: NDArray[Any]
    names: Mapping[int, str] = field(default_factory=dict)


@checked
def read_overlay(path: str | os.PathLike[str]) -> Overlay:
    """Read values or labels at the vertices of a surface.

    Parameters
    ----------
    path : path-like
        GIfTI (``.shape.gii``, ``.func.gii``, ``.label.gii``), annotations of FreeSurfer
        (``.annot``), or its values (``lh.thickness``, ``lh.curv``), which may have any name; packed
        or not. GIfTI and annotations need nibabel, which the extra ``brain`` installs.

    Returns
    -------
    Overlay
        In the order of the vertices. Of an annotation, labels count the names of its table, and -1
        is a vertex that has none of them.

    Raises
    ------
    InvalidFileError
        If the file is not there, cut short, or holds nothing of vertices.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from spectra_kit.geometry import read_overlay, write_overlay
    >>> with TemporaryDirectory() as folder:
    ...     write_overlay([2.5, 3.0, 1.5], Path(folder) / "lh.thickness")
    ...     read_overlay(Path(folder) / "lh.thickness").values
    array([2.5, 3. , 1.5])
    """
    return taken_of(Path(path), _overlay)


@checked
def write_overlay(values: ArrayLike, path: str | os.PathLike[str]) -> None:
    """Write values at the vertices of a surface for programs of neuro-imaging.

    Parameters
    ----------
    values : array_like of shape (n,) or (n, d)
        In any unit, rounded to float32; NaN says that there is none. The columns of several are
        one array each.
    path : path-like
        Where: GIfTI (best called ``.func.gii`` or ``.shape.gii``), or a file of FreeSurfer
        (``.curv``, ``.thickness``, ``.sulc``, ``.area``), which holds one value for each vertex.
        One that is there is replaced. `read_overlay` has an example.
    """
    path = Path(path)
    array = as_array("values", values)
    if array.dtype.kind not in "fiu" or array.ndim not in (1, 2) or not array.size:
        got = f"shape {array.shape} of {array.dtype}"
        raise InvalidInputError("values", "be numbers of shape (n,) or (n, d)", got)
    columns = array.reshape(len(array), -1).T
    if path.suffix.lower() == ".gii":
        with atomic_path(path) as part:
            gifti.save(part, {}, {f"{i}": column for i, column in enumerate(columns)})
    elif path.suffix.lower() not in _MORPHS:
        known = f"known are .gii, {', '.join(_MORPHS)}"
        raise InvalidFileError(path, f"cannot write values as {path.suffix!r}; {known}")
    elif len(columns) > 1:
        raise InvalidInputError("values", "have shape (n,) in files of FreeSurfer", array.shape)
    else:
        head = _MORPH + np.array([len(array), 0, 1], ">i4").tobytes()
        with atomic_path(path) as part:
            part.write_bytes(head + columns[0].astype(">f4").tobytes())


def _overlay(path: Path) -> Overlay:
    data = path.read_bytes()
    if path.suffix.lower() == ".gii":
        return _of_gifti(gifti.image_of(path))
    if path.suffix.lower() == ".annot":
        return _annotation(path, data)
    if not data.startswith(_MORPH):
        raise InvalidInputError(
            "holds no values of vertices that are known here: those of FreeSurfer, .annot and .gii"
        )
    n, _, each = np.frombuffer(data[3:15].ljust(12, b"\0"), ">i4").tolist()
    if n < 1 or each != 1 or len(data) != 15 + 4 * n:
        raise InvalidInputError(
            f"announces {n:,} vertices with {each} values, got {len(data) - 15:,} bytes; the file"
            " may be cut short"
        )
    return Overlay(np.frombuffer(data[15:], ">f4").astype(np.float64))


def _of_gifti(image: Any) -> Overlay:
    arrays = [array for array in image.darrays if array.intent not in _SURFACE]
    if not arrays or any(array.intent == _SOME for array in arrays):
        raise InvalidInputError("holds no values at each of the vertices")
    if len({np.shape(array.data) for array in arrays}) > 1:
        raise InvalidInputError("holds arrays of several lengths")
    is_labels = all(array.intent == _LABELS for array in arrays)
    table = [array.data if is_labels else np.asarray(array.data, np.float64) for array in arrays]
    names = dict(image.labeltable.get_labels_as_dict()) if is_labels else {}
    return Overlay(table[0] if len(table) == 1 else np.column_stack(table), names)


def _annotation(path: Path, data: bytes) -> Overlay:
    """Return the labels of an annotation; nibabel makes room before it knows how much there is."""
    freesurfer = optional("nibabel", extra="brain", needed_by="reading annotations").freesurfer
    n = int.from_bytes(data[:4], "big")
    rows = np.frombuffer(data[4 : 4 + 8 * n], ">i4") if len(data) > 12 + 8 * n else np.empty(0)
    is_table = data[4 + 8 * n : 8 + 8 * n] == b"\0\0\0\1"
    if not n or not is_table or (rows[::2] != np.arange(n)).any():
        raise InvalidInputError(
            f"announces {n:,} vertices, and has not all of them in order with a table of names"
            " behind; it may be damaged"
        )
    with read_by("nibabel"):
        values, table, names = freesurfer.read_annot(path, orig_ids=True)
    order = np.argsort(table[:, -1])
    at = order[np.searchsorted(table[order, -1], values).clip(max=len(order) - 1)]
    labels: Ints = np.where(table[at, -1] == values, at, -1)
    return Overlay(labels, {i: name.decode(errors="replace") for i, name in enumerate(names)})
