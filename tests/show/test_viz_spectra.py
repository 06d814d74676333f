"""Diagrams of spectra, signatures and methods: every mark lies where the numbers are."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import two_parts
from drawing import BALL, can_draw  # noqa: F401
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from spectra_kit import Dense, Spectrum, eigensolve, robust_laplacian, verify
from spectra_kit.features import (
    heat_kernel_signature,
    heat_times,
    wave_energies,
    wave_kernel_signature,
)
from spectra_kit.show import Page, Panel, View, plot_spectrum
from spectra_kit.show.layout import LINE_COLOURS
from spectra_kit.show.signatures import _pictures, draw_curves
from spectra_kit.show.spectra import weyl_law

LAPLACIAN = robust_laplacian(BALL)
EXACT = eigensolve(LAPLACIAN, 16, Dense())


@pytest.fixture(scope="module")
def rough():
    """Each mode mixed with a little noise: near true ones, not true."""
    noise = np.random.default_rng(0).standard_normal((EXACT.n, EXACT.k))
    basis = EXACT.eigenvectors + 0.02 * noise
    ortho = np.linalg.qr(np.sqrt(EXACT.mass)[:, None] * basis)[0] / np.sqrt(EXACT.mass)[:, None]
    values, turn = np.linalg.eigh(ortho.T @ (LAPLACIAN.stiffness @ ortho))
    return Spectrum(np.maximum(values, 0.0), ortho @ turn, EXACT.mass).certify(LAPLACIAN)


def figure_of(*spectra, **options):
    named = {f"spectrum {i}": spectrum for i, spectrum in enumerate(spectra)}
    return plot_spectrum.__wrapped__(named, page=Page("title", dpi=50), **options)


def markers(panel, colour):
    """The points (number, value) that are drawn in a colour."""
    lines = [x for x in panel.lines if x.get_linestyle() == "None" and x.get_color() == colour]
    points = np.vstack([line.get_xydata() for line in lines])
    return points[np.argsort(points[:, 0])]


def bars(panel):
    """The ends (k, 2) of the bars of each certified spectrum."""
    return [
        np.array([segment[:, 1] for segment in collection.get_segments()])
        for collection in panel.collections
    ]


def test_markers_lie_at_the_eigenvalues(rough):
    panel = figure_of(EXACT, rough).axes[0]
    for spectrum, colour in zip((EXACT, rough), LINE_COLOURS, strict=False):
        points = markers(panel, colour)
        np.testing.assert_array_equal(points[:, 0], np.arange(16))
        np.testing.assert_array_equal(points[:, 1], spectrum.eigenvalues)
    first, second = (line for line in panel.lines if line.get_linestyle() == "None")
    assert first.get_markersize() < second.get_markersize()  # where they coincide, both show
    assert second.get_markerfacecolor() == "none"
    assert "[1/length²]" in panel.get_ylabel()


def test_bars_hold_true_eigenvalues_and_end_at_zero(rough):
    panel = figure_of(rough).axes[0]
    true, residuals = EXACT.eigenvalues, rough.certificate.residuals
    (ends,) = bars(panel)
    for low, high in ends:
        assert low >= 0
        assert ((low <= true) & (true <= high)).any()
    np.testing.assert_allclose(ends[:, 1], rough.eigenvalues + residuals)
    assert rough.eigenvalues[1] < residuals[1]  # so that the end at zero was put to the test
    beyond = (rough.eigenvalues + residuals > 1.5 * rough.eigenvalues[-1]).sum()
    assert beyond > 0
    assert f"({beyond} bars leave the panel)" in panel.get_legend().get_texts()[-1].get_text()


def test_weyls_law_of_the_sphere(rough):
    """lambda = l (l + 1) up to the number (l + 1)^2: the line passes through every shell."""
    panel = figure_of(EXACT, rough).axes[0]
    [line] = [line for line in panel.lines if line.get_linestyle() == "--"]
    (start, begin), (end, height) = line.get_xydata()
    assert (start, begin) == (0, 0)
    assert height / end == pytest.approx(4 * np.pi / EXACT.area)
    shells = np.repeat([0, 2, 6, 12], [1, 3, 5, 7])
    np.testing.assert_allclose(markers(panel, LINE_COLOURS[0])[:, 1], shells, rtol=0.03, atol=1e-9)
    lines = figure_of(EXACT, EXACT.rescale(2.0)).axes[0].lines  # of different areas: one each
    slopes = [y[1] / x[1] for x, y in (v.get_data() for v in lines if v.get_linestyle() == "--")]
    assert slopes[0] == pytest.approx(4 * slopes[1])
    assert not [x for x in figure_of(EXACT, weyl=False).axes[0].lines if x.get_linestyle() == "--"]


def test_residuals_are_full_where_the_modes_are_verified(rough):
    proved = verify(EXACT, LAPLACIAN)
    assert proved.certificate.n_verified == 16
    panel = figure_of(proved, rough).axes[1]
    relative = markers(panel, LINE_COLOURS[1])[:, 1]
    np.testing.assert_array_equal(relative, rough.certificate.relative_residuals)
    faces = {
        line.get_color(): line.get_markerfacecolor()
        for line in panel.lines
        if len(line.get_xdata())
    }
    assert faces == {LINE_COLOURS[0]: LINE_COLOURS[0], LINE_COLOURS[1]: "none"}
    assert panel.get_yscale() == "log"
    assert panel.get_title(loc="right") == "full: verified, open: not"
    told = [text.get_text() for text in figure_of(proved).axes[0].get_legend().get_texts()]
    assert "16 of 16 verified" in told[-1]


def test_differences_are_relative_to_the_first_spectrum(rough):
    panel = figure_of(EXACT, rough.truncate(10)).axes[2]
    points = markers(panel, LINE_COLOURS[1])
    np.testing.assert_array_equal(points[:, 0], np.arange(1, 10))  # not that of zero to zero
    change = rough.eigenvalues[1:10] / EXACT.eigenvalues[1:10] - 1
    np.testing.assert_allclose(points[:, 1], change)
    assert {line.get_marker() for line in panel.lines if len(line.get_xdata())} == {"^"}
    below = figure_of(rough, EXACT).axes[2]
    assert {line.get_marker() for line in below.lines if len(line.get_xdata())} == {"v"}


def test_spectra_without_certificate_parts_and_single_modes_are_drawn():
    bare = replace(EXACT, certificate=None)
    figure = figure_of(bare)
    assert len(figure.axes) == 1
    assert "no certificate" in figure.axes[0].get_legend().get_texts()[-1].get_text()
    assert len(figure_of(bare, EXACT).axes) == 3
    pair = eigensolve(robust_laplacian(two_parts()), 6)
    assert pair.n_zero_modes == 2
    points = markers(figure_of(pair, pair).axes[2], LINE_COLOURS[1])
    np.testing.assert_array_equal(points[:, 0], [2, 3, 4, 5])
    single = EXACT.truncate(1)
    assert len(figure_of(single, single).axes) == 2  # zero modes do not differ: no empty panel


@pytest.mark.parametrize("held", [False, True])
def test_weyls_second_term_is_that_of_a_rectangle(held):
    """Its eigenvalues are known: pi^2 (i^2 / a^2 + j^2 / b^2), with i, j from 0, or from 1."""
    a, b = 1.0, 1.7
    i, j = np.ogrid[held:80, held:80]
    values = np.sort(np.pi**2 * ((i / a) ** 2 + (j / b) ** 2), axis=None)[50:1000]
    number = np.arange(50, 1000)
    around = 2 * (a + b) * (-1 if held else 1)
    with_two = weyl_law(number, a * b, around) / values - 1
    with_one = weyl_law(number, a * b) / values - 1
    assert abs(with_two.mean()) < 0.005
    assert np.abs(with_two).max() < 0.05
    assert (with_one < -0.02 if held else with_one > 0.02).mean() > 0.9
    again = weyl_law(number, 1e6 * a * b, 1e3 * around)  # in another unit
    np.testing.assert_allclose(1e6 * again, weyl_law(number, a * b, around))


def test_the_second_term_is_drawn_and_told():
    lines = figure_of(EXACT, free_boundary=-3.0).axes[0].lines
    (line,) = (line for line in lines if str(line.get_label()).startswith("Weyl"))
    told = f"√λ) / 4π, for the area {EXACT.area:.4g} and a held boundary of length 3"
    assert line.get_label().endswith(told)
    number, value = line.get_xydata().T
    assert (number[0], number[-1]) == (0, EXACT.k - 1)
    np.testing.assert_allclose(
        EXACT.area * value - 3 * np.sqrt(value), 4 * np.pi * number, atol=1e-9
    )


# --- signatures ---------------------------------------------------------------------------------


def test_curves_are_rows_of_the_signature():
    times = heat_times(EXACT, 12)
    hks = heat_kernel_signature(EXACT, times)
    panel, wave = Figure().subplots(1, 2)
    draw_curves(panel, hks, times, {"point 5": 5, "point 9": 9}, np.array([2, 7]), "heat")
    for line, point in zip(panel.lines, (5, 9), strict=False):
        np.testing.assert_array_equal(line.get_xydata(), np.column_stack([times, hks[point]]))
    assert [line.get_xdata()[0] for line in panel.lines[2:]] == [times[2], times[7]]
    assert panel.get_xscale() == panel.get_yscale() == "log"
    energies, width = wave_energies(EXACT, 12)
    wks = wave_kernel_signature(EXACT, energies, width=width)
    draw_curves(wave, wks, energies, {"point 5": 5}, np.array([2]), "wave")
    assert wave.get_xscale() == wave.get_yscale() == "linear"


@pytest.mark.parametrize("as_cloud", [False, True])
def test_balls_have_the_colours_of_their_curves_and_hidden_ones_are_told(as_cloud):
    geometry = BALL.as_cloud() if as_cloud else BALL
    # Seen from the view that is chosen, the first two are in front, the third is behind.
    rotation = View().rotation(geometry)
    seen = geometry.points @ rotation.T
    aim = np.array([[-0.5, 0, 0.86], [0.5, 0, 0.86], [0, 0, -1]])
    points = np.linalg.norm(seen[:, None] - aim, axis=2).argmin(axis=0)
    panel = Panel(values=seen[:, 1], low=-1.0, limit=1.0)
    pictures, visible = _pictures(geometry, [panel], points, rotation, 60)
    assert visible.tolist() == [True, True, False]
    [picture] = pictures.astype(int)
    side = picture.shape[1]
    for point, colour in zip(points[:2], LINE_COLOURS, strict=False):
        row, column = (int(side / 2 * (1 + 0.94 * at)) for at in (-seen[point, 1], seen[point, 0]))
        around = picture[row - 3 : row + 4, column - 3 : column + 4].reshape(-1, 3)
        assert np.abs(around - 255 * np.array(to_rgb(colour))).sum(axis=1).min() < 60
