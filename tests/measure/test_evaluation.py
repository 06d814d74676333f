"""The bench measures what the library does, remembers it, and the studies do their sums right."""

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

from spectra_kit import Neo, RayleighRitz, TriangleMesh, eigensolve
from spectra_kit.errors import InvalidInputError
from spectra_kit.evaluation import (
    STUDIES,
    Bench,
    Case,
    Failure,
    Measurement,
    Model,
    Settings,
    Weights,
    demo_models,
    figures,
    fourier,
    joined,
    models_in,
    neo,
    procedural_models,
    run_study,
    training_curve,
    write_report,
    write_summary,
    write_training,
)
from spectra_kit.evaluation.findings import Goal, Row, accuracy_findings, undominated
from spectra_kit.evaluation.report import number, statistics
from spectra_kit.geometry import rectangle, repair, sample, sphere, write
from spectra_kit.metrics import compare_spectra, subspace_span_error
from spectra_kit.neo import NeoConfig, build_network, save_weights
from spectra_kit.training.corpus import CorpusConfig, make_sample
from spectra_kit.training.families import FAMILIES
from spectra_kit.training.samples import sample_mesh

APP = Path(__file__).parents[2] / "apps" / "evaluate_neo.py"
SMALL = Weights("small")


@pytest.fixture(autouse=True)
def coarse_figures(monkeypatch):
    """Draw what nobody will look at with few pixels."""
    monkeypatch.setattr(figures, "_DPI", 60)


@pytest.fixture
def bench(tmp_path):
    return Bench(tmp_path / "bench", k=10)


@pytest.fixture(scope="module")
def animal():
    return demo_models()[0]


# --- what is measured ---


