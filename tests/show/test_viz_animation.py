"""Films of modes: what swings, how far, and that they close."""

import os
import re
import subprocess
import sys

import imageio.v3 as iio
import imageio_ffmpeg
import numpy as np
import pytest
from conftest import creature
from PIL import Image

from spectra_kit import Dense, eigensolve, robust_laplacian
from spectra_kit.errors import MissingDependencyError
from spectra_kit.geometry import sphere
from spectra_kit.show import View, animate_modes
from spectra_kit.show.animation import _inner_radii, _shifts

SIZE = {"width": 72, "fps": 8.0}  # 16 frames in two seconds
CAPTION = 6  # rows of such a frame


@pytest.fixture(scope="module")
def ball():
    """Long in one direction: its lowest mode tells the ends apart, and stands alone."""
    mesh = sphere(subdivisions=3).geometry
    return mesh.with_points(mesh.points * [1.6, 1.0, 0.9])


@pytest.fixture(scope="module")
def modes(ball):
    return eigensolve(robust_laplacian(ball), 5, Dense())


@pytest.fixture(scope="module")
def film(ball, modes, tmp_path_factory):
    """The frames of two modes, and where they are."""
    path = tmp_path_factory.mktemp("film") / "modes.gif"
    picture = animate_modes(ball, modes, path=path, modes=[1, 2], amplitude=0.05, **SIZE)
    assert picture.path == path
    return path


@pytest.fixture(scope="module")
def frames(film):
    return iio.imread(film).astype(int)


def redness(frames):
    """From -1 for blue to 1 for red, grey being 0."""
    return (frames[..., 0] - frames[..., 2]) / 255


def width_of(frame):
    """Columns that are not white, below the caption."""
    return int((frame[CAPTION:] < 250).any(axis=(0, 2)).sum())


def test_a_film_has_its_frames_its_time_and_no_end(film, frames):
    assert (len(frames), frames.shape[2]) == (32, SIZE["width"])
    with Image.open(film) as gif:  # of 125 milliseconds the nearest number of hundredths
        assert (gif.info["loop"], gif.info["duration"]) == (0, 120)


def test_colours_are_opposite_half_a_swing_later(frames):
    first, middle = redness(frames[0]), redness(frames[8])
    coloured = np.abs(first) > 0.25
    assert coloured.mean() > 0.1
    held = coloured & (np.abs(middle) > 0.25)
    assert held.sum() > 0.5 * coloured.sum()  # the rest has moved
    assert (np.sign(first[held]) == -np.sign(middle[held])).mean() > 0.99
    left, right = first[:, :24], first[:, -24:]
    assert np.sign(left.sum()) == -np.sign(right.sum())  # the mode that tells the ends apart


def test_a_mode_is_at_rest_between_two_modes(frames):
    for rest in (4, 12, 20, 28):  # a quarter before and after each peak
        assert np.abs(redness(frames[rest])).max() < 0.06
    np.testing.assert_allclose(frames[4][CAPTION:], frames[20][CAPTION:], atol=12)
    steps = np.abs(np.diff(frames, axis=0, append=frames[:1])).mean(axis=(1, 2, 3))
    assert steps[-1] == pytest.approx(steps[0], rel=0.3)  # the last flows into the first


def test_points_swing_along_the_normals_inside_one_unmoved_frame(frames):
    """The ends swing in turns, by a twentieth of the diagonal each, and nothing is cut off."""
    centre = [np.flatnonzero((frame[CAPTION:] < 250).any(axis=(0, 2))) for frame in frames]
    ends = np.array([(columns[0], columns[-1]) for columns in centre])
    swing = ends[:16] - ends[4]
    peak, opposite = swing[0], swing[8]
    assert np.sign(peak[0]) == np.sign(peak[1])  # one end out, the other one in
    np.testing.assert_allclose(peak, -opposite, atol=1)
    length = np.linalg.norm([3.2, 2.0, 1.8]) * 0.05  # in the unit of the points
    assert abs(peak[0]) * 3.2 / width_of(frames[4]) == pytest.approx(length, rel=0.35)
    borders = frames[:, CAPTION:][:, [0, -1]], frames[:, CAPTION:, [0, -1]]
    assert all((border == 255).all() for border in borders)


