"""The benchmark of eigensolvers: what is measured, what follows from it, and what it says."""

import json
import re

import benchmark_eigensolvers as app
import numpy as np
import pytest
from conftest import bumpy
from measure.eigensolvers import studies
from measure.eigensolvers.methods import METHODS, Contender, Method, contenders
from measure.eigensolvers.report import write_report
from measure.eigensolvers.sizes import leads, write_sizes
from measure.eigensolvers.studies import (
    EXACT,
    OPERATOR,
    Preparation,
    Solves,
    assemble,
    clouds_of,
)
from measure.eigensolvers.summary import summaries
from measure.recipes import REAL, Recipe
from measure.store import Store
from measure.study import Result, repeats_of, run

from spectra_kit import Arpack, Provenance, eigensolve, robust_laplacian
from spectra_kit.eigen import Eigenpairs
from spectra_kit.eigen.metrics import compare_spectra
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import sphere, write

PEERS = [name for name, method in METHODS.items() if method.peer]
MACHINE = {"name": "box", "processor": "fast", "accelerator": "", "cores": 2, "threads": 1}
MACHINE |= {"versions": {}, "commit": "", "code": ""}
(CLOUD,) = clouds_of(["creature:600"], [600])
SMALL = Recipe(
    name="small", sources=("creature:600",), steps=(("sample", 600),), traits=("smooth",)
)
TINY = ["--members", "small", "-k", "6", "--repeats", "1", "--threads", "1"]
TINY += ["--methods", "arpack", "eigsh", "--machine", "test", "--commit", "c0"]


def study(folder, names=("arpack",), given=(CLOUD,), **options):
    """Solves of prepared problems, without processes."""
    prepared = Preparation(folder=folder, problems=given, k=4)
    run(prepared, Store(folder), jobs=0)
    places = {"folder": folder, "problems": given, "prepared": prepared}
    return Solves(**places, contenders=contenders(names), **options)


# --- end to end ---


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("benchmark")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(app, "REAL", {"small": SMALL})
        assert app.main([str(folder), *TINY]) == 0
        yield folder


def test_json_says_what_was_measured(finished):
    record = json.loads((finished / "benchmark.json").read_text())
    assert record["machine"]["name"] == "test"
    assert record["machine"]["commit"] == "c0"
    assert record["machine"]["versions"]["numpy"] == np.__version__
    assert record["settings"]["k"] == 6
    assert record["methods"]["eigsh"] == {
        "solver": "ScipyEigsh(sigma=-0.01, tol=0.0)",
        "stops_at": "rounding",
        "peer": True,
    }
    assert [r["method"] for r in record["results"]] == ["arpack", "eigsh"]
    for result in record["results"]:
        assert (result["geometry"], result["n"], result["status"]) == ("cloud", 600, "ok")
        assert len(result["seconds"]) == 1
        assert min(result["seconds"]) > 0
        assert 0 <= result["waiting"] <= 1
        assert result["assembly_seconds"] > 0
        assert result["peak_bytes"] >= 0
        assert result["residual_max"] < 1e-9
        assert result["eigenvalue_error"] < 1e-9
        assert result["eigenvalue_error"] <= result["eigenvalue_error_max"] < 1e-9
    assert {*record["summaries"]} == {"all", "for tuning", "cloud", "smooth"}


def test_tables_and_plots_are_written_and_a_rerun_measures_nothing(finished, capsys):
    text = (finished / "benchmark.md").read_text()
    told = text[text.index("### small") :]
    assert len(re.findall(r"^\| \**(?:arpack|eigsh)\** +\| rounding \|", told, re.MULTILINE)) == 2
    pictures = {path.name for path in finished.glob("*.png")}
    assert pictures == {"accuracy.png"}
    measured = (finished / "measurements.jsonl").read_text()
    assert app.main([str(finished), *TINY]) == 0
    assert (finished / "measurements.jsonl").read_text() == measured
    assert "written:" in capsys.readouterr().out


# --- who ---


@pytest.mark.parametrize("name", PEERS)
def test_peers_agree_with_arpack(name):
    if not METHODS[name].present:
        pytest.skip(f"{METHODS[name].needs} is not installed")
    laplacian = robust_laplacian(bumpy())
    exact = eigensolve(laplacian, 12, Arpack())
    found = eigensolve(laplacian, 12, METHODS[name].make("cpu"))
    comparison = compare_spectra(exact, found)
    assert comparison.mean_eigenvalue_error < 1e-6
    assert comparison.mean_span_error < 1e-6


