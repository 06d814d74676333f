import dataclasses
import importlib.util
import json
import math
import re
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from conftest import bumpy

from spectra_kit import Arpack, Provenance, eigensolve, robust_laplacian
from spectra_kit.benchmarks import METHODS, Result, Settings, fit_exponent, measure
from spectra_kit.benchmarks.journal import Journal
from spectra_kit.benchmarks.methods import QUICK
from spectra_kit.benchmarks.peers import ScipyEigsh
from spectra_kit.benchmarks.problems import Problem, read_operator, write_operator
from spectra_kit.benchmarks.process import StoppedError, Worker
from spectra_kit.benchmarks.report import markdown
from spectra_kit.benchmarks.results import summarize
from spectra_kit.benchmarks.worker import Runner, assemble, refer
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import sphere, write
from spectra_kit.metrics import compare_spectra
from spectra_kit.neo import NeoSubspace

APP = Path(__file__).parents[2] / "apps" / "benchmark_eigensolvers.py"
PEERS = [name for name, entry in METHODS.items() if entry.peer]


@pytest.fixture(scope="module")
def app():
    specification = importlib.util.spec_from_file_location("benchmark_eigensolvers", APP)
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module.main


TINY = ["-k", "10", "--repeats", "2", "--threads", "1", "--methods", "arpack", "eigsh", "fourier"]
TINY += ["--machine", "test", "--commit", "c0", "--geometry", "cloud"]


@pytest.fixture(scope="module")
def finished(app):
    """The folder of a finished benchmark of two sizes."""
    with tempfile.TemporaryDirectory() as name:
        assert app([name, "--sizes", "900", "800", *TINY]) == 0
        yield Path(name)


def test_json_says_what_was_measured(finished):
    record = json.loads((finished / "benchmark.json").read_text())
    assert record["schema"] == 1
    assert record["machine"]["name"] == "test"
    assert record["machine"]["versions"]["numpy"] == np.__version__
    assert record["commits"] == ["c0"]
    assert record["settings"]["k"] == 10
    assert record["settings"]["operators"] == {"cloud": "delaunay"}
    assert record["methods"]["eigsh"] == {
        "solver": "ScipyEigsh(sigma=-0.01, tol=0.0)",
        "stops_at": "rounding",
        "peer": True,
    }
    results = record["results"]
    assert [(r["geometry"], r["n"]) for r in results[::3]] == [("cloud", 800), ("cloud", 900)]
    for result in results:
        assert result["status"] == "ok"
        assert len(result["seconds"]) == 2
        assert min(result["seconds"]) > 0
        assert 0 <= result["waiting"] <= 1
        assert result["assembly_seconds"] > 0
        assert result["peak_bytes"] >= 0
        if result["method"] == "fourier":  # 320 functions for 10 modes
            assert 1e-9 < result["eigenvalue_error"] < 0.1
        else:
            assert result["residual_max"] < 1e-9
            assert result["eigenvalue_error"] < 1e-9
            assert result["span_error"] < 1e-9
        assert result["missed"] == 0


def test_tables_and_plots_are_written(finished):
    text = (finished / "benchmark.md").read_text()
    assert "### cloud, 800 points" in text
    assert "### cloud, 900 points" in text
    assert len(re.findall(r"^\| \**(?:arpack|eigsh)\** \| rounding \|", text, re.MULTILINE)) == 4
    assert len(re.findall(r"^\| \**fourier\** \|  \|", text, re.MULTILINE)) == 2
    assert text.count("Operator: delaunay, assembled in") == 2
    assert "no process waits" not in text
    pictures = {path.name for path in finished.glob("*.png")}
    assert pictures == {"time-cloud.png", "accuracy-cloud-800.png", "accuracy-cloud-900.png"}


def test_a_rerun_continues(finished, app, capsys):
    journal = finished / "measurements.jsonl"
    lines = journal.read_text().splitlines()
    assert len(lines) == 12
    # As after a crash in the middle of writing the 11th line.
    journal.write_text("\n".join(lines[:10]) + "\n" + lines[10][:40])
    assert app([str(finished), "--sizes", "800", "900", *TINY]) == 0
    again = journal.read_text().splitlines()
    assert again[:10] == lines[:10]
    assert [json.loads(x)["key"] for x in again] == [json.loads(x)["key"] for x in lines]
    assert "written:" in capsys.readouterr().out


