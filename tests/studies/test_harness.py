"""The harness of the measurements: it remembers, limits, stops, goes on, and tells."""

import csv
import dataclasses
import json
import os
import re
import signal
import subprocess
import sys
import textwrap
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from conftest import bumpy
from studies import run as command
from studies.machine import describe_machine, machine_line
from studies.report import Table, plain, ratio, write_csv, write_report
from studies.shapes import (
    Shape,
    data_folder,
    read_operator,
    shapes_in,
    shapes_named,
    write_operator,
)
from studies.store import Store, code_digest
from studies.study import Result, Study, run
from studies.worker import FailedError, Limits, Worker
from toy_study import Lasting, Toy, calls, clock_ones, toy

from spectra_kit import PointCloud, robust_laplacian
from spectra_kit._core.version import VERSION
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import sphere, write


def test_each_is_measured_with_each_by_turns_and_once(tmp_path):
    study = toy(tmp_path, repeats=2)
    results = run(study, Store(tmp_path), limits=Limits(threads=3))
    assert [(r.problem, r.repeat, r.contender) for r in results] == [
        (p, i, c) for p in (1, 2) for i in (0, 1) for c in ("a", "b")
    ]
    assert all(r.ok and r.record["total"] == r.problem for r in results)
    assert {r.record["threads"] for r in results} == {"3"}
    assert len(calls(tmp_path)) == 8
    again = run(study, Store(tmp_path), jobs=0)
    assert [r.record for r in again] == [r.record for r in results]
    assert len(calls(tmp_path)) == 8


@pytest.mark.parametrize("changed", ["option", "version", "code", "file"])
def test_what_has_changed_is_measured_again(tmp_path, monkeypatch, changed):
    study = toy(tmp_path)
    run(study, Store(tmp_path), jobs=0)
    if changed == "option":
        study = dataclasses.replace(study, option="other")
    elif changed == "version":
        monkeypatch.setattr(Toy, "version", 2)
    elif changed == "code":
        monkeypatch.setattr("studies.study.code_digest", lambda sources: "other")
    else:
        study.file("a", 2, ".npy").unlink()
    run(study, Store(tmp_path), jobs=0)
    assert calls(tmp_path)[4:] == (["a 2"] if changed == "file" else calls(tmp_path)[:4])


def test_the_code_is_that_of_the_sources(tmp_path):
    for package in ("linalg", "neo", "show"):
        (tmp_path / package).mkdir()
        (tmp_path / package / "a.py").write_text("1")

    def found(*sources):
        code_digest.cache_clear()
        return code_digest(sources, tmp_path)

    first, neo = found(), found("neo/*.py")
    assert first.startswith(f"{VERSION}+")
    (tmp_path / "show" / "a.py").write_text("2")  # what draws decides no number
    assert found() == first
    (tmp_path / "linalg" / "a.py").rename(tmp_path / "linalg" / "b.py")
    assert found() != first
    assert found("neo/*.py") == neo
    with pytest.raises(InvalidInputError, match="must match files of the package"):
        found("linalg/a.py")


def test_the_sources_of_studies_are_there():
    for name in set(command.STUDIES.values()) | {"geodesics.distances", "learning.segmentation"}:
        import_module(f"studies.{name}")
    studies = Study.__subclasses__()
    assert {code_digest(study.sources) for study in studies if study is not Toy}


def test_a_store_that_was_cut_short_anywhere_goes_on(tmp_path):
    for n in range(2):
        Store(tmp_path).add(f"{n}", {"status": "ok"})
    path = tmp_path / "measurements.jsonl"
    whole = path.read_text()
    for end in range(whole.index("\n") + 1, len(whole)):  # the last one lacks the newline alone
        path.write_text(whole[:end])
        Store(tmp_path).add("2", {"status": "ok"})
        store = Store(tmp_path)
        assert [store.get(f"{n}") is not None for n in range(3)] == [True, False, True]
    path.write_text('{"no": 1}\n')
    with pytest.raises(InvalidInputError, match=r"line 1 of .* must be a measurement"):
        Store(tmp_path)


def test_a_store_is_not_repaired_while_another_run_writes_to_it(tmp_path):
    first = Store(tmp_path)
    with ThreadPoolExecutor(1) as other, first._alone() as file:
        file.write(b'{"key": "0", ')
        file.flush()
        second = other.submit(Store, tmp_path)
        time.sleep(0.2)
        assert not second.done()
        file.write(b'"status": "ok"}\n')
        file.close()
        assert second.result(10).get("0") == {"key": "0", "status": "ok"}


