"""What is tried: each trial calls ``spectra-kit batch`` and tells what came of it."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from spectra_kit.datasets import SpectrumStore

Facts = dict[str, Any]
_COMMAND = [sys.executable, "-m", "spectra_kit", "batch", "--json", "--quiet"]
_ALONE = ("--nworkers", "0")  # by one process
_POLL = 0.05  # seconds between two looks


@dataclass(frozen=True)
class Setting:
    """What the trials work on."""

    folder: Path  #: For stores.
    shapes: list[Path]
    workers: int
    memory_limit: str

    def store(self, name: str, *, fresh: bool = True) -> Path:
        """Return the place of a store, empty."""
        path = self.folder / name
        if fresh:
            shutil.rmtree(path, ignore_errors=True)
        self.folder.mkdir(parents=True, exist_ok=True)
        return path

    @property
    def shared(self) -> tuple[str, ...]:
        """Options of a run by the workers."""
        return ("--nworkers", str(self.workers))

    def command(self, store: Path, *options: str) -> list[str]:
        """Return the command of a run over all shapes."""
        listed = self.folder / "shapes.csv"
        listed.write_text("file\n" + "".join(f"{path.absolute()}\n" for path in self.shapes))
        return [*_COMMAND, str(listed), "--out", str(store), *options]

    def begin(self, store: Path, *options: str) -> subprocess.Popen[str]:
        """Begin a run."""
        command = self.command(store, *options)
        return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def run(self, store: Path, *options: str) -> tuple[Facts, float]:
        """Do a run; return what it told, and the seconds that the whole command took."""
        start = time.perf_counter()
        process = self.begin(store, *options)
        return ended(process), time.perf_counter() - start


def ended(process: subprocess.Popen[str]) -> Facts:
    """Wait for a run, and return what it told."""
    out, err = process.communicate()
    if not out:
        return {"code": process.returncode, "error": err.strip().splitlines()[-1:]}
    return {"code": process.returncode, **json.loads(out)}


def equal(a: Path, b: Path) -> bool:
    """Whether two stores hold the same entries, byte by byte."""
    one, other = ({e.path.relative_to(s): e.path for e in SpectrumStore(s).entries()}
                  for s in (a, b))  # fmt: skip
    return one.keys() == other.keys() and all(
        one[name].read_bytes() == other[name].read_bytes() for name in one
    )


def solved(store: Path) -> int:
    """Return how many spectra there are."""
    return sum(1 for _ in SpectrumStore(store).entries("spectra")) if store.exists() else 0


def _speed(setting: Setting) -> Facts:
    """Time one process, the workers, and a second run."""
    one, two = setting.store("one"), setting.store("two")
    first, alone = setting.run(one, *_ALONE)
    other, shared = setting.run(two, *setting.shared)
    again, second = setting.run(two, *setting.shared)
    return {
        "computed": [first["computed"], other["computed"], again["computed"]],
        "failed": [len(first["failed"]), len(other["failed"])],
        "seconds, one process": round(alone, 1),
        "seconds, workers": round(shared, 1),
        "shapes a second, workers": round(other["computed"] / shared, 1),
        "workers against one process": round(alone / shared, 2),
        "seconds, second run": round(second, 2),
        "second run against the first": round(second / shared, 4),
        "same bytes": equal(one, two),
    }


def _killed(setting: Setting) -> Facts:
    """Kill one worker by signal 9 when half of the shapes are done."""
    store, whole = setting.store("killed"), setting.store("one", fresh=False)
    process = setting.begin(store, *setting.shared)
    _wait_for(store, len(setting.shapes) // 2, process)
    worker = _workers(process.pid)[0]
    worker.kill()
    told = ended(process)
    return {"killed at": len(setting.shapes) // 2, "computed": told["computed"],
            "failed": len(told["failed"]), "spectra": solved(store),
            "as undisturbed": equal(store, whole)}  # fmt: skip


def _interrupted(setting: Setting) -> Facts:
    """Kill all of a run by signal 9, and call it again."""
    store, whole = setting.store("interrupted"), setting.store("one", fresh=False)
    process = setting.begin(store, *setting.shared)
    _wait_for(store, len(setting.shapes) // 3, process)
    for one in [psutil.Process(process.pid), *_workers(process.pid)]:
        one.kill()
    process.communicate()
    time.sleep(2)
    there = solved(store)
    told, _ = setting.run(store, *setting.shared)
    return {"there": there, "computed then": told["computed"], "sum": there + told["computed"],
            "failed": len(told["failed"]), "as undisturbed": equal(store, whole)}  # fmt: skip


def _damaged(setting: Setting) -> Facts:
    """Cut one entry short, turn a bit of another, empty a third; verify, and run again."""
    store, whole = setting.store("damaged"), setting.store("one", fresh=False)
    shutil.copytree(whole, store)
    entries = list(SpectrumStore(store).entries("spectra"))
    chosen = [entries[i].path for i in np.linspace(0, len(entries) - 1, 3).astype(int)]
    data = [path.read_bytes() for path in chosen]
    chosen[0].write_bytes(data[0][:-500])
    chosen[1].write_bytes(data[1][:5000] + bytes([data[1][5000] ^ 1]) + data[1][5001:])
    chosen[2].write_bytes(b"")
    command = [*_COMMAND[:3], "store", "verify", str(store), "--remove", "--json"]
    verified = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
    named = sum(one["path"] in map(str, chosen) for one in verified["damaged"])
    told, _ = setting.run(store, *setting.shared)
    return {"found": len(verified["damaged"]), "of these three": named,
            "computed": told["computed"], "as undisturbed": equal(store, whole)}  # fmt: skip


def _concurrent(setting: Setting) -> Facts:
    """Two runs at once into one store."""
    store, whole = setting.store("concurrent"), setting.store("one", fresh=False)
    both = [setting.begin(store, *_ALONE) for _ in range(2)]
    told = [ended(process) for process in both]
    return {"computed": [one["computed"] for one in told],
            "failed": [len(one["failed"]) for one in told],
            "as undisturbed": equal(store, whole)}  # fmt: skip


def _cluster(setting: Setting) -> Facts:
    """Run on a scheduler and workers begun by their own commands; then let the scheduler die."""
    store, whole = setting.store("cluster"), setting.store("one", fresh=False)
    with _dask(setting) as (address, scheduler):
        told, _ = setting.run(store, "--scheduler", address)
        same = equal(store, whole)
        lost = setting.store("lost")
        process = setting.begin(lost, "--scheduler", address)
        _wait_for(lost, len(setting.shapes) // 3, process)
        scheduler.kill()
        error = ended(process)
    there = solved(lost)
    resumed, _ = setting.run(lost, *setting.shared)
    return {
        "computed": told["computed"],
        "failed": len(told["failed"]),
        "as undisturbed": same,
        "scheduler dies": error,
        "there": there,
        "computed then": resumed["computed"],
        "resumed as undisturbed": equal(lost, whole),
    }


@contextmanager
def _dask(setting: Setting) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    dask = [sys.executable, "-m", "dask"]
    where = setting.folder / "scheduler.json"
    where.unlink(missing_ok=True)
    quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    scheduler = subprocess.Popen(
        [*dask, "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard",
         "--scheduler-file", str(where)], **quiet)  # fmt: skip
    processes = [scheduler]
    try:
        while not where.exists() or not where.read_text():
            time.sleep(_POLL)
        address = str(json.loads(where.read_text())["address"])
        processes += [
            subprocess.Popen([*dask, "worker", address, "--nthreads", "1", "--no-dashboard",
                              "--local-directory", str(setting.folder)], **quiet)
            for _ in range(setting.workers)
        ]  # fmt: skip
        yield address, scheduler
    finally:
        for process in processes[::-1]:
            process.terminate()
        for process in processes:
            try:
                process.wait(timeout=30)
            except subprocess.TimeoutExpired:
                process.kill()


def _broken(setting: Setting) -> Facts:
    """Thirty files that are broken in ten ways, among the shapes."""
    folder = setting.store("broken-files")
    folder.mkdir(parents=True)
    whole = setting.shapes[0].read_bytes()
    text = "OFF\n3 1 0\n0 0 0\n1 0 0\n{}\n{}\n"
    ways: dict[str, bytes] = {
        "empty.ply": b"",
        "cut.ply": whole[: len(whole) // 2],
        "header.ply": whole[:60],
        "zeros.ply": bytes(len(whole)),
        "words.obj": b"these are words\n",
        "nan.off": text.format("nan 1 0", "3 0 1 2").encode(),
        "outside.off": text.format("0 1 0", "3 0 1 7").encode(),
        "few.off": text.format("0 1 0", "3 0 1 2").encode(),  # points for so many modes
        "short.off": b"OFF\n3 1 0\n0 0 0\n",
        "packed.npz": b"PK\x03\x04" + bytes(50),
    }
    paths = [folder / f"{i}-{name}" for i in range(3) for name in ways]
    for path in paths:
        path.write_bytes(ways[path.name.split("-", 1)[1]])
    mixed = replace(setting, shapes=[*setting.shapes, *paths])
    told, _ = mixed.run(setting.store("broken"), *setting.shared)
    reasons = {one["name"]: one["reason"] for one in told["failed"]}
    return {
        "broken": len(paths),
        "named": sum(str(path.absolute()) in reasons for path in paths),
        "others that failed": len(reasons) - len(paths),
        "computed": told["computed"],
        "reasons": sorted({reason.split(": ", 1)[-1] for reason in reasons.values()}),
    }


def _memory(setting: Setting) -> Facts:
    """Follow the memory of all processes of a run over meshes of very different size."""
    store, peak, highest = setting.store("memory"), 0, 0
    limit = ("--memory-limit", setting.memory_limit) * bool(setting.workers)
    process = setting.begin(store, *setting.shared, *limit)
    start = time.perf_counter()
    while process.poll() is None:
        sizes = _memory_of(process.pid)
        peak, highest = max(peak, sum(sizes)), max(highest, *sizes, 0)
        time.sleep(_POLL)
    told = ended(process)
    return {
        "computed": told["computed"],
        "failed": [(one["name"], one["reason"]) for one in told["failed"]],
        "seconds": round(time.perf_counter() - start, 1),
        "GB, all processes": round(peak / 1e9, 2),
        "GB, largest process": round(highest / 1e9, 2),
    }


def _memory_of(process: int) -> list[int]:
    sizes = []
    for one in _tree(process):
        try:
            sizes.append(int(one.memory_info().rss))
        except psutil.NoSuchProcess:
            continue
    return sizes or [0]


def _tree(process: int) -> list[psutil.Process]:
    try:
        root = psutil.Process(process)
        return [root, *root.children(recursive=True)]
    except psutil.NoSuchProcess:
        return []


def _workers(process: int) -> list[psutil.Process]:
    return [one for one in _tree(process)[1:] if "spawn_main" in " ".join(one.cmdline())]


def _wait_for(store: Path, count: int, process: subprocess.Popen[str]) -> None:
    """Wait until a run has made so many spectra, or has ended."""
    while process.poll() is None and solved(store) < count:
        time.sleep(_POLL)


TRIALS: dict[str, Callable[[Setting], Facts]] = {
    "speed": _speed,
    "killed": _killed,
    "interrupted": _interrupted,
    "damaged": _damaged,
    "concurrent": _concurrent,
    "cluster": _cluster,
    "broken": _broken,
    "memory": _memory,
}