def test_a_damaged_journal_is_told(tmp_path, app, capsys):
    (tmp_path / "measurements.jsonl").write_text('{"no": 1}\n{"key": {}}\n')
    assert app([str(tmp_path), "--sizes", "800", *TINY]) == 2
    assert "line 1 of" in capsys.readouterr().err


def test_a_file_has_one_mesh_and_clouds_of_any_size(tmp_path):
    file = tmp_path / "ball.off"
    write(sphere(subdivisions=3).geometry, file)
    settings = Settings(file=str(file), sizes=(700, 800), k=4)
    assert [(p.kind, p.points) for p in settings.problems()] == [
        ("mesh", 0),
        ("cloud", 700),
        ("cloud", 800),
    ]
    mesh, cloud, _ = (problem.assemble() for problem in settings.problems())
    assert (mesh.n, cloud.n) == (642, 700)
    # Of unit area, so radius 1 / sqrt(4 pi): eigenvalues 4 pi l (l + 1).
    assert eigensolve(mesh, 4).eigenvalues[1:] == pytest.approx(8 * np.pi, rel=0.02)


def test_operators_survive_the_file(tmp_path):
    laplacian = Problem(kind="mesh", points=600, operator="robust").assemble()
    write_operator(laplacian, tmp_path / "operator.npz")
    again = read_operator(tmp_path / "operator.npz")
    assert (again.stiffness != laplacian.stiffness).nnz == 0
    assert np.array_equal(again.mass, laplacian.mass)
    assert np.array_equal(again.points, laplacian.points)
    assert (again.seconds, again.operator) == (laplacian.seconds, laplacian.operator)


@pytest.mark.parametrize("name", PEERS)
def test_peers_agree_with_arpack(name):
    if not METHODS[name].present:
        pytest.skip(f"{METHODS[name].pip} is not installed")
    laplacian = robust_laplacian(bumpy())
    exact = eigensolve(laplacian, 12, Arpack())
    found = eigensolve(laplacian, 12, METHODS[name].make("cpu"))
    comparison = compare_spectra(exact, found)
    assert comparison.mean_eigenvalue_error < 1e-6
    assert comparison.mean_span_error < 1e-6


def test_eigsh_is_measured_at_our_tolerance_too():
    loose = METHODS["eigsh-1e-6"].make("cpu")
    assert loose == dataclasses.replace(METHODS["eigsh"].make("cpu"), tol=1e-6)
    laplacian = robust_laplacian(bumpy())
    # Lanczos stops at a restart: with one number of modes it may have more digits than asked for.
    residuals = {
        m: max(
            eigensolve(laplacian, k, METHODS[m].make("cpu")).certificate.relative_residuals.max()
            for k in (8, 12, 20, 25, 40)
        )
        for m in PEERS[:2]
    }
    assert residuals["eigsh"] < 1e-9 < residuals["eigsh-1e-6"] < 1e-4


def test_the_tolerance_of_each_method_is_the_one_told():
    for name, entry in METHODS.items():
        solver = entry.make("cpu")
        tolerance = getattr(solver, "rtol", getattr(solver, "tol", None))
        if entry.stops == "1e-6":
            assert tolerance == 1e-6, name
        elif entry.stops == "rounding":
            assert not tolerance, name
        else:
            assert tolerance is None, name


def test_chebyshev_is_started_from_the_network_on_its_device():
    entry = METHODS["chebyshev-neo"]
    assert entry.devices == ("cpu", "cuda")
    solver = entry.make("cpu")
    assert (solver.method, solver.device, solver.rtol) == ("chebyshev", "cpu", 1e-6)
    assert isinstance(solver.start, NeoSubspace)
    assert solver.start.device == "cpu"


def test_the_quick_choice_leaves_out_the_slow_rivals(app):
    left = {name for name in METHODS if name not in QUICK}
    assert left == {"lobpcg", "lobpcg-amg", "spectra", "lobpcg-pyamg"}
    parse = app.__globals__["_parser"]().parse_args
    assert tuple(parse(["out", "--quick"]).methods) == QUICK
    assert tuple(parse(["out"]).methods) == tuple(METHODS)
    with pytest.raises(SystemExit):
        parse(["out", "--quick", "--methods", "arpack"])


