"""The file format of a `Spectrum`: an uncompressed, aligned npz with a JSON header."""

from __future__ import annotations

import json
import struct
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from spectra_kit._files import atomic_path
from spectra_kit.errors import InvalidInputError

FORMAT_VERSION = 2  # since certificates may hold a count; files without one are written as 1
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
        raise InvalidInputError(f"`path` must end in .npz, got {path.name!r}")
    members = dict(arrays)
    header: dict[str, Any] = {
        "format": "spectra_kit spectrum",
        "version": FORMAT_VERSION if certificate and "count" in certificate else 1,
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
        raise InvalidInputError(f"`path` must be a spectrum file, found no file {str(path)!r}")
    try:
        with zipfile.ZipFile(path) as archive, path.open("rb") as raw:
            header = json.loads(str(_read_member(archive, "header")))
            if header["format"] != "spectra_kit spectrum":
                raise KeyError("format")  # noqa: TRY301
            if header["version"] > FORMAT_VERSION:
                raise InvalidInputError(  # noqa: TRY301
                    f"{path} has format version {header['version']}, this spectra_kit reads up to"
                    f" {FORMAT_VERSION}; upgrade it"
                )
            certificate = header["certificate"]
            if certificate is not None:
                certificate |= {name: _read_member(archive, name) for name in _RESIDUALS}
            arrays = {
                name: _map_member(path, raw, archive, name) if mmap else _read_member(archive, name)
                for name in _ARRAYS
            }
    except InvalidInputError:
        raise
    except (zipfile.BadZipFile, KeyError, EOFError, OSError, ValueError, TypeError) as error:
        raise InvalidInputError(
            f"{path} is not a whole spectrum file ({error}); write it again with Spectrum.save"
        ) from error
    return arrays, certificate, header["provenance"]


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
    with archive.open(f"{name}.npy") as member:
        return np.asarray(np.lib.format.read_array(member, allow_pickle=False))


def _map_member(path: Path, raw: IO[bytes], archive: zipfile.ZipFile, name: str) -> NDArray[Any]:
    """Map ``name.npy`` read-only, straight out of the archive."""
    info = archive.getinfo(f"{name}.npy")
    if info.compress_type != zipfile.ZIP_STORED:
        raise InvalidInputError(f"{path} is compressed and cannot be mapped; load it without mmap")
    raw.seek(info.header_offset + 26)
    name_length, extra_length = struct.unpack("<HH", raw.read(4))
    raw.seek(info.header_offset + _LOCAL_HEADER + name_length + extra_length)
    np.lib.format.read_magic(raw)
    dims, fortran_order, dtype = np.lib.format.read_array_header_1_0(raw)
    return np.memmap(
        path, dtype, "r", offset=raw.tell(), shape=dims, order="F" if fortran_order else "C"
    )
