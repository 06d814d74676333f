"""The heat step by iteration: up from below, then in larger steps; see `HeatStep`."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from spectra_kit._core.types import Floats, Ints32
from spectra_kit.geodesics._kernels import residual, scaled_entries, solve_scaled

_RISE = 16  # iterations that suffice unless triangles differ much in size
_MOST = 300
_NARROW = 200  # binary orders of magnitude around 1 that need no new exponents


def _scaled(matrix: sparse.csr_array, exponents: Ints32) -> tuple[Floats, Floats]:
    """Return the entries of a matrix in the scaling of its columns, and in that of its rows."""
    forward, backward = np.empty_like(matrix.data), np.empty_like(matrix.data)
    scaled_entries(matrix.indptr, matrix.indices, matrix.data, exponents, forward, backward)
    return forward, backward


class ScaledSystem:
    """``A u = b`` and an incomplete factor of A, for ``x = 2**-exponents u``.

    The scaling is by powers of two, on both sides, so it rounds nothing; and between neighbours,
    so it overflows nowhere.
    """

    def __init__(
        self,
        matrix: sparse.csr_array,
        lower: sparse.csr_array,
        inverse: Floats,
        rhs: Floats,
        exponents: Ints32,
    ) -> None:
        self._matrix, self._lower, self._inverse, self._rhs = matrix, lower, inverse, rhs
        self.exponents = exponents
        self._entries, _ = _scaled(matrix, exponents)
        self._forward, self._backward = _scaled(lower, exponents)
        self._scaled_rhs = np.ldexp(rhs, -exponents)

    def aligned(self, x: Floats) -> tuple[ScaledSystem, Floats]:
        """Return the system scaled so that all values of x are about 1, and x in it."""
        size, power = np.frexp(x)
        exponents = (self.exponents + power).astype(np.int32)
        return ScaledSystem(self._matrix, self._lower, self._inverse, self._rhs, exponents), size

    def residual(self, x: Floats) -> tuple[float, Floats]:
        """Return the componentwise backward error of x, and ``b - A x``."""
        A, out = self._matrix, np.empty_like(x)
        share = residual(A.indptr, A.indices, self._entries, self._scaled_rhs, x, out)
        return share, out

    def product(self, x: Floats) -> Floats:
        """Return ``A x``."""
        A, out = self._matrix, np.empty_like(x)
        residual(A.indptr, A.indices, self._entries, np.zeros_like(x), -x, out)
        return out

    def precondition(self, r: Floats) -> Floats:
        """Return ``F^-1 r`` with the incomplete factor F."""
        L, out = self._lower, np.empty_like(r)
        solve_scaled(L.indptr, L.indices, self._forward, self._backward, self._inverse, r, out)
        return out


def iterate(
    matrix: sparse.csr_array,
    lower: sparse.csr_array,
    inverse: Floats,
    rhs: Floats,
    exponents: Ints32,
    *,
    accuracy: float,
) -> tuple[Floats, Ints32, int, float]:
    """Solve until the componentwise backward error is `accuracy`, or no more iterations are left.

    Return x and its exponents, ``u = 2**exponents x``, the iterations, and the error.

    First ``x += F^-1 (b - A x)``, which rises to the solution; if that takes long, BiCGStab (van
    der Vorst, SIAM J. Sci. Stat. Comput. 1992) from there, with exponents so near that its norm,
    of u relative to itself, heeds all points alike.
    """
    system, x = ScaledSystem(matrix, lower, inverse, rhs, exponents), np.zeros_like(rhs)
    share, r = system.residual(x)
    iterations = 0
    while share > accuracy and iterations < _RISE:
        x += system.precondition(r)
        iterations += 1
        power = np.frexp(x)[1]
        if np.abs(power).max() > _NARROW:
            system, x = system.aligned(x)
        share, r = system.residual(x)
    while not share <= accuracy and iterations < _MOST and np.isfinite(x).all():
        system, x = system.aligned(x)
        x, share, count = _stabilised(system, x, accuracy, _MOST - iterations)
        iterations += count
    return x, system.exponents, iterations, share


def _stabilised(
    system: ScaledSystem, x: Floats, accuracy: float, most: int
) -> tuple[Floats, float, int]:
    """Return where BiCGStab gets from x, its backward error, and its iterations."""
    share, r = system.residual(x)
    shadow, p, v = r.copy(), np.zeros_like(r), np.zeros_like(r)
    rho = alpha = omega = 1.0
    for count in range(1, most + 1):
        before, rho = rho, _dot(shadow, r)
        if rho == 0 or omega == 0:
            return x, share, count
        p = r + rho / before * alpha / omega * (p - omega * v)
        y = system.precondition(p)
        v = system.product(y)
        alpha = rho / _dot(shadow, v)
        s = r - alpha * v
        z = system.precondition(s)
        t = system.product(z)
        omega = _dot(t, s) / max(_dot(t, t), np.finfo(float).tiny)
        x = x + alpha * y + omega * z
        r = s - omega * t
        share, _ = system.residual(x)
        if share <= accuracy or not np.isfinite(share):
            return x, share, count
    return x, share, most


def _dot(a: Floats, b: Floats) -> float:
    """Return the inner product, without BLAS: its threads would take longer to meet than to add."""
    return float((a * b).sum())
