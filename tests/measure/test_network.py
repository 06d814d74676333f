"""The study of the network measures what the library does, remembers it, and does its sums."""

import dataclasses
import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from conftest import bumpy, two_parts
from measure import figures
from measure.network.accuracy import Accuracy
from measure.network.cases import Case, procedural_shapes
from measure.network.findings import Goal, Row, of_accuracy, undominated
from measure.network.methods import joined, label, network, waves
from measure.network.questions import QUESTIONS, Settings, ask
from measure.network.report import statistics, write_answer, write_summary
from measure.network.training import training_curve, write_training
from measure.shapes import Shape, demo_shapes
from measure.store import Store
from measure.study import run

from spectra_kit import Neo, RayleighRitz, TriangleMesh, eigensolve
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import rectangle, repair, write
from spectra_kit.metrics import compare_spectra, subspace_span_error
from spectra_kit.neo import NeoConfig, build_network, save_weights
from spectra_kit.subspaces import AmbientFourier
from spectra_kit.training.corpus import CorpusConfig, make_sample
from spectra_kit.training.families import FAMILIES
from spectra_kit.training.samples import sample_mesh

APP = Path(__file__).parents[2] / "apps" / "evaluate_neo.py"
SMALL = network("small")


@pytest.fixture(autouse=True)
def coarse_figures(monkeypatch):
    """Draw what nobody will look at with few pixels."""
    monkeypatch.setattr(figures, "_DPI", 60)


@pytest.fixture(scope="module")
def animal():
    return demo_shapes(1, 800)[0]


@pytest.fixture
def measured(tmp_path):
    """Return a function that measures every method on every case, in this process."""

    def measure(methods, cases, k=10):
        study = Accuracy(folder=tmp_path, contenders=methods, problems=cases, k=k)
        return [result.record for result in run(study, Store(tmp_path), jobs=0, retry=True)]

    return measure


def given(columns_of):
    """A method with columns from a function of the points, as a test wants them."""
    return dataclasses.replace(
        waves(12, 1.0),
        facts={"given": repr(columns_of)},
        basis=lambda points, mass: torch.from_numpy(np.array(columns_of(points))),
    )


# --- what is measured ---


