"""Whole commands where the world around them is odd: signals, full disks, environments.

A command takes seconds: few of them in a short run. Each has an earlier good output in its place.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import chdir
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from frame import Case, part, pytest_generate_tests  # noqa: F401

from spectra_kit import Spectrum, write
from spectra_kit._core.compiled import cache_folder
from spectra_kit.cli import main
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import sphere

_FEW = 0.02  # of the cases asked for
_OLD, _NEW = 4, 6  # modes
_PATHS = str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(_PATHS)}


def start(arguments: Sequence[str], folder: Path, **options: Any) -> subprocess.Popen[str]:
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
    finally:
        process.kill()
    if err.endswith("KeyboardInterrupt\n") and "spectra_kit/__main__.py" not in err:
        return  # Python itself was still starting
    judge(0 if process.returncode in expected else process.returncode, err)


def judge(code: int, err: str) -> None:
    """Raise what a command refused: bad input, no convergence, an interrupt; fail with others."""
    assert code in (0, 2, 3, 130), err
    assert "Traceback (most recent call last)" not in err
    if code:
        raise InvalidInputError(err.strip())


def test_commands_that_fail_are_told_from_those_that_refuse():
    bug, traceback = "error: this is a bug of spectra_kit\n", "Traceback (most recent call last)\n"
    for code, err in ((1, bug), (0, traceback), (-11, ""), (134, "double free\n")):
        with pytest.raises(AssertionError):
            judge(code, err)
    judge(0, "")
    with pytest.raises(InvalidInputError, match="no such file"):
        judge(2, "error: no such file\n")


def _ball(folder: Path, name: str = "ball.off") -> None:
    write(sphere(subdivisions=2).geometry, folder / "plain.off")
    (folder / "plain.off").rename(folder / name)


def _made(arguments: Sequence[str], folder: Path) -> dict[Path, bytes]:
    """Run a command that must succeed, in this process; return all files that are there then."""
    with chdir(folder):
        assert main(arguments) == 0
    return _files(folder)


def _files(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def _solve(k: int) -> tuple[str, ...]:
    return ("spectrum", "ball.off", "-k", str(k), "-o", "modes.npz")


def _measure(source: int) -> tuple[str, ...]:
    return ("geodesic", "ball.off", "--source", str(source), "--no-pictures", "-o", "out")


def _check_modes(folder: Path) -> None:
    assert Spectrum.load(folder / "modes.npz").k in (_OLD, _NEW)


def _check_distances(folder: Path, *, killed: bool = False) -> None:
    """The numbers are those that the report tells of; killed in between, there is no report."""
    report = folder / "out" / "report.json"
    if not report.exists():
        assert killed
        return
    source = json.loads(report.read_text())["sources"][0]["point"]
    assert np.load(folder / "out" / "distance.npy")[source] == 0


@part(share=_FEW, seconds=400)
def test_told_to_end(case: Case) -> None:
    """By any signal at any moment: the old output or the new one, and nothing temporary."""
    _ball(case.folder)
    solving = case.number % 2 == 0
    old, new = (_solve(_OLD), _solve(_NEW)) if solving else (_measure(0), _measure(5))
    kept = _made(old, case.folder).keys()
    names = ("SIGINT", "SIGTERM", "SIGHUP", "SIGKILL")
    number = int(getattr(signal, names[case.number // 2 % len(names)]))
    process = start(new, case.folder)
    try:
        process.wait(timeout=case.rng.uniform(0.0, 5.0))
    except subprocess.TimeoutExpired:
        process.send_signal(number)
    ended(process, 130, -number, 0)
    killed = number == signal.SIGKILL
    if solving:
        _check_modes(case.folder)
    else:
        _check_distances(case.folder, killed=killed)
    if not killed:
        assert _files(case.folder).keys() == kept


@part(share=_FEW, seconds=400)
def test_full_disk(case: Case) -> None:
    """No file may grow beyond some bytes: the old one stays."""
    _ball(case.folder)
    chosen = case.number % 3
    before = _made(_measure(0) if chosen else _solve(_OLD), case.folder)
    limit = int(10 ** case.rng.uniform(0, 4.2))
    commands = [_solve(_NEW), _measure(5), ("explore", "ball.off", "-k", "4", "-o", "a.html")]
    process = start(
        commands[chosen],
        case.folder,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
    )
    try:
        ended(process)
    except InvalidInputError:
        assert _files(case.folder) == before
        raise
    if chosen == 0:
        _check_modes(case.folder)
    else:
        _check_distances(case.folder)


def _odd_environments(folder: Path) -> list[dict[str, str]]:
    nowhere = "/dev/null/nowhere"  # cannot be made, by the superuser neither
    full = folder / "full"
    full.mkdir(mode=0o500)
    caches = ("NUMBA_CACHE_DIR", "MPLCONFIGDIR", "XDG_CACHE_HOME")
    compiled = {"NUMBA_CACHE_DIR": str((cache_folder() or folder).parent)}  # compiling takes long
    return [
        {"HOME": nowhere, "XDG_CONFIG_HOME": "", "XDG_CACHE_HOME": "", **compiled},
        {"DISPLAY": ":77", "WAYLAND_DISPLAY": "none"},
        dict.fromkeys(caches, nowhere),
        dict.fromkeys(caches, str(full)),
        {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
        {"LC_ALL": "tr_TR.UTF-8", "LANG": "tr_TR.UTF-8"},
        {"PYTHONIOENCODING": "ascii:strict"},
        {"TMPDIR": nowhere},
        {"COLUMNS": "1", "LINES": "1", "TERM": "dumb"},
        {"OMP_NUM_THREADS": "1000", "NUMBA_NUM_THREADS": "1"},
    ]


@part(share=_FEW, seconds=400)
def test_odd_environments(case: Case) -> None:
    """The answer is the same as anywhere."""
    names = ("ball.off", "I\u0131 \u00e4.off", os.fsdecode(b"b\xff\xfe.off"))
    name = names[case.rng.integers(3)]
    _ball(case.folder, name)
    environments = _odd_environments(case.folder)
    chosen = [
        ("info", name),
        ("modes", name, "-k", "4", "-o", "a.svg"),
        ("spectrum", name, "-k", "6", "-o", "modes.npz"),
        ("geodesic", name, "--source", "0", "--no-pictures", "-o", "out"),
        ("explore", name, "-k", "4", "-o", "a.html"),
    ][case.rng.integers(5)]
    environment = ENVIRONMENT | environments[case.number % len(environments)]
    ended(start(chosen, case.folder, env=environment))
    if "modes.npz" in chosen:
        values = Spectrum.load(case.folder / "modes.npz").eigenvalues
        assert np.allclose(values[1:4], values[1], rtol=0.05)
        assert 1.8 < values[1] < 2.1
