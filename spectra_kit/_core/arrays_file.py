"""Arrays under names in one file: an uncompressed npz, aligned to be mapped, with a JSON header."""

from __future__ import annotations

import json
import math
import struct
import zipfile
from collections.abc import Callable, Collection, Iterable, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.files import atomic_path, parsing
from spectra_kit.errors import InvalidFileError, InvalidInputError

_HEADER = "header"
_ALIGNMENT = 64
_LOCAL_HEADER = 30  # bytes of a zip local file header before the name
_ZIP64_EXTRA = 20  # bytes that zipfile adds to the local header under force_zip64


def write_arrays(
    path: Path,
    header: Mapping[str, Any],
    arrays: Mapping[str, NDArray[Any]],
    *,
    flush: bool = True,
) -> None:
    """Write arrays and a header to `path`, whole or not at all; same content, same bytes.

    `flush` is that of `atomic_path`.
    """
    if path.suffix.lower() != ".npz":
        raise InvalidInputError("path", "end in .npz", repr(path.name))
    with atomic_path(path, flush=flush) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        _write_member(archive, _HEADER, np.array(json.dumps(header)))
        for name, array in arrays.items():
            _write_member(archive, name, np.ascontiguousarray(array))


def read_arrays(
    path: Path,
    what: str,
    choose: Callable[[dict[str, Any]], Iterable[str]],
    *,
    remedy: str,
    mapped: Collection[str] = (),
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return the header of the file `path`, and the arrays that `choose` names once it sees that.

    Those that are `mapped` are not read but mapped, without a look at their checksums.
    """
    if not path.is_file():
        raise InvalidFileError(path, f"there is no such file; looked from {Path.cwd()}")
    with (
        parsing(path, what, remedy=remedy),
        zipfile.ZipFile(path) as archive,
        path.open("rb") as raw,
    ):
        header = json.loads(str(_read_member(archive, _HEADER)))
        arrays = {
            name: _map_member(path, raw, archive, name)
            if name in mapped
            else _read_member(archive, name)
            for name in choose(header)
        }
    return header, arrays


def _write_member(archive: zipfile.ZipFile, name: str, array: NDArray[Any]) -> None:
    """Store `array` as ``name.npy`` so that its data begin on a 64-byte boundary of the file."""
    info = zipfile.ZipInfo(f"{name}.npy")  # the fixed 1980 date: same spectrum, same bytes
    assert archive.fp is not None
    start = archive.fp.tell() + _LOCAL_HEADER + len(info.filename) + _ZIP64_EXTRA
    padding = -(start + 4) % _ALIGNMENT
    info.extra = struct.pack("<HH", 0x5A4B, padding) + bytes(padding)  # an id nobody interprets
    with archive.open(info, "w", force_zip64=True) as member:
        np.lib.format.write_array(member, array, allow_pickle=False)


def _read_member(archive: zipfile.ZipFile, name: str) -> NDArray[Any]:
    """Read ``name.npy``, all its bytes: at the last one `zipfile` compares the checksum."""
    info = _member(archive, name)
    with archive.open(info) as member:
        dims, _, dtype = _array_header(member)
        size = math.prod(dims) * dtype.itemsize
        if not dtype.itemsize or member.tell() + size != info.file_size:
            raise ValueError(f"{info.filename} has {info.file_size} bytes for a shape of {dims}")
        member.seek(0)
        return np.asarray(np.lib.format.read_array(member, allow_pickle=False))


def _member(archive: zipfile.ZipFile, name: str) -> zipfile.ZipInfo:
    """Return where ``name.npy`` is. It takes as many bytes as it holds, and no more is read."""
    info = archive.getinfo(f"{name}.npy")
    if info.compress_type != zipfile.ZIP_STORED or info.file_size != info.compress_size:
        raise ValueError(f"{info.filename} is compressed, which nothing here writes")
    return info


def _array_header(file: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    np.lib.format.read_magic(file)
    return np.lib.format.read_array_header_1_0(file)


def _map_member(path: Path, raw: IO[bytes], archive: zipfile.ZipFile, name: str) -> NDArray[Any]:
    """Map ``name.npy`` read-only, straight out of the archive."""
    info = _member(archive, name)
    raw.seek(info.header_offset + 26)
    name_length, extra_length = struct.unpack("<HH", raw.read(4))
    raw.seek(info.header_offset + _LOCAL_HEADER + name_length + extra_length)
    dims, fortran_order, dtype = _array_header(raw)
    return np.memmap(
        path, dtype, "r", offset=raw.tell(), shape=dims, order="F" if fortran_order else "C"
    )
