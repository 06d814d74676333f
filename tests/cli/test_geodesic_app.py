"""The app and the command that measure geodesic distances."""

import argparse
import json
import os

import numpy as np
import pytest
import trimesh
from test_apps import load

from spectra_kit.cli import main
from spectra_kit.cli.geodesic_compare import largest_difference
from spectra_kit.cli.geodesic_method import linear_solver, why_without_modes
from spectra_kit.cli.geodesic_sources import with_farthest
from spectra_kit.eigensolvers import eigensolve
from spectra_kit.geodesics import FacePoint, HeatGeodesics, Iterative, nearest_source
from spectra_kit.geometry import TriangleMesh, creature, read, rectangle, sphere, write
from spectra_kit.operators import intrinsic_delaunay
from spectra_kit.viz.colours import UNKNOWN

FILES = {"distance.npy", "distance.ply", "report.json"}


@pytest.fixture(scope="module")
def app():
    return load("geodesic_distances").main


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A sphere, an animal, a sheet and two balls, as files."""
    folder = tmp_path_factory.mktemp("shapes")
    ball = sphere(subdivisions=3).geometry
    write(ball, folder / "ball.off")
    write(ball.as_cloud(), folder / "cloud.ply")
    write(rectangle(n=400).geometry, folder / "sheet.off")
    write(creature(1500), folder / "animal.ply")
    pair = TriangleMesh(
        np.vstack([ball.points, ball.points + [3, 0, 0]]),
        np.vstack([ball.faces, ball.faces + ball.n]),
    )
    write(pair, folder / "pair.ply")
    laplacian = intrinsic_delaunay(read(folder / "animal.ply")).laplacian
    eigensolve(laplacian, 20).save(folder / "animal.npz")
    return folder


def report(app, capsys, *arguments):
    """Run the app, which must succeed in silence; return its report."""
    code = app([*map(str, arguments), "--no-pictures", "--json"])
    out, err = capsys.readouterr()
    assert (code, err) == (0, "")
    return json.loads(out)


def refusal(app, capsys, *arguments):
    assert app([*map(str, arguments), "--no-pictures"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    return err


def distances(folder):
    return np.load(folder / "distance.npy")


def test_distances_are_those_of_the_library(app, files, tmp_path, capsys):
    out = tmp_path / "out"
    found = report(app, capsys, files / "ball.off", "--source", 0, 5, "-o", out)
    mesh = read(files / "ball.off")
    field = HeatGeodesics(mesh).distance([0, 5])
    np.testing.assert_array_equal(distances(out), field.distance)
    truth = np.arccos(np.clip(mesh.points @ mesh.points[[0, 5]].T, -1, 1)).min(axis=1)
    assert np.abs(distances(out) - truth).max() < 0.12  # coarse
    assert found["time_step"] == pytest.approx(field.time_step)
    assert found["choice"] == field.choice
    assert found["iterations"] == field.poisson.iterations
    assert found["relative_residual"] == pytest.approx(field.poisson.relative_residual, abs=1e-10)
    assert found["largest_distance"] == pytest.approx(field.distance.max())
    assert found["mean_distance"] == pytest.approx(field.distance.mean())
    assert found["heat"]["method"] == field.heat.method
    assert found["points_not_reached"] == 0
    assert set(found["seconds"]) == set(field.seconds)
    assert found["sources"] == [{"point": 0}, {"point": 5}]
    assert set(os.listdir(out)) == FILES
    saved = json.loads((out / "report.json").read_text())
    assert saved == {key: value for key, value in found.items() if key != "written"}


def test_the_ply_holds_the_distances_and_their_colours(app, files, tmp_path, capsys):
    report(app, capsys, files / "pair.ply", "--source", 7, "-o", tmp_path / "out")
    path = tmp_path / "out" / "distance.ply"
    mesh, distance = read(files / "pair.ply"), distances(tmp_path / "out")
    np.testing.assert_array_equal(read(path).points, mesh.points)
    np.testing.assert_array_equal(read(path).faces, mesh.faces)
    seen = trimesh.load(path, process=False)
    quality = seen.metadata["_ply_raw"]["vertex"]["data"]["quality"]
    np.testing.assert_array_equal(quality, distance)
    colours = seen.visual.vertex_colors[:, :3]
    np.testing.assert_array_equal(colours[642:], np.tile(UNKNOWN, (642, 1)))
    light = colours[:642].astype(float) @ [0.299, 0.587, 0.114]
    order = np.argsort(distance[:642])
    assert (np.diff(light[order]) <= 1).all()  # darker with the distance


def test_what_cannot_be_reached_is_infinite_and_counted(app, files, tmp_path, capsys):
    found = report(app, capsys, files / "pair.ply", "--source", 7, "-o", tmp_path / "out")
    distance = distances(tmp_path / "out")
    assert np.isfinite(distance[:642]).all()
    assert np.isinf(distance[642:]).all()
    assert found["points_not_reached"] == 642
    assert found["largest_distance"] == distance[:642].max()


def test_places_and_points_of_faces(app, files, tmp_path, capsys):
    mesh = read(files / "ball.off")
    place = [0.1, 2.0, -0.3]
    found = report(
        app, capsys, files / "ball.off", "--at", *place, "--face", 3, 0.2, 0.3, 0.5, "-o", tmp_path
    )
    sources = [nearest_source(mesh, place), FacePoint(3, (0.2, 0.3, 0.5))]
    expected = HeatGeodesics(mesh).distance(sources).distance
    np.testing.assert_array_equal(distances(tmp_path), expected)
    assert [source["face"] for source in found["sources"]] == [sources[0].face, 3]
    assert found["sources"][1]["barycentric"] == pytest.approx([0.2, 0.3, 0.5])


def test_a_cloud_is_measured_too(app, files, tmp_path, capsys):
    found = report(app, capsys, files / "cloud.ply", "--at", 0, 0, 9, "-o", tmp_path / "out")
    cloud = read(files / "cloud.ply")
    top = int(cloud.points[:, 2].argmax())
    assert found["kind"] == "cloud"
    assert found["sources"] == [{"point": top}]
    truth = np.arccos(np.clip(cloud.points @ cloud.points[top], -1, 1))
    assert np.abs(distances(tmp_path / "out") - truth).max() < 0.06


def test_farthest_points_are_opposite_and_reach_every_part(app, files, tmp_path, capsys):
    found = report(
        app, capsys, files / "ball.off", "--source", 0, "--farthest", 1, "-o", tmp_path / "one"
    )
    points = read(files / "ball.off").points
    first, last = (source["point"] for source in found["sources"])
    assert first == 0
    assert points[first] @ points[last] < -0.98
    again = report(app, capsys, files / "ball.off", "--farthest", 2, "-o", tmp_path / "two")
    assert again["sources"][0]["point"] == last  # from point 0, which is no source here
    assert points[again["sources"][1]["point"]] @ points[last] < -0.98
    both = report(app, capsys, files / "pair.ply", "--farthest", 2, "-o", tmp_path / "pair")
    assert sorted(source["point"] >= 642 for source in both["sources"]) == [False, True]
    assert both["points_not_reached"] == 0


def test_farthest_points_on_a_line():
    place = np.arange(11.0)

    def distance(sources):
        return np.abs(place[:, None] - place[sources]).min(axis=1)

    assert with_farthest([], 3, distance) == [10, 0, 5]
    assert with_farthest([4], 2, distance) == [4, 10, 0]
    assert with_farthest([4, 10], 1, distance) == [4, 10, 0]
    assert with_farthest([4], 0, distance) == [4]


def test_solvers_agree_and_modes_save_iterations(app, files, tmp_path, capsys):
    animal, spectrum = files / "animal.ply", files / "animal.npz"
    runs, fields = {}, {}
    for name, options in {
        "direct": ("--solver", "direct"),
        "plain": ("--solver", "plain"),
        "file": ("--solver", "iterative", "--spectrum", spectrum),
        "computed": ("--solver", "iterative", "--spectrum", "exact", "--modes", 10),
        "projected": ("--solver", "projected", "--spectrum", spectrum),
        "neo": ("--solver", "iterative", "--spectrum", "neo"),
        "polished": ("--solver", "iterative", "--spectrum", "neo-polished"),
    }.items():
        out = tmp_path / name
        runs[name] = report(app, capsys, animal, "--source", 3, *options, "-o", out)
        fields[name] = distances(out)
    largest = fields["direct"].max()
    for field in fields.values():
        assert np.abs(field - fields["direct"]).max() < 1e-6 * largest
    assert runs["direct"]["iterations"] == 0
    assert runs["direct"]["spectrum"] is None
    assert runs["computed"]["iterations"] <= runs["plain"]["iterations"]  # ten modes are few
    for name in ("file", "projected", "neo", "polished"):
        assert runs[name]["iterations"] < runs["plain"]["iterations"]
    for name in ("file", "computed", "projected", "neo", "polished"):
        assert runs[name]["spectrum"]["seconds"] > 0
    assert runs["file"]["spectrum"]["from"] == str(spectrum)
    assert runs["computed"]["spectrum"]["modes"] == 11  # and the constant
    assert runs["neo"]["spectrum"]["modes"] == Iterative().modes + 1


def test_modes_that_auto_does_not_need_are_not_computed(app, files, tmp_path, capsys):
    arguments = (files / "animal.ply", "--source", 3, "--spectrum", "exact", "-o", tmp_path / "few")
    found = report(app, capsys, *arguments)
    assert found["choice"].startswith("direct")
    assert found["spectrum"] is None
    assert found["spectrum_unused"] == "not needed by the direct solver: 1500 points are few"
    assert app([*map(str, arguments), "--no-pictures"]) == 0
    assert "not needed by the direct solver: 1500 points" in capsys.readouterr().out


def test_modes_reach_the_solver_that_auto_chooses():
    asked = argparse.Namespace(solver="auto", spectrum="exact", modes=96, farthest=0, rtol=1e-6)
    solver = linear_solver(asked)
    assert solver.choose(100_000, 1)[0] == Iterative(modes=96, rtol=1e-6)
    assert why_without_modes(asked, solver, 100_000) == ""
    many = argparse.Namespace(**vars(asked) | {"farthest": 19, "modes": None})
    assert linear_solver(many).modes == Iterative().modes
    reason = why_without_modes(many, linear_solver(many), 100_000)
    assert reason.endswith("20 sources pay for factors of 100000 points")
    plain = argparse.Namespace(**vars(asked) | {"spectrum": "none"})
    assert why_without_modes(plain, solver, 100) == ""


def test_options_reach_the_method(app, files, tmp_path, capsys):
    sheet, source = files / "sheet.off", ("--at", 0.3, 0.2, 0)
    fields, steps = {}, {}
    for name, options in {
        "neumann": (),
        "dirichlet": ("--boundary", "dirichlet"),
        "average": ("--boundary", "average"),
        "smooth": ("--time-coefficient", 10),
        "rough": ("--solver", "plain", "--rtol", 1e-2),
    }.items():
        found = report(app, capsys, sheet, *source, *options, "-o", tmp_path / name)
        fields[name] = distances(tmp_path / name)
        steps[name] = found["time_step"]
    assert steps["smooth"] == pytest.approx(10 * steps["neumann"])
    assert 1e-4 < found["relative_residual"] < 1e-2  # of the last one, the rough one
    mesh = read(sheet)
    sources = nearest_source(mesh, [0.3, 0.2, 0])
    for name in ("neumann", "dirichlet", "average"):
        expected = HeatGeodesics(mesh, boundary=name).distance(sources).distance
        np.testing.assert_array_equal(fields[name], expected)
    for name in ("dirichlet", "average", "smooth"):
        assert np.abs(fields[name] - fields["neumann"]).max() > 1e-3


def test_the_command_does_the_same(files, tmp_path, capsys):
    ball, out = str(files / "ball.off"), tmp_path / "out"
    assert main(["geodesic", ball, "--source", "0", "-o", str(out), "--no-pictures"]) == 0
    printed = capsys.readouterr().out
    assert "points not reached  0" in printed
    assert "sources             1" in printed
    for name in FILES:
        assert f"written: {out / name}" in printed
    expected = HeatGeodesics(read(ball)).distance(0).distance
    np.testing.assert_array_equal(distances(out), expected)


def test_the_demo_draws_its_picture(app, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    code = app(["--points", "800", "--dpi", "40"])
    out, err = capsys.readouterr()
    if code == 2 and "OpenGL" in err:
        pytest.skip("no OpenGL library on this machine")
    assert code == 0, err
    folder = tmp_path / "geodesic_distances"
    assert set(os.listdir(folder)) == FILES | {"field.png"}
    assert "written: geodesic_distances/field.png" in out
    field = HeatGeodesics(creature(800)).distance(0)
    source = json.loads((folder / "report.json").read_text())["sources"][0]["point"]
    assert source == field.distance.argmax()
    assert distances(folder)[source] == 0


def test_solvers_are_compared(app, files, tmp_path, capsys):
    out = tmp_path / "out"
    arguments = [str(files / "animal.ply"), "--source", "0", "--compare", "--modes", "30"]
    code = app([*arguments, "--dpi", "40", "-o", str(out)])
    printed, err = capsys.readouterr()
    if code == 2 and "OpenGL" in err:
        pytest.skip("no OpenGL library on this machine")
    assert code == 0, err
    assert set(os.listdir(out)) == FILES | {"field.png", "convergence.png"}
    runs = {r["name"]: r for r in json.loads((out / "report.json").read_text())["comparison"]}
    plain = runs["IC(0)"]
    assert len(runs) == 9
    for name, run in runs.items():
        assert name in printed
        assert run["seconds"] == pytest.approx(sum(run["stages"].values()))
        assert min(run["stages"].values()) >= 0
        if name != "potpourri3d":
            assert run["difference_from_direct"] < 1e-6
        if "modes" in name:
            assert run["spectrum_seconds"] > 0
            assert run["iterations"] < plain["iterations"] / 1.5
        else:
            assert run["spectrum_seconds"] == 0
        if run["iterations"]:
            assert run["relative_residual"] <= 1e-8
            assert len(run["residuals"]) == len(run["times"]) == run["iterations"] + 1
    assert runs["direct Cholesky"]["difference_from_direct"] == 0
    assert 0 < runs["potpourri3d"]["difference_from_direct"] < 0.05


def test_differences_are_relative_to_what_was_reached():
    reference = np.array([0.0, 2.0, 4.0, np.inf])
    assert largest_difference(np.array([0.0, 2.2, 3.6, 9.0]), reference) == pytest.approx(0.1)
    assert largest_difference(reference, reference) == 0
    assert largest_difference(np.zeros(2), np.array([0.0, np.inf])) == 0


def test_files_of_another_run_are_not_mixed_with_its_own(app, files, tmp_path, capsys):
    out = tmp_path / "out"
    few = (files / "ball.off", "--source", 0, "-o", out)
    report(app, capsys, *few)
    report(app, capsys, *few)  # all is replaced
    (out / "field.png").write_bytes(b"old")
    assert "got field.png, which would stay beside the new one" in refusal(app, capsys, *few)
    assert (out / "field.png").read_bytes() == b"old"
    (out / "field.png").unlink()
    again = (out / "distance.ply", "--source", 0, "-o", out)
    assert "must not replace an input, got distance.ply" in refusal(app, capsys, *again)
    (tmp_path / "file").write_text("")
    assert "a file has that name" in refusal(app, capsys, *few[:-1], tmp_path / "file")
    assert "there is no" in refusal(app, capsys, *few[:-1], tmp_path / "no" / "out")


def test_bad_input_is_refused(app, files, tmp_path, capsys):
    ball, sheet, out = files / "ball.off", files / "sheet.off", ("-o", tmp_path / "out")
    source = ("--source", 0)
    for options, message in (
        ((ball,), "distances need at least one source; name some by --source, --at"),
        ((ball, "--source", 642), "`--source` must be in [0, 642), got 642"),
        ((ball, "--source", -1), "`--source` must be in [0, 642), got -1"),
        ((ball, "--face", 1.5, 1, 0, 0), "--face must begin with the number of a face, got 1.5"),
        ((ball, "--face", "nan", 1, 0, 0), "--face must begin with the number of a face"),
        ((ball, "--face", 5000, 1, 0, 0), "must be in [0, 1280), got 5000"),
        ((ball, "--face", 0, 1, 1, 0), "must be non-negative and sum to 1"),
        ((ball, "--at", "nan", 0, 0), "`--at` must be finite"),
        ((files / "cloud.ply", "--face", 0, 1, 0, 0), "FacePoint"),
        ((ball, "--farthest", -1), "`--farthest` must be at least 0, got -1"),
        ((ball, "--farthest", 643), "`--farthest` must be in [0, 642], got 643"),
        ((ball, *source, "--repair"), "name places by --at instead"),
        ((ball, *source, "--cloud", 100), "name places by --at instead"),
        ((ball, *source, "--modes", 0), "`--modes` must be at least 1"),
        ((ball, *source, "--rtol", -1), "`--rtol` must be positive"),
        ((ball, *source, "--time-coefficient", 0), "`--time-coefficient` must be positive"),
        ((ball, *source, "--spacing", 0), "`--spacing` must be positive"),
        ((ball, *source, "--spectrum", "best"), "none, exact, neo and neo-polished or an npz file"),
        ((ball, *source, "--spectrum", ball), "ball.off"),
        ((ball, *source, "--spectrum", files / "animal.npz"), "must have the 642 points"),
        ((ball, *source, "--solver", "projected"), "--solver projected needs modes"),
        (
            (ball, *source, "--solver", "direct", "--spectrum", "exact"),
            "--solver direct has no use for a spectrum",
        ),
        ((sheet, *source, "--boundary", "dirichlet"), "must not all lie on the boundary"),
        ((sheet, *source, "--boundary", "average", "--compare"), "--compare is for"),
        ((tmp_path / "none.off", *source), "none.off: there is no such file"),
    ):
        assert message in refusal(app, capsys, *options, *out)
    assert not (tmp_path / "out").exists()
    with pytest.raises(SystemExit) as exit_code:
        app([str(ball), "--solver", "magic"])
    assert exit_code.value.code == 2
    assert "invalid choice: 'magic'" in capsys.readouterr().err
