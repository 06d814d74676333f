"""Values and labels at the vertices of cortical surfaces, as FreeSurfer and GIfTI keep them."""

from __future__ import annotations

import gzip
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spectra_kit._core.checked import checked
from spectra_kit._core.files import atomic_path
from spectra_kit._core.optional import optional
from spectra_kit._core.records import Rebuilt
from spectra_kit._core.types import Ints
from spectra_kit._core.validate import as_array, check_count, quantity
from spectra_kit.errors import InvalidFileError, InvalidInputError
from spectra_kit.geometry.formats import gifti
from spectra_kit.geometry.formats._arrays import broken_line, real, whole
from spectra_kit.geometry.formats._room import PACKED, room
from spectra_kit.geometry.formats._text import text_of, words_of
from spectra_kit.geometry.formats.foreign import read_by
from spectra_kit.geometry.io import taken_of

_MORPH = b"\xff\xff\xff"  # how FreeSurfer's values begin, whatever they are called
_MORPHS = (".area", ".curv", ".sulc", ".thickness")
_VOXELS = {0: ">u1", 1: ">i4", 3: ">f4", 4: ">i2", 10: ">u2"}  # of FreeSurfer's volumes
_SURFACE, _SOME, _LABELS = (1008, 1009), 1001, 1002  # intents of GIfTI


@checked
@dataclass(frozen=True, eq=False)
class Overlay(Rebuilt):
    """What a file tells of the n vertices of a surface.

    Parameters
    ----------
    values : ndarray of shape (n,) or (n, d)
        Thickness, curvature, activity, in the unit of the file; or labels, integers; or whether a
        vertex is in the region of a ``.label``.
    names : dict of int to str
        What labels are called; empty where the values are none.
    """

    values: NDArray[np.bool_ | np.integer | np.floating]
    names: Mapping[int, str] = field(default_factory=dict)


