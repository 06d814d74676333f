"""The study of the network measures what the library does, remembers it, and does its sums."""

import dataclasses
import json

import numpy as np
import pytest
import torch
from conftest import bumpy, two_parts
from studies import run as command
from studies.network.accuracy import Accuracy
from studies.network.cases import Case
from studies.network.command import write_answer
from studies.network.findings import STEPS, Row, beside, lead, mean, over, worst
from studies.network.methods import joined, label, network, waves
from studies.network.questions import QUESTIONS, Settings, ask
from studies.network.training import training_curves, write_training
from studies.paper import errors_told
from studies.shapes import Shape, demo_shapes
from studies.store import Store
from studies.study import run

from spectra_kit import RayleighRitz, eigensolve
from spectra_kit.eigen.metrics import compare_spectra, subspace_span_error
from spectra_kit.eigen.subspaces import AmbientFourier
from spectra_kit.geometry import rectangle, write
from spectra_kit.neo import NeoConfig, build_network, save_weights

SMALL = network("small")


@pytest.fixture(scope="module")
def animal():
    return demo_shapes(1, 800)[0]


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """Return a function that writes weights whose errors fall like a power of the samples."""
    folder = tmp_path_factory.mktemp("weights")

    def write_weights(name, exponent, samples=(100, 200, 400, 1600)):
        # A row between two validations has none.
        rows = [
            {"samples": n, "seconds": 36 * n, "validation": 0.3 * ((n + 50) / 100) ** exponent}
            for n in samples
        ]
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        torch.manual_seed(0)
        config = NeoConfig(width=18, depth=1, heads=1, head_width=18, latents=4, m=12, k=6)
        history = [*rows[:1], {"samples": 150}, *rows[1:]]
        save_weights(path, build_network(config), {"history": history})
        return str(path)

    return write_weights


@pytest.fixture(scope="module")
def tiny(trained):
    """A small network that has learnt nothing."""
    return trained("tiny.safetensors", -0.5)


@pytest.fixture
def measured(tmp_path):
    """Return a function that measures every method on every case, in this process."""

    def measure(methods, cases, k=10):
        study = Accuracy(folder=tmp_path, contenders=methods, problems=cases, k=k)
        return [result.record for result in run(study, Store(tmp_path), jobs=0, retry=True)]

    return measure


# --- what is measured ---