@pytest.mark.parametrize("mesh", [bumpy(2562), two_parts()], ids=["one part", "two parts"])
@pytest.mark.parametrize("method", [fourier(120, 5.0), neo(SMALL)], ids=lambda m: m.name)
def test_the_bench_finds_what_the_solvers_find(bench, mesh, method):
    case = Case(model=Model("it", mesh), points=1500, seed=4)
    laplacian = case.laplacian()
    subspace = method.subspace
    solver = Neo() if method.poses else RayleighRitz(subspace=subspace)
    exact, predicted = (eigensolve(laplacian, 10, *s) for s in ((), (solver,)))
    span, dimension = subspace_span_error(subspace, laplacian, exact, predicted)
    comparison = compare_spectra(exact, predicted)

    [found] = bench.run([(case, method)])
    np.testing.assert_allclose(found.span, span, rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(found.vector, comparison.vector_error, rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(found.value, comparison.eigenvalue_error, rtol=1e-4, atol=1e-9)
    assert found.dimension == dimension
    assert found.mean("value") == pytest.approx(comparison.mean_eigenvalue_error, rel=1e-4)
    assert 0 < found.seconds < 60


def test_what_is_timed_is_what_the_solver_does(bench, animal):
    case = Case(model=animal, points=1200)
    solved = eigensolve(case.laplacian(), 10, Neo())
    timed, _ = bench.compare(case, neo(SMALL))[1:]
    np.testing.assert_array_equal(timed.eigenvalues, solved.eigenvalues)
    np.testing.assert_array_equal(timed.eigenvectors, solved.eigenvectors)
    stages = [dict(s.provenance.seconds) for s in (timed, solved)]
    assert stages[0].keys() - {"subspace"} == stages[1].keys() - {"frame", "forward"}


def test_seconds_of_other_threads_are_others(bench, animal, monkeypatch):
    pair = Case(model=animal, points=400), fourier(50, 3.0)
    bench.run([pair])
    monkeypatch.setattr(torch, "get_num_threads", lambda: 99)
    bench.run([pair])
    assert len(list((bench.folder / "measurements").iterdir())) == 2


def test_a_component_without_room_for_the_subspace_is_exact(bench):
    # The smaller part holds fewer points than the subspace has functions.
    case = Case(model=Model("two", two_parts()), points=None)
    [found] = bench.run([(case, fourier(200, 5.0))])
    assert case.n == 162 + 642
    assert found.dimension == 162 + 200
    assert found.mean("span") < 0.1


def test_a_subspace_that_holds_the_exact_modes_has_no_error(bench, animal):
    case = Case(model=animal, points=600)
    exact = eigensolve(case.laplacian(), 12)
    perfect = dataclasses.replace(
        fourier(12, 1.0), subspace=lambda points, mass: exact.eigenvectors, key={"perfect": True}
    )
    [found] = bench.run([(case, perfect)])
    assert found.span.max() < 1e-12
    assert found.vector.max() < 1e-9
    assert np.nanmax(found.value) < 1e-9
    assert np.isnan(found.value[0])


def test_a_union_is_no_worse_than_its_parts(bench, animal):
    parts = [fourier(60, 3.0), fourier(80, 6.0)]
    case = Case(model=animal, points=800)
    *alone, both = bench.run([(case, method) for method in [*parts, joined(parts)]])
    assert (both.span <= np.minimum(*(m.span for m in alone)) + 1e-12).all()


def test_rotation_moves_the_points_and_nothing_else(bench, animal):
    case = Case(model=animal, points=500)
    turned = dataclasses.replace(case, rotation=7)
    before, after = case.laplacian(), turned.laplacian()
    assert abs(before.stiffness - after.stiffness).max() == 0
    distances = [np.linalg.norm(x.points - x.points[0], axis=1) for x in (before, after)]
    np.testing.assert_allclose(*distances, atol=1e-12)
    assert np.abs(before.points - after.points).max() > 0.1

    framed = fourier(100, 4.0)  # in the canonical frame: the same basis in every rotation
    fixed = np.random.default_rng(0).normal(scale=4.0, size=(3, 100))
    posed = dataclasses.replace(
        framed, subspace=lambda points, mass: np.sin(points @ fixed + 1), key={"posed": 1}
    )
    a, b, c, d = bench.run([(x, m) for m in (framed, posed) for x in (case, turned)])
    np.testing.assert_allclose(a.span, b.span, atol=1e-9)
    assert abs(c.mean("span") / d.mean("span") - 1) > 1e-3
    assert len(list((bench.folder / "exact").iterdir())) == 1  # one exact solve for all


def test_masses_of_one_matter_where_samples_crowd(bench, animal):
    aware, blind = neo(SMALL), neo(SMALL, weighted=False)
    even, crowded = (Case(model=animal, points=1000, sigma=sigma) for sigma in (None, 0.15))
    results = bench.run([(case, method) for case in (even, crowded) for method in (aware, blind)])
    loss = [results[i + 1].mean("span") / results[i].mean("span") for i in (0, 2)]
    assert loss[1] > loss[0]
    assert loss[1] > 1.05


def test_procedural_models_are_those_of_the_corpus():
    models = procedural_models(3, seed=11)
    again = procedural_models(3, seed=11)
    assert [m.digest for m in models] == [m.digest for m in again]
    assert len({m.digest for m in models}) == 3
    config = CorpusConfig(seed=11, n_points=256, k=8)
    for index, model in enumerate(models):
        labels = make_sample(config, index).labels
        assert model.name == f"{list(FAMILIES)[labels['family']]} {index}"
        surface = repair(sample_mesh(config, labels)).geometry
        np.testing.assert_array_equal(model.mesh.points, surface.points)


# --- what is remembered ---


def test_an_answer_is_remembered(bench, animal, tmp_path):
    case, method = Case(model=animal, points=400), fourier(50, 3.0)
    [first] = bench.run([(case, method)])

    def never(points, mass):
        raise AssertionError("computed again")

    same = dataclasses.replace(method, subspace=never)
    [second] = Bench(tmp_path / "bench", k=10).run([(case, same)])
    np.testing.assert_array_equal(first.span, second.span)
    np.testing.assert_array_equal(first.value, second.value)
    assert first.seconds == second.seconds


@pytest.mark.parametrize(
    "change",
    [{"points": 401}, {"sigma": 0.3}, {"operator": "knn"}, {"rotation": 0}, {"seed": 1}],
    ids=str,
)
def test_another_case_is_another_answer(animal, change):
    case = Case(model=animal, points=400)
    assert dataclasses.replace(case, **change).key() != case.key()


def test_the_network_and_its_options_decide_the_key():
    keys = [neo(SMALL, **o).key for o in ({}, {"poses": 2}, {"dtype": "bfloat16"})]
    keys.append(neo(SMALL, weighted=False).key)
    assert len({json.dumps(key) for key in keys}) == 4
    assert keys[0]["neo"] == SMALL.sha256


def test_an_interruption_loses_one_solve(bench, animal):
    case = Case(model=animal, points=400)
    good = fourier(50, 3.0)

    def interrupted(points, mass):
        raise KeyboardInterrupt

    bad = dataclasses.replace(good, subspace=interrupted, key={"bad": 1})
    with pytest.raises(KeyboardInterrupt):
        bench.run([(case, good), (case, bad)])
    assert len(list((bench.folder / "measurements").iterdir())) == 1
    assert not list(bench.folder.rglob(".*"))


def test_a_failure_says_why_and_is_not_remembered(bench, tmp_path):
    flat = TriangleMesh(
        np.vstack([bumpy().points, [[9, 9, 9], [9, 9, 10], [9, 9, 11]]]),
        np.vstack([bumpy().faces, [[642, 643, 644]]]),
    )
    case = Case(model=Model("flat", flat), points=None, operator="cotan")
    [result] = bench.run([(case, fourier(50, 3.0))])
    assert isinstance(result, Failure)
    assert "faces of zero area" in result.reason
    thin = dataclasses.replace(fourier(5, 3.0), key={"thin": 1})
    [result] = bench.run([(Case(model=Model("ball", bumpy()), points=500), thin)])
    assert "must span at least k = 10" in result.reason
    assert not list((bench.folder / "measurements").iterdir())


def test_a_damaged_file_is_told(bench, animal):
    pair = Case(model=animal, points=400), fourier(50, 3.0)
    bench.run([pair])
    [path] = (bench.folder / "measurements").iterdir()
    path.write_text("{}")
    with pytest.raises(InvalidInputError, match=r"is not a whole measurement.*delete it"):
        bench.run([pair])


# --- what is refused ---


def test_bad_requests(animal, tmp_path, bench):
    with pytest.raises(InvalidInputError, match="`operator` must be one of"):
        Case(model=animal, points=100, operator="graph")
    with pytest.raises(InvalidInputError, match="cotan needs a mesh, got 100 sampled points"):
        Case(model=animal, points=100, operator="cotan")
    with pytest.raises(InvalidInputError, match=r"`folder` must hold meshes .* found none"):
        models_in(tmp_path)
    write(sample(sphere().geometry, 100, seed=0), tmp_path / "cloud.xyz")
    with pytest.raises(InvalidInputError, match=r"cloud.xyz: .*expected a mesh"):
        models_in(tmp_path)
    with pytest.raises(InvalidInputError, match="at least one model and one network, got 0 and 1"):
        Settings(sets={"real": ()}, weights=(SMALL,))
    settings = Settings(sets={"demo": (animal,)}, weights=(SMALL,))
    with pytest.raises(InvalidInputError, match="`name` must be one of"):
        run_study("beauty", settings, bench)
    with pytest.raises(InvalidInputError, match="`k` must be at least 1"):
        Bench(tmp_path, k=0)


# --- sums ---


def measurement(span, *, seconds=1.0, exact_seconds=100.0):
    span = np.asarray(span, dtype=float)
    value = np.r_[np.nan, span[1:]]
    return Measurement(
        n=100, dimension=9, span=span, vector=2 * span, value=value, seconds=seconds,
        exact_seconds=exact_seconds,
    )  # fmt: skip


def row(models, points, method, *spans, **seconds):
    model = Model("ball", bumpy())
    cases = tuple(
        (Case(model=model, points=points), measurement(span, **seconds)) for span in spans
    )
    return Row({"models": models, "points": points, "solver": method.name}, method, cases)


def test_statistics_over_models_of_means_over_modes():
    r = row("real", 2048, fourier(9, 1.0), [0, 0.2], [0, 0.4], [0, 0.6], [0, 2.0])
    np.testing.assert_allclose(r.means("span"), [0.1, 0.2, 0.3, 1.0])
    np.testing.assert_allclose(r.means("value"), [0.2, 0.4, 0.6, 2.0])  # without the kernel
    assert r.mean("vector") == pytest.approx(0.8)
    got = statistics(r.means("span"))
    assert got["mean"] == pytest.approx(0.4)
    assert got["median"] == pytest.approx(0.25)
    assert got["std"] == pytest.approx(np.sqrt(np.mean(np.square([0.3, 0.2, 0.1, 0.6]))))
    assert (got["q25"], got["q75"], got["iqr"]) == pytest.approx((0.175, 0.475, 0.3))


def test_lead_growth_and_goals():
    network = neo(SMALL)
    size = network.columns
    rows = [
        row("real", 8192, network, [0, 0.01], seconds=2.0),
        row("real", 8192, fourier(size, 7.0), [0, 0.04], seconds=1.0),
        row("real", 8192, fourier(size, 10.0), [0, 0.07], seconds=1.0),
        row("real", 8192, fourier(640, 10.0), [0, 0.004], seconds=2.05),
        row("real", 65536, network, [0, 0.02], seconds=20.0),
        row("procedural", 8192, network, [0, 0.02]),
        row("procedural", 65536, network, [0, 0.02]),
    ]
    elsewhere = (Case(model=Model("plate", rectangle(n=100).geometry), points=8192),)
    rows[5] = dataclasses.replace(  # a model that is missing at 65,536 points does not count
        rows[5], measured=(*rows[5].measured, (*elsewhere, measurement([0, 9.0])))
    )
    found = {finding.text: finding for finding in accuracy_findings(rows)}
    error = found["real, 8,192 points, neo small, 1 pose: mean span error"]
    assert error.value == pytest.approx(0.005)
    assert [goal.met(error.value) for goal in error.goals] == [True, True, False]
    lead = found[
        f"real, 8,192 points, neo small, 1 pose: times less than fourier m={size}, bandwidth 7"
    ]
    assert lead.value == pytest.approx(4)
    assert [goal.met(lead.value) for goal in lead.goals] == [True, False]
    growth = found["real, 65,536 points, neo small, 1 pose: times the error at 8,192"]
    assert growth.value == pytest.approx(2)
    assert growth.goals == (Goal(1.5),)
    assert not growth.goals[0].met(growth.value)
    growth = found["procedural, 65,536 points, neo small, 1 pose: times the error at 8,192"]
    assert (growth.value, growth.goals) == (pytest.approx(1), ())
    best = "real, 8,192 points, best in the time of neo small, 1 pose: fourier m=640, bandwidth 10"
    assert found[best].value == pytest.approx(0.002)
    assert undominated(rows[:4]) == [rows[0], rows[1], rows[3]]


def test_arpack_wins_where_it_takes_less_time():
    network, waves = neo(SMALL), fourier(640, 10.0)
    quick, slow = {"exact_seconds": 0.31}, {"exact_seconds": 3.0}
    rows = [
        row("real", 512, network, [0, 0.01], seconds=0.6, **quick),
        row("real", 512, waves, [0, 0.004], seconds=0.2, **quick),
        row("real", 8192, network, [0, 0.01], seconds=0.6, **slow),
        row("real", 8192, waves, [0, 0.004], seconds=0.5, **slow),
    ]
    found = {finding.text: finding.value for finding in accuracy_findings(rows)}
    exact = "ARPACK is faster (0.31 s) and exact, span error"
    assert found[f"real, 512 points, best in the time of neo small, 1 pose (0.60 s): {exact}"] == 0
    assert sum("ARPACK" in text for text in found) == 1
    best = f"real, 8,192 points, best in the time of neo small, 1 pose: {waves.name}"
    assert found[best] == pytest.approx(0.002)
    assert undominated(rows) == [rows[1], rows[3]]


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (0.00881, "8.81e-3"), (0.105, "0.105"), (12.34, "12.3"), (4e-12, "4.00e-12")],
)
def test_numbers_are_short(value, text):
    assert number(value) == text


