"""What draws, from where, and what is refused."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from drawing import BALL, SPECTRUM, SQUARE, borders_are_white, can_draw, draw, page  # noqa: F401
from scipy.spatial.transform import Rotation

from spectra_kit import show
from spectra_kit.eigen.metrics import compare_spectra
from spectra_kit.errors import InvalidInputError, MissingDependencyError
from spectra_kit.geometry import PointCloud, TriangleMesh, creature, rectangle, sphere, write
from spectra_kit.maps import MapErrors
from spectra_kit.show import Page, Panel, View, render
from spectra_kit.show.layout import short
from spectra_kit.show.render import ball_diameter

SHEET = rectangle(n=200).geometry.points
ONES, SAME = np.ones(BALL.n), np.arange(BALL.n)
PANEL = Panel(values=ONES, limit=1.0)
PAIR = show.MatchedPair(source=BALL, target=BALL, point_map=SAME)
TIMES = np.arange(1.0, 9)
SIGNATURE = np.ones((BALL.n, 8))
RUN = show.SolverRun(name="CG", stages={}, times=[0, 1], residuals=[1.0, 0.1])
several = partial(show.plot_spectrum, spectra={"a": SPECTRUM, "b": SPECTRUM.rescale(2)})
EMPTY = SPECTRUM.truncate(1).nonzero()


modes = partial(show.plot_modes, geometry=BALL, spectrum=SPECTRUM)
comparison = partial(
    show.plot_comparison,
    geometry=BALL,
    exact=SPECTRUM,
    predicted=SPECTRUM,
    comparison=compare_spectra(SPECTRUM, SPECTRUM),
    modes=[1],
)
fields = partial(show.plot_fields, geometry=BALL, fields={"a": ONES})
panels = partial(
    show.plot_panels, geometry=BALL, rows=[[PANEL]], rows_named=["a"], columns_named=["b"]
)
distance = partial(show.plot_distance, geometry=BALL, distance=ONES)
match = partial(show.plot_correspondence, source=BALL, target=BALL, point_map=SAME)
matches = partial(show.plot_correspondences, pairs=[PAIR])
signatures = partial(
    show.plot_signatures, geometry=BALL, signature=SIGNATURE, scales=TIMES, points=[0]
)
film = partial(show.animate_modes, geometry=BALL, spectrum=SPECTRUM)
convergence = partial(show.plot_convergence, runs=[RUN])


class TurnedError(Exception):
    """Raised by the camera."""


class Turned(View):
    def rotation(self, geometry):
        assert geometry is BALL
        raise TurnedError


@pytest.mark.parametrize(
    "plot", [modes, comparison, fields, panels, distance, match, matches, signatures, film]
)
def test_a_view_reaches_the_camera(plot):
    with pytest.raises(TurnedError):
        plot(view=Turned())


@pytest.mark.parametrize(
    ("plot", "arguments", "argument", "expected", "got"),
    [
        (panels, {"rows": [[Panel(values=ONES[:3], limit=1.0)]]}, "values", r"\(642,\)", "3"),
        (panels, {"rows": []}, "rows", "table of 1 columns", ""),
        (panels, {"columns_named": ["a", "b"]}, "rows", "table of 2 columns", r"\[1\]"),
        (panels, {"rows_named": ["a", "b"]}, "rows_named", "1 names", "2"),
        (comparison, {"modes": [9]}, "modes", r"in \[0, 8\]", "9"),
        (modes, {"modes": []}, "modes", "at least one mode", "none"),
        (modes, {"geometry": SQUARE}, "geometry", "the 642 points", "4"),
        (modes, {"path": "modes.jpg"}, "path", "end in .png, .pdf or .svg", "'modes.jpg'"),
        (fields, {"fields": {}}, "fields", "at least one function", "none"),
        (fields, {"fields": ONES}, "fields", "mapping of names", "ndarray"),
        (fields, {"fields": {"a": ONES[:4]}}, r"fields\['a'\]", r"\(642,\)", "4"),
        (distance, {"distance": -ONES}, "distance", "one number >= 0", "642 negative"),
        (distance, {"spacing": 1e-3}, "spacing", "at least 0.005", "0.001"),
        (match, {"point_map": SAME[:5]}, "point_map", r"\(642,\)", r"\(5,\); are .* exchanged"),
        (match, {"errors": ONES}, "errors", "MapErrors or None", ".*not say at which points"),
        (matches, {"pairs": []}, "pairs", "at least one MatchedPair", "none"),
        (show.plot_error_curves, {"errors": {}}, "errors", "at least one method", "none"),
        (convergence, {"runs": []}, "runs", "at least one SolverRun", "none"),
        (show.plot_spectrum, {"spectra": {}}, "spectra", "at least one Spectrum", "none"),
        (show.plot_spectrum, {"spectra": {"a": BALL}}, "spectra", "names to Spectrum", "a dict"),
        (show.plot_spectrum, {"spectra": {"b": EMPTY}}, "spectra", "have modes", "none in 'b'"),
        (several, {"free_boundary": 1}, "free_boundary", "of one surface", "1 for .* areas"),
        (signatures, {"scales": TIMES[::-1]}, "scales", "two or more ascending", ""),
        (signatures, {"scales": TIMES - 1}, "scales", "positive times", ".*say kind='wave'"),
        (signatures, {"points": [1, 1]}, "points", "one to 9 different", r"\[1, 1\]"),
        (signatures, {"shown": np.empty(0, int)}, "shown", "one to 9 different", r"\[\]"),
        (film, {"fps": 1e6}, "fps", "at most 20,000 frames", ""),
        (partial(replace, RUN), {"times": [0.0]}, "times", "ascending", r"shapes \(1,\) and \(2,"),
        (partial(replace, RUN), {"times": [1, 0]}, "times", "ascending", ""),
    ],
)
def test_bad_input_is_refused_before_anything_is_drawn(plot, arguments, argument, expected, got):
    with pytest.raises(InvalidInputError, match=rf"`{argument}` must .*{expected}.*, got .*{got}"):
        plot(**arguments)


@pytest.mark.parametrize("as_cloud", [False, True])
def test_a_sphere_is_a_disc_with_each_value_at_its_place(as_cloud):
    by_x, by_y, by_z = draw(BALL.as_cloud() if as_cloud else BALL)
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
    ring = 1e-6 * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    assert ball_diameter(PointCloud(ring)) == pytest.approx(2e-6 * np.sin(6 * np.pi / 200))
    assert ball_diameter(PointCloud(ring[::10])) == pytest.approx(0.24e-6)
    assert ball_diameter(PointCloud([[1.0, 2, 3]])) == ball_diameter(SQUARE) == 0


def test_a_view_is_a_rotation_that_keeps_the_geometry_upright():
    legs = np.array([[x, 0.0, z] for x in (-1, 1) for z in (-0.5, 0.5)])
    body = np.array([[x, 1.0 + y, z] for x in (-0.9, 0.9) for y in (0, 0.5) for z in (-0.3, 0.3)])
    table = np.vstack([legs, body])
    for points, up in ((table, 1), (table[:, [2, 0, 1]], 2)):
        view = View().rotation(PointCloud(points))
        np.testing.assert_allclose(view @ view.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(view) == pytest.approx(1)
        assert view[1, up] == pytest.approx(np.cos(np.deg2rad(22)))


def test_nothing_stands_on_a_tip_and_a_sheet_is_seen_from_above():
    points = np.random.default_rng(0).normal(size=(4000, 3))
    points /= np.abs(points).sum(axis=1, keepdims=True)  # an octahedron,
    blunt = PointCloud(points[points[:, 2] > -0.9])  # its lowest tip along z cut off
    for up, axis in ((None, 1), ("z", 2), ("x", 0)):
        assert View(up).rotation(blunt)[1, axis] > 0.9
    for up, axis in (("-x", 0), ("-y", 1), ("-z", 2)):
        view = View(up).rotation(blunt)
        assert view[1, axis] < -0.9
        assert np.linalg.det(view) == pytest.approx(1)
    assert View().rotation(PointCloud(points[points[:, 2] > -0.3]))[1, 2] > 0.9
    rough = SHEET.copy()
    rough[:, 2] = np.maximum(0.01 * np.random.default_rng(0).normal(size=len(rough)), 0)
    assert abs(View().rotation(PointCloud(rough))[2, 2]) > 0.5


def test_what_lies_in_a_plane_is_faced():
    np.testing.assert_allclose(View().rotation(PointCloud(SHEET)), np.eye(3), atol=1e-12)
    turn = Rotation.from_euler("xyz", [0.4, 0.3, 0.2]).as_matrix()
    tilted = View().rotation(PointCloud(SHEET @ turn.T))
    np.testing.assert_allclose(np.abs(tilted[2]), np.abs(turn[:, 2]), atol=1e-12)
    assert np.linalg.det(tilted) == pytest.approx(1)
    for axis in range(3):
        seen = View().rotation(PointCloud(np.roll(SHEET, axis, axis=1)))
        assert seen[2, (2 + axis) % 3] == pytest.approx(1)


def test_a_turn_takes_the_front_to_the_right():
    points = np.random.default_rng(0).normal(size=(500, 3)) * [1.0, 1.5, 0.6]
    for shape, up, axis in (
        (points, "y", 1),
        (points, "z", 2),
        (SHEET, None, 1),
        (points, "-y", 1),
    ):
        geometry = PointCloud(shape)
        view = View(up).rotation(geometry)
        level = np.cross(
            view[0], np.sign(view[1, axis]) * np.eye(3)[axis]
        )  # towards the viewer, and level
        turned = View(up, turn=30.0).rotation(geometry)
        np.testing.assert_allclose(turned[:, axis], view[:, axis], atol=1e-12)  # as upright
        assert turned[0] @ level == pytest.approx(0.5)
        np.testing.assert_allclose(View(up, 360.0).rotation(geometry), view, atol=1e-12)


def test_geometries_without_extent_are_drawn():
    for points in ([[0, 0, 0]], [[0, 0, 0], [1, 0, 0]]):
        cloud = PointCloud(points)
        rotation = View().rotation(cloud)
        assert len(draw(cloud, [np.zeros(cloud.n)], rotation=rotation, width=30)) == 1


@pytest.mark.parametrize(
    ("name", "plot"),
    [
        ("modes.png", partial(comparison, modes=[0, 3])),
        ("match.png", partial(match, errors=MapErrors(np.linspace(0, 10, BALL.n - 9), SAME[9:]))),
        ("hks.png", partial(signatures, signature=SIGNATURE + TIMES, shown=[1, 4, 6])),
        ("runs.png", convergence),
    ],
)
def test_pages_keep_their_margins(tmp_path, name, plot):
    found = plot(path=tmp_path / name, page=Page("Far too long for one page " * 9, "below", 50))
    assert found.path == tmp_path / name
    picture = page(found.path)
    assert picture.shape[1] <= 12 * 50
    assert borders_are_white(picture)
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_wide_geometries_stand_in_rows_tall_ones_in_columns(tmp_path):
    points = sphere(subdivisions=1).geometry.points
    for stretch in ([1, 1, 8], [1, 4, 1]):
        panel, style = Panel(values=points[:, 0], limit=1.0), {"columns_named": [*"abc"]}
        path, cloud = tmp_path / "x.png", PointCloud(points * stretch)
        style |= {"rows_named": [*"12345"], "page": Page(dpi=20)}
        show.plot_panels(cloud, [[panel] * 3] * 5, path=path, **style)
        height, width, _ = page(path).shape
        assert 0.5 < width / height < 2


@pytest.mark.parametrize(
    ("value", "text"),
    [(0, "0"), (2, "2.0"), (0.0361, "0.036"), (12.4, "12"), (3.64e-5, "3.6e-5"), (12345, "1.2e4")],
)
def test_short_numbers(value, text):
    assert short(value) == text


def test_a_geometry_may_be_a_file_and_so_may_the_picture(tmp_path):
    lone = TriangleMesh(SQUARE.points[:3], [[0, 1, 2]])
    write(lone, mesh := tmp_path / "lone.obj")
    options = {"fields": {"x": lone.points[:, 0]}, "page": Page(dpi=30)}
    path = tmp_path / "x.png"
    assert show.plot_fields(mesh, **options).content.startswith(b"\x89PNG")
    assert show.plot_fields(geometry=mesh, path=path, **options).path == path
    assert path.read_bytes().startswith(b"\x89PNG")
    with pytest.raises(InvalidInputError, match="`path` must be a string, path or None, got a Tri"):
        show.plot_modes(lone, SPECTRUM, path=lone)
    with pytest.raises(InvalidInputError, match=r"the folder .* does not exist"):
        modes(path=tmp_path / "no" / "modes.png", view=Turned())


PLOTTER = """
class Odd(Exception):
    def __init__(self, text, number):
        super().__init__(text)
