"""What tests of pictures share: whether anything can be drawn, and how pictures are read."""

import numpy as np
import pytest
from PIL import Image

from spectra_kit import eigensolve, robust_laplacian
from spectra_kit.errors import MissingDependencyError
from spectra_kit.geometry import TriangleMesh, sphere
from spectra_kit.show.render import Scene, render

BALL = sphere(subdivisions=3).geometry
SPECTRUM = eigensolve(robust_laplacian(BALL), 9)
# Two triangles.
SQUARE = TriangleMesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
BLUE_TO_RED = np.column_stack([np.arange(256), np.zeros(256), np.arange(256)[::-1]]).astype("u1")


def draw(geometry, functions=None, *, width=120, rotation=None, **options):
    """The pictures of a geometry, by default of its coordinates."""
    if functions is None:
        functions = list((geometry.points / np.abs(geometry.points).max()).T)
    rotation = np.eye(3) if rotation is None else rotation
    style = {"colours": BLUE_TO_RED} | options
    scene = Scene(geometry=geometry, functions=functions, rotation=rotation, width=width, **style)
    return render([scene])[0].astype(float)


@pytest.fixture(scope="session", autouse=True)
def can_draw():
    """Skips everything where no picture can be drawn."""
    try:
        draw(SQUARE, width=20)
    except MissingDependencyError as error:
        pytest.skip(f"no picture can be drawn here: {error}")


def page(path):
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB")).astype(int)


def borders_are_white(picture, width=2):
    inner = np.zeros(picture.shape[:2], dtype=bool)
    inner[width:-width, width:-width] = True
    return (picture[~inner] == 255).all() and (picture[inner] < 200).any()


def grey(colours):
    return np.asarray(colours, float) @ [0.299, 0.587, 0.114]