# --- studies and reports ---


@pytest.fixture(scope="module")
def settings(animal):
    return Settings(
        sets={"demo": (animal, Model("plate", rectangle(n=900).geometry))},
        weights=(SMALL,),
        points=(500, 800),  # room for one pose
        focus=800,
        poses=(1, 4),
        fourier=(60,),
        bandwidths=(4.0,),
        rotations=2,
    )


@pytest.fixture(scope="module")
def shared_bench(tmp_path_factory):
    return Bench(tmp_path_factory.mktemp("bench"), k=10)


@pytest.mark.parametrize("name", STUDIES)
def test_a_study_is_reported(name, settings, shared_bench, tmp_path):
    answer = run_study(name, settings, shared_bench)
    assert all(row.measured for row in answer.rows)
    path = write_report(answer, tmp_path)
    text, record = path.read_text(), json.loads((tmp_path / f"{name}.json").read_text())
    assert text.startswith(f"## {STUDIES[name].title}")
    table = [line for line in text.splitlines() if line.startswith("|")]
    assert len({line.count("|") for line in table}) == 1
    assert len(record["rows"]) == len(answer.rows)
    assert "NaN" not in (tmp_path / f"{name}.json").read_text()
    for line, r in zip(record["rows"], answer.rows, strict=True):
        assert line["span"]["mean"] == pytest.approx(r.mean())
        assert len(line["span"]["per_mode_quartiles"][1]) == 10
    assert record["figures"]
    assert all((tmp_path / figure).stat().st_size > 5000 for figure in record["figures"])
    assert all(f"]({figure})" in text for figure in record["figures"])
    chapters = write_summary(tmp_path, list(STUDIES)).read_text()
    assert chapters.count("## ") == 1