def test_what_fails_is_remembered_until_it_is_to_be_tried_again(tmp_path):
    study = toy(tmp_path, ["fails", "dies", "leaves a child", "a"])
    start = time.monotonic()
    for _ in range(2):
        results = run(study, Store(tmp_path), jobs=1)
        assert [r.record["status"] for r in results] == [
            *("failed", "stopped", "stopped", "ok"),
            *("skipped", "skipped", "skipped", "ok"),
        ]
        assert results[0].reason == "`problem` must be easier"
        assert results[1].reason == "the process ended with code 7"
        assert results[2].reason == "the process was killed, as systems do when memory ends"
        assert results[4].reason == "not at 1"
        assert len(calls(tmp_path)) == 5
    assert time.monotonic() - start < 50  # it does not wait for the child
    run(study, Store(tmp_path), jobs=1, retry=True)
    assert calls(tmp_path)[5:] == ["fails 1", "dies 1", "leaves a child 1"]
    lasting = toy(tmp_path, range(4), range(4), kind=Lasting)
    found = {r.record["process"] for r in run(lasting, Store(tmp_path), jobs=2)}
    assert len(found) == 2
    assert os.getpid() not in found


def test_limits_of_time_and_memory(tmp_path):
    study = toy(tmp_path, ["waits"], [1])
    (late,) = run(study, Store(tmp_path), limits=Limits(seconds=0.05))
    assert (late.record["status"], late.reason) == ("stopped", "took more than 0.05 s")
    (large,) = run(study, Store(tmp_path), limits=Limits(memory=1), retry=True)
    assert re.match(r"held 0\.\d GB, more than the 0\.0 GB allowed", large.reason)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL], ids=["interrupt", "kill"])
def test_all_processes_end_with_their_parent_and_it_goes_on(tmp_path, number):
    code = """
        import sys
        from pathlib import Path
        from studies.command import exit_code
        from studies.store import Store
        from studies.study import Result, Study, run
        from toy_study import toy
        folder = Path(sys.argv[1])
        study = toy(folder, ["a", "waits"], [1])
        sys.exit(exit_code(lambda: run(study, Store(folder), jobs=2)))
    """
    parent = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code), str(tmp_path)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)},
        stderr=subprocess.PIPE,
        text=True,
    )
    store = tmp_path / "measurements.jsonl"
    while len(calls(tmp_path)) < 2 or not store.exists():
        time.sleep(0.02)
        assert parent.poll() is None
    parent.send_signal(number)
    said = parent.communicate()[1]
    if number == signal.SIGINT:
        assert parent.returncode == 130
        assert said.strip() == "stopped; the same command goes on from here"
    deadline = time.monotonic() + 5
    while alive := _serving(tmp_path):
        assert time.monotonic() < deadline, alive
        time.sleep(0.05)
    assert Store(tmp_path).get(toy(tmp_path).key("a", 1))["status"] == "ok"