def test_options_name_a_method_in_the_same_words_every_time():
    for name, entry in METHODS.items():
        assert entry.options == (repr(entry.make("cpu")) if entry.present else "")
        assert " at 0x" not in entry.options, name


def test_a_method_with_other_options_is_measured_anew(tmp_path, monkeypatch):
    settings = Settings(sizes=(600,), k=4, methods=("eigsh",), kinds=("mesh",), repeats=1)
    [first] = measure(settings, tmp_path)
    assert measure(settings, tmp_path) == [first]
    entry = METHODS["eigsh"]
    changed = dataclasses.replace(entry, make=lambda device: ScipyEigsh(sigma=-0.02))
    monkeypatch.setitem(METHODS, "eigsh", changed)
    [second] = measure(settings, tmp_path)
    assert second["key"] == {**first["key"], "solver": "ScipyEigsh(sigma=-0.02, tol=0.0)"}
    assert len((tmp_path / "measurements.jsonl").read_text().splitlines()) == 2


def test_operators_and_exact_modes_are_those_of_the_code(tmp_path, monkeypatch):
    settings = Settings(sizes=(600,), k=4, methods=("eigsh",), kinds=("mesh",), repeats=1)
    measure(settings, tmp_path)
    module = sys.modules["spectra_kit.benchmarks.measure"]  # its name is the function's, too
    monkeypatch.setattr(module, "code_digest", lambda: "another")
    (tmp_path / "measurements.jsonl").unlink()
    measure(settings, tmp_path)
    parts = [path.stem.split("-")[1] for path in (tmp_path / "cache").iterdir()]
    assert sorted(parts) == ["exact", "exact", "operator", "operator"]


def test_a_journal_that_was_cut_short_anywhere_goes_on(tmp_path, monkeypatch):
    path = tmp_path / "journal.jsonl"
    for n in range(2):
        Journal(path).add({"n": n}, {"status": "ok"})
    whole = path.read_text()
    for end in range(whole.index("\n") + 1, len(whole)):  # the last one lacks the newline alone
        path.write_text(whole[:end])
        Journal(path).add({"n": 2}, {"status": "ok"})
        journal = Journal(path)
        assert [journal.get({"n": n}) is not None for n in range(3)] == [True, False, True]

    def full(file, text):
        raise OSError(28, "No space left on device")

    path.write_text(whole[:-1])
    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(OSError, match="No space"):
        Journal(path)
    assert path.read_text() == whole[:-1]


def test_seconds_are_those_of_solving(tmp_path):
    stages = {"assembly": 1.0, "solve": 2.0, "other": 4.0, "certify": 8.0, "verify": 16.0}
    assert Provenance(seconds=stages).solving_seconds == 6.0
    operator, reference = str(tmp_path / "operator.npz"), str(tmp_path / "exact.npz")
    assemble({"kind": "mesh", "points": 600, "operator": "robust"}, operator)
    refer(operator, reference, 4)
    solved = Runner("arpack", "cpu", operator, reference, 4).solve(keep=False)
    assert solved["seconds"] == Provenance(seconds=solved["stages"]).solving_seconds


def test_modes_are_dropped_when_they_are_compared(tmp_path):
    recipe = {"kind": "mesh", "points": 600, "operator": "robust"}
    operator, exact = str(tmp_path / "operator.npz"), str(tmp_path / "exact.npz")
    assemble(recipe, operator)
    refer(operator, exact, 4)
    runner = Runner("arpack", "cpu", operator, exact, 4)
    assert runner.solve(keep=False)["status"] == "ok"
    assert runner.spectrum is None
    runner.solve(keep=True)
    assert runner.compare()["eigenvalue_error"] < 1e-9
    assert runner.spectrum is None


def test_of_large_problems_one_process_lives_at_a_time(tmp_path, monkeypatch):
    alive, most = set(), []

    class Counted(Worker):
        def __init__(self, **options):
            super().__init__(**options)
            alive.add(self)
            most.append(len(alive))

        def close(self):
            super().close()
            alive.discard(self)

    monkeypatch.setitem(measure.__globals__, "Worker", Counted)
    options = {"sizes": (600,), "k": 4, "methods": ("eigsh", "arpack"), "kinds": ("mesh",)}
    settings = Settings(**options, repeats=2, alone_from=500)
    results = summarize(measure(settings, tmp_path))
    assert (max(most), len(most)) == (1, 5)  # the reference and four solves
    for result in results:
        assert result.ok
        assert len(result.seconds) == 2
        assert result.eigenvalue_error < 1e-9
    text = markdown(results, settings, {"name": "", "processor": "", "accelerator": ""})
    assert "From 500 points on no process waits while another one solves" in text
    most.clear()
    measure(Settings(**options, repeats=2), tmp_path / "small")
    assert (max(most), len(most)) == (2, 3)


