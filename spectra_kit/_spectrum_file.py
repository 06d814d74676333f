"""The file format of a `Spectrum`: an uncompressed, aligned npz with a JSON header."""

from __future__ import annotations

import json
import math
import struct
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from spectra_kit._files import atomic_path, parsing
from spectra_kit.catalogue import SOLVERS
from spectra_kit.errors import InvalidFileError, InvalidInputError

# 2: certificates may hold a count; 3: what it misses, `accuracy`, `excess`; 4: `name`; 5: `errors`;
# 6: `bounded`
# and `reason`
FORMAT_VERSION = 6
_ARRAYS = ("eigenvalues", "eigenvectors", "mass")
_RESIDUALS = ("residuals", "relative_residuals")
_ALIGNMENT = 64
_LOCAL_HEADER = 30  # bytes of a zip local file header before the name
_ZIP64_EXTRA = 20  # bytes that zipfile adds to the local header under force_zip64


def write_spectrum_file(
    path: Path,
    arrays: Mapping[str, NDArray[np.float64]],
    certificate: Mapping[str, Any] | None,
    provenance: Mapping[str, Any],
) -> None:
    """Write `arrays`, and the scalars of `certificate` and `provenance` as JSON, to `path`."""
    if path.suffix.lower() != ".npz":
        raise InvalidInputError("path", "end in .npz", repr(path.name))
    members = dict(arrays)
    header: dict[str, Any] = {
        "format": "spectra_kit spectrum",
        "version": FORMAT_VERSION,
        "provenance": {**provenance, "seconds": dict(provenance["seconds"])},
        "certificate": None,
    }
    if certificate is not None:
        members |= {name: certificate[name] for name in _RESIDUALS}
        header["certificate"] = {k: v for k, v in certificate.items() if k not in _RESIDUALS}
    with atomic_path(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        _write_member(archive, "header", np.array(json.dumps(header)))
        for name, array in members.items():
            _write_member(archive, name, np.ascontiguousarray(array))


def read_spectrum_file(
    path: Path, *, mmap: bool
) -> tuple[dict[str, Any], dict[str, Any] | None, dict[str, Any]]:
    """Return the arrays, the certificate's fields (or None) and the provenance's fields."""
    if not path.is_file():
        raise InvalidFileError(path, f"there is no such file; looked from {Path.cwd()}")
    with (
        parsing(path, "spectrum file", remedy="write it again with Spectrum.save"),
        zipfile.ZipFile(path) as archive,
        path.open("rb") as raw,
    ):
        header = json.loads(str(_read_member(archive, "header")))
        if header["format"] != "spectra_kit spectrum":
            raise KeyError("format")
        if header["version"] > FORMAT_VERSION:
            raise InvalidFileError(
                path,
                f"it has format version {header['version']}, this spectra_kit reads up to"
                f" {FORMAT_VERSION}; upgrade it",
            )
        certificate, provenance = header["certificate"], _named(header["provenance"])
        if certificate is not None:
            certificate |= {name: _read_member(archive, name) for name in _RESIDUALS}
        arrays = {
            name: _map_member(path, raw, archive, name) if mmap else _read_member(archive, name)
            for name in _ARRAYS
        }
    return arrays, certificate, provenance


def _named(provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Return the provenance with the name and accuracy of the solver, where the file lacks them."""
    made = str(provenance["solver"])
    name = "" if made == "user" else made.partition("(")[0].lower()
    if made.startswith("RayleighRitz(subspace=AmbientFourier("):
        name = "fourier"
    accuracy = SOLVERS[name].promise if name in SOLVERS else ""
    return {"name": name, "accuracy": accuracy, **provenance}


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
    info = archive.getinfo(f"{name}.npy")
    with archive.open(info) as member:
        dims, _, dtype = _array_header(member)
        size = math.prod(dims) * dtype.itemsize
        if member.tell() + size != info.file_size:
            raise ValueError(f"{info.filename} has {info.file_size} bytes for a shape of {dims}")
        member.seek(0)
        return np.asarray(np.lib.format.read_array(member, allow_pickle=False))


def _array_header(file: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    np.lib.format.read_magic(file)
    return np.lib.format.read_array_header_1_0(file)


def _map_member(path: Path, raw: IO[bytes], archive: zipfile.ZipFile, name: str) -> NDArray[Any]:
    """Map ``name.npy`` read-only, straight out of the archive."""
    info = archive.getinfo(f"{name}.npy")
    if info.compress_type != zipfile.ZIP_STORED:
        raise InvalidFileError(path, "it is compressed and cannot be mapped; load it without mmap")
    raw.seek(info.header_offset + 26)
    name_length, extra_length = struct.unpack("<HH", raw.read(4))
    raw.seek(info.header_offset + _LOCAL_HEADER + name_length + extra_length)
    dims, fortran_order, dtype = _array_header(raw)
    return np.memmap(
        path, dtype, "r", offset=raw.tell(), shape=dims, order="F" if fortran_order else "C"
    )
