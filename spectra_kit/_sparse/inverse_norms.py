"""Norms in the inverse of a mass that is no diagonal, by conjugate gradients.

A factor of it would have the fill of one of the stiffness, of numbers that vanish for the most
part; and its spectrum, scaled by the diagonal, is narrow.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import ArpackNoConvergence, eigsh

from spectra_kit._core.types import Floats
from spectra_kit._sparse.products import spmm
from spectra_kit.errors import InvalidInputError

_STEPS = 200  # of linear elements 10 do
_LEFT = 1e-4  # of the squares: norms are told to four digits, and too large
_RESTARTS = 100
_FEW = 16  # points up to which LAPACK tells the least eigenvalue


def inverse_squares(mass: sparse.csr_array, R: Floats, least: float) -> Floats:
    """Return ``r^T M^-1 r`` of each column, or a bound from above where that takes many steps.

    The square is the sum of what the steps add (Hestenes and Stiefel, *Methods of conjugate
    gradients for solving linear systems*, 1952). What they leave out is at most the square that is
    left, in the inverse of the diagonal, over the `least` eigenvalue of M relative to that.
    """
    inverse = 1 / mass.diagonal()[:, None]
    R = np.array(R, dtype=np.float64)
    towards = inverse * R
    squares = np.einsum("ij,ij->j", R, towards)
    found, enough = np.zeros(len(squares)), _LEFT * squares
    for _ in range(_STEPS):
        if (squares <= enough).all():
            break
        image = spmm(mass, towards)
        curvature = np.einsum("ij,ij->j", towards, image)
        step = np.divide(squares, curvature, out=np.zeros_like(squares), where=curvature > 0)
        found += step * squares
        R -= step * image
        before, Z = squares, inverse * R
        squares = np.einsum("ij,ij->j", R, Z)
        towards = (
            Z + np.divide(squares, before, out=np.zeros_like(before), where=before > 0) * towards
        )
    return np.asarray(found + squares / least)


def least_eigenvalue(mass: sparse.csr_array) -> float:
    """Return the least eigenvalue of M relative to its diagonal, to a few digits."""
    scale = sparse.diags_array(1 / np.sqrt(mass.diagonal()))
    scaled, n = scale @ mass @ scale, mass.shape[0]
    if n <= _FEW:
        return float(np.linalg.eigvalsh(scaled.toarray())[0])
    start = np.random.default_rng(0).standard_normal(n)
    asked: dict[str, Any] = {"which": "SA", "tol": 1e-2, "v0": start, "maxiter": _RESTARTS}
    try:
        return float(eigsh(scaled, 1, ncv=min(n, 40), return_eigenvectors=False, **asked)[0])
    except ArpackNoConvergence as error:
        raise InvalidInputError(
            "mass",
            "be far from singular",
            "a matrix whose least eigenvalue, relative to its diagonal, is not found in"
            f" {_RESTARTS} restarts of Lanczos",
        ) from error