def test_clouds_have_the_delaunay_operator_and_meshes_the_robust_one(tmp_path):
    settings = Settings(sizes=(600,), k=4)
    assert settings.operators == {"mesh": "robust", "cloud": "delaunay"}
    assert [p.operator for p in settings.problems()] == ["robust", "delaunay"]
    names = [p.assemble().operator.split("(")[0] for p in settings.problems()]
    assert names == ["robust_laplacian", "delaunay_laplacian"]


def test_every_method_names_what_it_is():
    for name, entry in METHODS.items():
        assert set(entry.devices) <= {"cpu", "cuda"}, name
        assert bool(entry.needs) == bool(entry.pip), name
        assert callable(entry.make("cpu").eigenpairs)


def test_an_absent_package_is_listed_with_its_name(tmp_path, monkeypatch):
    monkeypatch.setitem(
        METHODS, "lapy", METHODS["lapy"].__class__(make=Arpack, needs="no_such_module", pip="lapy")
    )
    settings = Settings(sizes=(600,), k=4, methods=("lapy",), kinds=("mesh",), repeats=1)
    [record] = measure(settings, tmp_path)
    assert record["status"] == "absent"
    assert record["reason"] == "not installed: pip install lapy"


def test_what_takes_too_long_is_stopped_and_skipped_at_larger_sizes(tmp_path):
    settings = Settings(
        sizes=(600, 700), k=4, methods=("eigsh",), kinds=("mesh",), repeats=1, time_limit=1e-9
    )
    first, second = summarize(measure(settings, tmp_path))
    assert (first.status, second.status) == ("stopped", "skipped")
    assert second.reason == "stopped at 600 points: took more than 1e-09 s"


def test_limits_of_a_worker(tmp_path):
    recipe = {"kind": "mesh", "points": 600, "operator": "robust"}
    request = {"do": "assemble", "recipe": recipe}
    request |= {"operator": str(tmp_path / "o.npz")}
    with (tmp_path / "log").open("ab") as log:
        with (
            Worker(threads=1, log=log) as worker,
            pytest.raises(StoppedError, match=r"more than the 0\.0 GB"),
        ):
            worker.ask(request, seconds=60, memory=1)
        with Worker(threads=1, log=log) as worker:
            worker._process.kill()
            with pytest.raises(StoppedError, match="killed"):
                worker.ask(request, seconds=60)
        with (
            Worker(threads=1, log=log) as worker,
            pytest.raises(StoppedError, match="ended with code 1"),
        ):
            worker.ask({"no": "such request"}, seconds=60)


def test_a_failure_is_recorded_and_does_not_end_the_run(tmp_path):
    settings = Settings(sizes=(600,), k=601, methods=("arpack",), kinds=("mesh",), repeats=1)
    [record] = measure(settings, tmp_path)
    assert record["status"] == "failed"
    assert "InvalidInputError: `k` must be at most" in record["reason"]


def test_without_exact_modes_there_are_times_but_no_errors(tmp_path):
    settings = Settings(
        sizes=(600,), k=4, methods=("arpack",), kinds=("mesh",), repeats=1, exact_limit=1e-9
    )
    [measured] = summarize(measure(settings, tmp_path))
    assert measured.ok
    assert measured.residual_max < 1e-9
    assert (measured.eigenvalue_error, measured.no_errors) == (None, "took more than 1e-09 s")


