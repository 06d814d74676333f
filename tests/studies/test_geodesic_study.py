"""The study of distances: what is measured on a mesh of our own, and what its tables say."""

import json
from dataclasses import replace

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
from studies.shapes import Shape
from studies.store import Store
from studies.study import Result, run

from spectra_kit import Neo
from spectra_kit.geodesics import HeatGeodesics, exact_distances
from spectra_kit.geometry import sphere, write
from spectra_kit.neo import NeoConfig, NeoNetwork, save_weights

ADDITIVE = "additive, 96 exact modes"


def studies_of(folder, shapes):
    """Those of the command, on the same meshes with the same options."""
    places = {"folder": folder, "problems": shapes}
    modes, exact = Modes(**places), Exact(**places, count=2)
    given = {**places, "modes": modes, "exact": exact, "warm": 2}
    return modes, exact, Accuracy(**given), Times(**given)


def test_a_race_is_measured_told_and_remembered(tmp_path):
    write(creature(500, seed=0), tmp_path / "animal.npz")
    out = tmp_path / "out"
    words = ["geodesics", str(out), "--race", "--meshes", str(tmp_path / "animal.npz"), "--quick"]
    words += ["--repeats", "1", "--sources", "2", "--exact-sources", "2", "--warm", "2"]
    assert command.main(words) == 0
    records = Store(out)._records.values()
    assert {record["status"] for record in records} == {"ok"}
    times = [record for record in records if record["study"] == "times"]
    assert len(times) == 2 * len(who.RACE)
    for record in times:  # stages that run side by side, and rounding, aside
        assert sum(record["stages"].values()) <= record["seconds"] * 1.05 + 1e-3
    tables = json.loads((out / "geodesics.json").read_text())["tables"]
    solvers = {row["solver"] for row in tables["Seconds to the first field"]}
    assert solvers == {*who.RACE, who.DIRECT}
    before = (out / "measurements.jsonl").read_text()
    assert command.main(words) == 0
    assert (out / "measurements.jsonl").read_text() == before


def test_numbers_are_those_of_the_library_and_modes_save_iterations(tmp_path):
    shape = Shape("animal", creature(500, seed=0))
    modes, exact, accuracy, _ = studies_of(tmp_path, [shape])
    some = who.DIRECT, who.ICPCG, ADDITIVE, who.ROBUST, who.LIBIGL
    for study in (replace(modes, contenders=["exact"]), exact):
        run(study, Store(tmp_path), jobs=0)
    results = run(replace(accuracy, contenders=some), Store(tmp_path), jobs=0)
    found = {result.contender: result.record for result in results}
    sources, distances = exact.distances(shape)
    field, truth = HeatGeodesics(shape.mesh).distance(sources[0]), distances[0]
    np.testing.assert_array_equal(truth, exact_distances(shape.mesh, sources[0]))
    away = truth > 0
    error = np.mean(np.abs(field.distance - truth)[away] / truth[away])
    own = found[who.DIRECT]["errors"]
    assert own[0]["mean"] == pytest.approx(error, rel=1e-6)
    for name in (who.ROBUST, who.LIBIGL):  # other packages, the same mean
        pairs = zip(found[name]["errors"], own, strict=True)
        assert all(a["mean"] == pytest.approx(b["mean"], rel=0.1) for a, b in pairs)
    assert max(found[name]["difference"] for name in some[:3]) < 1e-7
    rows = {row["solver"]: row for row in app.told({"accuracy": results})}
    assert rows[ADDITIVE]["fewer"] > 1 / 0.6
    assert rows[who.DIRECT]["iterations"] is None


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

    rows = app.told(
        {
            "first": told((2.0, 4.0, 6.0), (1.0, 8.0, 12.0)),
            "many": told((1.0, 3.0, 5.0), (1.0, None, 4.0)),
        }
    )
    ratios = ("times ours", "many: times ours")
    found = {(row["solver"], row["mesh"]): [row[name] for name in ratios] for row in rows}
    assert found[who.PLAIN, "easy"] == [2, 3]
    assert found[who.PLAIN, "hard"] == [8, None]
    assert found[who.ROBUST, "hard"] == [12, 4]
    over = {
        (row["solver"], row["figure"]): (row["mean"], row["worst"], row["on"])
        for row in app.over_meshes(rows)
    }
    assert over[who.PLAIN, ratios[0]] == (4, 2, "easy")
    assert over[who.PLAIN, ratios[1]] == (None, 3, "easy")
    assert over[who.ROBUST, ratios[1]] == (pytest.approx(20**0.5), 4, "hard")


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
        times = replace(times, machine="elsewhere")
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