def Color(name):
    raise {}
class Plotter:
    def __init__(self, **_): ...
"""


@pytest.mark.parametrize(
    ("fake", "error", "told", "note"),
    [
        (
            r"import os; os.write(2, b'\xff\n'); raise ImportError('no GL')",
            MissingDependencyError,
            r"\(ImportError: no GL",
            "",
        ),
        (
            "import os; os.abort()",
            MissingDependencyError,
            r"could not draw \(it crashed\).* apt-get install libegl1",
            "",
        ),
        # No sign of a missing library: nobody is sent to install one.
        (PLOTTER.format("MemoryError('no room')"), MemoryError, "^no room", "in Color"),
        # It cannot be unpickled.
        (PLOTTER.format("Odd('no room', 3)"), RuntimeError, r"^Odd\('no room'\)", "in Color"),
    ],
)
def test_what_fails_in_the_process_that_draws_is_told_and_the_picture_kept(
    tmp_path, monkeypatch, fake, error, told, note
):
    picture = tmp_path / "x.png"
    picture.write_text("the old one")
    (tmp_path / "pyvista.py").write_text(fake)  # in front of the real one, for new processes only
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    render.end_drawing()
    with pytest.raises(error, match=told) as caught:
        panels(path=picture)
    render.end_drawing()
    assert picture.read_text() == "the old one"
    notes = "".join(getattr(caught.value, "__notes__", ()))
    assert note in notes
    assert bool(note) == notes.startswith("It was raised in the process that draws:\nTraceback")


def test_one_process_draws_all_pictures_until_it_dies(monkeypatch):
    first = draw(BALL)[0]
    running = render._of_this_process().renderer._process

    def interrupt(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        film(modes=[1], amplitude=0.0, width=60, progress=interrupt)
    assert running.wait(10) == -signal.SIGKILL
    processes = []

    class Recorded(subprocess.Popen):
        def __init__(self, *arguments, **options):
            super().__init__(*arguments, **options)
            processes.append(self)

    monkeypatch.setattr(subprocess, "Popen", Recorded)
    assert all(np.array_equal(draw(BALL)[0], first) for _ in range(2))
    assert len(processes) == 1
    processes[0].kill()
    assert np.array_equal(draw(BALL)[0], first)
    with pytest.raises(IndexError, match="out of bounds") as caught:
        draw(BALL, [np.zeros(5)])
    assert "in the process that draws" in caught.value.__notes__[0]
    assert np.array_equal(draw(BALL)[0], first)
    assert len(processes) == 2  # it goes on
    render.end_drawing()
    assert [process.poll() is None for process in processes] == [False] * 2


def test_a_signal_while_another_process_draws_ends_this_one_by_it(tmp_path):
    """Not by an error of the pipe that it is reading."""
    begun = tmp_path / "begun"
    slow = f"import pathlib, time; pathlib.Path({str(begun)!r}).touch(); time.sleep(60)"
    (tmp_path / "pyvista.py").write_text(slow)
    paths = os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])
    code = (
        "from spectra_kit import show; from spectra_kit.geometry import sphere\n"
        "ball = sphere(subdivisions=1).geometry\n"
        f"show.plot_fields(ball, {{'x': ball.points[:, 0]}}, path={str(tmp_path / 'x.png')!r})"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code],
        env=os.environ | {"PYTHONPATH": paths},
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        while not begun.exists():
            assert process.poll() is None
            time.sleep(0.05)
        process.send_signal(signal.SIGTERM)
        assert process.communicate(timeout=30)[1] == ""
    assert process.returncode == -signal.SIGTERM


DRAWS = """
import sys
from spectra_kit import Spectrum, show
import numpy as np
spectrum = Spectrum(np.array([0.0, 1.0]), np.eye(2), np.ones(2))
assert "matplotlib" not in sys.modules
show.plot_spectrum(spectrum, path=sys.argv[1])
show.colours.error_colours(np.ones(3), 1.0)
import matplotlib
print(dict.__getitem__(matplotlib.rcParams, "backend"))
"""


def test_pictures_leave_the_backend_as_it_is(tmp_path):
    environment = os.environ | {"MPLBACKEND": "svg"}
    run = subprocess.run(
        [sys.executable, "-c", DRAWS, str(tmp_path / "a.png")], env=environment, text=True,
        capture_output=True, check=True,
    )  # fmt: skip
    assert (tmp_path / "a.png").stat().st_size > 1000
    assert run.stdout.strip().lower() == "svg"


def test_a_backend_that_was_chosen_stays(tmp_path):
    matplotlib = pytest.importorskip("matplotlib")
    with matplotlib.rc_context({"backend": "svg"}):
        show.plot_spectrum(SPECTRUM, path=tmp_path / "a.png")
        assert matplotlib.rcParams["backend"] == "svg"


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("up", ["y", "z", "-y"])
def test_an_animal_stands_on_its_feet_and_comes_with_its_head(seed, up):
    # Creatures stand on z = 0 and look along x.
    animal = creature(600, seed=seed)
    sign, axis = (-1 if up.startswith("-") else 1), "xyz".index(up[-1])
    turned = np.zeros((3, 3))
    turned[:, axis] = np.eye(3)[2] * sign
    turned[:, (axis + 1) % 3], turned[:, (axis + 2) % 3] = np.eye(3)[0], np.eye(3)[1] * sign
    rotation = View().rotation(animal.with_points(animal.points @ turned)) @ turned.T
    assert rotation[1, 2] > 0.9
    assert rotation[2, 0] > 0


@pytest.mark.data
def test_most_animals_that_lie_on_their_backs_are_turned_over(real_shapes):
    # SMAL's feet point along y.
    folder = real_shapes.parent / "smal_r"
    upright = []
    for path in sorted(folder.glob("*.npz"))[::3]:
        with np.load(path) as data:
            upright.append(View().rotation(TriangleMesh(data["V"], data["F"]))[1, 1] < -0.9)
    assert np.mean(upright) > 0.5


def test_a_mesh_is_drawn_plain_and_from_where_it_is_asked(tmp_path, monkeypatch):
    monkeypatch.setattr("spectra_kit.show.thumbnails._WIDEST", 0.3)  # inches: a vertex to a pixel
    animal = creature(600)
    first, other = (
        animal.plot(tmp_path / f"{name}.png", view=view).path.read_bytes()
        for name, view in (("a", None), ("b", View("z", turn=90)))
    )
    assert first != other


def test_fields_that_are_known_nowhere_or_infinite_are_refused():
    mesh = sphere(subdivisions=1).geometry
    for wrong in (np.full(mesh.n, np.nan), np.where(np.arange(mesh.n) == 3, np.inf, 1.0)):
        with pytest.raises(InvalidInputError, match="be finite") as caught:
            show.plot_fields(mesh, {"mean curvature": wrong})
        assert caught.value.argument == "fields['mean curvature']"
