"""Hashes by which results are known again: of arrays, of shapes, and of all that decides a result.

And by which a file is known to be whole, where its format has none (`sealed`).

Options tell all that decides a result by their `repr`, weights by a hash: so a solver, a recipe or
an embedding is its own description.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.types import Floats

_DIGEST = "_digest"


class _Shape(Protocol):
    @property
    def points(self) -> Floats: ...


def arrays_digest(*arrays: NDArray[Any]) -> str:
    """Hash of what arrays hold, their shapes and types."""
    found = hashlib.blake2b(digest_size=16)
    for array in arrays:
        found.update(f"{array.dtype.str}{array.shape}".encode())
        found.update(np.ascontiguousarray(array).data)
    return found.hexdigest()


def shape_digest(geometry: _Shape) -> str:
    """Hash of the points of a cloud; of a mesh, of its faces, too. It is kept with the geometry."""
    known: str | None = vars(geometry).get(_DIGEST)
    if known is None:
        parts = (getattr(geometry, name, None) for name in ("points", "faces"))
        known = arrays_digest(*(array for array in parts if array is not None))
        vars(geometry)[_DIGEST] = known
    return known


def facts_digest(facts: Mapping[str, object]) -> str:
    """Hash of what JSON can say."""
    text = json.dumps(facts, sort_keys=True)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


#: Where the sha256 of a file goes, while it is computed: the first such place in it.
BLANK = "0" * 64


def sealed(data: bytes) -> bytes:
    """Return the content of a file with its sha256 in place of the blank."""
    return data.replace(BLANK.encode(), hashlib.sha256(data).hexdigest().encode(), 1)


def has_seal(data: bytes, seal: object) -> bool:
    """Whether the content of a file, which names a seal, is what was `sealed` with it."""
    blank = data.replace(str(seal).encode(), BLANK.encode(), 1)
    return blank != data and sealed(blank) == data
