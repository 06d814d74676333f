"""`measure_pair`: match one pair and measure the map in every way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from spectra_kit._types import Floats, Ints
from spectra_kit._validate import frozen
from spectra_kit.correspondence import (
    accuracy_curve,
    auc,
    bijectivity_errors,
    coverage,
    dirichlet_energy,
    geodesic_errors,
    map_errors,
    orientation,
)
from spectra_kit.errors import InvalidInputError
from spectra_kit.evaluation.matching.methods import Outcome
from spectra_kit.evaluation.matching.subjects import Subject, truth_between
from spectra_kit.geometry import TriangleMesh
from spectra_kit.operators import robust_laplacian
from spectra_kit.operators.oriented import oriented_triangles

Geodesics = Literal["edges", "exact"]

#: Where accuracy curves are taken, in hundredths of the root of the area.
THRESHOLDS = frozen(np.linspace(0, 10, 41))


@dataclass(frozen=True, eq=False, kw_only=True)
class PairResult:
    """What came of a pair; errors in hundredths of the root of the source's area.

    Attributes
    ----------
    direct, symmetric, either : float
        Mean geodesic errors against the truth, its mirror image, and the smaller one at each
        correspondence; `symmetric` is NaN where there is no mirror image.
    flipped : bool
        Left for right: see `correspondence.MapErrors.flipped`. False where there is no mirror
        image.
    auc : float
        Of the direct errors up to 10.
    auc_either : float
        Of the smaller ones.
    coverage, energy, bijectivity, orientation : float
        See `correspondence`; `bijectivity` is the mean distance to where the transposed
        functional map leads back, the others need no more than the point map. `orientation` is
        NaN where a mesh has no consistent winding.
    oracle : float
        Mean direct error of the best finalist: of the map itself, or of the reported candidate that
        the truth prefers, finished by plain ZoomOut (see `best_candidate`), if that is smaller.
        NaN without candidates.
    margin, ambiguous : float, bool
        Which the method reports; NaN and False where it does not.
    seconds, cpu_seconds : float
        Of the matching, spectra given.
    accuracy, accuracy_either : ndarray of shape (41,)
        Share of errors up to each of `THRESHOLDS`, direct and smaller.
    """

    direct: float
    symmetric: float
    either: float
    flipped: bool
    auc: float
    auc_either: float
    coverage: float
    energy: float
    bijectivity: float
    orientation: float
    oracle: float
    margin: float
    ambiguous: bool
    seconds: float
    cpu_seconds: float
    accuracy: Floats
    accuracy_either: Floats


def measure_pair(
    source: Subject,
    target: Subject,
    outcome: Outcome,
    back: Ints,
    *,
    best: Ints | None = None,
    geodesics: Geodesics = "edges",
) -> PairResult:
    """Measure an outcome against the truth and without it.

    Parameters
    ----------
    source, target : Subject
        Of one class.
    outcome : Outcome
        Of a method; its map is between vertices.
    back : array_like of shape (n1,), integers
        Target vertex of each source vertex; see `correspondence.way_back`.
    best : array_like of shape (n2,), integers, optional
        Map of the candidate that is best by the truth, if another than the chosen one.
    geodesics : {"edges", "exact"}, default "edges"
        How errors are measured; see `correspondence.geodesic_distances`.

    Returns
    -------
    PairResult
        Distances are those on the source's mesh, also where clouds were matched; those of
        `bijectivity` are always along its edges.
    """
    truth, p = truth_between(source, target), outcome.point_map
    errors = map_errors(source.mesh, p, truth, method=geodesics)
    oracle = float(errors.direct.mean()) if outcome.candidates else float("nan")
    if best is not None:
        rival = geodesic_errors(source.mesh, best, truth, method=geodesics)
        oracle = min(oracle, float(rival.mean()))
    laplacian_1, laplacian_2 = (robust_laplacian(subject.mesh) for subject in (source, target))
    return PairResult(
        direct=float(errors.direct.mean()),
        symmetric=_mean(errors.symmetric),
        either=float(errors.either.mean()),
        flipped=errors.flipped(),
        auc=auc(errors.direct),
        auc_either=auc(errors.either),
        coverage=coverage(p, laplacian_1.mass),
        energy=dirichlet_energy(laplacian_1, laplacian_2, p),
        bijectivity=float(bijectivity_errors(source.mesh, p, back).mean()),
        orientation=_orientation(source.mesh, target.mesh, p),
        oracle=oracle,
        ambiguous=outcome.ambiguous,
        margin=outcome.margin,
        seconds=outcome.seconds,
        cpu_seconds=outcome.cpu_seconds,
        accuracy=accuracy_curve(errors.direct, THRESHOLDS),
        accuracy_either=accuracy_curve(errors.either, THRESHOLDS),
    )


def _orientation(source: TriangleMesh, target: TriangleMesh, point_map: Ints) -> float:
    try:
        a, b = oriented_triangles(source), oriented_triangles(target)
    except InvalidInputError:  # a surface without a consistent winding has no orientation
        return float("nan")
    return orientation(source.points, a.faces, b.faces, point_map)


def _mean(errors: Floats | None) -> float:
    return float("nan") if errors is None else float(errors.mean())
