"""Modes of two spectra side by side."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from spectra_kit._validate import check_count
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import Geometry
from spectra_kit.metrics import Comparison, align_modes
from spectra_kit.spectrum import Spectrum
from spectra_kit.viz.page import Panel, plot_panels
from spectra_kit.viz.pen import short
from spectra_kit.viz.picture import Picture

Floats = NDArray[np.float64]

_PERCENTILE = 99.0  # a lone spike must not bleach the rest
_FAINT = 1e-4  # differences below this part of the mode stay white


def plot_comparison(
    path: str | os.PathLike[str],
    geometry: Geometry,
    exact: Spectrum,
    predicted: Spectrum,
    comparison: Comparison,
    *,
    modes: Sequence[int],
    names: tuple[str, str] = ("exact", "predicted"),
    title: str = "",
    subtitle: str = "",
    dpi: int = 200,
) -> Picture:
    """Draw chosen modes of two spectra and their difference, one row or column per mode.

    Parameters
    ----------
    path : path-like
        The ``.png``, ``.pdf`` or ``.svg`` file to write, whole or not at all.
    geometry : TriangleMesh or PointCloud
        The points that both spectra live on.
    exact, predicted : Spectrum
        As given to `compare_spectra`.
    comparison : Comparison
        What it returned.
    modes : sequence of int
        Which modes, counted from 0 (mode 0 is constant on a connected surface).
    names : tuple of str, default ("exact", "predicted")
        What to call the two.
    title, subtitle : str, optional
        Two lines at the head of the page.
    dpi : int, default 200
        Pixels per inch; the page is at most 11 inches wide.

    Returns
    -------
    Picture
        Of the file written.

    Raises
    ------
    InvalidInputError
        If a mode is out of range, sizes disagree, or `path` cannot be written.

    Notes
    -----
    Functions are multiplied by sqrt(area), which makes the constant mode 1 and frees the colours of
    units. Exact and predicted share one symmetric limit for each mode, the difference
    has its own; both are printed. Predicted modes are aligned by `align_modes`: signs, and bases
    inside a cluster of near-equal eigenvalues, are chosen to look alike.
    """
    if geometry.n != exact.n:
        raise InvalidInputError(
            f"`geometry` must have the {exact.n} points of the spectra, got {geometry.n}"
        )
    chosen = [check_count("modes", mode, low=0, high=comparison.k - 1) for mode in modes]
    aligned = align_modes(exact, predicted, comparison)
    return plot_panels(
        path,
        geometry,
        [_panels(exact, predicted, aligned[:, i], comparison, i) for i in chosen],
        rows_named=[f"mode {i}" for i in chosen],
        columns_named=[*names, "difference"],
        title=title,
        subtitle=subtitle,
        dpi=dpi,
    )


def _panels(
    exact: Spectrum, predicted: Spectrum, aligned: Floats, comparison: Comparison, mode: int
) -> tuple[Panel, Panel, Panel]:
    """One mode: exact, predicted (already aligned), difference."""
    root = np.sqrt(exact.area)
    left, right = root * exact.eigenvectors[:, mode], root * aligned
    limit = _limit(left, right)
    true, guess = comparison.eigenvalues[mode], comparison.predicted_eigenvalues[mode]
    zero = mode < comparison.n_zero_modes
    exact_text = "λ = 0" if zero else f"λ = {true:.5g}"
    change = "" if zero else f"  ({100 * (guess / true - 1):+.2g} %)"
    size = next(stop - start for start, stop in comparison.clusters if start <= mode < stop)
    beside = f" (cluster of {size})" if size > 1 else ""
    return (
        Panel(values=left, limit=limit, lines=(exact_text, _residual(exact, mode))),
        Panel(
            values=right,
            limit=limit,
            lines=(f"λ = {guess:.5g}{change}", _residual(predicted, comparison.match[mode])),
        ),
        Panel(
            values=right - left,
            limit=max(_limit(right - left), _FAINT * limit),
            lines=(
                f"error {short(comparison.cluster_error[mode])}{beside}",
                f"outside the span {short(comparison.span_error[mode])}",
            ),
        ),
    )


def _limit(*functions: Floats) -> float:
    """The symmetric colour limit of all these functions together."""
    return max(float(np.percentile(np.abs(f), _PERCENTILE)) for f in functions) or 1.0


def _residual(spectrum: Spectrum, mode: int) -> str:
    """The relative residual of a mode in words, where it is certified."""
    if spectrum.certificate is None:
        return "not certified"
    return f"relative residual {short(spectrum.certificate.relative_residuals[mode])}"