def test_what_the_solver_finds_is_found(measured):
    case = Case(shape=Shape("it", two_parts()), points=700, seed=4)
    laplacian, subspace = case.laplacian(), AmbientFourier(m=80, bandwidth=4.0)
    exact, predicted = (
        eigensolve(laplacian, 10, *solver) for solver in ((), (RayleighRitz(subspace=subspace),))
    )
    span, dimension = subspace_span_error(subspace, laplacian, exact, predicted)
    comparison = compare_spectra(exact, predicted)

    [found] = measured([waves(80, 4.0)], [case])
    np.testing.assert_allclose(found["span"], span, rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(found["vector"], comparison.vector_error, rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(found["value"], comparison.eigenvalue_error, rtol=1e-4, atol=1e-9)
    assert found["dimension"] == dimension
    assert 0 < found["seconds"] < 60


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
    a, b = (np.array(r["span"]) for r in measured([framed], [case, turned]))
    np.testing.assert_allclose(a, b, atol=1e-9)
    assert len(list(tmp_path.glob("files/exact-*"))) == 1  # one exact solve for all


# --- what is remembered ---


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


# --- sums ---


def record(span, *, seconds=1.0, exact_seconds=100.0):
    times = {"seconds": seconds, "exact_seconds": exact_seconds}
    return {"span": span, "vector": [2 * x for x in span], "value": [np.nan, *span[1:]], **times}


def row(models, points, method, *spans, **seconds):
    case = Case(shape=Shape("ball", bumpy()), points=points)
    labels = {"models": models, "points": points, "solver": method.name}
    return Row(labels, method, (case,) * len(spans), tuple(record(s, **seconds) for s in spans))


def test_lead_and_growth():
    size = SMALL.columns
    rows = [
        row("real", 8192, SMALL, [0, 0.01]),
        row("real", 8192, waves(size, 7.0), [0, 0.04]),
        row("real", 8192, waves(size, 10.0), [0, 0.07]),
        row("real", 8192, waves(640, 10.0), [0, 0.004]),
        row("real", 65536, SMALL, [0, 0.02]),
        row("procedural", 8192, SMALL, [0, 0.02]),
        row("procedural", 65536, SMALL, [0, 0.02]),
    ]
    elsewhere = Case(shape=Shape("plate", rectangle(n=100).geometry), points=8192)
    rows[5] = dataclasses.replace(  # a shape that is missing at 65,536 points does not count
        rows[5], cases=(*rows[5].cases, elsewhere), records=(*rows[5].records, record([0, 9.0]))
    )
    assert rows[0].mean() == pytest.approx(0.005)
    assert lead(rows[0], rows) == pytest.approx(4)
    assert lead(rows[1], rows) is lead(rows[4], rows) is None
    assert over(rows[4], rows, points=8192) == pytest.approx(2)
    assert over(rows[6], rows, points=8192) == pytest.approx(1)
    assert over(rows[0], rows, points=8192) is over(rows[0], rows, points=1) is None


def test_neo_is_set_beside_waves_that_are_smoothed_alike():
    ball, plate = Shape("ball", bumpy()), Shape("plate", rectangle(n=100).geometry)
    cases = tuple(Case(shape=shape, points=None) for shape in (ball, plate))

    def of(method, steps, *values):
        labels = {"models": "real", "steps": steps}
        records = tuple(record([0, value]) for value in values)
        return Row(labels, method, cases[: len(values)], records)

    some = (0.5, 0.5), (0.02, 0.04), (1e-4, 2e-4)
    rows = [of(SMALL, n, *values) for n, values in zip(STEPS, some, strict=True)]
    for bandwidth, worse in ((7.0, 1), (10.0, 3)):  # of which the better is the rival
        method = waves(SMALL.columns, bandwidth)
        rows.append(of(method, 0, *[0.6 * worse] * 2))
        rows.append(of(method, 1, 0.04 * worse, 0.72 * worse))  # 2 and 18 times, 6 in the mean
        rows.append(of(method, STEPS[-1], 1e-4 * worse, 1e-4 * worse))
    [found] = beside(rows)
    assert list(found.worst_first) == [1, 0]
    np.testing.assert_allclose(found.columns["ratio after one step"], [2, 18])
    np.testing.assert_allclose(found.columns["ratio"], [1, 0.5])
    ratio = "ratio after one step"
    assert mean(ratio, found.columns[ratio]) == pytest.approx(6)
    assert worst(ratio, found.columns[ratio]) == pytest.approx(2)
    before = "span error before"
    assert mean(before, found.columns[before]) == pytest.approx(0.25)
    assert worst(before, found.columns[before]) == pytest.approx(0.25)
    rows[0] = of(SMALL, 0, 0.5)  # only what all were measured on
    assert [case.shape.name for one in beside(rows) for case in one.cases] == ["ball"]
    assert list(beside(rows[1:])) == []


# --- questions and reports ---


@pytest.fixture(scope="module")
def settings(tiny):
    ball = Shape("ball", bumpy())
    return Settings(
        sets={"demo": (ball, Shape("plate", rectangle(n=300).geometry))},
        weights=(tiny,),
        k=6,
        points=(110, 150),
        focus=150,
        poses=(1, 4),
        fourier=(80,),
        bandwidths=(4.0,),
        rotations=2,
    )


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return Store(tmp_path_factory.mktemp("store"))


@pytest.mark.parametrize("name", [name for name in QUESTIONS if name != "models"])
def test_a_question_is_answered(name, settings, store, tmp_path):
    answer = ask(name, settings, store)
    assert all(row.cases for row in answer.rows)
    write_answer(answer, tmp_path)
    tables = json.loads((tmp_path / f"{name}.json").read_text())["tables"]
    found = tables[QUESTIONS[name].title]
    for line, r in zip(found, answer.rows, strict=True):
        key = "mean span error" if name == "rotation" else "span error, mean"
        assert line[key] == pytest.approx(r.mean())
    if name == "accuracy":  # where there is no room for a method it is left out
        solved = {(row.labels["points"], row.labels["solver"]) for row in answer.rows}
        assert (150, "fourier m=80, bandwidth 4") in solved
        assert (110, "fourier m=80, bandwidth 4") not in solved
    if name == "sampling":
        crowded = {"models": "real", "sampling": "non-uniform", "attention": "mass-aware"}
        told = [errors_told(name, {**crowded, "models": of}) for of in ("real", "procedural")]
        assert told[0].span == 2.63e-3
        assert told[1] is None


# --- training ---


def test_the_validations_of_training_are_tabled_and_drawn(trained, tmp_path, capsys):
    weights = [trained("slow.safetensors", -0.25), trained("fast/weights.safetensors", -0.75)]
    write_training(weights, tmp_path)
    [table] = json.loads((tmp_path / "training.json").read_text())["tables"].values()
    slow, fast = table
    assert (slow["weights"], fast["weights"]) == ("slow", "fast") == tuple(map(label, weights))
    for row, p in ((slow, 0.25), (fast, 0.75)):
        assert row["p"] == pytest.approx(p, rel=0.01)
        assert row["s0"] == pytest.approx(50, rel=0.1)
        assert row["promise"] == pytest.approx((16050 / 1650) ** p, rel=0.01)
    assert slow["curve"]["samples"] == fast["curve"]["samples"] == [100, 200, 400, 1600]
    assert slow["curve"]["hours"] == pytest.approx([1, 2, 4, 16])
    expected = 0.3 * np.array([1.5, 2.5, 4.5, 16.5]) ** -0.25
    np.testing.assert_allclose(slow["curve"]["errors"], expected)
    assert (tmp_path / "figures" / "training-hours.png").stat().st_size > 5000
    [short] = training_curves(trained("short.safetensors", -1, samples=(100,)))
    assert short.law is None  # one validation has no slope
    [rising] = training_curves(trained("rising.safetensors", 1))
    assert np.isnan(rising.promise)
    before, after = training_curves("small")
    assert before.errors[-1] > after.errors[-1]
    silent = ["--weights", trained("silent.safetensors", -1, samples=())]
    assert command.main(["network", str(tmp_path), "training", *silent]) == 2
    assert "error: `weights` must hold the validations" in capsys.readouterr().err


# --- the command ---


def test_the_command_asks_one_question_draws_the_worst_and_continues(tiny, tmp_path, capsys):
    (tmp_path / "meshes").mkdir()
    write(bumpy(), tmp_path / "meshes" / "ball.ply")
    out = tmp_path / "out"
    words = ["network", str(out), "models", "--data", str(tmp_path / "meshes"), "-k", "6"]
    words += ["--procedural", "0", "--focus", "200", "--weights", tiny]
    assert command.main(words) == 0
    said, err = capsys.readouterr()
    assert "](figures/worst-real-1-ball.png)" in said
    assert (out / "figures" / "worst-real-1-ball.png").stat().st_size > 5000
    assert err == ""
    measured = (out / "measurements.jsonl").read_text()
    assert len(measured.splitlines()) == 18  # the network and two bandwidths, smoothed thrice
    assert command.main([*words, "--worst", "0"]) == 0
    assert (out / "measurements.jsonl").read_text() == measured
