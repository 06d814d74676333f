"""What the NEO paper tells, by its tables, to stand beside what is measured here.

*Learning Laplacian Eigenspace with Mass-Aware Neural Operators on Point Clouds*, SIGGRAPH 2026: a
network of 5.4 M weights and m = 192, on models of its own. Its code halves the eigenvector error
that both define, and may pair one predicted mode with several exact ones. Seconds are those of
scipy's ARPACK and of Spectra on 12 threads of a Ryzen 9 9950X, and of its network in FP32 on an RTX
3090, at the size that is less than a tenth off.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple


class Told(NamedTuple):
    """Errors that the paper tells: means, but for medians where `setting` says so."""

    table: str  #: By the first words of its caption.
    setting: str  #: By its own words.
    span: float
    vector: float
    value: float | None = None


_ROBUST, _PRECISION = "Robustness Analysis", "Accuracy, generalization, and numerical stability"
_REDUNDANCY = "Effect of Subspace Redundancy"

# Its models of graphics beside our real ones, and its test split of ShapeNet beside our unseen
# procedural shapes: on what each network was trained for.
_REAL: dict[str, str | int] = {"models": "real"}
_UNSEEN: dict[str, str | int] = {"models": "procedural", "points": 2048}
_EVEN, _CROWDED = {**_REAL, "sampling": "uniform"}, {**_REAL, "sampling": "non-uniform"}
_AWARE, _AGNOSTIC = {"attention": "mass-aware"}, {"attention": "masses of one"}
_REFERENCE = Told(_ROBUST, "64k", 3.27e-3, 1.05e-1, 4.59e-2)
_SNET = Told(_PRECISION, "ShapeNet, FP32", 3.7e-3, 3.0e-2, 3.5e-2)
_SNET_HALF = Told(_PRECISION, "ShapeNet, FP16", 3.8e-3, 3.0e-2, 3.6e-2)
_OF_M = {
    96: (5.69e-2, 1.21e-1),
    128: (1.10e-2, 6.97e-2),
    160: (6.91e-3, 5.50e-2),
    192: (3.59e-3, 3.09e-2),
    256: (2.40e-3, 2.15e-2),
}


def _robust(setting: str, *errors: float) -> Told:
    return Told(_ROBUST, setting, *errors)


# Question -> labels that a row must have, and what the paper tells of the same.
_ERRORS: dict[str, list[tuple[Mapping[str, str | int], Told]]] = {
    "accuracy": [
        ({**_REAL, "points": 8192}, _robust("8k", 2.58e-3, 3.49e-2, 1.86e-2)),
        ({**_REAL, "points": 65536}, _REFERENCE),
        ({**_REAL, "points": 524288}, _robust("512k", 7.41e-3, 1.71e-1, 5.08e-2)),
        (_UNSEEN, _SNET),
    ],
    "precision": [
        ({**_UNSEEN, "precision": "float32"}, _SNET),
        ({**_UNSEEN, "precision": "float16"}, _SNET_HALF),
    ],
    "sampling": [
        (_EVEN | _AWARE, _REFERENCE),
        (_EVEN | _AGNOSTIC, _robust("mass-agnostic, uniform", 3.71e-3, 1.10e-1, 4.61e-2)),
        (_CROWDED | _AWARE, _robust("mass-aware, non-uniform", 2.63e-3, 8.33e-2, 3.00e-2)),
        (_CROWDED | _AGNOSTIC, _robust("mass-agnostic, non-uniform", 4.04e-1, 3.01e-1, 7.68e-2)),
    ],
    "operators": [
        ({**_REAL, "operator": "cloud, Delaunay"}, _REFERENCE),
        ({**_REAL, "operator": "cloud, k-NN graph"}, _robust("k-NN", 5.67e-3, 1.30e-1, 8.81e-2)),
        ({**_REAL, "operator": "mesh, robust"}, _robust("mesh", 8.65e-3, 1.97e-1, 3.26e-2)),
    ],
    "redundancy": [
        ({**_UNSEEN, "m": m}, Told(_REDUNDANCY, f"m = {m}, medians", *errors))
        for m, errors in _OF_M.items()
    ],
}


def errors_told(question: str, labels: Mapping[str, str | int]) -> Told | None:
    """Return what the paper tells beside a row of an answer, or None."""
    for wanted, told in _ERRORS.get(question, ()):
        if wanted.items() <= labels.items():
            return told
    return None


#: Name of a method -> points -> its seconds in the table Eigensolver Timing Comparison.
_SECONDS = {
    "eigsh": {8192: 0.25, 65536: 4.58, 524288: 45.90, 1572864: 156.80},
    "spectra": {8192: 0.34, 65536: 5.65, 524288: 61.01, 1572864: 208.66},
    "neo-raw": {8192: 0.02, 65536: 0.23, 524288: 0.96, 1572864: 2.91},
}
_NEAR = 0.1


def seconds_told(method: str, points: int) -> float | None:
    """Return the seconds that the paper tells of a method at about so many points, or None."""
    for told, seconds in _SECONDS.get(method, {}).items():
        if abs(points - told) < _NEAR * told:
            return seconds
    return None
