"""Modes of a spectrum in a gallery, and of two side by side."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_count
from spectra_kit.eigen import Spectrum
from spectra_kit.eigen.metrics import Comparison, align_modes
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import Geometry, GeometryLike
from spectra_kit.show.camera import View
from spectra_kit.show.fields import Panel, draw_gallery, draw_table, symmetric_limit
from spectra_kit.show.layout import Page, short
from spectra_kit.show.picture import PathLike, plotted

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SHOWN = 12  # modes of a gallery
_FAINT = 1e-4  # differences below this part of the mode stay white
_TIED = 1e-6  # relative; differences below it may be rounding


@plotted
def plot_modes(
    geometry: GeometryLike,
    spectrum: Spectrum,
    *,
    path: PathLike | None = None,
    view: View = View(),
    page: Page = Page(),
    modes: Sequence[int] | None = None,
    nodal_lines: bool = True,
    columns: int | None = None,
) -> Figure:
    """Draw a gallery of modes, each with its number, eigenvalue and residual.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        The points that the spectrum lives on. A cloud is drawn as balls that overlap a little.
    spectrum : Spectrum
        Eigenvalues are in 1/length^2, as printed.
    $path
    $view
    $page
    modes : sequence of int, optional
        Which modes, counted from 0; by default the first twelve that are not constant.
    nodal_lines : bool, default True
        Draw where each mode is zero.
    $columns

    $returns

    Notes
    -----
    Modes are multiplied by sqrt(area), which makes the constant one 1 and frees the colours of
    units. The sign of a mode means nothing: in all pictures its largest value is positive. Each has
    its own colour limit, which one point in a hundred may exceed.

    Examples
    --------
    >>> from spectra_kit import eigensolve, robust_laplacian
    >>> from spectra_kit.geometry import sphere
    >>> from spectra_kit.show import Page, plot_modes
    >>> ball = sphere(subdivisions=2).geometry
    >>> plot_modes(ball, eigensolve(robust_laplacian(ball), 4), page=Page("A ball", dpi=30))
    Picture(path=None)
    """
    chosen = check_modes(geometry, spectrum, modes, _SHOWN)
    panels = [_panel(spectrum, mode, (0.0,) if nodal_lines else ()) for mode in chosen]
    return draw_gallery(geometry, panels, columns, view=view, page=page)


@plotted
def plot_comparison(
    geometry: GeometryLike,
    exact: Spectrum,
    predicted: Spectrum,
    comparison: Comparison,
    *,
    path: PathLike | None = None,
    view: View = View(),
    page: Page = Page(),
    modes: Sequence[int],
    names: tuple[str, str] = ("exact", "predicted"),
    nodal_lines: bool = True,
) -> Figure:
    """Draw chosen modes of two spectra and their difference, one row or column per mode.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        The points that both spectra live on.
    exact, predicted : Spectrum
        As given to `compare_spectra`.
    comparison : Comparison
        What it returned.
    $path
    $view
    $page
    modes : sequence of int
        Which modes, counted from 0 (mode 0 is constant on a connected surface).
    names : tuple of str, default ("exact", "predicted")
        What to call the two.
    nodal_lines : bool, default True
        Draw where the modes (not their difference) are zero.

    $returns

    Notes
    -----
    Exact modes have the scale and the signs of `plot_modes`. Predicted ones are aligned to them by
    `align_modes`: signs, and bases inside a cluster of near-equal eigenvalues, are chosen to look
    alike. Both share one symmetric limit for each mode, the difference has its own; both limits are
    printed.
    """
    chosen = check_modes(geometry, exact.truncate(comparison.k), modes)
    aligned = align_modes(exact, predicted, comparison)
    levels = (0.0,) if nodal_lines else ()
    rows = [_panels(exact, predicted, aligned[:, i], comparison, i, levels) for i in chosen]
    heads = [f"mode {i}" for i in chosen]
    return draw_table(geometry, rows, heads, [*names, "difference"], view=view, page=page)


def _panel(spectrum: Spectrum, mode: int, levels: tuple[float, ...]) -> Panel:
    """One mode of a gallery."""
    values = np.sqrt(spectrum.area) * spectrum.eigenvectors[:, mode]
    values = values * display_signs(values[:, None])
    zero = mode < spectrum.n_zero_modes
    text = f"mode {mode}    λ = {0 if zero else spectrum.eigenvalues[mode]:.5g}"
    lines = (text, _residual(spectrum, mode))
    return Panel(values=values, limit=symmetric_limit(values), lines=lines, levels=levels)


def _panels(
    exact: Spectrum,
    predicted: Spectrum,
    aligned: Floats,
    comparison: Comparison,
    mode: int,
    levels: tuple[float, ...],
) -> tuple[Panel, Panel, Panel]:
    """One mode: exact, predicted (already aligned), difference."""
    root = np.sqrt(exact.area) * display_signs(exact.eigenvectors[:, [mode]])
    left, right = root * exact.eigenvectors[:, mode], root * aligned
    limit = symmetric_limit(left, right)
    true, guess = comparison.eigenvalues[mode], comparison.predicted_eigenvalues[mode]
    zero = mode < comparison.n_zero_modes
    exact_text = "λ = 0" if zero else f"λ = {true:.5g}"
    change = "" if zero else f"  ({100 * (guess / true - 1):+.2g} %)"
    size = next(stop - start for start, stop in comparison.clusters if start <= mode < stop)
    beside = f" (cluster of {size})" if size > 1 else ""
    told = (
        (exact_text, _residual(exact, mode)),
        (f"λ = {guess:.5g}{change}", _residual(predicted, comparison.match[mode])),
        (
            f"error {short(comparison.cluster_error[mode])}{beside}",
            f"outside the span {short(comparison.span_error[mode])}",
        ),
    )
    faint = max(symmetric_limit(right - left), _FAINT * limit)
    return (
        Panel(values=left, limit=limit, lines=told[0], levels=levels),
        Panel(values=right, limit=limit, lines=told[1], levels=levels),
        Panel(values=right - left, limit=faint, lines=told[2]),
    )


def check_modes(
    geometry: Geometry, spectrum: Spectrum, modes: Sequence[int] | None, most: int = 0
) -> list[int]:
    """Return the modes to show, by default the first `most` that are not constant."""
    if geometry.n != spectrum.n:
        raise InvalidInputError(
            "geometry", f"have the {spectrum.n} points of the spectrum", geometry.n
        )
    if modes is None:
        first = min(spectrum.n_zero_modes, spectrum.k - 1)
        modes = range(first, min(first + most, spectrum.k))
    if not len(modes):
        raise InvalidInputError("modes", "hold at least one mode", "none")
    return [check_count("modes", mode, low=0, high=spectrum.k - 1) for mode in modes]


def display_signs(eigenvectors: Floats) -> Floats:
    """Return the factor (k,), 1 or -1, with which each mode, a column of (n, k), is shown.

    1 where the largest entry in absolute value is positive, otherwise -1. Where the largest and the
    smallest entry are opposite to rounding, the sum of the cubes decides, and where that is zero
    too, the first of the largest entries.
    """
    peak = np.abs(eigenvectors).max(axis=0, initial=0.0)
    scaled = eigenvectors / np.where(peak > 0, peak, 1.0)
    lean = scaled.max(axis=0, initial=0.0) + scaled.min(axis=0, initial=0.0)
    cubes = scaled**3
    skew = cubes.sum(axis=0) / np.maximum(np.abs(cubes).sum(axis=0), 1.0)
    first = (np.abs(scaled) >= 1.0 - _TIED).argmax(axis=0)
    foremost = np.take_along_axis(scaled, first[None], axis=0)[0]
    decisive = np.where(np.abs(lean) > _TIED, lean, np.where(np.abs(skew) > _TIED, skew, foremost))
    return np.where(decisive < 0, -1.0, 1.0)


def _residual(spectrum: Spectrum, mode: int) -> str:
    """How far the eigenvalue of a mode is off, if known, and its relative residual, in words."""
    certificate = spectrum.certificate
    if certificate is None:
        return "not certified"
    told = f"relative residual {short(certificate.relative_residuals[mode])}"
    if certificate.errors is None:
        return told
    kind = "≤" if certificate.bounded[mode] else "≈"
    return f"eigenvalue off by {kind} {short(certificate.errors[mode])}, {told}"