def test_methods_without_room_are_left_out(settings, shared_bench):
    answer = run_study("accuracy", settings, shared_bench)
    measured = {(row.labels["points"], row.labels["solver"]) for row in answer.rows}
    assert (500, "neo small, 1 pose") in measured
    assert (800, "neo small, 4 poses") not in measured  # 1,025 functions


def test_few_models_are_solved_where_it_takes_long(settings):
    large = dataclasses.replace(settings, points=(800, 65536), few=1)
    for name in ("accuracy", "precision"):
        lines = STUDIES[name].plan(large)
        sizes = {(line.labels["points"], len(line.cases)) for line in lines}
        assert sizes == {(800, 2), (65536, 1)}


def test_the_report_lists_what_failed(shared_bench, tmp_path, animal):
    pinched = Settings(sets={"demo": (animal,)}, weights=(SMALL,), points=(500,), fourier=(5,))
    answer = run_study("accuracy", dataclasses.replace(pinched, poses=(1,)), shared_bench)
    text = write_report(answer, tmp_path).read_text()
    assert "Could not be measured:" in text
    assert f"- {animal.name}: `basis` must span at least k = 10" in text


# --- training ---


@pytest.fixture
def trained(tmp_path):
    """Return a function that writes weights whose errors fall like a power of the samples."""

    def write_weights(name, exponent, samples=(100, 200, 400, 1600)):
        # A row between two validations has none.
        rows = [{"samples": n, "validation": 0.3 * (n / 100) ** exponent} for n in samples]
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        network = build_network(
            NeoConfig(width=18, depth=1, heads=1, head_width=18, latents=4, m=12, k=6)
        )
        save_weights(path, network, {"history": [*rows[:1], {"samples": 150}, *rows[1:]]})
        return Weights(path)

    return write_weights