@pytest.mark.parametrize("name", METHODS)
def test_a_method_is_what_is_told_of_it(name):
    method = METHODS[name]
    assert set(method.devices) <= {"cpu", "cuda"}
    solver = method.make("cpu")
    assert callable(solver.eigenpairs)
    tolerance = getattr(solver, "rtol", getattr(solver, "tol", None))
    if method.stops == "rounding":
        assert not tolerance
    elif tolerance is None:
        assert method.stops in ("", "default")
    else:
        assert float(method.stops) == tolerance
    options = Contender(name).solver  # in the same words every time: it is part of the key
    assert options == (repr(method.make("cpu")) if method.present else "")
    assert " at 0x" not in options


# --- on what ---


def test_operators_are_of_unit_area_and_clouds_of_any_size(tmp_path):
    file = tmp_path / "ball.off"
    write(sphere(subdivisions=3).geometry, file)
    clouds = clouds_of([str(file)], (700, 800))
    assert [str(p) for p in clouds] == ["ball.off, 700 points", "ball.off, 800 points"]
    recipes = Recipe(name="mesh", sources=(str(file),)), clouds[0]
    mesh, cloud = (assemble(recipe)[0] for recipe in recipes)
    assert (mesh.n, cloud.n) == (642, 700)
    assert [x.operator.split("(")[0] for x in (mesh, cloud)] == [
        *("robust_laplacian", "delaunay_laplacian")
    ]
    assert mesh.area == pytest.approx(1)
    assert np.linalg.norm(mesh.points, axis=1) == pytest.approx((4 * np.pi) ** -0.5, rel=0.02)
    # Of unit area, so radius 1 / sqrt(4 pi): eigenvalues 4 pi l (l + 1).
    assert eigensolve(mesh, 4).eigenvalues[1:] == pytest.approx(8 * np.pi, rel=0.02)
    with pytest.raises(InvalidInputError, match="sizes"):
        clouds_of([str(file)], (499,))


# --- how ---


def test_without_exact_modes_there_are_no_errors_but_seconds(tmp_path):
    solves = study(tmp_path)
    other = Contender("eigsh"), Contender("eigsh-1e-6"), Contender("cascade", "cuda")
    assert len({solves.key(who, CLOUD) for who in (Contender("cascade"), *other)}) == 4
    exact = solves.prepared.file(EXACT, CLOUD, ".npz")
    exact.rename(tmp_path / "elsewhere")
    (result,) = run(solves, Store(tmp_path), jobs=0)
    assert result.ok
    assert "eigenvalue_error" not in result.record
    stopped = Result(EXACT, CLOUD, 0, {"status": "stopped", "reason": "took more than 5 s"})
    text = write_report(solves, [result], [stopped], MACHINE)[1].read_text()
    assert "- exact eigenvalues (creature:600, 600 points): took more than 5 s" in text
    # Once they are there, it is measured again.
    (tmp_path / "elsewhere").rename(exact)
    (result,) = run(solves, Store(tmp_path), jobs=0)
    assert result.record["eigenvalue_error"] < 1e-9
    stages = result.record["stages"]
    assert result.record["seconds"] == Provenance(seconds=stages).solving_seconds


class Mixed:
    """Exact modes, some of them turned towards higher ones; and what it says of their errors."""

    promise = "approximate"
    shares, told = np.array([0.0, 1e-4, 1e-6, 1e-4]), np.array([1.0, 2.0, 4.0, 0.25])

    def eigenpairs(self, laplacian, k):
        exact = eigensolve(laplacian, 2 * k)
        values, vectors = exact.eigenvalues, exact.eigenvectors
        low, high = vectors[:, :k], vectors[:, k:]
        turned = np.sqrt(1 - self.shares) * low + np.sqrt(self.shares) * high
        found = (1 - self.shares) * values[:k] + self.shares * values[k:]
        errors = self.told * (found - values[:k]) / np.where(values[:k] > 1, values[:k], 1)
        return Eigenpairs(found, turned, errors=np.maximum(errors, 0))


