"""Damage to bytes, as disks, networks and careless hands do it."""

from __future__ import annotations

import numpy as np


def damaged(rng: np.random.Generator, data: bytes) -> bytes:
    """Return `data` with one to three faults."""
    for _ in range(rng.integers(1, 4)):
        data = _FAULTS[rng.integers(len(_FAULTS))](rng, data)
    return data


def flipped(rng: np.random.Generator, data: bytes) -> bytes:
    """One bit turned."""
    changed = bytearray(data)
    if changed:
        changed[rng.integers(len(changed))] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def truncated(rng: np.random.Generator, data: bytes) -> bytes:
    """The end is missing."""
    return data[: rng.integers(len(data) + 1)]


def _overwritten(rng: np.random.Generator, data: bytes) -> bytes:
    a, b = _range(rng, data)
    return data[:a] + rng.bytes(b - a) + data[b:]


def _zeroed(rng: np.random.Generator, data: bytes) -> bytes:
    a, b = _range(rng, data)
    return data[:a] + bytes(b - a) + data[b:]


def _cut_out(rng: np.random.Generator, data: bytes) -> bytes:
    a, b = _range(rng, data)
    return data[:a] + data[b:]


def _repeated(rng: np.random.Generator, data: bytes) -> bytes:
    a, b = _range(rng, data)
    return data[:b] + data[a:]


def _moved(rng: np.random.Generator, data: bytes) -> bytes:
    a, b = _range(rng, data)
    rest = data[:a] + data[b:]
    at = int(rng.integers(len(rest) + 1))
    return rest[:at] + data[a:b] + rest[at:]


def _range(rng: np.random.Generator, data: bytes) -> tuple[int, int]:
    """A piece, more often short than long."""
    start = int(rng.integers(len(data) + 1))
    return start, min(len(data), start + int(2 ** rng.uniform(0, 12)))


_FAULTS = (flipped, flipped, truncated, _overwritten, _zeroed, _cut_out, _repeated, _moved)