def test_the_validations_of_training_are_tabled_and_drawn(trained, tmp_path):
    weights = [trained("slow.safetensors", -0.25), trained("fast/weights.safetensors", -0.75)]
    path = write_training(weights, tmp_path / "out")
    slow, fast = json.loads((tmp_path / "out" / "training.json").read_text())["curves"]
    assert (slow["weights"], fast["weights"]) == ("slow", "fast")
    assert (slow["exponent"], fast["exponent"]) == (pytest.approx(-0.25), pytest.approx(-0.75))
    assert slow["samples"] == fast["samples"] == [100, 200, 400, 1600]
    np.testing.assert_allclose(slow["span_error"], 0.3 * np.array([1, 2, 4, 16]) ** -0.25)
    text = path.read_text()
    assert "| slow | 12 | 4 | 100 | 0.3 | 1,600 | 0.15 | 0.15 | -0.25 |" in text
    assert "| fast | 12 | 4 | 100 | 0.3 | 1,600 | 3.75e-2 | 3.75e-2 | -0.75 |" in text
    assert "](figures/training-samples.png)" in text
    assert (tmp_path / "out" / "figures" / "training-samples.png").stat().st_size > 5000


def test_validations_are_drawn_on_logarithmic_axes(trained, tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(figures, "_save", lambda figure, path: drawn.append(figure) or path)
    curves = [training_curve(trained(f"{i}.safetensors", -0.1 * i)) for i in range(1, 11)]
    figures.draw_curves(curves, tmp_path)
    [panel] = drawn[0].axes
    assert (panel.get_xscale(), panel.get_yscale()) == ("log", "log")
    for line, curve in zip(panel.lines, curves, strict=True):
        np.testing.assert_array_equal(line.get_xydata(), np.c_[curve.samples, curve.errors])


def test_one_validation_has_no_slope(trained, tmp_path):
    path = write_training([trained("short.safetensors", -1, samples=(100,))], tmp_path)
    assert "| 100 | 0.3 | 100 | 0.3 | 0.3 |  |" in path.read_text()
    assert json.loads((tmp_path / "training.json").read_text())["curves"][0]["exponent"] is None


def test_networks_without_validations_or_names_of_their_own_are_refused(trained, tmp_path, animal):
    silent = trained("silent.safetensors", -1, samples=())
    with pytest.raises(InvalidInputError, match=r"found none in .*silent.safetensors; train with"):
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


def test_the_app_runs_one_study_and_continues(main, tmp_path, capsys):
    (tmp_path / "meshes").mkdir()
    write(bumpy(), tmp_path / "meshes" / "ball.ply")
    command = ["sampling", str(tmp_path / "out"), "--data", str(tmp_path / "meshes"), "-k", "8"]
    command += ["--procedural", "0", "--focus", "500"]
    assert main(command) == 0
    out, err = capsys.readouterr()
    assert "real, non-uniform, mass-aware: times the error on uniform samples" in out
    assert out.rstrip().endswith("report.md")
    assert err == ""
    measured = {p: p.stat().st_mtime_ns for p in (tmp_path / "out").rglob("measurements/*")}
    assert len(measured) == 4
    assert main(command) == 0
    assert {p: p.stat().st_mtime_ns for p in measured} == measured


@pytest.mark.slow
def test_a_quick_run_of_everything_needs_no_data(main, tmp_path, capsys, monkeypatch):
    monkeypatch.delenv("SPECTRA_KIT_DATA", raising=False)
    # The demo alone; a procedural model goes through the app in a tree, below.
    monkeypatch.setitem(main.__globals__["_QUICK"], "procedural", 0)
    assert main(["all", str(tmp_path), "--quick"]) == 0
    text = (tmp_path / "report.md").read_text()
    assert all(f"## {study.title}" in text for study in STUDIES.values())
    assert "## Validation error against samples seen" in text


def test_the_app_shows_the_training_without_data(main, tmp_path, capsys, monkeypatch):
    monkeypatch.delenv("SPECTRA_KIT_DATA", raising=False)
    assert main(["training", str(tmp_path), "--procedural", "0"]) == 0
    assert "| small | " in capsys.readouterr().out
    assert {p.name for p in tmp_path.iterdir()} == {
        "training.json", "training.md", "report.md", "figures",
    }  # fmt: skip


def test_weights_without_validations_leave_out_one_chapter(
    main, trained, tmp_path, capsys, monkeypatch
):
    monkeypatch.setitem(main.__globals__, "STUDIES", {})  # the other chapters take a while
    weights = str(trained("silent.safetensors", -1, samples=()).source)
    reason = ": `weights` must hold the validations of their training, found none in"
    assert main(["training", str(tmp_path), "--weights", weights]) == 2
    assert f"error{reason}" in capsys.readouterr().err
    assert main(["all", str(tmp_path), "--quick", "--weights", weights]) == 0
    assert f"training is not drawn{reason}" in capsys.readouterr().err


@pytest.mark.slow
def test_the_app_runs_from_a_tree_that_is_not_installed(tmp_path):
    banned = ["potpourri3d", "pyvista", "trimesh"]  # nor are these needed
    code = (
        "import sys, runpy\n"
        "from importlib import metadata\n"
        "def never(name): raise metadata.PackageNotFoundError(name)\n"
        "metadata.version = never\n"
        f"sys.modules.update(dict.fromkeys({banned}))\n"
        f"sys.argv = ['evaluate_neo.py', 'sampling', {str(tmp_path)!r}, '--quick']\n"
        f"runpy.run_path({str(APP)!r}, run_name='__main__')"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": str(APP.parents[1]), "OMP_NUM_THREADS": "1"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "report:" in done.stdout


def test_the_app_says_what_is_wrong(main, tmp_path, capsys, monkeypatch):
    monkeypatch.delenv("SPECTRA_KIT_DATA", raising=False)
    assert main(["worst", str(tmp_path), "--procedural", "0"]) == 2
    assert "error: `sets` and `weights` must hold at least one model" in capsys.readouterr().err
