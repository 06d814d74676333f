"""Tall blocks of columns, on the host or on a device: which functions go with them."""

from __future__ import annotations

from typing import Any

import numpy as np


def operations(block: Any) -> Any:
    """Return the module of functions for a block of columns: `host` for arrays, else `device`.

    Both have the same functions; matrices and weights that go with a block are of its kind.
    """
    if isinstance(block, np.ndarray):
        from spectra_kit._sparse import host

        return host
    from spectra_kit._sparse import device

    return device