@pytest.mark.parametrize("mesh", [bumpy(2562), two_parts()], ids=["one part", "two parts"])
@pytest.mark.parametrize("method", [waves(120, 5.0), SMALL], ids=str)
def test_what_the_solvers_find_is_found(measured, mesh, method):
    case = Case(shape=Shape("it", mesh), points=1500, seed=4)
    laplacian = case.laplacian()
    subspace = AmbientFourier(m=120, bandwidth=5.0)
    solver = Neo() if method is SMALL else RayleighRitz(subspace=subspace)
    subspace = solver.subspace
    exact, predicted = (eigensolve(laplacian, 10, *s) for s in ((), (solver,)))
    span, dimension = subspace_span_error(subspace, laplacian, exact, predicted)
    comparison = compare_spectra(exact, predicted)

    [found] = measured([method], [case])
    np.testing.assert_allclose(found["span"], span, rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(found["vector"], comparison.vector_error, rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(found["value"], comparison.eigenvalue_error, rtol=1e-4, atol=1e-9)
    assert found["dimension"] == dimension
    assert 0 < found["seconds"] < 60


def test_what_is_timed_is_what_the_solver_does(animal, tmp_path):
    case = Case(shape=animal, points=1200)
    solved = eigensolve(case.laplacian(), 10, Neo())
    study = Accuracy(folder=Store(tmp_path).folder, contenders=[], problems=[], k=10)
    exact, timed, _ = study.compare(SMALL, case)
    np.testing.assert_array_equal(timed.eigenvalues, solved.eigenvalues)
    np.testing.assert_array_equal(timed.eigenvectors, solved.eigenvectors)
    stages = [dict(s.provenance.seconds) for s in (timed, solved)]
    assert stages[0].keys() - {"subspace"} == stages[1].keys() - {"frame", "forward"}
    assert study.measure(SMALL, case)["exact_seconds"] == exact.provenance.solving_seconds


def test_a_component_without_room_for_the_subspace_is_exact(measured):
    # The smaller part holds fewer points than the subspace has functions.
    case = Case(shape=Shape("two", two_parts()), points=None)
    [found] = measured([waves(200, 5.0)], [case])
    assert case.n == 162 + 642
    assert found["dimension"] == 162 + 200
    assert np.mean(found["span"]) < 0.1


def test_a_subspace_that_holds_the_exact_modes_has_no_error(measured, animal):
    case = Case(shape=animal, points=600)
    exact = eigensolve(case.laplacian(), 12)
    [found] = measured([given(lambda points: exact.eigenvectors)], [case])
    assert max(found["span"]) < 1e-12
    assert max(found["vector"]) < 1e-9
    assert np.nanmax(found["value"]) < 1e-9
    assert np.isnan(found["value"][0])


def test_joined_methods_are_no_worse_than_their_parts(measured, animal):
    parts = waves(60, 3.0), waves(80, 6.0)
    methods = [*parts, joined(parts)]
    *alone, both = (
        np.array(r["span"]) for r in measured(methods, [Case(shape=animal, points=800)])
    )
    assert (both <= np.minimum(*alone) + 1e-12).all()


def test_rotation_moves_the_points_and_nothing_else(measured, animal, tmp_path):
    case = Case(shape=animal, points=500)
    turned = dataclasses.replace(case, rotation=7)
    before = case.laplacian()
    after = turned.turned(before)
    assert abs(before.stiffness - after.stiffness).max() == 0
    distances = [np.linalg.norm(x.points - x.points[0], axis=1) for x in (before, after)]
    np.testing.assert_allclose(*distances, atol=1e-12)
    assert np.abs(before.points - after.points).max() > 0.1

    framed = waves(100, 4.0)  # in the canonical frame: the same in every rotation
    fixed = np.random.default_rng(0).normal(scale=4.0, size=(3, 100))
    posed = given(lambda points: np.sin(points @ fixed + 1))
    a, c, b, d = (np.array(r["span"]) for r in measured([framed, posed], [case, turned]))
    np.testing.assert_allclose(a, b, atol=1e-9)
    assert abs(c.mean() / d.mean() - 1) > 1e-3
    assert len(list(tmp_path.glob("files/exact-*"))) == 1  # one exact solve for all


def test_masses_of_one_matter_where_samples_crowd(measured, animal):
    methods = [SMALL, network("small", weighted=False)]
    cases = [Case(shape=animal, points=1000, sigma=sigma) for sigma in (None, 0.15)]
    spans = [np.mean(record["span"]) for record in measured(methods, cases)]
    loss = [spans[i + 1] / spans[i] for i in (0, 2)]
    assert loss[1] > max(loss[0], 1.05)


def test_procedural_shapes_are_those_of_the_corpus():
    shapes, again = (procedural_shapes(3, seed=11) for _ in range(2))
    assert [shape.digest for shape in shapes] == [shape.digest for shape in again]
    assert len({shape.digest for shape in shapes}) == 3
    config = CorpusConfig(seed=11, n_points=256, k=8)
    for index, shape in enumerate(shapes):
        labels = make_sample(config, index).labels
        assert shape.name == f"{list(FAMILIES)[labels['family']]} {index}"
        surface = repair(sample_mesh(config, labels)).geometry
        np.testing.assert_array_equal(shape.mesh.points, surface.points)


# --- what is remembered ---


def test_an_answer_is_remembered_and_an_interruption_loses_one_solve(measured, animal):
    cases = [Case(shape=animal, points=points) for points in (400, 500)]
    method, asked = waves(50, 3.0), []

    def interrupted(points, mass):
        asked.append(len(points))
        if len(points) == 500:
            raise KeyboardInterrupt
        return method.basis(points, mass)

    with pytest.raises(KeyboardInterrupt):
        measured([dataclasses.replace(method, basis=interrupted)], cases)
    first = measured([method], cases)
    assert measured([dataclasses.replace(method, basis=None)], cases) == first
    assert asked.count(400) == 1


def test_everything_that_decides_the_numbers_is_in_the_key(animal, tmp_path, monkeypatch):
    study = Accuracy(folder=tmp_path, contenders=[], problems=[], k=10)
    case = Case(shape=animal, points=400)
    changes = [{"points": 401}, {"sigma": 0.3}, {"operator": "knn"}, {"rotation": 0}, {"seed": 1}]
    others = [network("small", **o) for o in ({"poses": 2}, {"dtype": "bfloat16"})]
    others += [waves(257, 7.0), joined([SMALL, waves(9, 7.0)])]
    keys = [study.key(SMALL, case)]
    keys += [study.key(SMALL, dataclasses.replace(case, **change)) for change in changes]
    keys += [study.key(method, case) for method in others]
    keys.append(dataclasses.replace(study, k=11).key(SMALL, case))
    monkeypatch.setattr(torch, "get_num_threads", lambda: 99)  # seconds are kept
    keys.append(study.key(SMALL, case))
    assert len(set(keys)) == len(keys)


def test_a_failure_says_why(measured):
    flat = TriangleMesh(
        np.vstack([bumpy().points, [[9, 9, 9], [9, 9, 10], [9, 9, 11]]]),
        np.vstack([bumpy().faces, [[642, 643, 644]]]),
    )
    case = Case(shape=Shape("flat", flat), points=None, operator="cotan")
    [result] = measured([waves(50, 3.0)], [case])
    assert "faces of zero area" in result["reason"]
    ball = Case(shape=Shape("ball", bumpy()), points=500)
    [result] = measured([waves(5, 3.0)], [ball])
    assert "must span at least k = 10" in result["reason"]


def test_bad_requests(animal, tmp_path):
    with pytest.raises(InvalidInputError, match="`operator` must be one of"):
        Case(shape=animal, points=100, operator="graph")
    with pytest.raises(InvalidInputError, match="cotan needs a mesh, got 100 sampled points"):
        Case(shape=animal, points=100, operator="cotan")
    with pytest.raises(InvalidInputError, match="at least one shape and one network, got 0 and 1"):
        Settings(sets={"real": ()}, weights=("small",))
    with pytest.raises(InvalidInputError, match="`k` must be at least 1"):
        Settings(sets={"demo": (animal,)}, weights=("small",), k=0)
    with pytest.raises(InvalidInputError, match="`name` must be one of"):
        ask("beauty", Settings(sets={"demo": (animal,)}, weights=("small",)), Store(tmp_path))


# --- sums ---


def record(span, *, seconds=1.0, exact_seconds=100.0):
    times = {"seconds": seconds, "exact_seconds": exact_seconds}
    return {"span": span, "vector": [2 * x for x in span], "value": [np.nan, *span[1:]], **times}


def row(models, points, method, *spans, **seconds):
    case = Case(shape=Shape("ball", bumpy()), points=points)
    labels = {"models": models, "points": points, "solver": method.name}
    return Row(labels, method, (case,) * len(spans), tuple(record(s, **seconds) for s in spans))


def test_statistics_over_shapes_of_means_over_modes():
    r = row("real", 2048, waves(9, 1.0), [0, 0.2], [0, 0.4], [0, 0.6], [0, 2.0])
    np.testing.assert_allclose(r.means("span"), [0.1, 0.2, 0.3, 1.0])
    np.testing.assert_allclose(r.means("value"), [0.2, 0.4, 0.6, 2.0])  # without the kernel
    assert r.mean("vector") == pytest.approx(0.8)
    got = statistics(r.means("span"))
    assert got["mean"] == pytest.approx(0.4)
    assert got["median"] == pytest.approx(0.25)
    assert got["std"] == pytest.approx(np.sqrt(np.mean(np.square([0.3, 0.2, 0.1, 0.6]))))
    assert (got["q25"], got["q75"], got["iqr"]) == pytest.approx((0.175, 0.475, 0.3))


def test_lead_growth_and_goals():
    size = SMALL.columns
    rival, best = waves(size, 7.0), waves(640, 10.0)
    rows = [
        row("real", 8192, SMALL, [0, 0.01], seconds=2.0),
        row("real", 8192, rival, [0, 0.04], seconds=1.0),
        row("real", 8192, waves(size, 10.0), [0, 0.07], seconds=1.0),
        row("real", 8192, best, [0, 0.004], seconds=2.05),
        row("real", 65536, SMALL, [0, 0.02], seconds=20.0),
        row("procedural", 8192, SMALL, [0, 0.02]),
        row("procedural", 65536, SMALL, [0, 0.02]),
    ]
    elsewhere = Case(shape=Shape("plate", rectangle(n=100).geometry), points=8192)
    rows[5] = dataclasses.replace(  # a shape that is missing at 65,536 points does not count
        rows[5], cases=(*rows[5].cases, elsewhere), records=(*rows[5].records, record([0, 9.0]))
    )
    found = {finding.text: finding for finding in of_accuracy(rows)}
    error = found[f"real, 8,192 points, {SMALL}: mean span error"]
    assert error.value == pytest.approx(0.005)
    assert [goal.met(error.value) for goal in error.goals] == [True, True, False]
    lead = found[f"real, 8,192 points, {SMALL}: times less than {rival}"]
    assert lead.value == pytest.approx(4)
    assert [goal.met(lead.value) for goal in lead.goals] == [True, False]
    growth = found[f"real, 65,536 points, {SMALL}: times the error at 8,192"]
    assert (growth.value, growth.goals) == (pytest.approx(2), (Goal(1.5),))
    assert not growth.goals[0].met(growth.value)
    growth = found[f"procedural, 65,536 points, {SMALL}: times the error at 8,192"]
    assert (growth.value, growth.goals) == (pytest.approx(1), ())
    in_time = f"real, 8,192 points, best in the time of {SMALL}: {best}"
    assert found[in_time].value == pytest.approx(0.002)
    assert undominated(rows[:4]) == [rows[0], rows[1], rows[3]]


def test_arpack_wins_where_it_takes_less_time():
    rival = waves(640, 10.0)
    quick, slow = {"exact_seconds": 0.31}, {"exact_seconds": 3.0}
    rows = [
        row("real", 512, SMALL, [0, 0.01], seconds=0.6, **quick),
        row("real", 512, rival, [0, 0.004], seconds=0.2, **quick),
        row("real", 8192, SMALL, [0, 0.01], seconds=0.6, **slow),
        row("real", 8192, rival, [0, 0.004], seconds=0.5, **slow),
    ]
    found = {finding.text: finding.value for finding in of_accuracy(rows)}
    exact = "ARPACK is faster (0.31 s) and exact, span error"
    assert found[f"real, 512 points, best in the time of {SMALL} (0.60 s): {exact}"] == 0
    assert sum("ARPACK" in text for text in found) == 1
    best = f"real, 8,192 points, best in the time of {SMALL}: {rival}"
    assert found[best] == pytest.approx(0.002)
    assert undominated(rows) == [rows[1], rows[3]]


# --- questions and reports ---


@pytest.fixture(scope="module")
def settings(animal):
    return Settings(
        sets={"demo": (animal, Shape("plate", rectangle(n=900).geometry))},
        weights=("small",),
        k=10,
        points=(450, 600),  # room for one pose
        focus=600,
        poses=(1, 4),
        fourier=(60,),
        bandwidths=(4.0,),
        rotations=2,
    )


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return Store(tmp_path_factory.mktemp("store"))


@pytest.mark.parametrize("name", QUESTIONS)
def test_a_question_is_answered(name, settings, store, tmp_path):
    answer = ask(name, settings, store)
    assert all(row.cases for row in answer.rows)
    text = write_answer(answer, tmp_path)
    found = json.loads((tmp_path / f"{name}.json").read_text())
    assert text.startswith(f"## {QUESTIONS[name].title}")
    assert len(found["rows"]) == len(answer.rows)
    for line, r in zip(found["rows"], answer.rows, strict=True):
        assert line["span"]["mean"] == pytest.approx(r.mean())
        assert len(line["span"]["per_mode_quartiles"][1]) == 10
    assert found["figures"]
    assert all((tmp_path / figure).stat().st_size > 5000 for figure in found["figures"])
    assert all(f"]({figure})" in text for figure in found["figures"])
    assert write_summary(tmp_path, list(QUESTIONS)).read_text().count("## ") == 1
    if name == "accuracy":  # where there is no room for a method it is left out
        solved = {(row.labels["points"], row.labels["solver"]) for row in answer.rows}
        assert (450, "neo small, 1 pose") in solved
        assert (600, "neo small, 4 poses") not in solved  # 1,025 functions


@pytest.mark.parametrize("name", ["accuracy", "precision"])
def test_few_shapes_are_solved_where_it_takes_long(settings, name):
    large = dataclasses.replace(settings, points=(800, 65536), few=1)
    places = QUESTIONS[name].places(large)
    assert {(place["points"], len(cases)) for place, cases in places} == {(800, 2), (65536, 1)}


def test_the_report_lists_what_failed(settings, store, tmp_path, animal):
    few = dataclasses.replace(settings, sets={"demo": (animal,)}, points=(500,), fourier=(5,))
    text = write_answer(ask("accuracy", dataclasses.replace(few, poses=(1,)), store), tmp_path)
    assert "Could not be measured:" in text
    assert f"- {animal.name}: " in text
    assert "`basis` must span at least k = 10" in text


# --- training ---


@pytest.fixture
def trained(tmp_path):
    """Return a function that writes weights whose errors fall like a power of the samples."""

    def write_weights(name, exponent, samples=(100, 200, 400, 1600)):
        # A row between two validations has none.
        rows = [{"samples": n, "validation": 0.3 * (n / 100) ** exponent} for n in samples]
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        config = NeoConfig(width=18, depth=1, heads=1, head_width=18, latents=4, m=12, k=6)
        history = [*rows[:1], {"samples": 150}, *rows[1:]]
        save_weights(path, build_network(config), {"history": history})
        return str(path)

    return write_weights


def test_the_validations_of_training_are_tabled_and_drawn(trained, tmp_path):
    weights = [trained("slow.safetensors", -0.25), trained("fast/weights.safetensors", -0.75)]
    assert list(map(label, weights)) == ["slow", "fast"]
    text = write_training(weights, tmp_path / "out")
    slow, fast = json.loads((tmp_path / "out" / "training.json").read_text())["curves"]
    assert (slow["weights"], fast["weights"]) == ("slow", "fast")
    assert (slow["exponent"], fast["exponent"]) == (pytest.approx(-0.25), pytest.approx(-0.75))
    assert slow["samples"] == fast["samples"] == [100, 200, 400, 1600]
    np.testing.assert_allclose(slow["span_error"], 0.3 * np.array([1, 2, 4, 16]) ** -0.25)
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines()]
    assert ["slow", "12", "4", "100", "0.3", "1,600", "0.15", "0.15", "-0.25"] in cells
    assert ["fast", "12", "4", "100", "0.3", "1,600", "0.0375", "0.0375", "-0.75"] in cells
    assert (tmp_path / "out" / "figures" / "training-samples.png").stat().st_size > 5000
    short = training_curve(trained("short.safetensors", -1, samples=(100,)))
    assert np.isnan(short.exponent)  # one validation has no slope


def test_networks_without_validations_or_names_of_their_own_are_refused(trained, tmp_path, animal):
    silent = trained("silent.safetensors", -1, samples=())
    with pytest.raises(InvalidInputError, match=r"none in .*silent.safetensors; train with"):
        write_training([silent], tmp_path)
    twins = trained("a/x.safetensors", -1), trained("b/x.safetensors", -1)
    match = r"`weights` must have different names, got \['x', 'x'\]; rename"
    with pytest.raises(InvalidInputError, match=match):
        write_training(twins, tmp_path)
    with pytest.raises(InvalidInputError, match=match):
        Settings(sets={"demo": (animal,)}, weights=twins)


# --- the app ---


@pytest.fixture(scope="module")
def main():
    specification = importlib.util.spec_from_file_location("evaluate_neo", APP)
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module.main


def test_the_app_asks_one_question_and_continues(main, tmp_path, capsys):
    (tmp_path / "meshes").mkdir()
    write(bumpy(), tmp_path / "meshes" / "ball.ply")
    command = ["sampling", str(tmp_path / "out"), "--data", str(tmp_path / "meshes"), "-k", "8"]
    command += ["--procedural", "0", "--focus", "500"]
    assert main(command) == 0
    out, err = capsys.readouterr()
    assert "real, non-uniform, mass-aware: times the error on uniform samples" in out
    assert out.rstrip().endswith("report.md")
    assert err == ""
    measured = (tmp_path / "out" / "measurements.jsonl").read_text()
    assert len(measured.splitlines()) == 4
    assert main(command) == 0
    assert (tmp_path / "out" / "measurements.jsonl").read_text() == measured


@pytest.mark.slow
def test_a_quick_run_needs_no_data_and_draws_the_worst(tmp_path):
    environment = {**os.environ, "PYTHONPATH": str(APP.parents[1]), "OMP_NUM_THREADS": "1"}
    environment.pop("SPECTRA_KIT_DATA", None)
    done = subprocess.run(
        [sys.executable, str(APP), "worst", str(tmp_path), "--quick"],
        env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    sets = ["demo", "procedural"]
    rows = json.loads((tmp_path / "worst.json").read_text())["rows"]
    assert [row["models"] for row in rows] == sets
    if "are not drawn" not in done.stderr:
        assert all(list(tmp_path.glob(f"figures/worst-{name}-1-*.png")) for name in sets)


def test_the_app_shows_the_training_without_data(main, trained, tmp_path, capsys, monkeypatch):
    monkeypatch.delenv("SPECTRA_KIT_DATA", raising=False)
    out = tmp_path / "out"
    assert main(["training", str(out), "--procedural", "0"]) == 0
    assert "| small" in capsys.readouterr().out
    assert {p.name for p in out.iterdir()} == {
        "training.json", "training.md", "report.md", "figures",
    }  # fmt: skip
    weights = ["--weights", trained("silent.safetensors", -1, samples=())]
    assert main(["training", str(out), *weights]) == 2
    assert "error: `weights` must hold the validations" in capsys.readouterr().err
    monkeypatch.setitem(main.__globals__, "QUESTIONS", {})  # the other chapters take a while
    assert main(["all", str(out), "--quick", *weights]) == 0
    assert "training is not drawn: `weights` must hold the validations" in capsys.readouterr().err
    assert main(["worst", str(tmp_path), "--procedural", "0"]) == 2
    assert "error: `sets` and `weights` must hold at least one shape" in capsys.readouterr().err