def test_no_operator_no_solve(tmp_path):
    file = tmp_path / "broken.off"
    file.write_text("OFF\n3 1 0\n")
    settings = Settings(file=str(file), k=4, methods=("arpack",), kinds=("mesh",), repeats=1)
    [record] = measure(settings, tmp_path / "out")
    assert record["status"] == "failed"
    assert record["reason"].startswith("no operator: InvalidInputError")


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"methods": ("magic",)}, "`methods` must be among fourier"),
        ({"devices": ("tpu",)}, "`devices` must be cpu or cuda, got tpu"),
        ({"kinds": ("volume",)}, "`kind` must be one of"),
        ({"alone_from": 0}, "`alone_from` must be at least 1"),
        ({"sizes": (10,)}, "`sizes` must be at least 500"),
        ({"time_limit": 0.0}, "`time_limit` must be positive"),
        ({"exact_limit": -1.0}, "`exact_limit` must be positive"),
    ],
)
def test_wrong_settings(wrong, message):
    with pytest.raises(InvalidInputError, match=message):
        Settings(**wrong)


def test_the_operator_of_clouds_is_not_for_meshes():
    with pytest.raises(InvalidInputError, match="of a mesh must be robust, got delaunay"):
        Problem(kind="mesh", points=600, operator="delaunay")


def test_exponents_of_power_laws_with_noise():
    n = np.array([8e3, 32e3, 64e3, 131e3, 512e3])
    for exponent in (0.95, 1.0, 1.3, 2.0):
        noise = 1 + 0.05 * np.random.default_rng(0).standard_normal(len(n))
        assert fit_exponent(n, 1e-6 * n**exponent) == pytest.approx(exponent)
        assert fit_exponent(n, 1e-6 * n**exponent * noise) == pytest.approx(exponent, abs=0.05)
    assert math.isnan(fit_exponent([8000, 64000, 8000], [1.0, 8.0, 1.1]))
    with pytest.raises(InvalidInputError, match="positive and as many"):
        fit_exponent([1, 2], [0.5])
    with pytest.raises(InvalidInputError, match="positive and as many"):
        fit_exponent([1, 2], [0.5, 0.0])


def result(method, seconds, error, **changes):
    measured = Result(
        geometry="mesh",
        points=600,
        n=600,
        method=method,
        device="cpu",
        solver="",
        status="ok",
        reason="",
        seconds=(seconds,),
        waiting=0.0,
        iterations=None,
        assembly_seconds=0.1,
        peak_bytes=0,
        device_peak_bytes=0,
        residual_max=0.0,
        residual_median=0.0,
        eigenvalue_error=error,
        span_error=0.0,
        missed=0,
        no_errors="",
        commits=(),
    )
    return dataclasses.replace(measured, **changes)


def test_bold_methods_are_those_that_none_beats_on_their_device():
    results = [
        result("arpack", 4.0, 0.0),
        result("eigsh", 5.0, 1e-15),  # as exact, but slower
        result("neo", 0.1, 1e-2),
        result("polished", 0.5, 1e-4),
        result("fourier", 0.6, 1e-3),  # beaten
        result("lapy", 0.01, None),  # of unknown accuracy
        result("neo", 0.05, 2e-4, device="cuda"),
    ]
    machine = {"name": "box", "processor": "fast", "accelerator": ""}
    text = markdown(results, Settings(machine="box", commit="", repeats=1), machine)
    bold = [line.split("**")[1] for line in text.splitlines() if line.startswith("| **")]
    assert bold == ["arpack", "neo", "polished", "neo (cuda)"]


def test_the_report_says_what_is_missing_and_what_disturbed():
    results = [
        result("eigsh", 4.0, 0.0, n=8000, points=8000),
        result("neo", 0.5, 1e-2, n=8000, points=8000, waiting=0.25),
        result("eigsh", 8.0, None, n=16000, points=16000, no_errors="took more than 5 s"),
        result("neo", 1.0, None, n=16000, points=16000),
        result("eigsh", 16.0, 0.0, n=32000, points=32000),
        result("lapy", 1.0, None, status="absent", reason="pip install lapy"),
    ]
    machine = {"name": "box", "processor": "fast", "accelerator": ""}
    text = markdown(results, Settings(machine="box", commit="", repeats=1), machine)
    assert "up to 25% of a solve's time was spent waiting for a core" in text
    assert "| **neo** |  | 0.5 | 8.00 | 0.6 |" in text
    assert "- mesh, cpu: eigsh 1.00 (3 sizes)\n" in text  # and none for two sizes
    assert "- eigsh (mesh 16,000): no errors: took more than 5 s" in text
    assert "- lapy (mesh 600): pip install lapy" in text
