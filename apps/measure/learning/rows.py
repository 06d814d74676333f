"""The rows of both tables: an embedding, what learns from it, what is seen."""

from __future__ import annotations

from collections.abc import Iterable

from measure.learning.classification import Row, View
from measure.learning.segmentation import PartsRow
from spectra_kit.errors import InvalidInputError

_MESH, _CLOUD = View("mesh", "exact"), View("cloud", "exact")
_PREDICTED = View("cloud", "predicted")

#: Without any training, in minutes.
FREE = [
    Row(view, embedding, method)
    for view in (_MESH, _CLOUD, _PREDICTED)
    for embedding, method in (
        ("dna", "nearest"),
        ("heat", "nearest"),
        ("waves", "nearest"),
        ("waves+dna", "nearest"),
        ("waves+dna", "discriminant"),
        ("waves+dna", "support"),
        ("heat+waves+dna", "nearest"),
        ("heat+waves+dna", "discriminant"),
    )
]
#: Networks, on clouds: the paper's way, and its rivals.
TRAINED = [
    Row(_PREDICTED, embedding, method)
    for embedding, method in (
        ("neo-mass-free", "pointnet"),
        ("neo", "pointnet"),
        ("global", "pointnet"),
        ("heat+waves", "pointnet"),
        ("plane-waves", "pointnet"),
        ("encoding", "pointnet"),
        ("coordinates", "pointnet"),
        ("coordinates", "pointnet++"),
        ("coordinates", "point-transformer"),
    )
]


def rows_named(names: Iterable[str]) -> list[Row]:
    """Return rows by their names in the table."""
    known = {str(row): row for row in FREE + TRAINED}
    for name in names:
        if name not in known:
            raise InvalidInputError("rows", f"be of these: {' | '.join(known)}", repr(name))
    return [known[name] for name in names]


_EXACT, _PREDICTED_MESH = View("mesh", "exact"), View("mesh", "predicted")
_SIGNATURES = "heat+waves+global"


def parts_rows(name: str) -> list[PartsRow]:
    """Return the rows of the table of segmenters for a set."""
    both = f"{_SIGNATURES}+coordinates"
    if name != "human":  # all others stand alike
        return [
            PartsRow(name, _EXACT, both, "diffusion", upright=True),
            PartsRow(name, _EXACT, _SIGNATURES, "diffusion"),
            PartsRow(name, _EXACT, "coordinates", "diffusion", upright=True),
            PartsRow(name, _PREDICTED_MESH, both, "diffusion", upright=True),
        ]
    return [
        PartsRow(name, _EXACT, _SIGNATURES, "diffusion"),
        PartsRow(name, _EXACT, both, "diffusion"),
        PartsRow(name, _EXACT, "coordinates", "diffusion"),
        PartsRow(name, _PREDICTED_MESH, _SIGNATURES, "diffusion"),
        PartsRow(name, _PREDICTED, _SIGNATURES, "diffusion"),
        PartsRow(name, _EXACT, both, "diffusion", 10),
        PartsRow(name, _EXACT, _SIGNATURES, "diffusion", 10),
        PartsRow(name, _EXACT, "coordinates", "diffusion", 10),
        PartsRow(name, _EXACT, _SIGNATURES, "mlp"),
        PartsRow(name, _EXACT, "neo", "mlp"),
        PartsRow(name, _EXACT, "encoding", "mlp"),
        PartsRow(name, _EXACT, "neo-mass-free", "pointnet++"),
        PartsRow(name, _EXACT, "coordinates", "pointnet++"),
    ]
