"""Runs over many shapes: results beside failures, once each, whoever works."""

import csv
import os
import re
import signal
import socket
import subprocess
import sys
import time
from dataclasses import dataclass

import dask
import numpy as np
import psutil
import pytest
from conftest import bumpy, creature, moved, refused

import spectra_kit as sk
from spectra_kit._core.threads import usable_cores
from spectra_kit.datasets import (
    DaskEngine,
    Input,
    Plan,
    SpectrumStore,
    compute_all,
    find_inputs,
    write_table,
)
from spectra_kit.datasets.preload import own_device
from spectra_kit.datasets.run import Spared
from spectra_kit.datasets.table import check_columns
from spectra_kit.datasets.table import write as write_rows
from spectra_kit.errors import EngineLostError, InvalidFileError, InvalidInputError, StoreError
from spectra_kit.geometry import write

PLAN = Plan(k=6)


@pytest.fixture(scope="module")
def scans(tmp_path_factory):
    """Four shapes, of which two are one; and three files that are none."""
    folder = tmp_path_factory.mktemp("scans")
    for i in range(2):
        write(creature(520, seed=i), folder / f"animal{i}.off")
    write(moved(bumpy(), 3, 0, 0), folder / "bumpy.ply")
    write(moved(bumpy(), 3, 0, 0), folder / "copy.ply")
    (folder / "empty.off").touch()
    (folder / "half.off").write_text("OFF\n4 4 0\n0 0 0\n")
    (folder / "words.obj").write_text("these are words\n")
    return folder


@pytest.fixture
def store(tmp_path):
    return SpectrumStore(tmp_path / "store")


def write_sizes(folder, count, n=642):
    """Write one body in so many sizes: another shape each, and at once made."""
    for i in range(count):
        write(moved(bumpy(n), 0, 0, 0, scale=1 + i / 100), folder / f"{i}.off")


def entries(store):
    return {
        entry.path.relative_to(store.path): entry.path.read_bytes() for entry in store.entries()
    }


def test_results_and_failures_are_in_the_order_of_the_inputs(scans, store):
    told = []
    inputs = find_inputs([scans])
    report = compute_all(inputs, store, PLAN, progress=lambda *args: told.append(args))
    assert told == [(i + 1, 7) for i in range(7)]
    assert [one.path.name for one, _ in report.completed] == [
        *("animal0.off", "animal1.off", "bumpy.ply", "copy.ply")
    ]
    reasons = {one.input.path.name: str(one.error) for one in report.failed}
    assert [*reasons] == ["empty.off", "half.off", "words.obj"]
    assert "the file is empty" in reasons["empty.off"]
    assert all(name in reason for name, reason in reasons.items())
    assert report.computed == 3  # of two names of one shape, one is solved for
    assert report.replaced == ()
    for one, done in report.completed:
        expected = sk.spectrum(one.path, 6)
        np.testing.assert_allclose(
            done.record.eigenvalues, expected.eigenvalues, rtol=1e-12, atol=1e-12
        )
        assert done.record.area == pytest.approx(sk.read(one.path).area)


def test_a_second_run_computes_nothing_and_writes_nothing(scans, store):
    inputs = find_inputs([scans])
    compute_all(inputs, store, PLAN)
    before = {entry.path: entry.path.stat().st_mtime_ns for entry in store.entries()}
    report = compute_all(inputs, store, PLAN)
    assert (report.computed, len(report.completed), len(report.failed)) == (0, 4, 3)
    assert before == {entry.path: entry.path.stat().st_mtime_ns for entry in store.entries()}


def test_a_run_that_was_interrupted_goes_on(scans, store):
    class StoppedError(Exception):
        pass

    def stop(done, count):  # runs go each in an order of its own: broken files may be first
        if any(True for _ in store.entries("spectra")):
            raise StoppedError

    inputs = find_inputs([scans])
    with pytest.raises(StoppedError):
        compute_all(inputs, store, PLAN, progress=stop)
    there = len(list(store.entries("spectra")))
    report = compute_all(inputs, store, PLAN)
    assert there == 1
    assert report.computed == 2


def test_strict_runs_stop_at_the_first_failure(scans, store):
    with pytest.raises(InvalidFileError, match=r"empty\.off"):
        compute_all(find_inputs([scans]), store, PLAN, strict=True)


def test_a_store_that_cannot_be_written_ends_the_run(scans, store):
    (store.path / "spectra").write_text("in the way")
    with pytest.raises(StoreError, match="spectra"):
        compute_all(find_inputs([scans]), store, PLAN)


