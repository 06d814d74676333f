"""The file format of a `Spectrum`: arrays, and what is known of them as a JSON header."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from spectra_kit._core.arrays_file import read_arrays, write_arrays
from spectra_kit.catalogue import SOLVERS
from spectra_kit.eigen.certificate import Certificate, ModeCount, Provenance
from spectra_kit.errors import InvalidFileError

# 2: certificates may hold a count; 3: what it misses, `accuracy`, `excess`; 4: `name`; 5: `errors`
# and `reason`; 6: `bounded`; 7: a mass that is a matrix, `dimension`, which is 2 in those before
FORMAT_VERSION = 7
REMEDY = "write it again with Spectrum.save"
_ARRAYS = ("eigenvalues", "eigenvectors", "mass")
_RESIDUALS = ("residuals", "relative_residuals")
_MATRIX = ("mass_data", "mass_indices", "mass_indptr")  # of a mass that is not lumped


def write_spectrum_file(
    path: Path,
    arrays: Mapping[str, NDArray[np.floating]],
    certificate: Certificate | None,
    provenance: Provenance,
    **more: object,
) -> None:
    """Write `arrays`, and what is known of them as JSON, to `path`.

    What `more` there is to say stands in the header, too.
    """
    members: dict[str, NDArray[Any]] = dict(arrays)
    header: dict[str, Any] = {
        "format": "spectra_kit spectrum",
        "version": FORMAT_VERSION,
        "provenance": {**vars(provenance), "seconds": dict(provenance.seconds)},
        "certificate": None,
        "consistent_mass": _MATRIX[0] in members,
        **more,
    }
    if certificate is not None:
        record = {name: value for name, value in vars(certificate).items() if value is not None}
        members |= {name: record.pop(name) for name in _RESIDUALS}
        for name in record.keys() & {"excess", "errors", "bounded"}:
            record[name] = record[name].tolist()
        if certificate.count is not None:
            record["count"] = vars(certificate.count)
        header["certificate"] = record
    write_arrays(path, header, members)


def read_spectrum_file(path: Path, *, mmap: bool) -> dict[str, Any]:
    """Return what a spectrum is made of, by name."""

    def choose(header: dict[str, Any]) -> tuple[str, ...]:
        if header["format"] != "spectra_kit spectrum":
            raise KeyError("format")
        if header["version"] > FORMAT_VERSION:
            raise InvalidFileError(
                path,
                f"it has format version {header['version']}, this spectra_kit reads up to"
                f" {FORMAT_VERSION}; upgrade it",
            )
        header["provenance"] = _named(header["provenance"])
        chosen = _ARRAYS + (_MATRIX if header.get("consistent_mass") else ())
        if header["certificate"] is None:
            return chosen
        header["certificate"] = dict(header["certificate"])
        return chosen + _RESIDUALS

    header, arrays = read_arrays(
        path,
        "spectrum file",
        choose,
        remedy=REMEDY,
        mapped=_ARRAYS if mmap else (),
    )
    record, certificate = header["certificate"], None
    if record is not None:
        count = record.pop("count", None)
        record |= {name: arrays.pop(name) for name in _RESIDUALS}
        certificate = Certificate(**record, count=ModeCount(**count) if count else None)
    if _MATRIX[0] in arrays:
        n = len(arrays["mass"])
        parts = tuple(arrays.pop(name) for name in _MATRIX)
        arrays["consistent_mass"] = sparse.csr_array(parts, shape=(n, n))
    provenance, dimension = Provenance(**header["provenance"]), header.get("dimension", 2)
    return {
        **arrays,
        "certificate": certificate,
        "provenance": provenance,
        "dimension": dimension,
    }


def _named(provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Return the provenance with the name and accuracy of the solver, where the file lacks them."""
    made = str(provenance["solver"])
    name = "" if made == "user" else made.partition("(")[0].lower()
    if made.startswith("RayleighRitz(subspace=AmbientFourier("):
        name = "fourier"
    accuracy = SOLVERS[name].promise if name in SOLVERS else ""
    return {"name": name, "accuracy": accuracy, **provenance}
