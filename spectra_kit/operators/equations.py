"""Poisson's equation, that of heat, and the operator of Schroedinger's, on any Laplacian."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Annotated

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from spectra_kit._core.checked import checked
from spectra_kit._core.records import latest
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_positive, real_array
from spectra_kit._sparse.ldl import SparseLDL
from spectra_kit.errors import InvalidInputError
from spectra_kit.operators._held import DirichletProblem, Kernel, columns, factorised, solution
from spectra_kit.operators.laplacian import Laplacian

# Of these, an exponential is off by at most 1e-10: see `heat_weights`.
_SOLVES, _STEP = 24, 0.0677


@checked
def poisson(
    laplacian: Laplacian,
    density: ArrayLike,
    *,
    fixed: Annotated[ArrayLike | None, NDArray[np.bool_]] = None,
    values: ArrayLike | None = None,
) -> Floats:
    """Solve Poisson's equation ``-Delta u = f``, where f is given at the points.

    Parameters
    ----------
    laplacian : Laplacian
        On n points. Nothing flows through a boundary that is not fixed.
    density : array_like of shape (n,) or (n, c)
        f, in the unit of u over length^2; of mean zero on components without a fixed point.
    fixed, values
        As of `Laplacian.solve`: points at which u is given, and what it is there.

    Returns
    -------
    ndarray of shape (n,) or (n, c)
        ``laplacian.solve(M f, ...)``.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> ball = sk.geometry.sphere(subdivisions=4).geometry
    >>> z = ball.points[:, 2]  # an eigenfunction, of eigenvalue 2
    >>> u = sk.operators.poisson(sk.robust_laplacian(ball), 2 * z)
    >>> bool(abs(u - z).max() < 2e-3)
    True
    """
    f = columns("density", density, laplacian.n)
    return solution(laplacian, "density", laplacian._weighed(f), fixed, values)


@checked
def diffuse(laplacian: Laplacian, field: ArrayLike, time: float) -> Floats:
    """Let heat spread for some time: ``du/dt = Delta u``, from u at the start.

    Parameters
    ----------
    laplacian : Laplacian
        On n points. Those held at zero take up heat; no other boundary lets any through.
    field : array_like of shape (n,) or (n, c)
        u at the start; not heeded at fixed points.
    time : float
        In length^2: heat of one point has then spread to about the root of it.

    Returns
    -------
    ndarray of shape (n,) or (n, c)
        u after that time, of any operator within 1e-10 of the field in the norm by mass; each
        column is what it would be alone. Means by mass stay what they were.

    Notes
    -----
    A polynomial in ``B = (M + s L)^-1 M`` interpolates ``exp(-t M^-1 L)`` in Chebyshev points
    (Andersson, *Approximation of e^-x by rational functions with concentrated negative poles*,
    Journal of Approximation Theory 32, 1981): one factor, kept for the same time, and 24 solves.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> mesh = sk.geometry.creature(1000)
    >>> laplacian, field = sk.robust_laplacian(mesh), mesh.points[:, 2]
    >>> later = sk.operators.diffuse(laplacian, field, 0.01)
    >>> bool(abs(laplacian.mass @ (later - field)) < 1e-12), bool(later.std() < field.std())
    (True, True)
    """
    flow = latest(laplacian, HeatFlow, check_positive("time", time))
    return flow.after(columns("field", field, laplacian.n))


class HeatFlow:
    """``exp(-t M^-1 L)`` for one time."""

    def __init__(self, laplacian: Laplacian, time: float) -> None:
        self._kernel, self._laplacian, self._step = Kernel(laplacian), laplacian, _STEP * time
        self._held = np.zeros(laplacian.n, dtype=bool)
        self._held[laplacian.fixed] = True
        self._factor: SparseLDL | None = None
        try:
            self._factor = factorised(laplacian, -1 / self._step, self._held)
        except InvalidInputError:  # beside L, the mass over the time is rounding
            DirichletProblem(laplacian, laplacian.fixed)  # which refuses what is not definite

    def after(self, field: Floats) -> Floats:
        """Return what becomes of a field (n,) or (n, c)."""
        flat = self._kernel.means(field)
        if self._factor is None:
            return flat
        last = field - flat
        last[self._held] = 0.0
        now = 2 * self._decayed(last) - last
        c = heat_weights(_SOLVES, _STEP)
        found = c[0] * last + c[1] * now
        for weight in c[2:]:  # T_(k+1) = 2 y T_k - T_(k-1), y = 2 B - 1
            last, now = now, 4 * self._decayed(now) - 2 * now - last
            found += weight * now
        return np.asarray(found - self._kernel.means(found) + flat)

    def _decayed(self, field: Floats) -> Floats:
        """Return ``(M + s L)^-1 M u``."""
        assert self._factor is not None
        weighted = self._laplacian._weighed(field) / self._step
        weighted[self._held] = 0.0
        return self._factor.solve(weighted)


@cache
def heat_weights(solves: int, step: float) -> Floats:
    """Return coefficients of Chebyshev polynomials in ``2 b - 1`` for ``exp(-x)``, x >= 0.

    Of ``b = 1 / (1 + step x)``, in [0, 1]. Ends are interpolated: what does not decay stays, and
    what decays infinitely fast is gone.
    """
    nodes = chebyshev.chebpts2(solves + 1)
    b = (nodes + 1) / 2
    with np.errstate(divide="ignore"):
        values = np.exp((1 - 1 / b) / step)
    return np.asarray(chebyshev.chebfit(nodes, values, solves))


@checked
def schroedinger(laplacian: Laplacian, potential: ArrayLike) -> Laplacian:
    """Return the operator ``-Delta + V`` of Schroedinger's equation, or of what is damped.

    Parameters
    ----------
    laplacian : Laplacian
        On n points.
    potential : float or array_like of shape (n,)
        V >= 0, in 1/length^2. Of another one pass ``V - V.min()``: modes are the same, eigenvalues
        higher by as much.

    Returns
    -------
    Laplacian
        ``L + V^1/2 M V^1/2``, for all solvers.

    Examples
    --------
    Levels of the harmonic oscillator on a square that is large beside it: 2, 4, 4.

    >>> import spectra_kit as sk
    >>> square = sk.geometry.rectangle(n=2500, width=9.0, height=9.0).geometry
    >>> V = ((square.points[:, :2] - 4.5) ** 2).sum(axis=1)
    >>> oscillator = sk.operators.schroedinger(sk.robust_laplacian(square), V)
    >>> sk.eigensolve(oscillator, 3).eigenvalues.round(1)
    array([2., 4., 4.])
    """
    values = real_array("potential", potential)
    if values.shape not in ((), (laplacian.n,)):
        raise InvalidInputError(
            "potential", f"be a number or have shape ({laplacian.n},)", values.shape
        )
    if values.min() < 0:
        raise InvalidInputError(
            "potential",
            "not be negative",
            f"down to {values.min():.3g}",
            advice="pass potential - potential.min(): eigenvalues rise by as much, and modes stay",
        )
    root = np.sqrt(np.broadcast_to(values, laplacian.n))
    if laplacian.consistent_mass is None:
        energy = sparse.diags_array(laplacian.mass * values)
    else:  # symmetric, as positive as M, and V M where V is one number
        energy = sparse.diags_array(root) @ laplacian.consistent_mass @ sparse.diags_array(root)
    lifted = laplacian.stiffness + energy
    return replace(laplacian, stiffness=lifted, operator=f"schroedinger({laplacian.operator})")
