"""The command that measures geodesic distances."""

import json
import os

import numpy as np
import pytest
import trimesh
from conftest import creature, joined, moved
from running import printed, record, refusal, write_shapes

from spectra_kit import show
from spectra_kit.cli import main
from spectra_kit.cli.geodesic import linear_solver, why_without_modes
from spectra_kit.cli.program import parse
from spectra_kit.eigen import eigensolve
from spectra_kit.geodesics import (
    FacePoint,
    HeatGeodesics,
    Iterative,
    exact_distances,
    nearest_source,
)
from spectra_kit.geometry import TriangleMesh, read, sphere, write
from spectra_kit.operators import intrinsic_delaunay
from spectra_kit.show.colours import UNKNOWN

FILES = {"distance.npy", "distance.ply", "report.json"}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A sphere, an animal, a sheet and two balls, as files."""
    folder = tmp_path_factory.mktemp("shapes")
    ball = write_shapes(folder)
    write(creature(1500), folder / "animal.ply")
    pair = joined(ball, moved(ball, 3, 0, 0))
    write(pair, folder / "pair.ply")
    unused = TriangleMesh(np.vstack([[[9, 9, 9]], ball.points]), ball.faces + 1)
    write(unused, folder / "unused.off")
    laplacian = intrinsic_delaunay(read(folder / "animal.ply")).laplacian
    eigensolve(laplacian, 20).save(folder / "animal.npz")
    return folder


def report(capsys, *arguments):
    """Measure in silence; return the report."""
    return record(capsys, "geodesic", *arguments, "--no-pictures")


def distances(folder):
    return np.load(folder / "distance.npy")


def test_distances_are_those_of_the_library(files, tmp_path, capsys):
    out = tmp_path / "out"
    ball = (files / "ball.off", "--source", 0, 5)
    found = report(capsys, *ball, "--method", "direct", "-o", out)
    mesh = read(files / "ball.off")
    field = HeatGeodesics(mesh).distance([0, 5])
    np.testing.assert_array_equal(distances(out), field.distance)
    truth = np.arccos(np.clip(mesh.points @ mesh.points[[0, 5]].T, -1, 1)).min(axis=1)
    assert np.abs(distances(out) - truth).max() < 0.12  # coarse
    assert found["time_step"] == pytest.approx(field.time_step)
    assert found["choice"] == "direct: as asked"
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


def test_distances_on_small_meshes_are_exact(files, tmp_path, capsys):
    found = report(capsys, files / "ball.off", "--source", 0, 5, "-o", tmp_path)
    np.testing.assert_array_equal(
        distances(tmp_path), exact_distances(read(files / "ball.off"), [0, 5])
    )
    assert found["choice"] == "exact: at most 2000 vertices"
    assert found["heat"] is found["iterations"] is found["time_step"] is None
    out, _ = printed(
        capsys, "geodesic", files / "ball.off", "--source", 0, "--no-pictures", "-o", tmp_path
    )
    assert "time step" not in out


@pytest.mark.filterwarnings("default")
def test_heat_on_large_triangles_is_doubted(tmp_path, capsys):
    write(sphere(subdivisions=0).geometry, tmp_path / "coarse.off")
    command = ("geodesic", tmp_path / "coarse.off", "--method", "direct", "--no-pictures")
    _, err = printed(capsys, *command, "--source", 0, "-o", tmp_path / "out")
    assert "triangles are too large beside the surface" in err
    assert "take --method auto" in err


def test_the_ply_holds_the_distances_and_their_colours(files, tmp_path, capsys):
    """What cannot be reached is infinite, grey, and counted."""
    found = report(capsys, files / "pair.ply", "--source", 7, "-o", tmp_path / "out")
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
    assert np.isfinite(distance[:642]).all()
    assert np.isinf(distance[642:]).all()
    assert found["points_not_reached"] == 642
    assert found["largest_distance"] == distance[:642].max()


def test_places_and_points_of_faces(files, tmp_path, capsys):
    mesh = read(files / "ball.off")
    place = [0.1, 2.0, -0.3]
    found = report(
        capsys, files / "ball.off", "--at", *place, "--face", 3, 0.2, 0.3, 0.5, "-o", tmp_path
    )
    sources = [nearest_source(mesh, place), FacePoint(3, (0.2, 0.3, 0.5))]
    expected = exact_distances(mesh, sources)
    np.testing.assert_array_equal(distances(tmp_path), expected)
    assert [source["face"] for source in found["sources"]] == [sources[0].face, 3]
    assert found["sources"][1]["barycentric"] == pytest.approx([0.2, 0.3, 0.5])


def test_a_cloud_is_measured_too(files, tmp_path, capsys):
    found = report(capsys, files / "cloud.ply", "--at", 0, 0, 9, "-o", tmp_path / "out")
    cloud = read(files / "cloud.ply")
    top = int(cloud.points[:, 2].argmax())
    assert (found["kind"], found["sources"]) == ("cloud", [{"point": top}])
    truth = np.arccos(np.clip(cloud.points @ cloud.points[top], -1, 1))
    assert np.abs(distances(tmp_path / "out") - truth).max() < 0.06


def test_sources_keep_their_place_when_a_file_is_repaired(files, tmp_path, capsys):
    """Numbers are those of the file, and so are the distances."""
    command = ("geodesic", files / "unused.off", "--repair", "--no-pictures", "-o", tmp_path)
    printed(capsys, *command, "--source", 8)
    expected = exact_distances(read(files / "ball.off"), 7)
    np.testing.assert_array_equal(distances(tmp_path), [np.nan, *expected])
    assert main([*map(str, command), "--source", "0"]) == 2
    assert "`--source` must name points that --repair and --largest keep, got 0" in (
        capsys.readouterr().err
    )


def test_farthest_points_are_opposite_and_reach_every_part(files, tmp_path, capsys):
    ball = files / "ball.off"
    found = report(capsys, ball, "--source", 0, "--farthest", 1, "-o", tmp_path / "one")
    points = read(ball).points
    first, last = (source["point"] for source in found["sources"])
    assert first == 0
    assert points[first] @ points[last] < -0.98
    again = report(capsys, ball, "--farthest", 3, "-o", tmp_path / "three")
    begun, opposite, between = (source["point"] for source in again["sources"])
    assert begun == last  # from point 0, which is no source here
    assert points[opposite] @ points[last] < -0.98
    assert abs(points[between] @ points[last]) < 0.1
    both = report(capsys, files / "pair.ply", "--farthest", 2, "-o", tmp_path / "pair")
    assert sorted(source["point"] >= 642 for source in both["sources"]) == [False, True]
    assert both["points_not_reached"] == 0


def test_solvers_agree_and_modes_save_iterations(files, tmp_path, capsys):
    animal, spectrum = files / "animal.ply", files / "animal.npz"
    runs, fields = {}, {}
    for name, options in {
        "direct": ("--method", "direct"),
        "plain": ("--method", "plain"),
        "file": ("--method", "iterative", "--spectrum", spectrum),
        "computed": ("--method", "iterative", "--solver", "arpack", "-k", 11),
        "projected": ("--method", "projected", "--spectrum", spectrum),
        "refined": ("--method", "iterative", "--solver", "refined"),
    }.items():
        out = tmp_path / name
        runs[name] = report(capsys, animal, "--source", 3, *options, "-o", out)
        fields[name] = distances(out)
    largest = fields["direct"].max()
    for field in fields.values():
        assert np.abs(field - fields["direct"]).max() < 1e-6 * largest
    assert runs["direct"]["iterations"] == 0
    assert runs["direct"]["spectrum"] is None
    assert runs["computed"]["iterations"] <= runs["plain"]["iterations"]  # ten modes are few
    for name in ("file", "projected"):
        assert runs[name]["iterations"] < runs["plain"]["iterations"]
    for name in ("file", "computed", "projected", "refined"):
        assert runs[name]["spectrum"]["seconds"] > 0
    assert runs["file"]["spectrum"]["from"] == str(spectrum)
    assert runs["computed"]["spectrum"]["modes"] == 11  # with the constant
    assert runs["refined"]["spectrum"]["modes"] == Iterative().modes + 1


def test_modes_that_auto_does_not_need_are_not_computed(files, tmp_path, capsys):
    command = (files / "animal.ply", "--source", 3, "--solver", "arpack", "-o", tmp_path / "few")
    found = report(capsys, *command)
    assert found["choice"].startswith("direct")
    assert found["spectrum"] is None
    assert (
        found["spectrum_unused"]
        == "not needed by the direct solver: factors of 1500 points fit into 4 GiB"
    )
    out, _ = printed(capsys, "geodesic", *command, "--no-pictures")
    assert "not needed by the direct solver: factors of 1500" in out
    for name in FILES:
        assert f"written: {tmp_path / 'few' / name}" in out


def test_modes_reach_the_solver_that_auto_chooses():
    command = ["geodesic", "demo", "--poisson-rtol", "1e-6"]
    asked = parse([*command, "--solver", "arpack"])[0]
    solver = linear_solver(asked, 96)
    assert solver.choose(100_000_000)[0] == Iterative(modes=96, rtol=1e-6)
    assert why_without_modes(asked, solver, 100_000_000) == ""
    reason = why_without_modes(asked, solver, 100_000)
    assert reason.endswith("factors of 100000 points fit into 4 GiB")
    assert why_without_modes(parse(command)[0], solver, 100) == ""


def test_options_reach_the_method(files, tmp_path, capsys):
    sheet, source = files / "sheet.off", ("--at", 0.3, 0.2, 0)
    fields, steps = {}, {}
    for name, options in {
        "neumann": ("--method", "direct"),
        "dirichlet": ("--heat-boundary", "dirichlet"),
        "average": ("--heat-boundary", "average"),
        "smooth": ("--time-coefficient", 10),
        "rough": ("--method", "plain", "--poisson-rtol", 1e-2),
    }.items():
        found = report(capsys, sheet, *source, *options, "-o", tmp_path / name)
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


def test_the_demo_draws_its_picture(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    out, _ = printed(capsys, "geodesic", "demo", "--points", 500, "--dpi", 40)
    folder = tmp_path / "geodesic"
    assert set(os.listdir(folder)) == FILES | {"field.png"}
    assert "written: geodesic/field.png" in out
    field = exact_distances(creature(500), 0)
    source = json.loads((folder / "report.json").read_text())["sources"][0]["point"]
    assert source == field.argmax()
    assert distances(folder)[source] == 0

    below = []

    def interrupted(*_, page, **__):
        below.append(page.subtitle)
        raise KeyboardInterrupt

    monkeypatch.setattr(show, "plot_distance", interrupted)
    assert main(["geodesic", "demo", "--points", "500", "-o", "other"]) == 130
    out, err = capsys.readouterr()
    kept = "the numbers in other are whole, but not drawn: other/field.png"
    assert (out, err) == ("", f"{kept}\ninterrupted\n")
    assert set(os.listdir("other")) == FILES
    assert main(["geodesic", "demo", "--points", "2500", "-o", "heat"]) == 130
    assert below == [
        "500 points \N{MIDDLE DOT} exact distances",
        "2,500 points \N{MIDDLE DOT} heat method",
    ]


def test_solvers_are_compared(files, tmp_path, capsys):
    out = tmp_path / "out"
    command = ("geodesic", files / "animal.ply", "--source", 0, "--compare", "-k", 31)
    text, _ = printed(capsys, *command, "--dpi", 40, "-o", out)
    assert set(os.listdir(out)) == FILES | {"field.png", "convergence.png"}
    runs = {r["name"]: r for r in json.loads((out / "report.json").read_text())["comparison"]}
    plain = runs["IC(0)"]
    assert len(runs) == 8
    assert "IC(0) + 30 exact modes" in runs
    for name, run in runs.items():
        assert name in text
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


def test_files_of_another_run_are_not_mixed_with_its_own(files, tmp_path, capsys):
    out = tmp_path / "out"
    few = (files / "ball.off", "--source", 0, "--no-pictures", "-o", out)
    for _ in range(2):  # all is replaced
        report(capsys, *few)
    (out / "field.png").write_bytes(b"old")
    left = "got field.png, which would stay beside the new one"
    assert left in refusal(capsys, "geodesic", *few)
    eaten = "not replace an input, got distance.ply"
    assert eaten in refusal(capsys, "geodesic", out / "distance.ply", *few[1:])
    assert (out / "field.png").read_bytes() == b"old"