def _serving(folder):
    """Processes whose work lies in a folder: their log is open in it."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if os.readlink(process / "fd" / "1").startswith(str(folder)):
                found.append(process.name)
        except OSError:  # ended meanwhile, or another user's
            continue
    return found


def test_a_worker_clocks_time_and_memory_and_outlives_a_failure():
    with closing(
        Worker(Limits())
    ) as worker:  # a heap that is new has no freed memory to take again
        found = worker.call(clock_ones, size := 8_000_000)
        with pytest.raises(FailedError, match="ValueError: "):
            worker.call(int, "no number")
        assert worker.call(abs, -3) == 3
    assert 0.05 <= found["seconds"] < 5
    assert found["peak_bytes"] >= 0.9 * 8 * size
    assert found["waited_seconds"] >= 0


def test_a_machine_is_described():
    machine = json.loads(json.dumps(describe_machine(name="box", threads=2)))
    assert machine["versions"]["numpy"] == np.__version__
    assert machine_line(machine).startswith(f"box: {machine['processor']}, ")
    assert "threads: 2;" in machine_line(machine)


# --- shapes ---


def test_shapes_are_files_or_known(tmp_path, monkeypatch):
    ball = sphere(subdivisions=1).geometry
    moved = ball.with_points(2 * ball.points)
    assert Shape("a", ball).digest == Shape("b", ball).digest != Shape("a", moved).digest
    write(ball, tmp_path / "mine.ply")
    (tmp_path / "ood_public").mkdir()
    write(ball, tmp_path / "ood_public" / "igea.npz")
    monkeypatch.delenv("SPECTRA_KIT_DATA", raising=False)
    assert data_folder("ood_public") is None
    with pytest.raises(InvalidInputError, match="must name files"):
        shapes_named(["igea"])
    monkeypatch.setenv("SPECTRA_KIT_DATA", str(tmp_path))
    found = shapes_named(["igea", str(tmp_path / "mine.ply")])
    assert [str(shape) for shape in found] == ["igea", "mine"]
    assert [s.name for s in shapes_in(data_folder("ood_public"))] == ["igea"]
    with pytest.raises(InvalidInputError, match="names of their own, got igea twice"):
        shapes_named(["igea", "igea"])
    with pytest.raises(InvalidInputError, match="must hold meshes"):
        shapes_in(tmp_path / "nowhere")
    write(PointCloud(np.eye(3)), tmp_path / "cloud.ply")
    with pytest.raises(InvalidInputError, match=r"cloud\.ply"):
        shapes_named([str(tmp_path / "cloud.ply")])


def test_operators_survive_the_file(tmp_path):
    laplacian = robust_laplacian(bumpy())
    write_operator(laplacian, tmp_path / "operator.npz")
    again = read_operator(tmp_path / "operator.npz")
    assert (again.stiffness != laplacian.stiffness).nnz == 0
    assert np.array_equal(again.mass, laplacian.mass)
    assert np.array_equal(again.points, laplacian.points)
    assert (again.seconds, again.operator) == (laplacian.seconds, laplacian.operator)


# --- the report and the command ---


def test_a_report_has_a_tidy_line_for_each_measurement(tmp_path, capsys):
    good = {"status": "ok", "key": "k", "x": {"a": 1.5, "b": [1, 2.5]}, "errors": [{"m": 3}]}
    results = [Result("a", 1, 0, good)]
    results += [Result("b", n, 0, {"status": "failed", "reason": "too | hard"}) for n in (1, 2)]
    rows = [{"who": "a", "x": 0.125, "best": True}, {"who": "b", "x": np.nan}]
    table = Table("Numbers", rows, {"who": "", "x": ".2f", "y": ""})
    path = write_report(tmp_path, "toy", results, [table], describe_machine(), more=(1,))
    assert path.read_text() in capsys.readouterr().out
    assert str(table).splitlines() == [
        "| who   |    x |  y |",
        "| :---- | ---: | -: |",
        "| **a** | 0.12 |  - |",
        "| b     |    - |  - |",
    ]
    lines = list(csv.DictReader((tmp_path / "toy.csv").read_text().splitlines()))
    told = [lines[0][name] for name in ("contender", "status", "x.a", "x.b", "errors.0.m")]
    assert told == ["a", "ok", "1.5", "1 2.5", "3"]
    assert [line["reason"] for line in lines] == ["", "too | hard", "too | hard"]
    record = json.loads((tmp_path / "toy.json").read_text())
    assert record["tables"]["Numbers"][1] == {"who": "b", "x": None}
    assert record["failed"] == [{"contender": "b", "reason": "too | hard", "problems": "1; 2"}]
    assert record["more"] == [1]


def test_values_may_be_missing_and_json_has_no_nan(tmp_path):
    assert ratio(None, 1.0) is ratio(1.0, None) is ratio(1.0, 0.0) is None
    assert ratio(1.0, 4.0) == 0.25
    write_csv(tmp_path / "a.csv", [{"x": 1}, {"y": "b,c"}])
    assert (tmp_path / "a.csv").read_text() == 'x,y\n1,\n,"b,c"\n'
    shown = {"a": np.array([1.0, np.nan]), "b": Limits(), 3: (np.int64(2), Path("x"))}
    limits = {"threads": 1, "seconds": None, "memory": None}
    assert plain(shown) == {"a": [1.0, None], "b": limits, "3": [2, "x"]}


@pytest.mark.parametrize("name", command.STUDIES)
def test_every_study_has_a_command_that_tells_how_it_is_called(name, capsys):
    with pytest.raises(SystemExit, match="0"):
        command.main([name, "--help"])
    assert f"apps/studies/run.py {name} OUT" in capsys.readouterr().out


def test_the_command_runs_as_a_script_and_names_its_studies():
    script = [sys.executable, command.__file__]
    told = subprocess.run([*script, "nothing"], capture_output=True, text=True, check=False)
    assert told.returncode == 2
    assert "'eigensolvers', 'geodesics'" in told.stderr
