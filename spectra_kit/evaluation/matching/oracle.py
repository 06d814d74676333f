"""Which of the candidates that a method reports is the best by the truth, by plain ZoomOut.

A yardstick for the choice among them, no bound: candidates that were dropped before are not seen,
and the chosen one is finished by the whole method, the others by plain ZoomOut alone.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from spectra_kit._types import Floats, Ints
from spectra_kit.correspondence import geodesic_distances
from spectra_kit.evaluation.matching.subjects import Subject, truth_between
from spectra_kit.functional_maps import nearest_rows, zoomout
from spectra_kit.spectra import Spectrum

_SCOUTS = 400  # correspondences that rank the candidates
_STEP = 10  # modes of a step of the final refinement


def best_candidate(
    source: Subject,
    target: Subject,
    spectra: tuple[Spectrum, Spectrum],
    candidates: Sequence[Floats],
    vertices: Ints,
    points: Ints,
) -> Ints | None:
    """Finish the candidate that is best by the truth, by plain ZoomOut.

    Parameters
    ----------
    source, target : Subject
        Of one class.
    spectra : (Spectrum, Spectrum)
        Of source and target, at least as large as the candidates.
    candidates : sequence of ndarray of shape (k, k)
        Functional maps, the chosen one first.
    vertices : ndarray of shape (n1,)
        The source vertex of each point of the source's spectrum.
    points : ndarray, integers
        The point of the target's spectrum at each target vertex.

    Returns
    -------
    ndarray of shape (n2,) or None
        Point map between the points of the spectra after ZoomOut to all modes; None if the chosen
        candidate is the best one.
    """
    a, b = (s.rescale(1 / np.sqrt(s.area)) for s in spectra)
    truth = truth_between(source, target)
    some = np.linspace(0, len(truth.source) - 1, min(_SCOUTS, len(truth.source))).astype(np.int64)
    rows, goals = points[truth.target[some]], truth.source[some]
    errors = []
    for C in candidates:
        k2, k1 = C.shape
        found = nearest_rows(b.eigenvectors[rows, :k2], a.eigenvectors[:, :k1] @ C.T)
        errors.append(geodesic_distances(source.mesh, vertices[found], goals).mean())
    best = int(np.argmin(errors))
    if best == 0:
        return None
    return zoomout(a, b, candidates[best], k_final=min(a.k, b.k), step=_STEP).point_map
