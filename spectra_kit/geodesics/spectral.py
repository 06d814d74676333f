"""Distances by the heat method in the modes alone: smooth, approximate, no linear solve."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import NDArray

from spectra_kit._validate import check_positive
from spectra_kit.errors import InvalidInputError
from spectra_kit.geodesics.sources import Sources, SourcesLike, check_sources
from spectra_kit.operators.intrinsic import IntrinsicTriangulation
from spectra_kit.spectrum import Spectrum

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]

_NEGATIVE = 0.01  # share of the surface that truncation may cool below zero
_SAMPLE = 4096  # points that stand for all of them in the search for a time


def spectral_heat(
    spectrum: Spectrum, sources: SourcesLike, time: float, *, exact: bool = False
) -> Floats:
    """Heat at every point, a time after it was put on the sources, as far as the modes tell.

    Parameters
    ----------
    spectrum : Spectrum
        k modes; zero modes take part.
    sources : int, sequence, mask, or Sources
        As `check_sources` takes them; for points of faces, what it returns.
    time : float
        In length^2, positive; see `smallest_spectral_time`.
    exact : bool, default False
        Let the heat flow, by ``exp(-t lambda)``, in place of one backward Euler step of the heat
        method, by ``1 / (1 + t lambda)``. The flow needs fewer modes: those left out of the step
        decay slowly.

    Returns
    -------
    ndarray of shape (n,)
        ``sum_i g(lambda_i) u_i <u_i, heat>``, in units of the heat over length^2. For short times
        the truncated sum oscillates around zero.

    Raises
    ------
    InvalidInputError
        If there is no source, one is out of range, or `time` is not positive.

    Notes
    -----
    With all n modes, a backward Euler step is the solution of ``(M + t L) u = heat``, the first
    step of Crane, Weischedel, Wardetzky (2013).

    Examples
    --------
    >>> spectrum = Spectrum(np.array([0.0, 1.0]), np.eye(2), np.ones(2))
    >>> spectral_heat(spectrum, [0, 1], 1.0)
    array([1. , 0.5])
    """
    _check_spectrum(spectrum)
    check_positive("time", time)
    seen = _seen(spectrum, check_sources(sources, spectrum))
    return np.asarray(spectrum.eigenvectors @ (_gain(spectrum.eigenvalues, time, exact) * seen))


def smallest_spectral_time(
    spectrum: Spectrum, sources: SourcesLike, *, exact: bool = False
) -> float:
    """Shortest time at which the modes resolve the heat of some sources wherever it gets to.

    Parameters
    ----------
    spectrum : Spectrum
        k modes, the zero modes among them.
    sources : int, sequence, mask, or Sources
        As `check_sources` takes them. The more there are, the shorter the time.
    exact : bool, default False
        As in `spectral_heat`: of heat that flows, or of a backward Euler step.

    Returns
    -------
    float
        In length^2: the time after which `spectral_heat` is positive on 99 per cent of the
        components with a source, within 5 per cent.

    Raises
    ------
    InvalidInputError
        If `spectrum` has no zero mode, or all its modes are; if there is no source, or one is on
        a part without a zero mode.

    Notes
    -----
    True heat is positive everywhere. It falls by ``exp(-d^2 / (4 t))`` at a distance d, while
    the modes left out carry about ``exp(-t lambda_k)``: their balance,
    ``t = d / (2 sqrt(lambda_k))``, is the shortest time whose heat the modes still resolve at
    the distance d. No diameter is needed to find it; beyond it the truncated sum changes sign.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> ball = sk.geometry.sphere(subdivisions=3).geometry
    >>> spectrum = sk.eigensolve(sk.robust_laplacian(ball), 100)
    >>> time = smallest_spectral_time(spectrum, 0, exact=True)
    >>> print(round(time, 2), round(3.14 / (2 * spectrum.eigenvalues[-1] ** 0.5), 2))
    0.13 0.18
    """
    _check_resolving(spectrum)
    checked = check_sources(sources, spectrum)
    return _smallest_time(spectrum, checked, _reached(spectrum, checked), exact)


def spectral_distance(
    spectrum: Spectrum,
    triangulation: IntrinsicTriangulation,
    sources: SourcesLike,
    *,
    time: float | None = None,
) -> Floats:
    """Approximate the distance to the nearest source by the heat method in the modes alone.

    Parameters
    ----------
    spectrum : Spectrum
        k modes, the zero modes among them, Neumann.
    triangulation : IntrinsicTriangulation
        Of the same n points.
    sources : int, sequence, mask, or Sources
        As `check_sources` takes them; for points of faces, what it returns.
    time : float, optional
        For which the heat flows, in length^2; `smallest_spectral_time` by default.

    Returns
    -------
    ndarray of shape (n,)
        In length; 0 at a single source, infinite on components without one.

    Raises
    ------
    InvalidInputError
        If `spectrum` and `triangulation` differ in points or components, there is no source, one
        is out of range, or `time` is not positive.

    Warns
    -----
    UserWarning
        If `time` is too short for the modes.
    """
    _check_resolving(spectrum)
    _check_triangulation(triangulation, spectrum)
    checked = check_sources(sources, triangulation)
    reached = _reached(spectrum, checked)
    label = triangulation.laplacian.component_labels
    if not np.array_equal(reached, np.isin(label, label[checked.vertices])):
        raise InvalidInputError(
            "`spectrum` must have a zero mode for each of the"
            f" {triangulation.laplacian.n_components} components of `triangulation`, got"
            f" {spectrum.n_zero_modes}; compute it with Neumann conditions, of the same geometry"
        )
    shortest = _smallest_time(spectrum, checked, reached, exact=True)
    time = shortest if time is None else check_positive("time", time)
    heat = np.where(reached, spectral_heat(spectrum, checked, time, exact=True), 0.0)
    cold = _cold_share(heat[reached], spectrum.mass[reached])
    if time < shortest and cold > _NEGATIVE:
        warnings.warn(
            f"`time` {time:.3g} is too short for {spectrum.k} modes: their heat is negative on"
            f" {100 * cold:.0f} % of the surface, where distances are wrong; use at least"
            f" {shortest:.3g}, the default, or more modes",
            stacklevel=2,
        )
    gradient = triangulation.gradient(heat)
    norm = np.linalg.norm(gradient, axis=1, keepdims=True)
    away = np.divide(-gradient, norm, out=np.zeros_like(gradient), where=norm > 0)
    modes = spectrum.nonzero()
    seen = modes.eigenvectors.T @ triangulation.divergence(away)
    potential = modes.eigenvectors @ (seen / modes.eigenvalues)
    return _from_the_sources(potential, checked, label, modes.eigenvalues[-1])


def _from_the_sources(potential: Floats, sources: Sources, label: Ints, highest: float) -> Floats:
    """Turn a potential, known up to a constant on each component, into distances.

    In the plane, a distance |x| has the Fourier transform ``-2 pi / |xi|^3``, so that frequencies
    up to ``sqrt(lambda_k)`` blunt the cone: they lift its tip to ``r = 1 / sqrt(lambda_k)`` and
    leave it where it is far away. We undo this as if the blunt cone were ``sqrt(d^2 + r^2)``.
    """
    blunt = highest**-0.5
    lifted = np.hypot(sources.offsets, blunt)
    distance = np.full(len(potential), np.inf)
    for component in np.unique(label[sources.vertices]):
        here = label[sources.vertices] == component
        at_sources = potential[sources.vertices[here]] - lifted[here]
        height = potential[label == component] - np.average(at_sources, weights=sources.heat[here])
        distance[label == component] = np.sqrt(np.maximum(height, blunt) ** 2 - blunt**2)
    return distance


def _seen(spectrum: Spectrum, sources: Sources) -> Floats:
    """Return the coefficients of the heat of `sources` in the modes, shape (k,)."""
    return np.asarray(sources.heat @ spectrum.eigenvectors[sources.vertices])


def _gain(eigenvalues: Floats, time: float, exact: bool) -> Floats:
    """Return what a time leaves of the heat in each mode."""
    return np.exp(-time * eigenvalues) if exact else 1 / (1 + time * eigenvalues)


def _smallest_time(spectrum: Spectrum, sources: Sources, reached: Mask, exact: bool) -> float:
    """Search for the first time at which hardly any of the `reached` points are cold."""
    points = np.flatnonzero(reached)
    points = points[:: -(-len(points) // _SAMPLE)]
    seen, eigenvalues = _seen(spectrum, sources), spectrum.eigenvalues
    U, mass = spectrum.eigenvectors[points], spectrum.mass[points]

    def resolved(time: float) -> bool:
        heat = U @ (_gain(eigenvalues, time, exact) * seen)
        return _cold_share(heat, mass) <= _NEGATIVE

    high = 1 / eigenvalues[-1]
    while not resolved(high):  # ends: what is left in the end, the zero modes, is positive
        high *= 2
    low = high / 2
    while high > 1.05 * low:
        middle = (low * high) ** 0.5
        low, high = (low, middle) if resolved(middle) else (middle, high)
    return float(high)


def _cold_share(heat: Floats, mass: Floats) -> float:
    """Return the share of the surface with negative heat, which only truncation can cause."""
    return float(mass[heat < 0].sum() / mass.sum())


def _reached(spectrum: Spectrum, sources: Sources) -> Mask:
    """Mark the points on the components of the sources.

    Rows of the zero modes are parallel in a component, and orthogonal between two.
    """
    rows = spectrum.eigenvectors[:, : spectrum.n_zero_modes]
    length = np.linalg.norm(rows, axis=1, keepdims=True)
    rows = np.divide(rows, length, out=np.zeros_like(rows), where=length > 0)
    reached = np.asarray(rows @ rows[sources.vertices].sum(axis=0) > 0.5)
    if not reached[sources.vertices].all():
        raise InvalidInputError(
            "`sources` must be on components with a zero mode, got"
            f" {sources.vertices[~reached[sources.vertices]][0]}, where there is none;"
            " compute the spectrum with Neumann conditions, and keep its zero modes"
        )
    return reached


def _check_spectrum(spectrum: Spectrum) -> None:
    if not isinstance(spectrum, Spectrum):
        raise InvalidInputError(
            f"`spectrum` must be a Spectrum, got {type(spectrum).__name__};"
            " solve for one: eigensolve(robust_laplacian(mesh), 100)"
        )


def _check_resolving(spectrum: Spectrum) -> None:
    """Refuse a spectrum of zero modes alone."""
    _check_spectrum(spectrum)
    if spectrum.k == spectrum.n_zero_modes:
        raise InvalidInputError(
            f"`spectrum` must have modes outside its kernel, got {spectrum.k} modes, all of them"
            " zero modes; compute more than there are components"
        )


def _check_triangulation(triangulation: IntrinsicTriangulation, spectrum: Spectrum) -> None:
    if not isinstance(triangulation, IntrinsicTriangulation):
        raise InvalidInputError(
            "`triangulation` must be an IntrinsicTriangulation, got"
            f" {type(triangulation).__name__}; make one by intrinsic_delaunay(mesh)"
        )
    if triangulation.n != spectrum.n:
        raise InvalidInputError(
            f"`triangulation` must have the {spectrum.n} points of `spectrum`, got"
            f" {triangulation.n}"
        )
