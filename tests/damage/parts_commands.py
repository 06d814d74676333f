"""Whole commands where the world around them is odd: signals, full disks, streams, environments.

A command takes seconds: few of them in a short run. Each has an earlier good output in its place.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from frame import (
    Case,
    Verdict,
    command,
    command_environment,
    ended,
    judge,
    part,
    refused,
    start,
    wrong,
)

from spectra_kit import Spectrum, write
from spectra_kit.geometry import sphere

_FEW = 0.02  # of the cases asked for
_OLD, _NEW = 4, 6  # modes


def _ball(folder: Path, name: str = "ball.off") -> Path:
    path = folder / name
    write(sphere(subdivisions=2).geometry, folder / "plain.off")
    (folder / "plain.off").rename(path)
    return path


def _solve(k: int) -> tuple[str, ...]:
    return ("spectrum", "ball.off", "-k", str(k), "-o", "modes.npz")


def _measure(source: int) -> tuple[str, ...]:
    return ("geodesic", "ball.off", "--source", str(source), "--no-pictures", "-o", "out")


def _check_modes(folder: Path) -> None:
    if Spectrum.load(folder / "modes.npz").k not in (_OLD, _NEW):
        wrong("the spectrum is neither the old one nor the new one")


def _check_distances(folder: Path, *, killed: bool = False) -> None:
    """The numbers are those that the report tells of; killed in between, there is no report."""
    report = folder / "out" / "report.json"
    if not report.exists():
        if not killed:
            wrong("the report is gone")
        return
    source = json.loads(report.read_text())["sources"][0]["point"]
    if np.load(folder / "out" / "distance.npy")[source] != 0:
        wrong("the distances are not those of the report")


@part(share=_FEW, seconds=400)
def told_to_end(case: Case) -> None:
    """By any signal at any moment: the old output or the new one, and nothing temporary."""
    _ball(case.folder)
    solving = case.number % 2 == 0
    old, new = (_solve(_OLD), _solve(_NEW)) if solving else (_measure(0), _measure(5))
    command(old, case.folder)
    kept = sorted(case.folder.rglob("*"))
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
    if not killed and sorted(case.folder.rglob("*")) != kept:
        wrong(f"files were left: {sorted(set(case.folder.rglob('*')) - set(kept))}")


@part(share=_FEW, seconds=400)
def full_disk(case: Case) -> None:
    """No file may grow beyond some bytes, or all are written to /dev/full: the old one stays."""
    _ball(case.folder)
    command(_solve(_OLD), case.folder)
    command(_measure(0), case.folder)
    before = {path: path.read_bytes() for path in case.folder.rglob("*") if path.is_file()}
    limit = int(10 ** case.rng.uniform(0, 4.2))
    chosen = [_solve(_NEW), _measure(5), ("explore", "ball.off", "-k", "4", "-o", "a.html")]
    process = start(
        chosen[case.number % len(chosen)],
        case.folder,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
    )
    try:
        ended(process)
    except Verdict as verdict:
        if verdict.outcome != "refused":
            raise
        after = {path: path.read_bytes() for path in case.folder.rglob("*") if path.is_file()}
        if before != after:
            wrong(
                f"a refused command changed {sorted(p for p in after if after[p] != before.get(p))}"
            )
        raise
    _check_modes(case.folder)
    _check_distances(case.folder)


@part(share=_FEW, seconds=300)
def odd_streams(case: Case) -> None:
    """Closed, full, or with a reader that leaves."""
    _ball(case.folder)
    streams = ("2>&-", ">&-", "<&-", ">&- 2>&-", "<&- >&- 2>&-", ">/dev/full", "2>/dev/full")
    streams += ("| true", "2>&1 | head -c 5", "> /dev/null 2>&1")
    commands = (
        "info ball.off",
        "info none.off",
        "--help",
        "modes --help",
        "spectrum ball.off -k 4",
    )
    commands += ("info ball.off --json", "spectrum", "spectrum ball.off -k 4 --picture a.svg")
    stream = streams[case.number % len(streams)]
    chosen = commands[case.rng.integers(len(commands))]
    told = ">/dev/full" in stream.split() and chosen != "info none.off"
    shell = f"{sys.executable} -m spectra_kit {chosen} {stream}"
    done = subprocess.run(
        ["bash", "-c", f"set -o pipefail; {shell}"],
        cwd=case.folder,
        env=command_environment(),
        capture_output=True,
        text=True,
        timeout=200,
    )
    if "2>" in stream and done.returncode == 2:
        refused("without a stderr to tell it on")
    judge(done.returncode, done.stderr)
    if told:
        wrong("what a full disk lost counts as told")


def _odd_environments(folder: Path) -> list[Mapping[str, str]]:
    nowhere = "/dev/null/nowhere"  # cannot be made, by the superuser neither
    full = folder / "full"
    full.mkdir(mode=0o500, exist_ok=True)
    own = command_environment()
    homeless = {key: value for key, value in own.items() if not key.startswith("XDG")}
    return [
        homeless | {"HOME": nowhere},
        {key: value for key, value in homeless.items() if key != "HOME"},
        own | {"DISPLAY": ":77", "WAYLAND_DISPLAY": "none"},
        own | dict.fromkeys(("NUMBA_CACHE_DIR", "MPLCONFIGDIR", "XDG_CACHE_HOME"), nowhere),
        own | dict.fromkeys(("NUMBA_CACHE_DIR", "MPLCONFIGDIR", "XDG_CACHE_HOME"), str(full)),
        own | {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
        own | {"LC_ALL": "tr_TR.UTF-8", "LANG": "tr_TR.UTF-8"},
        own | {"PYTHONIOENCODING": "ascii:strict"},
        own | {"PYTHONIOENCODING": "utf-8:strict"},
        own | {"TMPDIR": nowhere},
        own | {"COLUMNS": "1", "LINES": "1", "TERM": "dumb"},
        own | {"OMP_NUM_THREADS": "1000", "NUMBA_NUM_THREADS": "1"},
    ]


@part(share=_FEW, seconds=400)
def odd_environments(case: Case) -> None:
    """The answer is the same as anywhere."""
    names = ("ball.off", "I\u0131 \u00e4.off", os.fsdecode(b"b\xff\xfe.off"))
    name = names[case.rng.integers(3)]
    _ball(case.folder, name)
    environments = _odd_environments(case.folder)
    environment = environments[case.number % len(environments)]
    chosen = [
        ("info", name),
        ("spectrum", name, "-k", "6", "-o", "modes.npz"),
        ("spectrum", name, "-k", "6", "-o", "modes.npz", "--picture", "a.png"),
        ("modes", name, "-k", "4", "-o", "a.svg"),
        ("geodesic", name, "--source", "0", "--no-pictures", "-o", "out"),
        ("explore", name, "-k", "4", "-o", "a.html"),
    ][case.rng.integers(6)]
    command(chosen, case.folder, environment=environment)
    if "modes.npz" in chosen:
        values = Spectrum.load(case.folder / "modes.npz").eigenvalues
        if not np.allclose(values[1:4], values[1], rtol=0.05) or not 1.8 < values[1] < 2.1:
            wrong(f"the eigenvalues of a sphere are {values}")


@part(share=0.001, seconds=600)
def cold_caches(case: Case) -> None:
    """Two commands at the same time fill one empty cache of compiled loops."""
    _ball(case.folder)
    cache = case.folder / "cache"
    environment = command_environment() | {"NUMBA_CACHE_DIR": str(cache)}
    both = [
        start(("spectrum", "ball.off", "-k", "6", "-o", f"{i}.npz"), case.folder, environment)
        for i in range(2)
    ]
    for process in both:
        ended(process)
    one, other = (Spectrum.load(case.folder / f"{i}.npz") for i in range(2))
    if not np.array_equal(one.eigenvectors, other.eigenvectors):
        wrong("the two answers differ")


@part(share=_FEW, seconds=300)
def pipes_as_outputs(case: Case) -> None:
    """A named pipe gets the whole file; where its reader leaves early, that is told."""
    _ball(case.folder)
    pipe = case.folder / "modes.npz"
    os.mkfifo(pipe)
    early = case.number % 2 == 1
    got: list[bytes] = []

    def read() -> None:
        with pipe.open("rb") as file:  # waits until the command opens it
            got.append(file.read(1 if early else -1))

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    ended(start(_solve(_NEW), case.folder))
    if not pipe.is_fifo():
        wrong("the pipe was replaced")
    reader.join(timeout=60)
    if early:
        return  # all of it fitted into the pipe
    (case.folder / "file.npz").write_bytes(got[0])
    if Spectrum.load(case.folder / "file.npz").k != _NEW:
        wrong("another spectrum came through the pipe")
