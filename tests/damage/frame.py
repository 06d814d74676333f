"""The frame of the damage suite: cases run in a process of their own, and each has an outcome.

A part is a function of one `Case` in a module ``parts_*.py`` beside this file, marked with `part`.
It damages something as ``case.rng`` says, uses it, and

- returns where the answer is right (it calls `wrong` where it is not),
- lets errors of the library through: a SpectraKitError with a message is a clear refusal,
- calls `command` for a whole command, which judges exit code and stderr.

One case again, in this process, with its traceback and its files kept::

    python tests/damage/frame.py parts_own_files saved_spectrum 17
"""

from __future__ import annotations

import importlib
import multiprocessing
import os
import subprocess
import sys
import tempfile
import traceback
import zlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

FINE = ("right", "refused")
HERE = Path(__file__).resolve().parent
EXIT_CODES = (0, 2, 3, 130)  # of a command: fine, bad input, no convergence, interrupted
ENVIRONMENT = {
    **os.environ,
    "PYTHONPATH": os.pathsep.join([str(HERE.parents[1]), os.environ.get("PYTHONPATH", "")]),
}


@dataclass(frozen=True)
class Case:
    """What a part is called with: the same `number` is the same case, on every machine."""

    number: int
    rng: np.random.Generator
    folder: Path  # empty, and the case's own


@dataclass(frozen=True)
class Part:
    """A function of a case, how many cases of the asked-for number it gets, and their limit."""

    function: Callable[[Case], None]
    share: float
    seconds: float  # without an answer are a hang

    @property
    def name(self) -> str:
        return self.function.__name__

    def numbers(self, asked: int) -> range:
        return range(max(1, round(self.share * asked)))

    def run(self, number: int, folder: Path) -> None:
        seed = [number, zlib.crc32(self.name.encode())]
        self.function(Case(number, np.random.default_rng(seed), folder))


def part(*, share: float = 1.0, seconds: float = 120.0) -> Callable[[Callable[[Case], None]], Part]:
    return lambda function: Part(function, share, seconds)


def parts_of(module: str) -> dict[str, Part]:
    values = vars(importlib.import_module(module)).values()
    return {value.name: value for value in values if isinstance(value, Part)}


class Verdict(Exception):  # noqa: N818  # an outcome, not always an error
    """Ends a case with an outcome of its own."""

    def __init__(self, outcome: str, message: str) -> None:
        super().__init__(message)
        self.outcome = outcome


def wrong(message: str) -> NoReturn:
    """Say that an answer came without a word and is not the right one."""
    raise Verdict("wrong", message)


def start(arguments: Sequence[str | Path], folder: Path, **options: Any) -> subprocess.Popen[str]:
    """Start ``spectra-kit`` in `folder`."""
    return subprocess.Popen(
        [sys.executable, "-m", "spectra_kit", *arguments],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
        **{"env": ENVIRONMENT, **options},
    )


def ended(process: subprocess.Popen[str], *expected: int) -> None:
    """Wait, and judge the exit code where it is not one of those expected."""
    try:
        _, err = process.communicate(timeout=300)
    except subprocess.TimeoutExpired as late:
        process.kill()
        process.communicate()
        raise Verdict("hang", f"no end of {process.args}") from late
    if err.endswith("KeyboardInterrupt\n") and "spectra_kit/__main__.py" not in err:
        return  # Python itself was still starting
    judge(0 if process.returncode in expected else process.returncode, err)


def command(arguments: Sequence[str | Path], folder: Path, **options: Any) -> None:
    """Run ``spectra-kit`` in `folder`; a refusal ends the case."""
    ended(start(arguments, folder, **options))


def judge(code: int, err: str) -> None:
    """End the case unless a command ended well."""
    if code < 0 or code > 130:
        raise Verdict("crash", f"exit code {code}: {err[-400:]}")
    silent = code and not err.strip()
    if "Traceback (most recent call last)" in err or code not in EXIT_CODES or silent:
        raise Verdict("foreign", f"exit code {code}: {err[-400:]}")
    if code:
        raise Verdict("refused", err.strip().splitlines()[-1])


def outcome_of(module: str, name: str, number: int) -> tuple[str, str]:
    """Run one case here; return its outcome and what there is to say."""
    from spectra_kit.errors import SpectraKitError

    with tempfile.TemporaryDirectory(prefix="damage-") as folder:
        try:
            parts_of(module)[name].run(number, Path(folder))
        except Verdict as verdict:
            return verdict.outcome, str(verdict)
        except SpectraKitError as error:
            message = str(error)
            return ("refused" if len(message) > 20 else "foreign"), message
        except (Exception, SystemExit) as error:  # noqa: BLE001  # whatever: that is the outcome
            where = traceback.extract_tb(error.__traceback__)[-1]
            return "foreign", f"{error!r} in {where.filename}:{where.lineno}"
    return "right", ""


def outcomes(module: str, cases: Sequence[tuple[str, int]]) -> Iterator[tuple[str, str]]:
    """Run cases, each a part's name and a number; yield the outcome and message of each."""
    parts, spawn = parts_of(module), multiprocessing.get_context("spawn")
    pool = None
    for name, number in cases:
        if pool is None:  # one that crashed or hung is followed by another
            pool = ProcessPoolExecutor(1, mp_context=spawn)
            pool.submit(exec, f"import {module}").result()
        try:
            yield pool.submit(outcome_of, module, name, number).result(parts[name].seconds)
            continue
        except TimeoutError:
            found = "hang", f"no answer after {parts[name].seconds:g} s"
        except BrokenProcessPool as error:
            found = "crash", str(error)
        for process in pool._processes.values():
            process.kill()
        pool.shutdown(cancel_futures=True)
        pool = None
        yield found
    if pool is not None:
        pool.shutdown()


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


if __name__ == "__main__":
    sys.modules["frame"] = sys.modules["__main__"]  # parts import this very module
    one, name, number = sys.argv[1:]
    folder = Path(tempfile.mkdtemp(prefix="damage-"))
    print(f"{one} {name} {number} in {folder}")  # noqa: T201
    parts_of(one)[name].run(int(number), folder)
    print("right")  # noqa: T201
