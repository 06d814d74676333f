"""The study of distances end to end on a mesh of our own, and what its tables say."""

import dataclasses
import json

import numpy as np
import pytest
from conftest import creature
from studies import run as command
from studies import store
from studies.geodesics import command as app
from studies.geodesics import contenders as who
from studies.geodesics.distances import (
    EIGENSOLVERS,
    Accuracy,
    Exact,
    Modes,
    Times,
    relative_errors,
)
from studies.shapes import Shape, shape_at
from studies.store import Store
from studies.study import Result, run

from spectra_kit import Neo
from spectra_kit.geodesics import HeatGeodesics, exact_distances
from spectra_kit.geometry import sphere, write
from spectra_kit.neo import NeoConfig, NeoNetwork, save_weights

QUICK = ["--quick", "--repeats", "1", "--sources", "2", "--exact-sources", "2", "--warm", "2"]
QUICK += ["--sphere", "2", "3"]
N = 500


def studies_of(folder, shapes):
    """Those of the command, on the same meshes with the same options."""
    places = {"folder": folder, "problems": shapes}
    modes, exact = Modes(**places), Exact(**places, count=2)
    given = {**places, "modes": modes, "exact": exact, "warm": 2}
    return modes, exact, Accuracy(**given), Times(**given)


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """The folder of the command, its tables, and the mesh."""
    folder = tmp_path_factory.mktemp("geodesics")
    path = folder / "animal.npz"
    write(creature(N, seed=0), path)
    out = folder / "out"
    assert command.main(["geodesics", str(out), "--meshes", str(path), *QUICK]) == 0
    return out, json.loads((out / "geodesics.json").read_text())["tables"], shape_at(path)


@pytest.fixture(scope="module")
def accuracy(measured):
    """Its errors, from the store."""
    out, _, shape = measured
    results = run(studies_of(out, [shape])[2], Store(out), jobs=0)
    return {result.contender: result.record for result in results}


# --- end to end ---


def test_everything_is_measured_of_every_contender(measured):
    out, tables, _ = measured
    records = Store(out)._records.values()
    assert {record["status"] for record in records} == {"ok"}
    for study, names in (("accuracy", who.CONTENDERS), ("modes", EIGENSOLVERS)):
        assert {r["contender"] for r in records if r["study"] == study} == set(names)
    times = [record for record in records if record["study"] == "times"]
    assert len(times) == len(who.CONTENDERS) + len(who.MANY)
    for record in times:
        assert 0 < record["seconds"] < 60
        stages = sum(record["stages"].values())
        # Stages that run side by side, and rounding, aside.
        assert stages <= record["seconds"] * 1.05 + 1e-3, record["contender"]
    assert [row["solver"] for row in tables["Seconds to the first field"]] == [*who.CONTENDERS]
    rates = {row["solver"]: row["rate"] for row in tables["The unit sphere"]}
    assert all(0.5 < rate < 3 for rate in rates.values())


def line(results, name, mesh="easy"):
    rows = app.told(results, sources=2)
    return next(row for row in rows if (row["solver"], row["mesh"]) == (name, mesh))


def test_a_race_has_a_mean_and_a_worst_only_of_what_solved_every_mesh():
    shapes = [Shape(name, sphere(subdivisions=1).geometry) for name in ("easy", "hard")]

    def told(*seconds):
        """A study; without seconds it has failed."""
        return [
            Result(
                name, shape, 0, {"status": "ok" if s else "failed"} | ({"seconds": s} if s else {})
            )
            for shape, mesh in zip(shapes, seconds, strict=True)
            for name, s in zip(who.RACE, mesh, strict=True)
        ]

    race = {
        "first": told((2.0, 4.0, 6.0), (1.0, 8.0, 12.0)),
        "many": told((1.0, 3.0, 5.0), (1.0, None, 4.0)),
    }
    ratios = ("times ours", "many: times ours")
    assert [line(race, who.PLAIN)[name] for name in ratios] == [2, 3]
    assert [line(race, who.PLAIN, "hard")[name] for name in ratios] == [8, None]
    assert [line(race, who.ROBUST, "hard")[name] for name in ratios] == [12, 4]
    over = {
        (row["solver"], row["figure"]): (row["mean"], row["worst"], row["on"])
        for row in app.over_meshes(app.told(race, sources=2))
    }
    assert over[who.PLAIN, ratios[0]] == (4, 2, "easy")
    assert over[who.ROBUST, ratios[0]] == (6, 3, "easy")
    assert over[who.PLAIN, ratios[1]] == (None, 3, "easy")
    assert over[who.ROBUST, ratios[1]] == (pytest.approx(20**0.5), 4, "hard")


def test_numbers_are_those_of_the_library(measured, accuracy):
    out, _, shape = measured
    sources, distances = studies_of(out, [shape])[1].distances(shape)
    field, exact = HeatGeodesics(shape.mesh).distance(sources[0]), distances[0]
    np.testing.assert_array_equal(exact, exact_distances(shape.mesh, sources[0]))
    away = np.arange(N) != sources[0]
    truth = np.mean(np.abs(field.distance - exact)[away] / exact[away])
    assert accuracy[who.DIRECT]["errors"][0]["mean"] == pytest.approx(truth, rel=1e-6)
    # Other packages, the same mean.
    for name in (who.ROBUST, who.PLAIN, who.LIBIGL):
        pairs = zip(accuracy[name]["errors"], accuracy[who.DIRECT]["errors"], strict=True)
        assert all(a["mean"] == pytest.approx(b["mean"], rel=0.1) for a, b in pairs)


