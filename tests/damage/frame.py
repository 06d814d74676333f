"""The frame of the damage suite: a part is a test of many random cases, each with an outcome.

A part is a function of one `Case`, marked with `part`. It damages something as ``case.rng`` says,
uses it, and

- returns where the answer is right, and asserts that it is,
- lets errors of the library through: a SpectraKitError with a message is a clear refusal.

All else fails. A crash or a hang ends the process of the tests, which pytest-xdist tells by case.
One case again: ``pytest 'tests/damage/test_damaged_files.py::test_saved_spectrum[17]'``.
"""

from __future__ import annotations

import faulthandler
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from spectra_kit.errors import SpectraKitError


@dataclass(frozen=True)
class Case:
    """What a part is called with: the same `number` is the same case, on every machine."""

    number: int
    rng: np.random.Generator
    folder: Path  # empty, and the case's own


def part(*, share: float = 1.0, seconds: float = 120.0) -> Callable[..., Callable[..., None]]:
    """Make a test of `share` as many cases as are asked for, each a hang after `seconds`."""

    def test_of(function: Callable[[Case], None]) -> Callable[..., None]:
        name = function.__name__.removeprefix("test_")

        @pytest.mark.slow
        @pytest.mark.filterwarnings("ignore")
        def test(number: int, tmp_path: Path, record_property) -> None:
            rng = np.random.default_rng([number, zlib.crc32(name.encode())])
            refusal = None
            faulthandler.dump_traceback_later(seconds, exit=True)
            try:
                function(Case(number, rng, tmp_path))
            except SpectraKitError as error:
                refusal = str(error)
            finally:
                faulthandler.cancel_dump_traceback_later()
            assert refusal is None or len(refusal) > 20
            record_property("damage", f"{name}, {'refused' if refusal else 'right'}")

        test.share = share
        return test

    return test_of


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Number the cases of the parts of a module that imports this."""
    if share := getattr(metafunc.function, "share", None):
        asked = metafunc.config.getoption("damage")
        metafunc.parametrize("number", range(max(1, round(share * asked))))


# --- damage to bytes, as disks, networks and careless hands do it ---------------------------------


def damaged(rng: np.random.Generator, data: bytes) -> bytes:
    """Return `data` with one to three faults."""
    for _ in range(rng.integers(1, 4)):
        fault = rng.integers(len(_PIECES) + 3)
        if fault >= 3:
            start = int(rng.integers(len(data) + 1))  # of a piece, more often short than long
            end = min(len(data), start + int(2 ** rng.uniform(0, 12)))
            data = _PIECES[fault - 3](rng, data[:start], data[start:end], data[end:])
        else:
            data = data[: rng.integers(len(data) + 1)] if fault == 2 else flipped(rng, data)
    return data


def flipped(rng: np.random.Generator, data: bytes) -> bytes:
    """One bit turned."""
    changed = bytearray(data)
    if changed:
        changed[rng.integers(len(changed))] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def _moved(rng: np.random.Generator, a: bytes, piece: bytes, b: bytes) -> bytes:
    at = int(rng.integers(len(a + b) + 1))
    return (a + b)[:at] + piece + (a + b)[at:]


_PIECES = (
    lambda rng, a, piece, b: a + rng.bytes(len(piece)) + b,
    lambda _, a, piece, b: a + bytes(len(piece)) + b,
    lambda _, a, piece, b: a + b,
    lambda _, a, piece, b: a + piece + piece + b,
    _moved,
)