@checked
def read_overlay(path: str | os.PathLike[str], *, n: int | None = None) -> Overlay:
    """Read values or labels at the vertices of a surface.

    Parameters
    ----------
    path : path-like
        GIfTI (``.shape.gii``, ``.func.gii``, ``.label.gii``), annotations of FreeSurfer
        (``.annot``), its regions (``.label``), volumes that hold values of vertices (``.mgh``,
        ``.mgz``), or its values (``lh.thickness``, ``lh.curv``), which may have any name; packed
        or not. GIfTI and annotations need nibabel, which the extra ``brain`` installs.
    n : int, optional
        How many vertices the surface has. A ``.label`` lists those of a region, and does not tell;
        of other files, whether they are of as many is looked at.

    Returns
    -------
    Overlay
        In the order of the vertices. Of an annotation, labels count the names of its table, and -1
        is a vertex that has none of them. Of a region, True and False, as `restrict` takes them.

    Raises
    ------
    InvalidFileError
        If the file is not there, cut short, holds nothing of vertices, or is of another number.

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
    size = None if n is None else check_count("n", n, low=1)

    def take(plain: Path) -> Overlay:
        found = _overlay(plain, size)
        if size not in (None, len(found.values)):
            told = f"is of {quantity(len(found.values), 'vertex')}, and the surface has {size:,}"
            raise InvalidInputError(told, advice="is it of the other hemisphere, or resampled?")
        return found

    return taken_of(Path(path), take)


@checked
def write_overlay(values: ArrayLike | Overlay, path: str | os.PathLike[str]) -> None:
    """Write values or labels at the vertices of a surface for programs of neuro-imaging.

    Parameters
    ----------
    values : array_like of shape (n,) or (n, d), or Overlay
        In any unit, rounded to float32; NaN says that there is none. The columns of several are
        one array each. An `Overlay` may name labels.
    path : path-like
        Where: GIfTI (best called ``.func.gii`` or ``.shape.gii``), or a file of FreeSurfer
        (``.curv``, ``.thickness``, ``.sulc``, ``.area``), which holds one value for each vertex.
        Integers become labels in a ``.label.gii``, called by their numbers where they have no
        names. One that is there is replaced. `read_overlay` has an example.
    """
    path = Path(path)
    names = values.names if isinstance(values, Overlay) else {}
    array = as_array("values", values.values if isinstance(values, Overlay) else values)
    if array.dtype.kind not in "fiu" or array.ndim not in (1, 2) or not array.size:
        got = f"shape {array.shape} of {array.dtype}"
        raise InvalidInputError("values", "be numbers of shape (n,) or (n, d)", got)
    columns = array.reshape(len(array), -1).T
    is_labels = bool(names) or path.name.lower().endswith(".label.gii")
    if is_labels and (array.dtype.kind == "f" or path.suffix.lower() != ".gii"):
        got = f"{array.dtype} for {path.name}"
        raise InvalidInputError("values", "be integers for a .label.gii where they are labels", got)
    if path.suffix.lower() == ".gii":
        table = {key: f"{key}" for key in np.unique(array).tolist()} | dict(names)
        with atomic_path(path) as part:
            named = {f"{i}": column for i, column in enumerate(columns)}
            gifti.save(part, {}, named, table if is_labels else None)
    elif path.suffix.lower() not in _MORPHS:
        known = f"known are .gii, {', '.join(_MORPHS)}"
        raise InvalidFileError(path, f"cannot write values as {path.suffix!r}; {known}")
    elif len(columns) > 1:
        raise InvalidInputError("values", "have shape (n,) in files of FreeSurfer", array.shape)
    else:
        head = _MORPH + np.array([len(array), 0, 1], ">i4").tobytes()
        with atomic_path(path) as part:
            part.write_bytes(head + columns[0].astype(">f4").tobytes())


def _overlay(path: Path, size: int | None) -> Overlay:
    data, suffix = path.read_bytes(), path.suffix.lower()
    if suffix == ".gii":
        return _of_gifti(gifti.image_of(path))
    if suffix == ".annot":
        return _annotation(path, data)
    if suffix == ".label":
        return _region(data, size)
    if suffix in (".mgh", ".mgz"):
        return _of_volume(data)
    if not data.startswith(_MORPH):
        raise InvalidInputError(
            "holds no values of vertices that are known here: those of FreeSurfer (lh.thickness,"
            " .annot, .label, .mgh, .mgz) and of GIfTI (.gii)"
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


def _region(data: bytes, size: int | None) -> Overlay:
    """Return which vertices a label lists: behind their count, each with x, y, z and a value."""
    if size is None:
        advice = "give `n`, that of the surface: read_overlay(path, n=mesh.n)"
        raise InvalidInputError(
            "lists vertices of a region, and not how many there are", advice=advice
        )
    rows = words_of(text_of(data))
    number, words = next(rows, (0, ["nothing"]))
    listed = []
    try:
        (count,) = map(whole, words)
        for number, words in rows:  # noqa: B007  # of the line that is broken
            vertex, *others = words
            if len([real(word) for word in others]) != 4:
                raise ValueError("where there must be a vertex, x, y, z and a value")  # noqa: TRY301
            listed.append(whole(vertex))
    except ValueError as error:
        raise broken_line(number, words, error) from error
    if len(listed) != count:
        raise InvalidInputError(
            f"announces {quantity(count, 'vertex')}, got {len(listed):,}; the file may be cut short"
        )
    if listed and not 0 <= min(listed) <= max(listed) < size:
        beyond = max(listed) if min(listed) >= 0 else min(listed)
        raise InvalidInputError(f"lists vertex {beyond:,}, and the surface has {size:,}")
    return Overlay(np.isin(np.arange(size), listed))


def _of_volume(data: bytes) -> Overlay:
    """Return the values of an image that is one voxel thin in two directions."""
    if data.startswith(PACKED[".gz"][0]):
        with read_by("gzip"):
            data = gzip.GzipFile(fileobj=BytesIO(data)).read(room(len(data)))
    version, *shape, kind = np.frombuffer(data[:24].ljust(24, b"\0"), ">i4").tolist()
    if version != 1 or kind not in _VOXELS or min(shape) < 1:
        raise InvalidInputError("must begin as .mgh does; the file may be damaged")
    if sorted(shape[:3])[1] > 1:
        raise InvalidInputError(
            f"holds an image of shape {tuple(shape)}, and no values at vertices",
            advice="of labels, geometry.from_labels(image) makes a surface of each",
        )
    n, columns = max(shape[:3]), shape[3]
    size = n * columns * np.dtype(_VOXELS[kind]).itemsize
    rows = data[284 : 284 + size]
    if len(rows) < size:
        told = f"announces {quantity(n, 'vertex')} with {quantity(columns, 'value')}"
        raise InvalidInputError(f"{told}, got {len(rows):,} bytes; the file may be cut short")
    values = np.frombuffer(rows, _VOXELS[kind]).reshape(columns, n).T
    values = values.astype(np.int64 if values.dtype.kind in "iu" else np.float64)
    return Overlay(values[:, 0] if columns == 1 else values)
