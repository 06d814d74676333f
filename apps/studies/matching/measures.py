"""A map between two subjects, measured with the truth and without it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from spectra_kit._core.records import frozen
from spectra_kit._core.types import Floats, Ints
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import InvalidInputError
from spectra_kit.geodesics import pair_distances
from spectra_kit.geometry import Geometry, TriangleMesh
from spectra_kit.maps import (
    accuracy_curve,
    auc,
    bijectivity_errors,
    coverage,
    dirichlet_energy,
    geodesic_errors,
    map_errors,
    nearest_rows,
    orientation,
    zoomout,
)
from spectra_kit.operators import laplacian
from spectra_kit.operators.oriented import oriented_triangles
from studies.matching.methods import Outcome
from studies.matching.subjects import Subject, truth_between

Geodesics = Literal["edges", "exact"]
Measured = dict[str, Any]

#: Where accuracy curves are taken, in hundredths of the root of the area.
THRESHOLDS = frozen(np.linspace(0, 10, 41))
_SCOUTS = 400  # correspondences that rank the candidates
_STEP = 10  # modes of a step of the final refinement


def measure_map(
    source: Subject,
    target: Subject,
    outcome: Outcome,
    back: Ints,
    *,
    best: Ints | None = None,
    geodesics: Geodesics = "edges",
) -> Measured:
    """Measure a map from points to vertices, in hundredths of the root of the source's area.

    The source is a mesh. `back` is the target point of each source vertex (see
    `maps.inverse_map`), `best` the map of the candidate that is best by the truth, if
    another than the chosen one. Distances are those on the source's mesh, also between clouds; NaN
    is what cannot be known.

    ``either`` is the mean of the smaller error at each correspondence, against the truth and its
    mirror image; ``accuracy`` are shares up to each of `THRESHOLDS`, ``bijectivity`` is the mean
    distance to where the transposed functional map leads back, ``oracle`` the direct error of the
    best finalist.
    """
    truth, p = truth_between(source, target), outcome.point_map
    errors = map_errors(source.mesh, p, truth, method=geodesics)
    oracle = float(errors.direct.mean()) if outcome.candidates else float("nan")
    if best is not None:
        rival = geodesic_errors(source.mesh, best, truth, method=geodesics)
        oracle = min(oracle, float(rival.mean()))
    laplacian_1, laplacian_2 = (laplacian(subject.geometry) for subject in (source, target))
    return {
        "direct": float(errors.direct.mean()),
        "symmetric": float("nan") if errors.symmetric is None else float(errors.symmetric.mean()),
        "either": float(errors.either.mean()),
        "flipped": bool(errors.flipped()),
        "auc": auc(errors.direct),
        "auc_either": auc(errors.either),
        "coverage": coverage(p, laplacian_1.mass),
        "energy": dirichlet_energy(laplacian_1, laplacian_2, p),
        "bijectivity": float(bijectivity_errors(source.mesh, p, back).mean()),
        "orientation": _orientation(source.mesh, target.geometry, p),
        "oracle": oracle,
        "confidence": outcome.confidence,
        "margin": outcome.margin,
        "ambiguous": bool(outcome.ambiguous),
        **outcome.evidence,
        "seconds": outcome.seconds,
        "cpu_seconds": outcome.cpu_seconds,
        "accuracy": accuracy_curve(errors.direct, THRESHOLDS).tolist(),
        "accuracy_either": accuracy_curve(errors.either, THRESHOLDS).tolist(),
    }


def best_candidate(
    source: Subject,
    target: Subject,
    spectra: tuple[Spectrum, Spectrum],
    candidates: Sequence[Floats],
    vertices: Ints,
    points: Ints,
) -> Ints | None:
    """Finish the candidate that is best by the truth, by plain ZoomOut.

    A yardstick for the choice among them, no bound: candidates that were dropped before are not
    seen, and the chosen one is finished by the whole method, the others by plain ZoomOut alone.

    `candidates` are functional maps, the chosen one first; if that is the best, the answer is None,
    otherwise a map between the points of the spectra. `vertices` are the source vertices of the
    points of the source's spectrum, `points` those of the target's spectrum at its vertices.
    """
    a, b = (s.rescale(1 / np.sqrt(s.area)) for s in spectra)
    truth = truth_between(source, target)
    some = np.linspace(0, len(truth.source) - 1, min(_SCOUTS, len(truth.source))).astype(np.int64)
    rows, goals = points[truth.target[some]], truth.source[some]
    errors = []
    for C in candidates:
        k2, k1 = C.shape
        found = nearest_rows(b.eigenvectors[rows, :k2], a.eigenvectors[:, :k1] @ C.T)
        errors.append(pair_distances(source.mesh, vertices[found], goals).mean())
    best = int(np.argmin(errors))
    if best == 0:
        return None
    return zoomout(a, b, candidates[best], k_final=min(a.k, b.k), step=_STEP).point_map


def _orientation(source: TriangleMesh, target: Geometry, point_map: Ints) -> float:
    try:
        a, b = oriented_triangles(source), oriented_triangles(target)
    except InvalidInputError:  # a surface without a consistent winding has no orientation
        return float("nan")
    return orientation(source.points, a.faces, b.faces, point_map)