def test_an_engine_that_is_none(scans, store):
    refused("engine", "return tasks with their results", compute_all, find_inputs([scans]), store,
            PLAN, engine=lambda tasks: None)  # fmt: skip


def test_shapes_that_go_together_have_the_modes_of_each_alone(store, tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_NUM_THREADS", "2")
    plan = Plan(k=12, solver=sk.Neo())
    for i in range(4):
        write(creature(700 + 20 * i, seed=i), tmp_path / f"{i}.off")
    (tmp_path / "empty.off").touch()
    told = []
    inputs = find_inputs([str(tmp_path / "*.off")])
    report = compute_all(inputs, store, plan, progress=lambda *args: told.append(args))
    assert told == [(i + 1, 5) for i in range(5)]
    assert (report.computed, len(report.failed)) == (4, 1)
    assert [one for one, _ in report.completed] == inputs[:4]
    for one, done in report.completed:
        alone = sk.eigensolve(plan.laplacian(sk.read(one.path)), 12, sk.Neo())
        np.testing.assert_allclose(done.record.eigenvalues, alone.eigenvalues, rtol=1e-5, atol=1e-9)
    assert compute_all(inputs, store, plan).computed == 0


RUN = """
import sys, time
from pathlib import Path
import spectra_kit as sk
store, ready = sk.datasets.SpectrumStore(sys.argv[1]), Path(sys.argv[3])
inputs = sk.datasets.find_inputs([sys.argv[2]])
ready.touch()
while len([*ready.parent.glob("ready*")]) < 2:
    time.sleep(0.001)
report = sk.datasets.compute_all(inputs, store, sk.datasets.Plan(k=6))
assert [one.name for one, _ in report.completed] == [one.name for one in inputs]
print(report.computed)
"""


@pytest.mark.slow
def test_two_runs_into_one_store_share_the_work(store, tmp_path):
    (tmp_path / "scans").mkdir()
    write_sizes(tmp_path / "scans", 40)
    here = [sys.executable, "-c", RUN, str(store.path), str(tmp_path / "scans")]
    both = [
        subprocess.Popen([*here, str(tmp_path / f"ready{i}")], stdout=subprocess.PIPE, text=True)
        for i in range(2)
    ]
    computed = [int(process.communicate(timeout=120)[0]) for process in both]
    assert 40 <= sum(computed) < 55  # in one order, more than half would be computed by both
    alone = SpectrumStore(tmp_path / "alone")
    compute_all(find_inputs([tmp_path / "scans"]), alone, PLAN)
    assert entries(store) == entries(alone)


# --- tables ---


def test_a_table_has_a_row_for_each_shape(scans, store, tmp_path):
    plan = Plan(k=6, descriptors=("dna",))
    found = [Input(name=path.name, path=path, columns={"age": "3"}) for path in
             (scans / "bumpy.ply", scans / "animal0.off", scans / "copy.ply")]  # fmt: skip
    report = compute_all(found, store, plan)
    write_table(tmp_path / "table.csv", report)
    with (tmp_path / "table.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["name"], row["age"], row["same_as"]) for row in rows] == [
        *(("bumpy.ply", "3", ""), ("animal0.off", "3", ""), ("copy.ply", "3", "bumpy.ply"))
    ]
    for row, (_, done) in zip(rows, report.completed, strict=True):
        values = [float(row[f"eigenvalue_{i}"]) for i in range(6)]
        np.testing.assert_array_equal(values, done.record.eigenvalues)
        signature = [float(row[f"dna_{i + 1}"]) for i in range(len(done.record.dna))]
        np.testing.assert_array_equal(signature, done.record.dna)
        assert float(row["area"]) == done.record.area
        assert store.load(row["spectrum"]).k == 6
        assert (row["components"], row["zero_modes"], row["level"]) == ("1", "1", "verified")


@pytest.mark.parametrize("column", ["area", "eigenvalue_0", "dna_12"])
def test_columns_of_a_tables_own_are_refused_before_the_work(column, scans):
    check_columns([Input(name="a", path=scans, columns={"age": "3", "eigenvalue": "4"})])
    one = Input(name="a", path=scans, columns={column: "3"})
    refused("columns", "not have the names of the table's own", check_columns, [one])


@pytest.mark.parametrize(
    "text",
    ["=1+1", "+1+1", "-1+1", "@SUM(1)", "\t=1", "\r=1", "\n=1", " =1", "\uff1d1", "-", "--1",
     "-1.5x", "=cmd|'/C calc'!A0", "+49 30 123", "-1,5"],
)  # fmt: skip
def test_no_cell_is_run_by_a_spreadsheet(tmp_path, text):
    for columns, row in (([text], {text: "1"}), (["a"], {"a": text})):
        write_rows(tmp_path / "table.csv", columns, [row])
        with (tmp_path / "table.csv").open(newline="", encoding="utf-8") as file:
            cells = [cell for row in csv.reader(file) for cell in row]
        assert not any(cell.lstrip()[:1] in set("=+-@\uff1d") for cell in cells)
        assert any(text.strip() in cell for cell in cells)


@pytest.mark.parametrize("value", ["-1.5", "+3", "-.5e-3", "-2.", 7, -1.5, "cat", "", "a=b", True])
def test_numbers_and_words_stay_what_they_are(tmp_path, value):
    write_rows(tmp_path / "table.csv", ["a"], [{"a": value}])
    with (tmp_path / "table.csv").open(newline="") as file:
        assert [*csv.DictReader(file)] == [{"a": str(value)}]


def test_names_of_files_may_be_no_text(scans, store, tmp_path):
    name = os.fsdecode(b"caf\xe9.ply")
    (tmp_path / name).write_bytes((scans / "bumpy.ply").read_bytes())
    report = compute_all(find_inputs([tmp_path / name]), store, PLAN)
    write_table(tmp_path / "table.csv", report)
    assert b"caf\xe9.ply" in (tmp_path / "table.csv").read_bytes()


def test_rows_without_all_columns_have_blanks(store, tmp_path):
    """Shapes of more parts have fewer values outside the kernel; manifests have their columns."""
    ball = sk.geometry.sphere(subdivisions=1).geometry
    parts = [ball.points, ball.points + [3.0, 0, 0]], [ball.faces, ball.faces + ball.n]
    write(ball, tmp_path / "one.off")
    write(sk.TriangleMesh(*map(np.vstack, parts)), tmp_path / "two.off")
    for name, column in (("one", "age"), ("two", "sex")):
        (tmp_path / f"{name}.csv").write_text(f"file,{column}\n{name}.off,7\n")
    inputs = find_inputs([tmp_path / "one.csv", tmp_path / "two.csv"])
    report = compute_all(inputs, store, Plan(k=6, descriptors=("dna",)))
    write_table(tmp_path / "table.csv", report)
    one, two = csv.DictReader((tmp_path / "table.csv").read_text().splitlines())
    assert (one["age"], one["sex"], two["age"], two["sex"]) == ("7", "", "", "7")
    assert one["dna_5"]
    assert two["dna_4"]
    assert two["dna_5"] == ""


def test_tables_of_other_columns_and_of_nothing(scans, store, tmp_path):
    one = Input(name="a", path=scans / "bumpy.ply", columns={"area": "3"})
    report = compute_all([one], store, PLAN)
    refused("columns", "not have the names of the table's own", write_table,
            tmp_path / "table.csv", report)  # fmt: skip
    assert not (tmp_path / "table.csv").exists()
    write_table(tmp_path / "table.csv", compute_all([], store, PLAN))
    assert (tmp_path / "table.csv").read_text().startswith("name,kind,points")


# --- workers ---


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
def test_each_local_worker_sees_a_device_of_its_own(monkeypatch):
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "5,7")
    with DaskEngine(nworkers=2)._client() as client:
        seen = client.run(lambda: os.environ["CUDA_VISIBLE_DEVICES"])
    assert sorted(seen.values()) == ["5", "7"]


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
    todo = [Works(str(i), 0.01) for i in range(10**6)]
    handed = []

    def engine(tasks):
        handed.extend(tasks)
        yield from ((task, "there") for task in tasks)

    results = [*Spared(engine)(todo)]
    assert [task for task, _ in results] == todo
    assert 0 < len(handed) == sum(result == "there" for _, result in results) < len(todo)


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="Linux binds processes to cores")
def test_workers_are_as_many_as_the_cores_that_may_be_used():
    distributed, before = pytest.importorskip("distributed"), os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(before)})
    try:
        with DaskEngine()._client() as client:
            workers = client.scheduler_info(n_workers=-1)["workers"].values()
            assert [one["memory_limit"] for one in workers] == [distributed.system.MEMORY_LIMIT]
    finally:
        os.sched_setaffinity(0, before)
    with DaskEngine(nworkers=3)._client() as client:  # more than there are cores, maybe
        workers = client.scheduler_info(n_workers=-1)["workers"].values()
        given = [one["memory_limit"] for one in workers]
        assert given == [distributed.system.MEMORY_LIMIT // 3] * 3


@pytest.mark.slow
@pytest.mark.parametrize("limit", ["1MB", "100MB", "0.0005"])
def test_a_memory_limit_that_no_worker_can_keep_is_refused_at_once(scans, store, limit):
    inputs, engine = find_inputs([scans]), DaskEngine(nworkers=1, memory_limit=limit)
    with pytest.raises(InvalidInputError, match="`memory_limit` must be more than a") as caught:
        compute_all(inputs, store, PLAN, engine=engine)
    assert list(store.entries()) == []
    needed = re.search(r"takes before it has a shape, (\d+) MB, got", str(caught.value)).group(1)
    report = compute_all(
        inputs[:1], store, PLAN, engine=DaskEngine(nworkers=1, memory_limit=f"{2 * int(needed)}MB")
    )
    assert report.failed == ()


@pytest.mark.slow
def test_workers_end_with_the_bytes_of_one_process(scans, store, tmp_path):
    inputs = find_inputs([scans])
    alone = compute_all(inputs, store, PLAN)
    other = SpectrumStore(tmp_path / "other")
    report = compute_all(inputs, other, PLAN, engine=DaskEngine(nworkers=2))
    assert entries(store) == entries(other)
    assert [one.name for one, _ in report.completed] == [one.name for one, _ in alone.completed]
    assert [str(x.error) for x in report.failed] == [str(x.error) for x in alone.failed]


def test_an_engine_is_not_begun_for_what_is_there(scans, store):
    def engine(tasks):
        raise AssertionError

    inputs = find_inputs([scans / "bumpy.ply", scans / "copy.ply"])
    compute_all(inputs, store, PLAN)
    assert len(compute_all(inputs, store, PLAN, engine=engine).completed) == 2


def test_inputs_of_one_name(scans, store):
    twice = [Input(name="x", path=scans / file) for file in ("bumpy.ply", "animal0.off")]
    refused("inputs", "have names of their own, got 1", compute_all, twice, store, PLAN)


class Killed:
    """A progress that kills the workers by signal 9 when the first shape is done."""

    def __init__(self):
        self.count = 0

    def __call__(self, done, count):
        if not self.count:
            for child in psutil.Process().children(recursive=True):
                if "spawn_main" in " ".join(child.cmdline()):
                    child.kill()
                    self.count += 1


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # whoever talks to the dead says so
def test_workers_that_are_killed_lose_nothing(scans, store, tmp_path):
    write_sizes(tmp_path, 6, n=2562)
    inputs, killed = find_inputs([str(tmp_path / "*.off")]), Killed()
    report = compute_all(inputs, store, PLAN, engine=DaskEngine(nworkers=1), progress=killed)
    assert killed.count >= 1
    assert (len(report.completed), report.failed) == (6, ())
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
    report = compute_all(inputs[:3], store, PLAN, engine=DaskEngine(scheduler=address))
    assert report.computed == 3
    file = DaskEngine(scheduler_file=tmp_path / "where.json")
    assert compute_all(inputs[:3], store, PLAN, engine=file).computed == 0

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
    assert len(left.completed) == 4


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
def test_what_cannot_be_handed_to_workers_is_told(scans, store):
    class Local(sk.Arpack):
        """A solver that only this function knows."""

    engine, inputs = DaskEngine(nworkers=1), find_inputs([scans / "bumpy.ply"])
    refused("engine", "be handed what can be pickled", compute_all, inputs, store,
            Plan(k=6, solver=Local()), engine=engine)  # fmt: skip


@pytest.mark.slow
def test_workers_refuse_what_will_not_fit(scans, store):
    plan = Plan(k=500)
    engine = DaskEngine(nworkers=1, memory_limit="300MB")  # 0.28 GiB
    write(creature(9000), store.path / "large.off")
    report = compute_all(find_inputs([store.path / "large.off"]), store, plan, engine=engine)
    assert "need about 0." in str(report.failed[0].error)


@pytest.mark.slow
def test_ctrl_c_ends_workers_without_a_word_of_theirs(tmp_path):
    write_sizes(tmp_path, 8, n=2562)
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
