"""What a pair's own match has found, in a file: so that a collection goes on where it stopped."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from spectra_kit._core.arrays_file import read_arrays, write_arrays
from spectra_kit._core.fingerprint import arrays_digest, facts_digest
from spectra_kit._core.version import VERSION
from spectra_kit.maps.prepare import Prepared
from spectra_kit.maps.synchronise import Found

_NAMES = ("maps", "scores", "mirrored")


def shape_key(shape: Prepared) -> str:
    """Return a hash of all that a match takes of a surface."""
    spectrum, seen = shape.spectrum, shape.surface
    placed = () if seen is None else (seen.points, seen.oriented.faces, seen.curvature)
    parts = (spectrum.eigenvalues, spectrum.eigenvectors, spectrum.mass, shape.samples, *placed)
    return arrays_digest(*parts)


def found_path(folder: Path, source: str, target: str, how: str) -> Path:
    """Return the file of a pair, by the keys of its surfaces and how it is matched."""
    facts = {"release": VERSION, "source": source, "target": target, "how": how}
    return folder / f"{facts_digest(facts)}.npz"


def write_found(path: Path, found: Found) -> None:
    """Keep it, whole or not at all."""
    arrays = {name: np.asarray(getattr(found, name)) for name in _NAMES}
    write_arrays(path, {"convincing": found.convincing}, arrays)


def read_found(path: Path) -> Found:
    """Return what was kept."""
    header, arrays = read_arrays(
        path, "kept pair of a collection", lambda _: _NAMES, remedy="remove it: it is made again"
    )
    return Found(**arrays, convincing=bool(header["convincing"]))
