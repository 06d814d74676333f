"""What the page holds: its facts as plain lists, and whole numbers that compress well.

Points are put in an order in which neighbours follow each other, so that a smooth function changes
little from one to the next. A column of 16-bit numbers is then stored as its steps, wrapped to 16
bits, with the sign in the lowest bit (0, -1, 1, -2, … become 0, 1, 2, 3, …), high bytes before low
bytes: most high bytes are zero. Everything together passes through gzip and base64.
"""

from __future__ import annotations

import base64
import gzip
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components, depth_first_order
from scipy.spatial import cKDTree

from spectra_kit._core.types import Floats, Ints
from spectra_kit.eigen import Spectrum
from spectra_kit.eigen.metrics import Comparison
from spectra_kit.geometry.shapes import Geometry, TriangleMesh

LEVELS = 32767  # of the positive half of a signed 16-bit number
_NEIGHBOURS = 8  # of a point of a cloud, to walk along
PERCENTILE = 99.0  # a lone spike must not bleach the rest
FLOOR = 8  # steps of 16 bits; below, a difference would show its rounding


def quantised(functions: Floats, scale: Floats) -> NDArray[np.int16]:
    """Round columns (n, k) to steps of ``scale / LEVELS``, `scale` (k,) the largest number."""
    unit = np.where(scale > 0, scale, 1.0)
    return np.round(functions * (LEVELS / unit)).astype(np.int16)


def walk(geometry: Geometry) -> Ints:
    """Return an order of the points in which neighbours mostly follow each other."""
    n = geometry.n
    if isinstance(geometry, TriangleMesh):
        i, j = geometry.unique_edges[0].T
    else:
        _, near = cKDTree(geometry.points).query(geometry.points, k=min(_NEIGHBOURS, n))
        near = near.reshape(n, -1)
        i, j = np.repeat(np.arange(n), near.shape[1]), near.ravel()
    graph = sparse.coo_array((np.ones(len(i)), (i, j)), shape=(n, n)).tocsr()
    # One more node ties the components together, so that one walk meets them all.
    _, label = connected_components(graph, directed=False)
    first = np.unique(label, return_index=True)[1]
    rows, columns = np.append(i, np.full(len(first), n)), np.append(j, first)
    tied = sparse.coo_array((np.ones(len(rows)), (rows, columns)), shape=(n + 1, n + 1)).tocsr()
    order, _ = depth_first_order(tied, n, directed=False, return_predecessors=True)
    return np.asarray(order[1:], dtype=np.int64)


def renumbered(faces: NDArray[np.integer], order: Ints) -> Ints:
    """Faces (f, 3) of the points in another order, sorted by where they start."""
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    rows = rank[faces]
    # Turned so that the smallest corner comes first: the orientation stays.
    start = rows.argmin(axis=1)
    rows = np.take_along_axis(rows, (start[:, None] + np.arange(3)) % 3, axis=1)
    return np.asarray(rows[np.lexsort(rows.T[::-1])])


def steps(columns: NDArray[np.integer], bits: int) -> bytes:
    """Store columns (n, c) of whole numbers of 16 or 32 bits, one after the other."""
    delta = np.diff(columns, axis=0, prepend=0)
    wrapped: Ints = delta.astype(f"i{bits // 8}").astype(np.int64)
    zigzag = ((wrapped << 1) ^ (wrapped >> 63)).T
    planes = [(zigzag >> shift) & 255 for shift in range(bits - 8, -1, -8)]
    return np.stack(planes, axis=1).astype(np.uint8).tobytes()


def face_bytes(faces: Ints) -> bytes:
    """Store sorted faces: the first corner by its steps, the others by how far they are from it."""
    first = faces[:, :1]
    return steps(np.hstack([first, faces[:, 1:] - first]), 32)


def packed(*parts: bytes) -> str:
    """Compress, and write as text; equal input makes equal text."""
    return base64.b64encode(gzip.compress(b"".join(parts), 6, mtime=0)).decode("ascii")


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
