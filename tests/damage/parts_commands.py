"""Whole commands where the world around them is odd: signals, full disks, pipes, environments.

A command takes seconds: few of them in a short run. Each has an earlier good output in its place.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import threading
from pathlib import Path

import numpy as np
from frame import ENVIRONMENT, Case, Verdict, command, ended, part, start, wrong

from spectra_kit import Spectrum, write
from spectra_kit.geometry import sphere

_FEW = 0.02  # of the cases asked for
_OLD, _NEW = 4, 6  # modes


def _ball(folder: Path, name: str = "ball.off") -> None:
    write(sphere(subdivisions=2).geometry, folder / "plain.off")
    (folder / "plain.off").rename(folder / name)


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
    """No file may grow beyond some bytes: the old one stays."""
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
    except Verdict:
        after = {path: path.read_bytes() for path in case.folder.rglob("*") if path.is_file()}
        if before != after:
            changed = sorted(path for path in after if after[path] != before.get(path))
            wrong(f"a refused command changed {changed}")
        raise
    _check_modes(case.folder)
    _check_distances(case.folder)


def _odd_environments(folder: Path) -> list[dict[str, str]]:
    nowhere = "/dev/null/nowhere"  # cannot be made, by the superuser neither
    full = folder / "full"
    full.mkdir(mode=0o500)
    caches = ("NUMBA_CACHE_DIR", "MPLCONFIGDIR", "XDG_CACHE_HOME")
    return [
        {"HOME": nowhere, "XDG_CONFIG_HOME": "", "XDG_CACHE_HOME": ""},
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
def odd_environments(case: Case) -> None:
    """The answer is the same as anywhere."""
    names = ("ball.off", "I\u0131 \u00e4.off", os.fsdecode(b"b\xff\xfe.off"))
    name = names[case.rng.integers(3)]
    _ball(case.folder, name)
    environments = _odd_environments(case.folder)
    chosen = [
        ("info", name),
        ("spectrum", name, "-k", "6", "-o", "modes.npz", "--picture", "a.png"),
        ("modes", name, "-k", "4", "-o", "a.svg"),
        ("geodesic", name, "--source", "0", "--no-pictures", "-o", "out"),
        ("explore", name, "-k", "4", "-o", "a.html"),
    ][case.rng.integers(5)]
    command(chosen, case.folder, env=ENVIRONMENT | environments[case.number % len(environments)])
    if "modes.npz" in chosen:
        values = Spectrum.load(case.folder / "modes.npz").eigenvalues
        if not np.allclose(values[1:4], values[1], rtol=0.05) or not 1.8 < values[1] < 2.1:
            wrong(f"the eigenvalues of a sphere are {values}")


@part(share=0.001, seconds=600)
def cold_caches(case: Case) -> None:
    """Two commands at the same time fill one empty cache of compiled loops."""
    _ball(case.folder)
    empty = ENVIRONMENT | {"NUMBA_CACHE_DIR": str(case.folder / "cache")}
    both = [
        start(("spectrum", "ball.off", "-k", "6", "-o", f"{i}.npz"), case.folder, env=empty)
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
    pipe, early = case.folder / "modes.npz", case.number % 2 == 1
    os.mkfifo(pipe)
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
