"""What the NEO paper tells, by its tables, to stand beside what is measured here.

*Learning Laplacian Eigenspace with Mass-Aware Neural Operators on Point Clouds*, SIGGRAPH 2026: a
network of 5.4 M weights and m = 192, on models of its own. Its code halves the eigenvector error
that both define, and may pair one predicted mode with several exact ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple


class Told(NamedTuple):
    """Errors that the paper tells: means, but for medians of each m."""

    span: float
    vector: float
    value: float | None = None


# Its models of graphics beside our real ones, and its test split of ShapeNet beside our unseen
# procedural shapes: on what each network was trained for.
_REAL: dict[str, str | int] = {"models": "real"}
_UNSEEN: dict[str, str | int] = {"models": "procedural", "points": 2048}
_EVEN, _CROWDED = {**_REAL, "sampling": "uniform"}, {**_REAL, "sampling": "non-uniform"}
_AWARE, _AGNOSTIC = {"attention": "mass-aware"}, {"attention": "masses of one"}
# Table "Robustness Analysis", at 64k points.
_REFERENCE = Told(3.27e-3, 1.05e-1, 4.59e-2)
# Table "Accuracy, generalization, and numerical stability": ShapeNet, FP32 and FP16.
_SNET = Told(3.7e-3, 3.0e-2, 3.5e-2)
_SNET_HALF = Told(3.8e-3, 3.0e-2, 3.6e-2)
# Table "Effect of Subspace Redundancy".
_OF_M = {
    96: (5.69e-2, 1.21e-1),
    128: (1.10e-2, 6.97e-2),
    160: (6.91e-3, 5.50e-2),
    192: (3.59e-3, 3.09e-2),
    256: (2.40e-3, 2.15e-2),
}


# Question -> labels that a row must have, and what the paper tells of the same; where nothing else
# is said, in the table "Robustness Analysis".
_ERRORS: dict[str, list[tuple[Mapping[str, str | int], Told]]] = {
    "accuracy": [
        ({**_REAL, "points": 8192}, Told(2.58e-3, 3.49e-2, 1.86e-2)),
        ({**_REAL, "points": 65536}, _REFERENCE),
        ({**_REAL, "points": 524288}, Told(7.41e-3, 1.71e-1, 5.08e-2)),
        (_UNSEEN, _SNET),
    ],
    "precision": [
        ({**_UNSEEN, "precision": "float32"}, _SNET),
        ({**_UNSEEN, "precision": "float16"}, _SNET_HALF),
    ],
    "sampling": [
        (_EVEN | _AWARE, _REFERENCE),
        (_EVEN | _AGNOSTIC, Told(3.71e-3, 1.10e-1, 4.61e-2)),
        (_CROWDED | _AWARE, Told(2.63e-3, 8.33e-2, 3.00e-2)),
        (_CROWDED | _AGNOSTIC, Told(4.04e-1, 3.01e-1, 7.68e-2)),
    ],
    "operators": [
        ({**_REAL, "operator": "cloud, Delaunay"}, _REFERENCE),
        ({**_REAL, "operator": "cloud, k-NN graph"}, Told(5.67e-3, 1.30e-1, 8.81e-2)),
        ({**_REAL, "operator": "mesh, robust"}, Told(8.65e-3, 1.97e-1, 3.26e-2)),
    ],
    "redundancy": [({**_UNSEEN, "m": m}, Told(*errors)) for m, errors in _OF_M.items()],
}


def errors_told(question: str, labels: Mapping[str, str | int]) -> Told | None:
    """Return what the paper tells beside a row of an answer, or None."""
    for wanted, told in _ERRORS.get(question, ()):
        if wanted.items() <= labels.items():
            return told
    return None
