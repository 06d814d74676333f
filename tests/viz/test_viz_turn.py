"""Every picture of a geometry can be turned."""

import numpy as np
import pytest

from spectra_kit import Dense, eigensolve, robust_laplacian, viz
from spectra_kit.geometry import sphere
from spectra_kit.metrics import compare_spectra

BALL = sphere(subdivisions=1).geometry
SAME, ONES = np.arange(BALL.n), np.ones(BALL.n)
PANEL = viz.Panel(values=ONES, limit=1.0)
PAIR = viz.MatchedPair(source=BALL, target=BALL, point_map=SAME)


class TurnedError(Exception):
    """Raised by the camera."""


class Turned(viz.View):
    def rotation(self, geometry):
        assert geometry is BALL
        raise TurnedError


@pytest.mark.parametrize(
    "draw",
    [
        lambda s, **o: viz.plot_modes(BALL, s, **o),
        lambda s, **o: viz.plot_comparison(BALL, s, s, compare_spectra(s, s), modes=[1], **o),
        lambda s, **o: viz.plot_fields(BALL, {"one": ONES}, **o),
        lambda s, **o: viz.plot_panels(BALL, [[PANEL]], rows_named=["a"], columns_named=["b"], **o),
        lambda s, **o: viz.plot_distance(BALL, ONES, **o),
        lambda s, **o: viz.plot_correspondence(BALL, BALL, SAME, **o),
        lambda s, **o: viz.plot_correspondences([PAIR], **o),
        lambda s, **o: viz.plot_signatures(
            BALL, np.stack([ONES, ONES], axis=1), [1.0, 2.0], points=[0], **o
        ),
        lambda s, **o: viz.animate_modes(BALL, s, **o),
    ],
)
def test_a_view_reaches_the_camera(draw):
    found = eigensolve(robust_laplacian(BALL), 4, Dense())
    with pytest.raises(TurnedError):
        draw(found, view=Turned())
