"""The benchmark of distances end to end on meshes of our own, and what its tables say."""

import importlib.util
import json
import re
from pathlib import Path

import numpy as np
import pytest
import torch

from spectra_kit import Neo, PointCloud, Spectrum
from spectra_kit._version import VERSION
from spectra_kit.benchmarks.code import code_digest
from spectra_kit.benchmarks.geodesics import (
    CONTENDERS,
    ExactCache,
    NamedMesh,
    Settings,
    measure_ball,
    measure_mesh,
    problems,
    problems_named,
    truth,
)
from spectra_kit.benchmarks.geodesics.contenders import AUTOMATIC, DIRECT, ICPCG, ROBUST, UNAIDED
from spectra_kit.benchmarks.geodesics.markdown import table
from spectra_kit.benchmarks.geodesics.measure import compare_with_exact
from spectra_kit.benchmarks.geodesics.problems import choose_sources
from spectra_kit.benchmarks.geodesics.process import measured
from spectra_kit.benchmarks.geodesics.records import (
    iterations,
    mean_error,
    ratio,
    seconds,
    seconds_in_all,
)
from spectra_kit.benchmarks.geodesics.truth import relative_errors
from spectra_kit.errors import InvalidInputError
from spectra_kit.geodesics import exact_distances, geodesic_distance
from spectra_kit.geometry import creature, sphere, write
from spectra_kit.neo import NeoConfig, NeoNetwork, save_weights

APP = Path(__file__).parents[2] / "apps" / "benchmark_geodesics.py"
QUICK = ["--quick", "--repeats", "1", "--sources", "2", "--exact-sources", "2", "--warm", "2"]


@pytest.fixture(scope="module")
def app():
    spec = importlib.util.spec_from_file_location("benchmark_geodesics", APP)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("geodesics")


@pytest.fixture(scope="module")
def animal(folder):
    path = folder / "animal.npz"
    write(creature(700, seed=0), path)
    return path


@pytest.fixture(scope="module")
def measurement(app, folder, animal):
    """What the app left, of one mesh."""
    out = folder / "out"
    assert app.main([str(out), "--meshes", str(animal), *QUICK, "--sphere", "2", "3"]) == 0
    return out, json.loads((out / "animal.json").read_text())


# --- end to end ---


def test_everything_is_measured_of_every_contender(measurement):
    _, record = measurement
    assert record["n"] == 700
    assert set(record["errors"]) == set(record["first"]) == set(CONTENDERS)
    assert not [name for name, answer in record["first"].items() if "failure" in answer]
    for name, answer in record["first"].items():
        assert 0 < answer["seconds"] < 60, name
        stages = sum(answer["stages"].values())
        # Stages that run side by side, and rounding, aside.
        assert stages <= answer["seconds"] * 1.05 + 1e-3, name
    assert set(record["spectra"]) == {"exact", "neo", "neo-polished"}
    assert all(seconds > 0 for seconds in record["spectra"].values())


def test_numbers_are_those_of_the_library(measurement, animal):
    _, record = measurement
    (model,) = problems_named([str(animal)])
    source = record["exact_sources"][0]
    field = geodesic_distance(model.mesh, source)
    exact = exact_distances(model.mesh, source)
    away = np.arange(700) != source
    truth = np.mean(np.abs(field.distance - exact)[away] / exact[away])
    assert record["errors"][DIRECT][0]["mean"] == pytest.approx(truth, rel=1e-6)
    # Another package, another mean over sources.
    assert mean_error(record, ROBUST) == pytest.approx(mean_error(record, DIRECT), rel=0.05)


def test_solvers_agree_and_modes_save_iterations(measurement):
    _, record = measurement
    assert max(max(d) for d in record["differences"].values()) < 1e-7
    few = [iterations(record, name) for name in CONTENDERS if name.startswith("additive")]
    assert max(few) < 0.6 * iterations(record, ICPCG)
    assert iterations(record, DIRECT) is None


