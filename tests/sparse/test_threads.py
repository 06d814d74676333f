"""Small problems leave the threads of BLAS asleep, whatever the environment asks for."""

import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from spectra_kit._core.threads import (
    _quota,
    alone,
    blas_threads_for,
    ended_beside,
    in_threads,
    single_threaded,
    single_threaded_blas,
)

# What threads other than the main one ran for, in milliseconds: they spin while they wait.
CODE = """
import contextlib, glob, json, os, time
import numpy as np, scipy.linalg
import spectra_kit as sk
from spectra_kit.features import heat_kernel_signature

def others():
    total = 0
    for f in glob.glob("/proc/self/task/*/schedstat"):
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):  # one that has just ended
            total += int(open(f).read().split()[0]) * (f"/{os.getpid()}/s" not in f)
    return total / 1e6

def spun(call):
    call()  # imports, compiles
    before = others()
    call()
    time.sleep(0.1)  # they go on spinning for a while
    return others() - before

mesh = sk.geometry.creature(1000, seed=0)
laplacian = sk.robust_laplacian(mesh)
small = sk.robust_laplacian(sk.geometry.sphere(subdivisions=2).geometry)
s = sk.eigensolve(laplacian, 30)
jobs = {
    "default": lambda: sk.eigensolve(laplacian, 30),
    "Dense, tiny": lambda: sk.eigensolve(small, 30, sk.Dense()),
    "Refined": lambda: sk.eigensolve(laplacian, 30, sk.Refined()),
    "Cascade": lambda: sk.eigensolve(laplacian, 30, sk.Cascade(coarsest=250)),
    "verify": lambda: sk.verify(s, laplacian),
    "HeatGeodesics": lambda: sk.HeatGeodesics(mesh, s).distance(0),
    "heat kernel": lambda: heat_kernel_signature(s),
    "project": lambda: s.reconstruct(s.project(np.ones((mesh.n, 20)))),
    "match": lambda: sk.match(sk.prepare(s, mesh), sk.prepare(s, mesh)),
}
large = np.ones((600, 600))
answer = {"product": spun(lambda: large @ large)}
print(json.dumps(answer | {name: spun(job) for name, job in jobs.items()}))
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="counts in /proc")
def test_small_problems_wake_no_threads() -> None:
    done = subprocess.run(
        [sys.executable, "-c", CODE],
        env={**os.environ, "OPENBLAS_NUM_THREADS": "4"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    spun = json.loads(done.stdout)
    if spun.pop("product") < 1:
        pytest.skip("this BLAS has no threads that wait by spinning")
    assert {name: round(ms) for name, ms in spun.items() if ms > 1} == {}


def blas_threads() -> list[int]:
    return [i["num_threads"] for i in threadpool_info() if i["user_api"] == "blas"]


@pytest.fixture
def _three_threads() -> Iterator[None]:
    """Threads for BLAS to keep or lose, whatever the environment gives it."""
    with threadpool_limits(3, user_api="blas"):
        yield


@pytest.mark.usefixtures("_three_threads")
def test_large_blocks_keep_their_threads() -> None:
    before = blas_threads()
    assert set(before) == {3}
    with blas_threads_for(10**8):
        assert blas_threads() == before
    with single_threaded_blas(), blas_threads_for(10**8):  # nor is one limit lifted by another
        assert set(blas_threads()) == {1}
    with blas_threads_for(np.ones((100, 30)).size):
        assert set(blas_threads()) == {1}
    assert blas_threads() == before


@pytest.mark.usefixtures("_three_threads")
def test_any_thread_may_limit_blas_and_the_last_to_leave_restores_it() -> None:
    def limited() -> list[int]:
        with single_threaded_blas():
            return blas_threads()

    before = blas_threads()
    assert set(before) == {3}
    assert set(limited()) == {1}  # here first, then elsewhere
    with ThreadPoolExecutor(1) as pool:
        assert set(pool.submit(limited).result()) == {1}
        first = single_threaded_blas()
        pool.submit(first.__enter__).result()
        with single_threaded_blas():
            pool.submit(first.__exit__, None, None, None).result()
            assert set(blas_threads()) == {1}
        assert blas_threads() == before
        assert pool.submit(blas_threads).result() == before


def test_after_a_failure_nothing_new_begins(monkeypatch):
    monkeypatch.setenv("NUMBA_NUM_THREADS", "2")
    begun, gate = [], threading.Event()

    def task(i):
        begun.append(i)
        if i == 0:
            raise ValueError("the first")
        gate.wait(0.2)  # until the failure has been seen
        if i == 1:
            raise KeyError("the second")

    with pytest.raises(ValueError, match="the first"):
        in_threads(task, ((i,) for i in range(100)))
    assert len(begun) < 10


@pytest.mark.parametrize(
    ("group", "files", "cores"),
    [
        ("0::/", {"cpu.max": "150000 100000\n"}, 1.5),
        ("0::/", {"cpu.max": "max 100000\n"}, np.inf),
        ("0::/job/step", {"job/step/cpu.max": "max 100000", "job/cpu.max": "200000 100000"}, 2),
        ("0::/job/step", {"job/step/cpu.max": "50000 100000", "job/cpu.max": "max 100000"}, 0.5),
        ("2:cpu,cpuacct:/job", {"cpu,cpuacct/job/cpu.cfs_quota_us": "300000",
                                "cpu,cpuacct/job/cpu.cfs_period_us": "100000"}, 3),
        ("2:cpu:/a\n1:memory:/a", {"cpu/a/cpu.cfs_quota_us": "-1",
                                   "cpu/a/cpu.cfs_period_us": "100000"}, np.inf),
        ("3:cpuset:/a\n0::/a", {"a/cpu.max": "no number"}, np.inf),
        (None, {}, np.inf),
    ],
)  # fmt: skip
def test_the_cores_of_a_group_are_counted(tmp_path, group, files, cores):
    own = tmp_path / "cgroup"
    if group is not None:
        own.write_text(group + "\n")
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    assert _quota(tmp_path, own) == cores


def test_each_ends_beside_the_next_that_begins_here():
    begun, ended, met = [], [], threading.Barrier(2, timeout=10)

    def begin(i):
        begun.append((i, threading.get_ident()))
        if i:
            met.wait()  # until the one before is at its end
        return i * i

    def end(square):
        ended.append((alone(), threading.get_ident()))
        if square < 9:
            met.wait()  # until the next has begun
        return square + 1

    with single_threaded():
        assert list(ended_beside(begin, end, range(4))) == [1, 2, 5, 10]
    assert begun == [(i, threading.get_ident()) for i in range(4)]
    assert all(there != threading.get_ident() and kept for kept, there in ended)
    assert list(ended_beside(begin, end, [])) == []


def test_what_fails_beside_is_told_in_its_turn():
    whole = ended_beside(int, lambda i: 1 // (2 - i), range(4))
    assert [next(whole), next(whole)] == [0, 1]
    with pytest.raises(ZeroDivisionError):
        next(whole)
