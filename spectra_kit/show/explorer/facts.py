"""What the page says in numbers: one record of plain lists, ready for JSON."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.types import Floats
from spectra_kit.eigen import Spectrum
from spectra_kit.eigen.metrics import Comparison
from spectra_kit.show.explorer.payload import LEVELS

PERCENTILE = 99.0  # a lone spike must not bleach the rest
FLOOR = 8  # steps of 16 bits; below, a difference would show its rounding


def spectrum_facts(spectrum: Spectrum, modes: NDArray[np.int64]) -> dict[str, Any]:
    """Eigenvalues and certificate of some modes."""
    certificate = spectrum.certificate
    return {
        "eigenvalues": numbers(spectrum.eigenvalues[modes]),
        "residuals": certificate and numbers(certificate.residuals[modes]),
        "relative": certificate and numbers(certificate.relative_residuals[modes]),
        "errors": certificate
        and (None if certificate.errors is None else numbers(certificate.errors[modes])),
        "bounded": certificate and certificate.bounded[modes].tolist(),
        "verified": int(certificate.n_verified) if certificate else 0,
        "completeness": certificate and certificate.completeness,
        "solver": spectrum.provenance.solver,
    }


def comparison_facts(comparison: Comparison) -> dict[str, Any]:
    """Errors of each mode, and how many share its cluster."""
    sizes = np.concatenate([np.full(b - a, b - a) for a, b in comparison.clusters])
    return {
        "eigenvalue_error": numbers(
            (comparison.predicted_eigenvalues - comparison.eigenvalues)
            / np.where(np.isnan(comparison.eigenvalue_error), np.nan, comparison.eigenvalues)
        ),
        "cluster_error": numbers(comparison.cluster_error),
        "cluster_size": sizes.tolist(),
        "span_error": numbers(comparison.span_error),
        "partner": comparison.match.tolist(),
    }


def colour_facts(exact: Floats, predicted: Floats | None, scale: Floats) -> dict[str, Any]:
    """Limits of the colours of each mode, from all points, and the scale of the numbers shown.

    `hidden` tells which differences are too small for the 16 bits of the page.
    """
    both = [_limits(exact)] + ([] if predicted is None else [_limits(predicted)])
    facts: dict[str, Any] = {
        "scale": numbers(scale),
        "limit": numbers(np.max(both, axis=0)),
    }
    if predicted is not None:
        floor = FLOOR * scale / LEVELS
        difference = _limits(predicted - exact)
        facts["difference"] = numbers(np.maximum(difference, floor))
        facts["hidden"] = (difference < floor).tolist()
    return facts


def numbers(values: Floats) -> list[float | None]:
    """Nine digits of each, which is more than a page shows; None for what is no number."""
    return [float(f"{value:.9g}") if np.isfinite(value) else None for value in values]


def _limits(functions: Floats) -> Floats:
    """The symmetric colour limit of each column."""
    return np.asarray(np.percentile(np.abs(functions), PERCENTILE, axis=0))
