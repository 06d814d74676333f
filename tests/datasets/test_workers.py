"""Workers: they do what one process does, and end with it."""

import os
import pickle
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import dask
import psutil
import pytest
from conftest import bumpy, creature, moved, refused

import spectra_kit as sk
from spectra_kit._core.threads import usable_cores
from spectra_kit.datasets import (
    DaskEngine,
    Matching,
    Pair,
    Plan,
    SpectrumStore,
    compute_all,
    find_inputs,
    find_pairs,
    match_all,
)
from spectra_kit.datasets.preload import own_device
from spectra_kit.datasets.run import Job, Spared
from spectra_kit.errors import EngineLostError, InvalidFileError, InvalidInputError
from spectra_kit.geometry import sphere, write

PLAN = Plan(k=6)


@pytest.fixture(scope="module")
def scans(tmp_path_factory):
    """Two shapes, and two files that are none."""
    folder = tmp_path_factory.mktemp("scans")
    write(creature(520), folder / "animal.off")
    write(bumpy(), folder / "bumpy.ply")
    (folder / "empty.off").touch()
    (folder / "words.obj").write_text("these are words\n")
    return folder


@pytest.fixture
def store(tmp_path):
    return SpectrumStore(tmp_path / "store")


@pytest.fixture(scope="module")
def workers():
    """Two workers, started once for the tests that need none of their own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CUDA_VISIBLE_DEVICES", "5,7")
        with DaskEngine(nworkers=2)._client() as client:
            yield client


def write_sizes(folder, count, n=2562):
    """Write one body in so many sizes: another shape each, and at once made."""
    for i in range(count):
        write(moved(bumpy(n), 0, 0, 0, scale=1 + i / 100), folder / f"{i}.off")


def test_a_task_finds_its_files_from_another_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    sent = pickle.dumps(Job("a", Path("store"), (Path("a.off"), 3), print))
    monkeypatch.chdir("/")
    there = pickle.loads(sent)
    assert (there.store, there.given) == (tmp_path / "store", (tmp_path / "a.off", 3))


def entries(store):
    return {
        entry.path.relative_to(store.path): entry.path.read_bytes() for entry in store.entries()
    }


@pytest.mark.parametrize(
    ("argument", "expected", "options"),
    [
        ("nworkers", "be at least 1", {"nworkers": 0}),
        ("nthreads", "be at least 1", {"nthreads": 0}),
        ("scheduler_file", "be left out", {"scheduler": "tcp://a:1", "scheduler_file": "b"}),
        ("nworkers", "be left out where there is a scheduler", {"scheduler": "a", "nworkers": 2}),
        ("nthreads", "be left out where there is a", {"scheduler_file": "a", "nthreads": 2}),
        ("memory_limit", "be a size such as 3GB, or auto", {"memory_limit": "lots"}),
        ("memory_limit", "be left out where", {"scheduler": "a", "memory_limit": "1GB"}),
    ],
)
def test_engines_that_cannot_be(argument, expected, options):
    refused(argument, expected, DaskEngine, **options)


@pytest.mark.parametrize(
    ("visible", "number", "own"),
    [
        ("0,1,2", 1, "1"),
        ("0,1,2", 5, "2"),
        ("GPU-8f,GPU-2c", 2, "GPU-8f"),
        ("", 3, ""),
        ("4", 1, "4"),
    ],
)
def test_workers_take_devices_by_turns(visible, number, own, monkeypatch):
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", visible)
    assert own_device(number) == own


@pytest.mark.slow
def test_each_worker_has_a_device_and_a_share_of_the_memory(workers):
    distributed = pytest.importorskip("distributed")
    seen = workers.run(lambda: os.environ["CUDA_VISIBLE_DEVICES"])
    assert sorted(seen.values()) == ["5", "7"]
    given = [
        one["memory_limit"] for one in workers.scheduler_info(n_workers=-1)["workers"].values()
    ]
    assert given == [distributed.system.MEMORY_LIMIT // 2] * 2


@dataclass(frozen=True)
class Works:
    """A task that takes a processor so many seconds."""

    name: str
    seconds: float

    def __call__(self) -> tuple[str, int]:
        end = time.process_time() + self.seconds
        while time.process_time() < end:
            pass
        return self.name, os.getpid()


def test_no_workers_start_for_what_does_not_pay():
    def never(tasks):
        raise AssertionError

    few = [Works(str(i), 0.001) for i in range(20)]
    assert [result for _, result in Spared(never)(few)] == [(t.name, os.getpid()) for t in few]


@pytest.mark.skipif(usable_cores() < 2, reason="one core is this process's")
def test_workers_start_for_what_pays():
    todo = [Works(str(i), 0.1) for i in range(10**5)]
    handed = []

    def engine(tasks):
        handed.extend(tasks)
        yield from ((task, "there") for task in tasks)

    results = [*Spared(engine)(todo)]
    assert [task for task, _ in results] == todo
    assert 0 < len(handed) == sum(result == "there" for _, result in results) < len(todo)


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="Linux binds processes to cores")
def test_workers_are_as_many_as_the_cores_that_may_be_used(monkeypatch):
    """Of a real cluster, but for its processes: threads of this one start at once."""
    distributed, before = pytest.importorskip("distributed"), os.sched_getaffinity(0)
    start, here = distributed.LocalCluster, {"processes": False, "preload": []}
    monkeypatch.setattr(distributed, "LocalCluster", lambda **asked: start(**asked | here))
    os.sched_setaffinity(0, {min(before)})
    try:
        with DaskEngine()._local(distributed) as cluster:
            (worker,) = cluster.workers.values()
            assert worker.state.nthreads == 1
            assert worker.memory_manager.memory_limit == distributed.system.MEMORY_LIMIT
    finally:
        os.sched_setaffinity(0, before)


@pytest.mark.slow
def test_memory_is_looked_at_before_workers_and_before_shapes(scans, store, tmp_path):
    inputs, engine = find_inputs([scans / "bumpy.ply"]), DaskEngine(nworkers=1, memory_limit="1MB")
    with pytest.raises(InvalidInputError, match="`memory_limit` must be more than a") as caught:
        compute_all(inputs, store, PLAN, engine=engine)
    assert list(store.entries()) == []
    needed = re.search(r"takes before it has a shape, (\d+) MB, got", str(caught.value)).group(1)
    write(sphere(subdivisions=6).geometry, tmp_path / "large.ply")
    inputs += find_inputs([tmp_path / "large.ply"])
    engine = DaskEngine(nworkers=1, memory_limit=f"{2 * int(needed)}MB")
    report = compute_all(inputs, store, Plan(k=200), engine=engine)
    assert [one for one, _ in report.completed] == inputs[:1]
    assert "need about 0." in str(report.failed[0].error)


@pytest.mark.slow
def test_workers_end_with_the_bytes_of_one_process(workers, scans, store, tmp_path):
    inputs = find_inputs([scans])
    alone = compute_all(inputs, store, PLAN)
    other = SpectrumStore(tmp_path / "other")
    report = compute_all(inputs, other, PLAN, engine=DaskEngine(scheduler=address_of(workers)))
    assert entries(store) == entries(other)
    assert [one.name for one, _ in report.completed] == [one.name for one, _ in alone.completed]
    assert [str(x.error) for x in report.failed] == [str(x.error) for x in alone.failed]


def address_of(client):
    return client.scheduler.address


@pytest.mark.slow
def test_workers_find_the_maps_of_one_process(workers, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # paths that workers in another folder would not find
    for seed in range(2):
        write(creature(520, seed=seed), f"{seed}.off")
    one, engine = SpectrumStore("one"), DaskEngine(scheduler=address_of(workers))
    compute_all(find_inputs(["*.off"]), one, Plan(k=40))
    shutil.copytree("one", "other")
    other = SpectrumStore("other")
    pairs = [*find_pairs("all", one), Pair(source="0.off", target="nobody")]
    quick = Matching(options=sk.maps.MatchOptions(growing=16, finalists=3, rounds=1))
    alone = match_all(pairs, one, matching=quick)
    report = match_all(pairs, other, matching=quick, engine=engine)
    assert entries(one) == entries(other)
    assert [one.name for one, _ in report.completed] == [one.name for one, _ in alone.completed]
    assert [str(x.error) for x in report.failed] == [str(x.error) for x in alone.failed]
    assert match_all(pairs, other, matching=quick, engine=engine).computed == 0


class Killed:
    """A progress that kills the workers by signal 9 when the first shape is done."""

    def __init__(self):
        self.count, self.others = 0, set(psutil.Process().children(recursive=True))

    def __call__(self, done, count):
        if not self.count:
            for child in {*psutil.Process().children(recursive=True)} - self.others:
                if "spawn_main" in " ".join(child.cmdline()):
                    child.kill()
                    self.count += 1


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # whoever talks to the dead says so
def test_workers_that_are_killed_lose_nothing(scans, store, tmp_path):
    write_sizes(tmp_path, 4)
    inputs, killed = find_inputs([str(tmp_path / "*.off")]), Killed()
    report = compute_all(inputs, store, PLAN, engine=DaskEngine(nworkers=1), progress=killed)
    assert killed.count >= 1
    assert (len(report.completed), report.failed) == (4, ())
    again = SpectrumStore(tmp_path / "again")
    compute_all(inputs, again, PLAN)
    assert entries(store) == entries(again)


def free_port():
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


@pytest.fixture
def cluster(tmp_path):
    """A scheduler and a worker, begun by their own commands; its address, and the scheduler."""
    address = f"tcp://127.0.0.1:{free_port()}"
    here = {"cwd": tmp_path, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    dask = [sys.executable, "-m", "dask"]
    own = ["--host", address, "--no-dashboard", "--scheduler-file", str(tmp_path / "where.json")]
    scheduler = subprocess.Popen([*dask, "scheduler", *own], **here)
    worker = subprocess.Popen([*dask, "worker", address, "--nthreads", "1", "--no-dashboard",
                               "--death-timeout", "60", "--local-directory", str(tmp_path)],
                              **here)  # fmt: skip
    try:
        yield address, scheduler
    finally:
        for process in (worker, scheduler):
            process.terminate()
            try:
                process.wait(timeout=20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("wait", [0.2, 1.2])  # until the client has noticed; until it asks again
def test_a_cluster_does_the_same_and_its_end_is_told(scans, cluster, store, tmp_path, wait):
    address, scheduler = cluster
    inputs = find_inputs([scans])
    report = compute_all(inputs[:2], store, PLAN, engine=DaskEngine(scheduler=address))
    assert report.computed == 2
    file = DaskEngine(scheduler_file=tmp_path / "where.json")
    assert compute_all(inputs[:2], store, Plan(k=4), engine=file).computed == 2
    write_sizes(tmp_path, 8, n=642)  # more than are handed out before the first is done
    inputs += find_inputs([str(tmp_path / "*.off")])

    def end(done, count):
        scheduler.kill()
        scheduler.wait()
        time.sleep(wait)

    with (
        dask.config.set({"distributed.comm.timeouts.connect": "1s"}),
        pytest.raises(EngineLostError, match="the same command goes on"),
    ):
        compute_all(inputs, store, Plan(k=5), engine=DaskEngine(scheduler=address), progress=end)
    left = compute_all(inputs, store, Plan(k=5))
    assert len(left.completed) == 10


@pytest.mark.slow
def test_a_scheduler_that_is_not_there():
    engine = DaskEngine(scheduler=f"tcp://127.0.0.1:{free_port()}")
    with (
        dask.config.set({"distributed.comm.timeouts.connect": "1s"}),
        pytest.raises(EngineLostError, match=r"no scheduler answers at tcp://127\.0\.0\.1:"),
    ):
        list(engine([]))


@pytest.mark.slow
def test_workers_end_with_a_run_that_fails(scans, store):
    before = len(psutil.Process().children(recursive=True))
    inputs = find_inputs([scans / "words.obj", scans / "bumpy.ply"])
    with pytest.raises(InvalidFileError) as caught:  # which keeps the frames of the run alive
        compute_all(inputs, store, PLAN, engine=DaskEngine(nworkers=1), strict=True)
    assert len(psutil.Process().children(recursive=True)) <= before + 1  # a tracker of semaphores
    assert caught.value.path


@pytest.mark.slow
def test_what_cannot_be_handed_to_workers_is_told(workers, scans, store):
    class Local(sk.Arpack):
        """A solver that only this function knows."""

    engine = DaskEngine(scheduler=address_of(workers))
    inputs = find_inputs([scans / "bumpy.ply"])
    refused("engine", "be handed what can be pickled", compute_all, inputs, store,
            Plan(k=6, solver=Local()), engine=engine)  # fmt: skip


@pytest.mark.slow
def test_ctrl_c_ends_workers_without_a_word_of_theirs(tmp_path):
    write_sizes(tmp_path, 8, n=642)
    command = [sys.executable, "-m", "spectra_kit", "batch", str(tmp_path), "-k", "200",
               "--nworkers", "1", "--out", str(tmp_path / "store")]  # fmt: skip
    run = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    spectra, deadline = tmp_path / "store" / "spectra", time.monotonic() + 90
    while time.monotonic() < deadline and not [*spectra.rglob("*.npz")]:
        time.sleep(0.05)
    workers = psutil.Process(run.pid).children(recursive=True)
    os.killpg(run.pid, signal.SIGINT)  # as a terminal does
    out, err = run.communicate(timeout=60)
    assert (run.returncode, out) == (130, "")
    assert err == "what is done is kept; the same command goes on with what is not\ninterrupted\n"
    assert psutil.wait_procs(workers, timeout=10)[1] == []