def test_the_second_source_is_the_farthest_from_the_first(measurement, animal):
    _, record = measurement
    (model,) = problems_named([str(animal)])
    first, second = record["exact_sources"]
    assert second == exact_distances(model.mesh, first).argmax()


def test_tables_are_computed_from_the_record(measurement):
    out, record = measurement
    report = (out / "report.md").read_text()
    assert "the seconds are not comparable" in report
    count, saved = re.search(rf"\| {ICPCG} +\| +(\d+) \(([\d.]+)\) \|", report).groups()
    assert int(count) == round(iterations(record, ICPCG))
    assert saved == "1.00"
    name = "additive, 96 exact modes"
    count, saved = re.search(rf"\| {name} +\| +(\d+) \(([\d.]+)\) \|", report).groups()
    assert float(saved) == pytest.approx(
        iterations(record, ICPCG) / iterations(record, name), abs=0.006
    )
    worst = re.search(r"mean error over that of potpourri3d +\| +([\d.]+) \|", report)[1]
    assert float(worst) == pytest.approx(
        mean_error(record, DIRECT) / mean_error(record, ROBUST), abs=6e-4
    )
    for words, own in (
        (r"automatic, no modes\*", seconds(record, UNAIDED)),
        (r"automatic, exact modes\*, spectrum at hand", seconds(record, AUTOMATIC)),
        (r"automatic, exact modes\*, its spectrum counted", seconds_in_all(record, AUTOMATIC)),
    ):
        found = re.search(rf"potpourri3d over \*{words}: first field +\| +([\d.]+) \|", report)[1]
        assert float(found) == pytest.approx(seconds(record, ROBUST) / own, abs=0.006)
    # No mesh is large.
    assert re.search(r"first field, 100,000 vertices or more +\| +- \|", report)


def test_a_finished_mesh_is_not_measured_again(app, measurement, animal, capsys):
    out, record = measurement
    capsys.readouterr()
    arguments = [str(out), "--meshes", str(animal), *QUICK, "--sphere", "2", "3"]
    assert app.main(arguments) == 0
    said = capsys.readouterr()
    assert said.err.splitlines() == ["animal: measured before"]
    assert "## In short" in said.out
    assert json.loads((out / "animal.json").read_text()) == record


@pytest.mark.parametrize("changed", ["mesh", "code", "solvers", "machine"])
def test_another_mesh_of_that_name_or_another_code_is_measured(
    measurement, animal, tmp_path, changed
):
    _, record = measurement
    (model,) = problems_named([str(animal)])
    if changed == "mesh":
        model = NamedMesh("animal", model.mesh.with_points(2 * model.mesh.points))
    else:
        record = {**record, changed: "another"}
    (tmp_path / "animal.json").write_text(json.dumps(record))
    said = []
    # It ends at the first step, once it is clear that it goes on.
    with pytest.raises(KeyboardInterrupt):
        measure_mesh(model, Settings(**record["settings"]), tmp_path, say=_interrupting(said))
    assert said == ["animal: exact modes"]


@pytest.mark.filterwarnings("ignore::spectra_kit.errors.DoubtfulSpectrumWarning")
def test_other_weights_have_other_modes(tmp_path, monkeypatch):
    weights = tmp_path / "weights.safetensors"
    monkeypatch.setitem(problems.EIGENSOLVERS, "neo", lambda: Neo(weights=weights))
    model = NamedMesh("ball", sphere(subdivisions=3).geometry)
    found = []
    for seed in range(2):
        torch.manual_seed(seed)
        save_weights(weights, NeoNetwork(NeoConfig.named("small")), {"steps": 0})
        found.append(Spectrum.load(problems.spectrum_path(model, "neo", tmp_path)))
    assert np.abs(found[0].eigenvalues - found[1].eigenvalues).max() > 1e-3


