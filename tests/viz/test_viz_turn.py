"""Every picture of a geometry can be turned."""

import numpy as np
import pytest

from spectra_kit import Dense, eigensolve, robust_laplacian
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import sphere
from spectra_kit.metrics import compare_spectra
from spectra_kit.viz import (
    MatchedPair,
    Panel,
    animate_modes,
    plot_comparison,
    plot_correspondence,
    plot_correspondences,
    plot_distance,
    plot_fields,
    plot_modes,
    plot_panels,
    plot_signatures,
)

BALL = sphere(subdivisions=1).geometry
SAME, ONES = np.arange(BALL.n), np.ones(BALL.n)


@pytest.fixture(scope="module")
def found():
    return eigensolve(robust_laplacian(BALL), 4, Dense())


@pytest.mark.parametrize(
    "draw",
    [
        lambda to, s, **o: plot_modes(f"{to}.png", BALL, s, **o),
        lambda to, s, **o: plot_comparison(
            f"{to}.png", BALL, s, s, compare_spectra(s, s), modes=[1], **o
        ),
        lambda to, s, **o: plot_fields(f"{to}.png", BALL, {"one": ONES}, **o),
        lambda to, s, **o: plot_panels(
            *(f"{to}.png", BALL, [[Panel(values=ONES, limit=1.0)]]),
            rows_named=["a"],
            columns_named=["b"],
            **o,
        ),
        lambda to, s, **o: plot_distance(f"{to}.png", BALL, ONES, **o),
        lambda to, s, **o: plot_correspondence(f"{to}.png", BALL, BALL, SAME, **o),
        lambda to, s, **o: plot_correspondences(
            f"{to}.png", [MatchedPair(source=BALL, target=BALL, point_map=SAME)], **o
        ),
        lambda to, s, **o: plot_signatures(
            f"{to}.png", BALL, np.stack([ONES, ONES], axis=1), [1.0, 2.0], points=[0], **o
        ),
        lambda to, s, **o: animate_modes(f"{to}.gif", BALL, s, **o),
    ],
)
def test_a_turn_reaches_the_camera(tmp_path, found, draw):
    with pytest.raises(InvalidInputError, match="`turn` must be a number, got"):
        draw(tmp_path / "x", found, turn=np.nan)
    assert not list(tmp_path.iterdir())