def test_estimates_are_compared_to_true_errors(tmp_path, monkeypatch):
    monkeypatch.setitem(METHODS, "neo", Method(make=lambda device: Mixed()))
    monkeypatch.setattr(studies, "sphere", lambda **_: sphere(subdivisions=3))  # to warm up: small
    (result,) = run(study(tmp_path, ("neo",)), Store(tmp_path), jobs=0)
    record = result.record
    # Of the three modes that are no constant, one is told within a factor of 3, one 4 times too
    # high and one 4 times too low.
    assert (record["estimated"], record["apart"]) == (3, pytest.approx(2 / 3))
    assert record["low"] == pytest.approx(1 / 3)
    monkeypatch.setattr(Mixed, "shares", np.array([0.0, 1e-4, 1e-13, 0.0]))  # below rounding
    (result,) = run(study(tmp_path / "2", ("neo",)), Store(tmp_path / "2"), jobs=0)
    assert (result.record["estimated"], result.record["apart"]) == (1, 0.0)


def test_what_is_absent_or_failed_is_not_tried(tmp_path, monkeypatch):
    monkeypatch.setitem(METHODS, "lapy", Method(make=Arpack, needs="no_such_module"))
    solves = study(tmp_path)
    (other,) = clouds_of(["creature:600"], [700])
    eigsh = Contender("eigsh")
    assert solves.excuse(eigsh, other, []) == "there is no operator"
    solves.prepared.file(OPERATOR, other, ".npz").touch()
    absent = "not installed: pip install no_such_module"
    assert solves.excuse(Contender("lapy"), CLOUD, []) == absent
    failed = Result(eigsh, CLOUD, 0, {"status": "failed", "reason": "no"})
    assert solves.excuse(eigsh, CLOUD, [failed]) == "no"
    assert solves.excuse(eigsh, other, [failed]) == ""
    assert solves.excuse(Contender("arpack"), CLOUD, [failed]) == ""


# --- what follows ---


def measured(name, seconds, error, points=600, device="cpu", problem=None, **changes):
    record = {"status": "ok", "n": points, "seconds": seconds, "assembly_seconds": 0.1}
    record |= {"eigenvalue_error": error, "waiting": 0.0, **changes}
    problem = problem or Recipe(name=f"mesh, {points} points", sources=("a",))
    return Result(Contender(name, device), problem, 0, record)


def report(folder, results):
    prepared = Preparation(folder=folder, problems=(), k=96)
    solves = Solves(folder=folder, contenders=(), problems=(), prepared=prepared)
    return write_report(solves, results, [], MACHINE)[1].read_text()


def test_the_report_says_who_is_best_what_is_missing_and_what_disturbed(tmp_path):
    results = [
        measured("arpack", 4.0, 0.0),
        measured("eigsh", 5.0, 1e-15),  # as exact, but slower
        measured("neo", 0.5, 1e-2, waiting=0.25),
        measured("fourier", 0.6, 1e-1),  # beaten
        measured("lapy", 0.01, None),  # of unknown accuracy
        measured("neo", 0.05, 2e-4, device="cuda"),
        measured("spectra", None, None, status="skipped", reason="too slow"),
    ]
    text = report(tmp_path, results)
    bold = [line.split("**")[1] for line in text.splitlines() if line.startswith("| **")]
    assert bold == ["arpack", "neo", "neo (cuda)"]
    assert "up to 25% of a solve's time was spent waiting for a core" in text
    cells = next(x for x in text.splitlines() if x.startswith("| **neo**")).replace(" ", "")
    assert cells.startswith("|**neo**||0.5|10.00|0.6|")
    assert "members" not in text  # of no set
    assert "- spectra (mesh, 600 points): too slow" in text


EASY = Recipe(name="easy", sources=("a",), traits=("smooth",))
HARD = Recipe(name="hard", sources=("b",), traits=("CAD", "smooth"), held_back=True)
SPOTS = Recipe(name="spots", sources=("c",), steps=(("sample", 9),), traits=("CAD",))


def on(problem, name, seconds, error, **changes):
    return measured(name, seconds, error, problem=problem, residual_max=error, **changes)


