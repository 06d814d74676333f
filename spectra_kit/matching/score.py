"""How good a candidate map is, without ground truth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spectra_kit.functional_maps.nearest import nearest
from spectra_kit.matching.prepare import Prepared

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_LEAST = 1e-3  # mismatch below which maps count as equally good

# Exponents of the mismatches in the score; absent ones are left out.
WEIGHTS = {"curvature": 2.0, "wave": 0.5, "spacing": 0.5, "embedding": 1.0, "orientation": 0.2}


def mismatches(
    source: Prepared,
    target: Prepared,
    functional_map: Floats,
    *,
    reversing: bool = False,
    n_samples: int | None = None,
) -> dict[str, float]:
    """Return what a map of good surfaces keeps small, each in [0, about 1], dimensionless.

    Parameters
    ----------
    source, target : Prepared
        The surfaces.
    functional_map : ndarray of shape (k, k)
        Of source to target.
    reversing : bool, default False
        Whether it is meant to turn the surface over.
    n_samples : int, optional
        How many of the samples to look at; all by default.

    Returns
    -------
    dict of str to float
        ``embedding``: distance of the rows ``U2`` to their nearest in ``U1 C^T``, relative to their
        length; ``spacing``: ``|C diag(lambda1) - diag(lambda2) C|^2 / |lambda2|^2``, zero for
        isometries; ``wave``: relative difference of the wave kernel signatures; ``curvature``: that
        of the smoothed mean curvatures, both ways; ``orientation``: (1 - t) / 2 with the turning
        t of `orientation_of`.
    """
    a, b = source.spectrum, target.spectrum
    k = len(functional_map)
    image = a.eigenvectors[:, :k] @ functional_map.T
    here, there = target.samples[:n_samples], source.samples[:n_samples]
    back = nearest(b.eigenvectors[here, :k], image)
    forth = nearest(image[there], b.eigenvectors[:, :k])
    rows = b.eigenvectors[here, :k]
    values = {
        "embedding": float(np.linalg.norm(rows - image[back]) / np.linalg.norm(rows)),
        "spacing": _spacing_error(functional_map, a.eigenvalues[:k], b.eigenvalues[:k]),
        "wave": float(
            np.mean(
                [
                    _relative(source.wave[back], target.wave[here]),
                    _relative(source.wave[there], target.wave[forth]),
                ]
            )
        ),
    }
    if source.curvature is not None and target.curvature is not None:
        values["curvature"] = float(
            np.sqrt(
                _curvature_error(source.curvature[back], target.curvature[here])
                * _curvature_error(source.curvature[there], target.curvature[forth])
            )
        )
    turning = orientation_of(source, target, functional_map)
    if turning is not None:
        values["orientation"] = (1 + turning if reversing else 1 - turning) / 2
    return values


def score_of(values: dict[str, float]) -> float:
    """Return the weighted geometric mean of `mismatches`: the lower, the better."""
    total = sum(WEIGHTS[name] for name in values)
    logs = sum(WEIGHTS[name] * np.log(max(value, 0.0) + _LEAST) for name, value in values.items())
    return float(np.exp(logs / total))


def orientation_of(source: Prepared, target: Prepared, functional_map: Floats) -> float | None:
    """Return the turning of a map: near 1 if it keeps the sides, near -1 for a mirror image.

    It is the correlation of the area forms ``T[a, b, c] = integral of u_a du_b ^ du_c`` of the
    target's modes with those of the source's, carried over by the map. None without geometries.
    """
    if source.form is None or target.form is None:
        return None
    m = min(20, len(functional_map), len(source.form), len(target.form))
    C = functional_map[:m, :m]
    carried = np.einsum("ia,jb,kc,abc->ijk", C, C, C, source.form[:m, :m, :m], optimize=True)
    form = target.form[:m, :m, :m]
    return float(np.vdot(carried, form) / (np.linalg.norm(carried) * np.linalg.norm(form)))


def _spacing_error(C: Floats, values1: Floats, values2: Floats) -> float:
    """Return how far `C` is from commuting with the Laplacians."""
    gaps = C * (values1[None] - values2[:, None])
    return float((gaps**2).sum() / (values2**2).sum())


def _relative(x: Floats, y: Floats) -> float:
    """Return the mean of |x - y| / (x + y) of positive quantities."""
    return float((np.abs(x - y) / (x + y + 1e-300)).mean())


def _curvature_error(x: Floats, y: Floats) -> float:
    """Return the mean difference, relative to the mean size, averaged over columns."""
    return float((np.abs(x - y).mean(axis=0) / (np.abs(y).mean(axis=0) + 1e-300)).mean())
