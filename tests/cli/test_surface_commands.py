"""`path`, `curvature` and `smooth`: what they write is what the library says."""

import json
from pathlib import Path

import numpy as np
import pytest
from conftest import bumpy, joined
from running import printed

from spectra_kit import read, spectrum, write
from spectra_kit.cli.entry import main
from spectra_kit.eigen import low_pass
from spectra_kit.geodesics import exact_distances, geodesic_path
from spectra_kit.operators import curvature, smooth


@pytest.fixture
def mesh(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(bumpy(), "bumpy.obj")
    return read("bumpy.obj")


def test_paths_are_written_as_a_table_and_as_lines(mesh, capsys) -> None:
    out, _ = printed(
        *(capsys, "path", "bumpy.obj", "--source", "5", "--to", "100", "600"),
        *("--no-pictures", "-q", "--json"),
    )
    table = np.loadtxt("paths/paths.csv", delimiter=",", skiprows=1)
    for i, target in enumerate((100, 600)):
        path, rows = geodesic_path(mesh, 5, target), table[table[:, 0] == i]
        np.testing.assert_allclose(rows[:, 1:4], path.points, rtol=1e-12)
        np.testing.assert_allclose(rows[:, 4], path.lengths, rtol=1e-12)
        np.testing.assert_array_equal(rows[:, 5], path.faces)
        assert json.loads(out)["paths"][i]["length"] == pytest.approx(path.length)
    lines = [x for x in Path("paths/paths.obj").read_text().splitlines() if x.startswith("l ")]
    assert [len(line.split()) - 1 for line in lines] == [(table[:, 0] == i).sum() for i in (0, 1)]


def test_without_an_end_the_farthest_is_one(mesh, capsys) -> None:
    where = ("--at", *map(str, mesh.points[5]))
    out, _ = printed(capsys, "path", "bumpy.obj", *where, "--no-pictures", "-q", "--json")
    assert json.loads(out)["paths"][0]["length"] == pytest.approx(exact_distances(mesh, 5).max())


def test_curvature_is_written_for_each_point_of_the_file(mesh, capsys) -> None:
    out, _ = printed(capsys, "curvature", "bumpy.obj", "--no-pictures", "-q", "--json")
    bent = curvature(mesh)
    table = np.loadtxt("curvature/curvature.csv", delimiter=",", skiprows=1)
    expected = np.column_stack([bent.mean, bent.gaussian, bent.principal])
    np.testing.assert_allclose(table, expected, rtol=1e-12)
    assert json.loads(out)["quantiles"]["mean"][2] == pytest.approx(np.median(bent.mean))


def test_a_smoother_one_is_written(mesh, capsys) -> None:
    printed(capsys, "smooth", "bumpy.obj", "-o", "flow.npz", "--steps", "2", "--free-volume", "-q")
    expected = smooth(mesh, steps=2, volume="free")
    np.testing.assert_allclose(read("flow.npz").points, expected.points, rtol=1e-12)
    printed(capsys, "smooth", "bumpy.obj", "-o", "low.npz", "--modes", "12", "-q")
    expected = low_pass(mesh, spectrum(mesh, 12))
    np.testing.assert_allclose(read("low.npz").points, expected.points, atol=1e-8)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("path", "bumpy.obj"), "paths need a point to begin at"),
        (("path", "bumpy.obj", "--source", "5", "--to", "700"), "`--to` must be in [0, 642)"),
        (("path", "two.obj", "--source", "5", "--to", "700"), "be reached from a source"),
        (("path", "cloud.xyz", "--source", "5"), "hold faces"),
        (("curvature", "bumpy.obj", "--scale", "-1"), "`--scale` must be positive"),
        (("smooth", "bumpy.obj", "--modes", "9", "--steps", "3"), "--steps has no effect"),
        (("smooth", "bumpy.obj", "-o", "a.png"), "be a .obj or .off"),
    ],
)
def test_they_refuse(mesh, capsys, arguments, told) -> None:
    write(mesh.as_cloud(), "cloud.xyz")
    write(joined(mesh, mesh), "two.obj")
    assert main([*arguments]) == 2
    assert told in capsys.readouterr().err