def test_exact_distances_are_those_of_the_code(tmp_path, monkeypatch):
    mesh = sphere(subdivisions=1).geometry
    right = ExactCache(tmp_path).distances(mesh, 0)
    monkeypatch.setattr(truth, "code_digest", lambda **options: "another")
    monkeypatch.setattr(truth, "exact_distances", lambda mesh, source: 2 * right)
    np.testing.assert_array_equal(ExactCache(tmp_path).distances(mesh, 0), 2 * right)


def test_the_code_is_that_of_the_sources(tmp_path):
    for package in ("geodesics", "linalg", "neo", "operators", "viz"):
        (tmp_path / package).mkdir()
        (tmp_path / package / "a.py").write_text("1")
    first = code_digest(tmp_path)
    (tmp_path / "viz" / "a.py").write_text("2")
    assert code_digest(tmp_path) == first
    (tmp_path / "linalg" / "a.py").write_text("2")
    second = code_digest(tmp_path)
    (tmp_path / "linalg" / "a.py").rename(tmp_path / "linalg" / "b.py")
    third = code_digest(tmp_path)
    (tmp_path / "neo" / "a.py").write_text("2")
    assert len({first, second, third, code_digest(tmp_path), code_digest()}) == 5
    assert code_digest().startswith(f"{VERSION}+")


def _interrupting(said):
    def say(text):
        said.append(text)
        raise KeyboardInterrupt

    return say


def test_interrupted_it_says_how_to_go_on(app, tmp_path, animal, monkeypatch, capsys):
    def say(text):
        raise KeyboardInterrupt

    monkeypatch.setattr(app, "_say", say)
    assert app.main([str(tmp_path / "out"), "--meshes", str(animal), *QUICK]) == 130
    assert "run the same command to continue" in capsys.readouterr().err


# --- parts ---


def test_a_fresh_process_finds_the_same(animal, tmp_path):
    options = {"threads": 1, "subdivisions": 2}
    fields = [tmp_path / "fresh.npy", tmp_path / "here.npy"]
    fresh = measured(DIRECT, animal, [3, 5], fields=fields[0], **options)
    measured(DIRECT, animal, [3, 5], fields=fields[1], fresh=False, **options)
    assert fresh["iterations"] == [None, None]
    assert fresh["seconds"] > 0
    found = [np.load(path) for path in fields]
    assert found[0].shape == (2, 700)
    np.testing.assert_array_equal(found[0], found[1])


def test_what_a_contender_refuses_is_a_failure(animal, tmp_path):
    answer = measured(DIRECT, animal, [700], threads=1, subdivisions=1, fresh=False)
    assert answer["failure"].startswith("InvalidInputError: `sources` must be in [0, 700)")
    # A process that ends before it has said anything.
    lost = measured(DIRECT, tmp_path / "lost.npz", [0], threads=1, subdivisions=1)
    assert lost == {"failure": "the process ended with code 1"}


def test_the_direct_solver_must_not_fail(tmp_path):
    def run(name, sources, *, fields):
        return {"failure": "the process ended with code -9"}

    model = NamedMesh("bad", sphere(subdivisions=1).geometry)
    with pytest.raises(InvalidInputError, match=r"`model` bad must be one that the direct .* -9"):
        compare_with_exact(model, [0], ExactCache(tmp_path), run, tmp_path / "fields.npy")


def test_exact_distances_are_kept(tmp_path):
    mesh = sphere(subdivisions=2).geometry
    cache = ExactCache(tmp_path / "exact")
    np.testing.assert_array_equal(cache.distances(mesh, 4), exact_distances(mesh, 4))
    np.testing.assert_array_equal(ExactCache(tmp_path / "exact").distances(mesh, 4),
                                  exact_distances(mesh, 4))  # fmt: skip
    assert len(cache.seconds) == len(list((tmp_path / "exact").iterdir())) == 1
    cache.distances(mesh, 5)
    cache.distances(mesh.with_points(2 * mesh.points), 4)
    assert len(list((tmp_path / "exact").iterdir())) == 3


