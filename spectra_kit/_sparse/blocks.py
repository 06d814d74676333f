"""Tall blocks of columns, on the host or on a device: what goes with them, torch or none."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np

from spectra_kit._core.clock import Clock


def operations(block: Any) -> Any:
    """Return the module of functions for a block of columns: `host` for arrays, else `device`.

    Both have the same functions; matrices and weights that go with a block are of its kind.
    """
    if isinstance(block, np.ndarray):
        from spectra_kit._sparse import host

        return host
    from spectra_kit._sparse import device

    return device


def device_clock(device: object) -> Clock:
    """Return a clock that waits for CUDA, which otherwise works on after a call returns."""
    if str(device) == "cpu":  # which needs no torch
        return Clock()
    import torch

    place = torch.device(str(device))
    return Clock(partial(torch.cuda.synchronize, place) if place.type == "cuda" else None)


@contextmanager
def device_memory() -> Iterator[None]:
    """Turn what torch raises for want of memory into a `MemoryError`."""
    try:
        yield
    except RuntimeError as error:
        torch = sys.modules.get("torch")  # without it, nothing of its own can have been raised
        full = torch is not None and isinstance(error, torch.OutOfMemoryError)
        # What the CPU's allocator raises has no type of its own.
        if not full and "can't allocate memory" not in str(error):
            raise
        raise MemoryError(str(error).partition("\n")[0]) from error
