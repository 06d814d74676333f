"""The frame of the damage suite: cases run in a process of their own, and each has an outcome.

A part is a function of one `Case` in a module ``parts_*.py`` beside this file, marked with `part`.
It damages something as ``case.rng`` says, uses it, and

- returns where the answer is right (it calls `wrong` where it is not),
- lets errors of the library through: a SpectraKitError with a message is a clear refusal,
- calls `command` for a whole command, which judges exit code and stderr.

One case again, in this process, with its traceback and its files kept::

    python tests/damage/frame.py parts_spectra saved_spectrum 17
"""

from __future__ import annotations

import importlib
import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
import traceback
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

FINE = ("right", "refused")
OUTCOMES = (*FINE, "foreign", "crash", "hang", "wrong")
HERE = Path(__file__).resolve().parent
EXIT_CODES = (0, 2, 3, 130)  # of a command: fine, bad input, no convergence, interrupted


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
    seconds: float

    @property
    def name(self) -> str:
        return self.function.__name__

    @property
    def module(self) -> str:
        return Path(self.function.__code__.co_filename).stem

    def cases(self, asked: int) -> int:
        return max(1, round(self.share * asked))


def part(*, share: float = 1.0, seconds: float = 120.0) -> Callable[[Callable[[Case], None]], Part]:
    """Make a function of a case a part; `seconds` without an answer are a hang."""
    return lambda function: Part(function, share, seconds)


def all_parts() -> list[Part]:
    modules = [importlib.import_module(path.stem) for path in sorted(HERE.glob("parts_*.py"))]
    return [p for module in modules for p in vars(module).values() if isinstance(p, Part)]


class Verdict(Exception):  # noqa: N818  # an outcome, not always an error
    """Ends a case with an outcome of its own."""

    def __init__(self, outcome: str, message: str) -> None:
        super().__init__(message)
        self.outcome = outcome


def wrong(message: str) -> NoReturn:
    """Say that an answer came without a word and is not the right one."""
    raise Verdict("wrong", message)


def refused(message: str) -> NoReturn:
    """Say that what ran was refused as it should be."""
    raise Verdict("refused", message)


def command(
    arguments: Sequence[str | bytes | Path],
    *,
    folder: Path,
    seconds: float = 120.0,
    environment: Mapping[str, str] | None = None,
    stdout: int = subprocess.PIPE,
) -> str:
    """Run ``spectra-kit`` in `folder`, and return what it printed; a refusal ends the case."""
    process = subprocess.Popen(
        [sys.executable, "-m", "spectra_kit", *arguments],
        cwd=folder,
        env=command_environment() if environment is None else dict(environment),
        stdin=subprocess.DEVNULL,
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
    )
    try:
        out, err = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired as late:
        process.kill()
        process.communicate()
        raise Verdict("hang", f"no end after {seconds:g} s of {arguments}") from late
    judge(process.returncode, err)
    return out or ""


def judge(code: int, err: str) -> None:
    """End the case unless a command ended well."""
    if code < 0 or code > 130:
        raise Verdict("crash", f"exit code {code}: {err[-400:]}")
    if "Traceback (most recent call last)" in err or code not in EXIT_CODES:
        raise Verdict("foreign", f"exit code {code}: {err[-400:]}")
    if code:
        if not err.strip():
            raise Verdict("foreign", f"exit code {code} without a message")
        refused(err.strip().splitlines()[-1])


def command_environment() -> dict[str, str]:
    """Return the environment of a command that imports this tree from any folder."""
    paths = [str(HERE.parents[1]), os.environ.get("PYTHONPATH", "")]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}


def outcome_of(function: Callable[[Case], None], case: Case) -> tuple[str, str]:
    """Run one case here; return its outcome and what there is to say."""
    from spectra_kit.errors import SpectraKitError

    try:
        function(case)
    except Verdict as verdict:
        return verdict.outcome, str(verdict)
    except SpectraKitError as error:
        message = str(error)
        return ("refused" if len(message) > 20 else "foreign"), message
    except (Exception, SystemExit) as error:  # noqa: BLE001  # whatever it is: that is the outcome
        where = traceback.extract_tb(error.__traceback__)[-1]
        return "foreign", f"{error!r} in {where.filename}:{where.lineno}"
    return "right", ""


def case_of(chosen: Part, number: int, folder: Path) -> Case:
    seed = [number, zlib.crc32(chosen.name.encode())]
    return Case(number, np.random.default_rng(seed), folder)


def run_part(chosen: Part, count: int, folder: Path) -> Iterator[tuple[int, str, str]]:
    """Run the cases 0 … `count` - 1 in a worker; yield number, outcome and message of each."""
    number = 0
    while number < count:  # a worker that crashed or hung is followed by another
        with (folder / "stderr").open("w+b") as err:
            worker = subprocess.Popen(
                [sys.executable, __file__, chosen.module, chosen.name, str(number), str(count)],
                cwd=folder,
                env=command_environment(),
                stdout=subprocess.PIPE,
                stderr=err,
                stdin=subprocess.DEVNULL,
            )
            try:
                lines = _lines(worker, chosen.seconds)
                next(lines, None)  # it is there
                for line in lines:
                    yield number, *json.loads(line)
                    number += 1
                if number < count:
                    late = worker.poll() is None
                    worker.kill()
                    code = worker.wait()
                    err.seek(0)
                    said = err.read()[-600:].decode(errors="replace")
                    told = f"no answer after {chosen.seconds:g} s" if late else f"exit code {code}"
                    yield number, "hang" if late else "crash", f"{told}: {said}"
                    number += 1
            finally:
                worker.kill()
                worker.communicate()


def _lines(worker: subprocess.Popen[bytes], seconds: float) -> Iterator[bytes]:
    """Yield the lines of a worker, until it ends or is silent for so long."""
    assert worker.stdout is not None
    pending, patience = b"", 60.0  # to start with
    while select.select([worker.stdout], [], [], seconds + patience)[0]:
        if not (chunk := os.read(worker.stdout.fileno(), 65536)):
            worker.wait()
            return
        *lines, pending = (pending + chunk).split(b"\n")
        yield from lines
        patience = 0.0


def tally(outcomes: Mapping[str, int]) -> str:
    return ", ".join(f"{outcomes.get(name, 0):,} {name}" for name in OUTCOMES)


def _work(chosen: Part, first: int, count: int) -> None:
    """Answer on stdout, a line to begin with and one a case; what is printed goes to stderr."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    answers.write("\n")
    answers.flush()
    for number in range(first, count):
        with tempfile.TemporaryDirectory(prefix="damage-") as folder:
            answer = outcome_of(chosen.function, case_of(chosen, number, Path(folder)))
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


def main(module: str, name: str, first: str, count: str | None = None) -> None:
    chosen: Part = getattr(importlib.import_module(module), name)
    if count is not None:
        _work(chosen, int(first), int(count))
        return
    folder = Path(tempfile.mkdtemp(prefix="damage-"))
    print(f"{chosen.module} {chosen.name} {first} in {folder}")  # noqa: T201
    chosen.function(case_of(chosen, int(first), folder))
    shutil.rmtree(folder)
    print("right")  # noqa: T201


if __name__ == "__main__":
    sys.modules["frame"] = sys.modules["__main__"]  # parts import this very module
    main(*sys.argv[1:])