def test_sources_are_random_and_far(tmp_path):
    model = NamedMesh("ball", sphere(subdivisions=3).geometry)
    cache = ExactCache(tmp_path)
    sources = choose_sources(model, 4, cache, seed=1)
    assert len(set(sources)) == 4
    near = model.mesh.points[sources[:3]] @ model.mesh.points.T
    assert near.max(axis=0).argmin() == sources[3]
    assert sources != choose_sources(model, 4, cache, seed=2)
    assert sources == choose_sources(model, 4, cache, seed=1)


def test_errors_leave_out_sources_and_what_is_out_of_reach():
    exact = np.array([0.0, 1.0, 2.0, np.inf])
    found = relative_errors(np.array([5.0, 1.5, 2.0, 7.0]), exact, np.array([1.0, 1.0, 3.0, 1.0]))
    assert (found.mean, found.weighted, found.largest) == (0.25, 0.125, 0.5)


def test_on_the_sphere_errors_fall_alike():
    found = measure_ball([2, 3, 4])
    for kind in ("mesh", "cloud"):
        mean = {name: np.array(errors["mean"]) for name, errors in found[kind].items()}
        assert (np.diff(mean[DIRECT]) < 0).all()
        np.testing.assert_allclose(mean[DIRECT], mean[ROBUST], rtol=0.25)
    assert found["points"] == [162, 642, 2562]


def test_the_spectrum_is_paid_by_those_who_use_it(measurement):
    _, record = measurement
    name = "additive, 96 NEO modes"
    assert seconds_in_all(record, name) == seconds(record, name) + record["spectra"]["neo"]
    # Few points: what is automatic solves directly, and leaves the modes alone.
    assert record["first"][AUTOMATIC]["choice"].startswith("direct")
    for name in (AUTOMATIC, DIRECT, ICPCG, ROBUST):
        assert seconds_in_all(record, name) == seconds(record, name)
    used = {**record["first"][AUTOMATIC], "choice": "iterative: one source does not pay"}
    iterative = {**record, "first": {AUTOMATIC: used}}
    assert seconds_in_all(iterative, AUTOMATIC) == used["seconds"] + record["spectra"]["exact"]
    assert seconds_in_all({"first": {DIRECT: {"failure": "no"}}}, DIRECT) is None


def test_tables_are_aligned():
    assert table(["a", "b"], [["long", "1"], ["x", "22"]]).splitlines() == [
        "| a    |  b |",
        "| :--- | -: |",
        "| long |  1 |",
        "| x    | 22 |",
    ]
    assert ratio(None, 1.0) is ratio(1.0, None) is ratio(1.0, 0.0) is None
    assert ratio(1.0, 4.0) == 0.25


# --- refusals ---


def test_names_are_files_or_known(app, tmp_path, animal, monkeypatch, capsys):
    monkeypatch.delenv("SPECTRA_KIT_DATA", raising=False)
    assert app.main([str(tmp_path / "out"), "--meshes", "igea"]) == 2
    assert "error: `meshes` must name files" in capsys.readouterr().err
    (tmp_path / "ood_public").mkdir()
    write(creature(500, seed=0), tmp_path / "ood_public" / "igea.npz")
    monkeypatch.setenv("SPECTRA_KIT_DATA", str(tmp_path))
    assert [model.name for model in problems_named(["igea", str(animal)])] == ["igea", "animal"]
    with pytest.raises(InvalidInputError, match="names of their own, got igea twice"):
        problems_named(["igea", "igea"])
    write(PointCloud(np.eye(3)), tmp_path / "cloud.ply")
    with pytest.raises(InvalidInputError, match=r"cloud\.ply"):
        problems_named([str(tmp_path / "cloud.ply")])


def test_counts_are_positive(app, tmp_path, animal, capsys):
    assert app.main([str(tmp_path), "--meshes", str(animal), "--repeats", "0"]) == 2
    assert "error: `repeats` must be at least 1, got 0" in capsys.readouterr().err
