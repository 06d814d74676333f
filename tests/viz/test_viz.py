import os
import signal
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from conftest import bumpy
from PIL import Image
from scipy.spatial.transform import Rotation

from spectra_kit import eigensolve, robust_laplacian
from spectra_kit.errors import InvalidInputError, MissingDependencyError
from spectra_kit.geometry import PointCloud, TriangleMesh, rectangle, sphere
from spectra_kit.metrics import compare_spectra
from spectra_kit.viz import Page, Panel, View, drawer, plot_comparison, plot_panels
from spectra_kit.viz.pen import short
from spectra_kit.viz.render import Scene, ball_diameter, render

BLUE_TO_RED = np.column_stack([np.arange(256), np.zeros(256), np.arange(256)[::-1]]).astype("u1")


@pytest.fixture(scope="module")
def ball():
    return sphere(subdivisions=3).geometry


@pytest.fixture(scope="module", autouse=True)
def small_picture(ball):
    try:
        return draw(ball, width=40)
    except MissingDependencyError as error:
        pytest.skip(f"no picture can be drawn here: {error}")


def draw(geometry, *, width=120):
    values = geometry.points / np.abs(geometry.points).max()
    scene = Scene(
        geometry=geometry,
        functions=list(values.T),
        rotation=np.eye(3),
        width=width,
        colours=BLUE_TO_RED,
    )
    return render([scene])[0].astype(float)


def without(fake, tmp_path, monkeypatch):
    """Put a `pyvista` in front of the real one, for new processes only."""
    (tmp_path / "pyvista.py").write_text(fake)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    drawer.end_drawing()


@pytest.mark.parametrize("as_cloud", [False, True])
def test_a_sphere_is_a_disc_with_each_value_at_its_place(ball, as_cloud):
    geometry = ball.as_cloud() if as_cloud else ball
    by_x, by_y, by_z = draw(geometry)
    assert by_x.shape == by_y.shape == by_z.shape
    rows, columns = np.nonzero((by_x < 250).any(axis=2))
    radius = (np.ptp(columns) + 1) / 2
    assert np.ptp(rows) == pytest.approx(np.ptp(columns), abs=2)
    assert radius == pytest.approx(60, abs=6)
    assert len(rows) == pytest.approx(np.pi * radius**2, rel=0.03)

    def redness(picture):
        return picture[..., 0] - picture[..., 2]

    middle, edge = by_x.shape[0] // 2, int(radius * 0.7)
    assert redness(by_x)[middle, 60 + edge] > 50 > -50 > redness(by_x)[middle, 60 - edge]
    assert redness(by_y)[middle - edge, 60] > 50 > -50 > redness(by_y)[middle + edge, 60]
    assert redness(by_z)[middle, 60] > 50  # the near side, not the far one