def test_solvers_agree_and_modes_save_iterations(accuracy):
    ours = [name for name in who.CONTENDERS if name not in (who.ROBUST, who.PLAIN, who.LIBIGL)]
    assert max(accuracy[name]["difference"] for name in ours) < 1e-7
    most = {name: accuracy[name]["iterations"] for name in who.CONTENDERS}
    few = [max(most[name]) for name in who.CONTENDERS if name.startswith("additive")]
    assert max(few) < 0.6 * min(most[who.ICPCG])
    assert most[who.DIRECT] == [None, None]


def test_tables_are_computed_from_the_records(measured, accuracy):
    _, tables, _ = measured
    rows = {row["solver"]: row for row in tables["Iterations, and errors against exact distances"]}
    middle = {name: np.median(accuracy[name]["iterations"]) for name in (who.ICPCG, ADDITIVE)}
    for name, count in middle.items():
        assert rows[name]["iterations"] == count
        assert rows[name]["fewer"] == pytest.approx(middle[who.ICPCG] / count)
    means = [
        np.mean([e["mean"] for e in accuracy[name]["errors"]]) for name in (who.DIRECT, who.ROBUST)
    ]
    assert rows[who.DIRECT]["over robust"] == pytest.approx(means[0] / means[1])


ADDITIVE = "additive, 96 exact modes"


# --- parts ---


def test_what_lacks_modes_or_truth_is_left_out(tmp_path):
    shape = Shape("ball", sphere(subdivisions=1).geometry)
    _, exact, accuracy, _ = studies_of(tmp_path, [shape])
    assert accuracy.excuse(ADDITIVE, shape, []) == "there are no exact modes"
    assert accuracy.excuse(who.DIRECT, shape, []) == "there are no exact distances"
    (found,) = run(exact, Store(tmp_path), jobs=0)
    first, second = found.record["sources"]  # one drawn, one as far as possible
    assert shape.mesh.points[first] @ shape.mesh.points[second] < -0.99
    assert accuracy.excuse(who.DIRECT, shape, []) == accuracy.excuse(who.ROBUST, shape, []) == ""
    assert accuracy.excuse(who.ICPCG, shape, []) == "the direct solver has failed"


@pytest.mark.parametrize(
    ("changed", "kept"),
    [
        ("mesh", [False, False, False]),
        ("code", [True, False, False]),
        ("machine", [True, True, False]),
        ("weights", [True, False, False]),
    ],
)
def test_what_changes_makes_another_key(tmp_path, monkeypatch, changed, kept):
    shape = Shape("ball", sphere(subdivisions=1).geometry)
    _, exact, accuracy, times = studies_of(tmp_path, [shape])
    name = "additive, 96 NEO modes"

    def keys(shape):
        return exact.key("exact", shape), accuracy.key(name, shape), times.key(name, shape)

    before = keys(shape)
    if changed == "mesh":
        shape = Shape("ball", shape.mesh.with_points(2 * shape.mesh.points))
    elif changed == "machine":
        times = dataclasses.replace(times, machine="elsewhere")
    elif changed == "code":
        # Exact distances have sources of their own, which did not change.
        digest = store.code_digest
        others = {Exact.sources: digest(Exact.sources)}
        monkeypatch.setattr("studies.study.code_digest", lambda s: others.get(s, "other"))
    else:
        weights = tmp_path / "weights.safetensors"
        save_weights(weights, NeoNetwork(NeoConfig.named("small")), {"steps": 0})
        monkeypatch.setitem(EIGENSOLVERS, "neo", lambda: Neo(weights=weights))
    assert [a == b for a, b in zip(before, keys(shape), strict=True)] == kept


def test_errors_leave_out_sources_and_what_is_out_of_reach():
    exact = np.array([0.0, 1.0, 2.0, np.inf])
    found = relative_errors(np.array([5.0, 1.5, 2.0, 7.0]), exact, np.array([1.0, 1.0, 3.0, 1.0]))
    assert found == {"mean": 0.25, "weighted": 0.125, "largest": 0.5}


def test_the_spectrum_is_paid_by_those_who_use_it():
    shape = Shape("easy", sphere(subdivisions=1).geometry)
    modes = [Result("exact", shape, 0, {"status": "ok", "seconds": 5.0})]
    for name, status, solver, paid in (
        (who.AUTOMATIC, "ok", "two-level", 7.0),
        (who.AUTOMATIC, "ok", "direct", 2.0),  # it leaves the modes alone
        (who.UNAIDED, "ok", "iterative", 2.0),
        (who.ICPCG, "failed", "", None),
    ):
        first = [Result(name, shape, 0, {"status": status, "seconds": 2.0, "solver": solver})]
        assert line({"modes": modes, "first": first}, name)["in all"] == paid