def test_captions_tell_the_mode(frames):
    captions = frames[:, :CAPTION]
    assert (captions < 200).any(axis=(1, 2, 3)).all()
    assert len(np.unique(captions, axis=0)) == 2  # nothing flickers
    same = [np.array_equal(caption, captions[0]) for caption in captions]
    assert same == [True] * 12 + [False] * 16 + [True] * 4


def test_clouds_swing_and_nodal_lines_stand_still(ball, modes, tmp_path):
    path = tmp_path / "cloud.gif"
    told = []
    style = {"seconds_per_mode": 0.5, "nodal_lines": True, "width": 150, "fps": 8}
    style |= {"view": View("z"), "progress": lambda done, total: told.append((done, total))}
    animate_modes(ball.as_cloud(), modes, path=path, modes=[1], amplitude=0.05, **style)
    assert told == [(1, 3), (2, 3), (3, 3)]  # at both ends and at rest
    frames = iio.imread(path).astype(int)
    assert len(frames) == 4
    pictures = frames[:, 12:].max(axis=3)  # below the caption
    line = pictures[1] < 140  # at rest all else is white
    assert line.sum() > 20
    for peak in (0, 2):
        assert (pictures[peak][line] < 170).mean() > 0.6
    ends = np.array([np.flatnonzero((f[12:] < 250).any(axis=(0, 2)))[[0, -1]] for f in frames])
    assert np.abs(ends[0] - ends[2]).min() >= 3


def test_a_film_as_mp4(ball, modes, tmp_path):
    path = tmp_path / "modes.mp4"
    animate_modes(ball, modes, path=path, modes=[1], seconds_per_mode=1, width=71, fps=8)
    decode = [imageio_ffmpeg.get_ffmpeg_exe(), "-i", str(path), "-f", "rawvideo"]
    film = subprocess.run([*decode, "-pix_fmt", "rgb24", "-"], capture_output=True, check=True)
    about = film.stderr.decode()
    width, height = (int(side) for side in re.search(r"h264.* (\d+)x(\d+)", about).groups())
    assert " 8 fps" in about
    frames = np.frombuffer(film.stdout, np.uint8).reshape(-1, height, width, 3).astype(int)
    assert (len(frames), height % 2, width) == (8, 0, 72)
    first, middle = redness(frames[0]), redness(frames[4])
    assert (first * middle < -0.04).sum() > 100 > (first * middle > 0.04).sum()


def test_without_ffmpeg_the_error_names_the_extra(ball, modes, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)  # as if it were not installed
    with pytest.raises(MissingDependencyError) as error:
        animate_modes(ball, modes, path=tmp_path / "modes.mp4")
    assert str(error.value).startswith("MP4 needs imageio-ffmpeg; pip install 'spectra_kit[video]'")
    assert os.listdir(tmp_path) == []


def test_thin_parts_do_not_turn_inside_out():
    mesh = creature(2500, seed=0)
    spectrum = eigensolve(robust_laplacian(mesh), 7)
    functions = [u / np.abs(u).max() for u in spectrum.eigenvectors.T[1:]]
    resting = np.cross(*np.diff(mesh.points[mesh.faces], axis=1).swapaxes(0, 1))
    for shift in _shifts(mesh, functions, 0.01):
        for swing in (1, -1):
            moved = (mesh.points + swing * shift)[mesh.faces]
            faces = np.cross(*np.diff(moved, axis=1).swapaxes(0, 1))
            assert (np.einsum("ij,ij->i", faces, resting) > 0).all()
    assert np.abs(shift).max() > 0.005  # the trunk moves as far as it was asked to


def test_balls_inside_are_as_large_as_there_is_room():
    ball = sphere(radius=2.0, subdivisions=4).geometry
    np.testing.assert_allclose(_inner_radii(ball.points, ball.points / 2, 10.0), 2.0, rtol=1e-6)
    thin = ball.points * [1, 1, 0.05]  # at its poles the radius of curvature is 40, half of it 0.1
    normals = ball.points / [1, 1, 0.05]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    pole = np.abs(ball.points[:, 2]) > 1.99
    np.testing.assert_allclose(_inner_radii(thin, normals, 10.0)[pole], 0.1, rtol=0.05)
