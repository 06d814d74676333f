"""Operators as arrays of an entry: the Laplacian, and gradients in tangent planes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import DTypeLike, NDArray
from scipy.sparse import csr_array

from spectra_kit.datasets.plan import Plan
from spectra_kit.geometry import Geometry
from spectra_kit.operators import TangentGradient, tangent_gradient

OperatorName = Literal["stiffness", "gradient"]
_INDICES = ("indptr", "indices")


def operator_facts(shape: str, plan: Plan, name: OperatorName) -> dict[str, object]:
    """Return all that an operator of a shape follows from."""
    own = ("release", "precision", *(("operator", "boundary") if name == "stiffness" else ()))
    return {"shape": shape, "kept": name, **{key: plan.solved[key] for key in own}}


def packed(shape: Geometry, plan: Plan, name: OperatorName) -> dict[str, NDArray[Any]]:
    """Assemble an operator of a shape, and return its arrays."""
    if name == "stiffness":
        matrix = csr_array(plan.laplacian(shape).stiffness)
        return {"data": matrix.data.astype(plan.precision), **_pattern(matrix)}
    frames, x, y = tangent_gradient(shape, oriented=True)
    values = {"x": x.data, "y": y.data, "frames": frames}
    assert np.array_equal(x.indices, y.indices)  # both of the same triangles
    return {name: array.astype(plan.precision) for name, array in values.items()} | _pattern(x)


def stiffness_of(arrays: Mapping[str, NDArray[Any]]) -> csr_array:
    """Return the stiffness that was packed."""
    return _matrix(arrays, "data")


def gradient_of(arrays: Mapping[str, NDArray[Any]]) -> TangentGradient:
    """Return the gradient that was packed."""
    return TangentGradient(arrays["frames"], _matrix(arrays, "x"), _matrix(arrays, "y"))


def _pattern(matrix: csr_array) -> dict[str, NDArray[Any]]:
    kind: DTypeLike = np.int32 if matrix.nnz < 2**31 else np.int64
    return {name: getattr(matrix, name).astype(kind) for name in _INDICES}


def _matrix(arrays: Mapping[str, NDArray[Any]], values: str) -> csr_array:
    n = len(arrays["indptr"]) - 1
    return csr_array((arrays[values], arrays["indices"], arrays["indptr"]), shape=(n, n))