def test_a_set_has_a_geometric_mean_and_its_worst_and_nobody_is_excused(tmp_path):
    results = [
        *(on(recipe, "eigsh", 8.0, 1e-15) for recipe in (EASY, HARD, SPOTS)),
        *(on(EASY, "cascade", 1.0, 1e-4), on(HARD, "cascade", 8.0, 5e-2)),
        on(SPOTS, "cascade", 1.0, 1e-4, peak_bytes=3e9),
        *(on(EASY, "neo", 0.1, 1e-9), on(SPOTS, "neo", 0.1, 1e-9)),
        on(HARD, "neo", None, None, status="failed", reason="too hard"),
        on(EASY, "refined", None, None, status="failed", reason="never"),
    ]
    eigsh, cascade, neo = summaries(repeats_of(results))
    assert cascade.over["slowdown"] == (pytest.approx(1 / 4), 1.0, "hard")  # 8 * 1 * 8 = 4 ** 3
    assert cascade.over["eigenvalue_error"] == (pytest.approx(5.02e-2 / 3), 5e-2, "hard")
    assert cascade.over["bytes"] == (pytest.approx(1e9), 3e9, "spots")
    assert eigsh.over["slowdown"].mean == 1
    assert (neo.members, neo.lost) == (3, ("hard",))
    assert np.isnan(neo.over["slowdown"].mean)  # of the easier two it would flatter
    text = report(tmp_path, results)
    headlines = re.findall("^## (.*)$", text, re.MULTILINE)
    counts = [("all", 3), ("held back", 1), ("for tuning", 2), ("mesh", 2), ("cloud", 1)]
    counts += [("CAD", 2), ("smooth", 2)]
    assert headlines == [f"{name}: {count} members" for name, count in counts]
    table = text[text.index("## all") : text.index("## held back")]
    rows = [line.replace(" ", "").split("|")[1:-1] for line in table.splitlines() if "/3" in line]
    assert rows[1][:5] == ["**cascade**", "", "3/3", "4.00", "1.00(hard)"]
    assert rows[1][5:] == ["1.7e-02", "5.0e-02(hard)", "1.7e-02", "5.0e-02", "1.00", "3.00"]
    assert rows[2][:5] == ["neo", "", "2/3", "-", "none(hard)"]
    assert "- neo (hard): too hard" in text
    assert (tmp_path / "accuracy.png").exists()


def test_what_was_promised_is_told_beside_what_came(tmp_path):
    results = [
        # It is of another package: what was measured of its errors is no promise.
        *(on(recipe, "eigsh", 8.0, 1e-15, apart=1.0, low=1.0) for recipe in (EASY, HARD, SPOTS)),
        # Of those that meet 1e-3, the best takes 4, 8 and 2 seconds; on EASY one is quicker and
        # misses it, on SPOTS one was asked for an accuracy itself.
        *(on(EASY, "cascade", 4.0, 9e-4, apart=0.0, low=0.0), on(EASY, "neo", 0.1, 2e-3)),
        on(HARD, "cascade", 9.0, 1e-5, apart=0.5, low=0.25),
        *(on(SPOTS, "cascade", 2.0, 0.0), on(SPOTS, "automatic-1e-2", 0.1, 1e-4)),
        *(on(EASY, "automatic-1e-3", 4.0, 1e-3), on(HARD, "automatic-1e-3", 4.0, 1e-5)),
        on(SPOTS, "automatic-1e-3", 4.0, 1.5e-3),
        on(EASY, "automatic-1e-8", 8.0, None),
    ]
    found = {str(one.contender): one for one in summaries(repeats_of(results))}
    automatic, cascade = found["automatic-1e-3"], found["cascade"]
    assert automatic.over["over_asked"] == (pytest.approx(2.51 / 3), pytest.approx(1.5), "spots")
    assert automatic.over["behind"] == (pytest.approx(1.0), 2.0, "spots")  # 1 * 1/2 * 2
    assert automatic.above == {"over_asked": ("spots",), "behind": ("spots",)}
    assert cascade.over["apart"] == (0.25, 0.5, "hard")
    assert cascade.over["low"] == (0.125, 0.25, "hard")
    assert not {"behind", "over_asked"} & cascade.over.keys()
    assert "over_asked" not in found["automatic-1e-8"].over  # its error is not known
    text = report(tmp_path, results)
    table = text[text.index("## What is promised") : text.index("###")]
    rows = [line.replace(" ", "").split("|")[1:-1] for line in table.splitlines() if "%" in line]
    assert rows == [["cascade", "75.0%", "50%(hard)", "12.5%", "25%(hard)", *"------"]]
    asked = [x.replace(" ", "").split("|")[1:-1] for x in table.splitlines() if "| auto" in x]
    assert [row[5:8] for row in asked] == [
        ["0.01", "1.0e-04(spots)", "1/3"],  # of all members: nobody is excused
        ["0.001", "1.5e-03(spots)", "2/3"],
    ]
    assert asked[1][8:] == ["1.00", "2.00(spots)", "spots"]