def test_no_gap_of_a_cloud_shows_its_far_side():
    points = np.random.default_rng(0).normal(size=(400, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    by_z = draw(PointCloud(points))[2]
    rows, columns = np.indices(by_z.shape[:2]) - np.array(by_z.shape[:2])[:, None, None] / 2
    middle = by_z[np.hypot(rows, columns) < 35]
    assert (middle[:, 0] > middle[:, 2] + 40).all()  # red is near, blue far


def test_balls_reach_the_twelfth_neighbour_but_few_points_stay_apart():
    turn = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    ring = PointCloud(np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1))
    twelfth = 2 * np.sin(6 * np.pi / 200)  # six on either side
    for scale in (1, 1e-6):
        scaled = PointCloud(scale * ring.points)
        assert ball_diameter(scaled) == pytest.approx(scale * twelfth)
        assert ball_diameter(PointCloud(scale * ring.points[::10])) == pytest.approx(0.24 * scale)
    assert ball_diameter(PointCloud([[1.0, 2, 3]])) == 0
    assert ball_diameter(rectangle(n=50).geometry) == 0


def test_pictures_are_the_same_twice_and_silent(ball, small_picture, capfd):
    np.testing.assert_array_equal(draw(ball, width=40), small_picture)
    assert capfd.readouterr() == ("", "")


def test_view_is_a_rotation_that_keeps_the_geometry_upright():
    legs = np.array([[x, 0.0, z] for x in (-1, 1) for z in (-0.5, 0.5)])
    body = np.array([[x, 1.0 + y, z] for x in (-0.9, 0.9) for y in (0, 0.5) for z in (-0.3, 0.3)])
    table = PointCloud(np.vstack([legs, body]))
    z_up = PointCloud(table.points[:, [2, 0, 1]])
    for geometry, up in ((table, 1), (z_up, 2)):
        view = View().rotation(geometry)
        np.testing.assert_allclose(view @ view.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(view) == pytest.approx(1)
        assert view[1, up] == pytest.approx(np.cos(np.deg2rad(22)))


def test_nothing_stands_on_a_tip():
    points = np.random.default_rng(0).normal(size=(4000, 3))
    points /= np.abs(points).sum(axis=1, keepdims=True)  # an octahedron,
    blunt = points[points[:, 2] > -0.9]  # its lowest tip along z cut off
    assert View().rotation(PointCloud(blunt))[1, 1] > 0.9
    assert View(up="z").rotation(PointCloud(blunt))[1, 2] > 0.9
    assert View(up="x").rotation(PointCloud(blunt))[1, 0] > 0.9
    assert View().rotation(PointCloud(points[points[:, 2] > -0.3]))[1, 2] > 0.9


def test_what_lies_in_a_plane_is_faced():
    flat = rectangle(n=200).geometry.points
    np.testing.assert_allclose(View().rotation(PointCloud(flat)), np.eye(3), atol=1e-12)
    turn = Rotation.from_euler("xyz", [0.4, 0.3, 0.2]).as_matrix()
    tilted = View().rotation(PointCloud(flat @ turn.T))
    np.testing.assert_allclose(np.abs(tilted[2]), np.abs(turn[:, 2]), atol=1e-12)
    assert np.linalg.det(tilted) == pytest.approx(1)
    for axis in range(3):
        seen = View().rotation(PointCloud(np.roll(flat, axis, axis=1)))
        assert seen[2, (2 + axis) % 3] == pytest.approx(1)


def test_a_turn_takes_the_front_to_the_right():
    points = np.random.default_rng(0).normal(size=(500, 3)) * [1.0, 1.5, 0.6]
    cloud = PointCloud(points)
    flat = PointCloud(rectangle(n=200).geometry.points)
    for geometry, up, axis in ((cloud, "y", 1), (cloud, "z", 2), (flat, None, 1)):
        view = View(up=up).rotation(geometry)
        level = np.cross(view[0], np.eye(3)[axis])  # towards the viewer, and level
        turned = View(up=up, turn=30.0).rotation(geometry)
        np.testing.assert_allclose(turned[:, axis], view[:, axis], atol=1e-12)  # as upright
        assert turned[0] @ level == pytest.approx(0.5)
        np.testing.assert_allclose(View(up=up, turn=360.0).rotation(geometry), view, atol=1e-12)
    with pytest.raises(InvalidInputError, match="`turn` must be a finite number of degrees"):
        View(turn=float("nan"))


def test_a_sheet_is_seen_from_above():
    rough = rectangle(n=200).geometry.points.copy()
    rough[:, 2] = np.maximum(0.01 * np.random.default_rng(0).normal(size=len(rough)), 0)
    assert abs(View().rotation(PointCloud(rough))[2, 2]) > 0.5


@pytest.mark.parametrize("points", [[[0, 0, 0]], [[0, 0, 0], [1, 0, 0]]])
def test_geometries_without_extent_are_drawn(points):
    cloud = PointCloud(points)
    scene = Scene(
        geometry=cloud,
        functions=[np.zeros(cloud.n)],
        rotation=View().rotation(cloud),
        width=30,
        colours=BLUE_TO_RED,
    )
    assert render([scene])[0].shape[0] == 1


def test_comparison_page(tmp_path):
    mesh = bumpy()
    laplacian = robust_laplacian(mesh)
    exact = eigensolve(laplacian, 8)
    path = tmp_path / "modes.png"
    plot_comparison(
        path,
        mesh,
        exact,
        exact,
        compare_spectra(exact, exact),
        modes=[0, 3],
        page=Page("A title far too long for one page " * 6, "below", dpi=50),
    )
    with Image.open(path) as image:
        page = np.asarray(image.convert("RGB"))
    assert page.shape[1] <= 11 * 50
    assert (page[:3] == 255).all()  # nothing touches
    assert (page[-3:] == 255).all()  # the border,
    assert (page[:, :3] == 255).all()  # long titles
    assert (page[:, -3:] == 255).all()  # included
    assert (page < 200).any()
    assert os.listdir(tmp_path) == ["modes.png"]


def test_wide_geometries_stand_in_rows_tall_ones_in_columns(tmp_path):
    def aspect(stretch):
        points = sphere(subdivisions=1).geometry.points * stretch
        panel = Panel(values=points[:, 0], limit=1.0)
        plot_panels(
            tmp_path / "x.png",
            PointCloud(points),
            [[panel] * 3] * 5,
            rows_named=[*"12345"],
            columns_named=[*"abc"],
            page=Page(dpi=20),
        )
        with Image.open(tmp_path / "x.png") as page:
            return page.width / page.height

    for stretch in ([1, 1, 8], [1, 4, 1]):
        assert 0.5 < aspect(stretch) < 2


@pytest.mark.parametrize(
    ("value", "text"),
    [(0, "0"), (2, "2.0"), (0.0361, "0.036"), (12.4, "12"), (3.64e-5, "3.6e-5"), (12345, "1.2e4")],
)
def test_short_numbers(value, text):
    assert short(value) == text


def one_panel(path, geometry, values, **options):
    panel = Panel(values=values, limit=1.0)
    named = {"rows_named": ["r"], "columns_named": ["c"]}
    plot_panels(path, geometry, [[panel]], **named, page=Page(dpi=20), **options)


def test_bad_input_is_refused(tmp_path, ball):
    good = np.zeros(ball.n)
    with pytest.raises(
        InvalidInputError, match=r"`path` must end in .png, .pdf or .svg, got 'modes.jpg'"
    ):
        one_panel("modes.jpg", ball, good)
    with pytest.raises(InvalidInputError, match=r"`values` must have shape \(642,\), got \(3,\)"):
        one_panel(tmp_path / "x.png", ball, good[:3])
    with pytest.raises(InvalidInputError, match=r"`values` must be finite"):
        one_panel(tmp_path / "x.png", ball, good * np.nan)
    with pytest.raises(InvalidInputError, match=r"the folder .* does not exist"):
        one_panel(tmp_path / "no" / "x.png", ball, good)
    panel = Panel(values=good, limit=1.0)
    for rows, names in (([], "a"), ([[panel]], "ab"), ([[]], "")):
        with pytest.raises(InvalidInputError, match=r"`rows` must be a table of \d columns"):
            plot_panels(tmp_path / "x.png", ball, rows, rows_named=["r"], columns_named=[*names])


def test_modes_out_of_range_are_refused(tmp_path, ball):
    exact = eigensolve(robust_laplacian(ball), 4)
    comparison = compare_spectra(exact, exact)
    with pytest.raises(InvalidInputError, match=r"`modes` must be in \[0, 3\], got 4"):
        plot_comparison(tmp_path / "x.png", ball, exact, exact, comparison, modes=[4])
    other = TriangleMesh(ball.points[:3], [[0, 1, 2]])
    with pytest.raises(InvalidInputError, match=r"`geometry` must have the 642 points"):
        plot_comparison(tmp_path / "x.png", other, exact, exact, comparison, modes=[1])


@pytest.mark.parametrize(
    ("fake", "message"),
    [
        (
            "raise ImportError('libGL.so.1: cannot open')",
            r"\(ImportError: libGL.so.1.* apt-get",
        ),
        ("import os; os.abort()", r"could not draw \(it crashed\).* apt-get install libegl1"),
    ],
)
def test_a_machine_without_opengl_gets_an_error_and_keeps_its_picture(
    ball, tmp_path, monkeypatch, fake, message
):
    picture = tmp_path / "x.png"
    picture.write_text("the old one")
    without(fake, tmp_path, monkeypatch)
    with pytest.raises(MissingDependencyError, match=message):
        one_panel(picture, ball, np.zeros(ball.n))
    assert picture.read_text() == "the old one"


@pytest.mark.parametrize(
    ("raised", "error", "told"),
    [
        ("MemoryError('no room for colours')", MemoryError, r"^no room for colours"),
        ("Odd('no room', 3)", RuntimeError, r"^Odd\('no room'\)"),  # it cannot be unpickled
    ],
)
def test_an_error_in_the_process_that_draws_comes_out_as_itself(
    ball, tmp_path, monkeypatch, raised, error, told
):
    """It is no sign of a missing library, and nobody is sent to install one."""
    monkeypatch.delenv("VTK_DEFAULT_OPENGL_WINDOW", raising=False)
    fake = f"""
import os
class Odd(Exception):
    def __init__(self, text, number):
        super().__init__(text)
def Color(name):
    raise {raised}
class Plotter:
    def __init__(self, **_): ...
"""
    without(fake, tmp_path, monkeypatch)
    with pytest.raises(error, match=told) as caught:
        one_panel(tmp_path / "x.png", ball, np.zeros(ball.n))
    (note,) = caught.value.__notes__
    assert note.startswith("It was raised in the process that draws:\nTraceback")
    assert "in Color" in note
    assert not (tmp_path / "x.png").exists()


def test_one_process_draws_all_pictures_until_it_dies(ball, tmp_path, monkeypatch):
    processes = []

    class Recorded(subprocess.Popen):
        def __init__(self, *arguments, **options):
            super().__init__(*arguments, **options)
            processes.append(self)

    monkeypatch.setattr(subprocess, "Popen", Recorded)
    drawer.end_drawing()
    first, again = (draw(ball)[0] for _ in range(2))
    assert np.array_equal(first, again)
    assert len(processes) == 1
    processes[0].kill()
    assert np.array_equal(draw(ball)[0], first)

    def interrupt(done, total):
        raise KeyboardInterrupt

    by_x = [ball.points[:, 0]]
    scene = Scene(
        geometry=ball, functions=by_x * 9, rotation=np.eye(3), width=60, colours=BLUE_TO_RED
    )
    with pytest.raises(KeyboardInterrupt):
        render([scene], progress=interrupt)
    assert processes[-1].wait(10) == -signal.SIGKILL
    assert np.array_equal(draw(ball)[0], first)
    n = len(processes)
    with pytest.raises(IndexError, match="out of bounds") as caught:
        render([replace(scene, functions=[np.zeros(5)])])
    assert len(processes) == n  # no other way to draw was tried
    assert "in the process that draws" in caught.value.__notes__[0]
    assert np.array_equal(draw(ball)[0], first)
    drawer.end_drawing()
    assert [process.poll() is None for process in processes] == [False] * len(processes)