def test_what_is_not_there_is_skipped_with_a_reason(tmp_path, monkeypatch):
    monkeypatch.delenv("SPECTRA_KIT_DATA", raising=False)
    igea = REAL["igea"]
    prepared = Preparation(folder=tmp_path, problems=(igea, REAL["40 parts"]), k=4)
    results = run(prepared, Store(tmp_path), jobs=0)
    assert {result.record["status"] for result in results} == {"skipped"}
    told = "no data: ood_public/igea; set SPECTRA_KIT_DATA"
    assert results[0].record["reason"] == told
    solves = Solves(folder=tmp_path, contenders=(), problems=(), prepared=prepared)
    assert solves.excuse(Contender("eigsh"), igea, []) == told


# --- many models at several sizes ---


def test_models_are_solved_at_every_size(tmp_path, monkeypatch):
    monkeypatch.setenv("SPECTRA_KIT_DATA", str(tmp_path))
    (tmp_path / "ood_public").mkdir()
    mesh = bumpy()
    for name, longer in (("ball", 1), ("egg", 2)):
        points = mesh.points * [1, 1, longer]
        np.savez(tmp_path / "ood_public" / f"{name}.npz", V=points, F=mesh.faces)
    out = tmp_path / "out"
    command = [
        str(out),
        "--set",
        "models",
        "--sizes",
        "600",
        "700",
        "--models",
        "2",
        "1",
        "-k",
        "6",
    ]
    command += ["--repeats", "1", "--threads", "1", "--methods", "arpack", "cascade-1e-2"]
    assert app.main(command) == 0
    record = json.loads((out / "sizes.json").read_text())
    counts = {size: found[0]["members"] for size, found in record["summaries"].items()}
    assert counts == {"600 points": 2, "700 points": 1}
    assert (out / "sizes.png").stat().st_size > 5000
    table = (out / "sizes.md").read_text()
    assert re.search(r"^\| arpack +\|.*\| +(ball|egg) \|", table, re.MULTILINE)
    measured = (out / "measurements.jsonl").read_text()
    assert app.main(command) == 0
    assert (out / "measurements.jsonl").read_text() == measured
    assert app.main([*command[:7], "2", "-k", "6"]) == 2  # a count for each size


def test_waves_are_as_many_as_the_network_has_functions():
    waves, neo = METHODS["fourier"].make("cpu"), METHODS["neo-raw"].make("cpu")
    assert waves.subspace.m == neo.subspace.n_functions
    smoothed, default = METHODS["fourier-smoothed"].make("cpu"), METHODS["neo"].make("cpu")
    assert (smoothed.max_steps, smoothed.target) == (default.max_steps, default.target)


def test_the_network_pays_where_nothing_without_it_is_as_quick_and_as_near():
    a, b = clouds_of(("a", "b"), [600])
    results = [
        *(on(a, "neo", 1.0, 1e-4), on(b, "neo", 1.0, 1e-4)),
        *(on(a, "fourier", 0.25, 1e-2), on(b, "fourier", 1.0, 1e-4)),  # 0.5 s and 1e-3
        *(on(a, "arpack", 2.0, 0.0), on(b, "arpack", 2.0, 0.0)),
        *(on(a, "neo-raw", 0.1, 1e-1), on(b, "neo-raw", 0.1, 1e-1)),
        *(on(a, "refined-neo", 9.0, 1e-14), on(b, "refined-neo", 9.0, 1e-14)),
    ]
    neo, raw, refined = leads(repeats_of(results))
    assert (neo.contender.name, neo.rival.name, neo.ratio) == ("neo", "fourier", pytest.approx(10))
    assert (neo.models, neo.measured) == (("a, 600 points",), 2)
    assert (raw.rival, raw.ratio, len(raw.models)) == (None, np.inf, 2)
    assert (refined.rival.name, refined.ratio, refined.models) == ("arpack", 1, ())


def test_exponents_are_of_three_sizes_and_more(tmp_path):
    sizes = (8000, 16000, 32000)
    results = [
        *(on(r, "eigsh", n / 1000, 1e-14) for n in sizes for r in clouds_of(("a",), [n])),
        *(on(r, "neo", n / 8000, 1e-2) for n in sizes[:2] for r in clouds_of(("a",), [n])),
    ]
    prepared = Preparation(folder=tmp_path, problems=(), k=96)
    solves = Solves(folder=tmp_path, contenders=(), problems=(), prepared=prepared)
    text = write_sizes(solves, results, [], MACHINE)[1].read_text()
    assert re.search(r"^\| eigsh +\| +1\.00 \|", text, re.MULTILINE)
    assert re.search(r"^\| neo +\| +- \|", text, re.MULTILINE)
