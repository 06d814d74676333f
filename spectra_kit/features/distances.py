"""Distances that all paths count in, and points spread by them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.distance import cdist

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_count, check_positive
from spectra_kit.eigen import Spectrum
from spectra_kit.features._spectra import Solvable, check_sources, outside_kernel, solved


@checked
def diffusion_distances(surface: Solvable, sources: ArrayLike, *, time: float) -> Floats:
    """Difference of the heat that spreads from two points, a time after.

    Coifman and Lafon, *Diffusion Maps*, Applied and Computational Harmonic Analysis 21(1), 2006.

    Parameters
    ----------
    surface, sources
        As of `biharmonic_distances`; zero modes take part.
    time : float
        In length^2; `heat_times` spans the useful ones.

    Returns
    -------
    ndarray of shape (s, n)
        ``sqrt(sum_i exp(-2 lambda_i t) (u_i(x) - u_i(y))^2)``, in 1/length: the L2 norm of
        ``k_t(x, .) - k_t(y, .)``. Finite between components too, which share no heat.

    Notes
    -----
    The diffusion is the heat kernel. Averaged over all pairs of points, k modes leave about
    ``exp(-2 lambda_k t) / (4 pi t)`` out of the square (Weyl's law).

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> spectrum = sk.Spectrum(np.array([0.0, 1.0]), np.eye(2), np.ones(2))
    >>> sk.features.diffusion_distances(spectrum, [0], time=20.0)
    array([[0., 1.]])
    """
    spectrum = solved(surface)
    sources = check_sources("sources", sources, spectrum)
    gain = np.exp(-check_positive("time", time) * spectrum.eigenvalues)
    embedding = spectrum.eigenvectors * gain
    return np.asarray(cdist(embedding[sources], embedding))


@checked
def biharmonic_distances(surface: Solvable, sources: ArrayLike) -> Floats:
    """Biharmonic distances: smooth, without a parameter, and local as well as global.

    Lipman, Rustamov and Funkhouser, *Biharmonic Distance*, ACM Transactions on Graphics 29(3),
    2010.

    Parameters
    ----------
    surface : Spectrum, TriangleMesh, PointCloud, path or Laplacian
        As of `heat_kernel_signature`; zero modes tell the components apart.
    sources : array_like of shape (s,)
        Indices of points.

    Returns
    -------
    ndarray of shape (s, n)
        ``sqrt(sum_i (u_i(x) - u_i(y))^2 / lambda_i^2)`` over the modes outside the kernel, in
        length. Infinite between components; parts that are fixed to zero somewhere count as one.

    Notes
    -----
    The sum grows with k and converges: averaged over all pairs of points, k modes leave about
    ``1 / (2 pi lambda_k)``, or ``area / (8 pi^2 k)``, out of the square (Weyl's law; exact on the
    sphere, where the whole is radius^2 / (2 pi)).

    Examples
    --------
    >>> import spectra_kit as sk
    >>> from spectra_kit.features import biharmonic_distances
    >>> ball = sk.geometry.sphere(subdivisions=3).geometry
    >>> spectrum = sk.eigensolve(sk.robust_laplacian(ball), 100)
    >>> south = ball.points[:, 2].argmin()
    >>> distance = biharmonic_distances(spectrum, [ball.points[:, 2].argmax()])[0, south]
    >>> bool(abs(distance - (3.14159 / 12) ** 0.5) < 0.01)  # the exact value of antipodes
    True
    """
    spectrum = solved(surface)
    sources = check_sources("sources", sources, spectrum)
    embedding = _biharmonic_embedding(spectrum)
    distances = np.asarray(cdist(embedding[sources], embedding))
    return _infinite_between(kernel_labels(spectrum), sources, distances)


@checked
def commute_time_distances(surface: Solvable, sources: ArrayLike) -> Floats:
    """Roots of the time a random walk takes, on average, to a point and back.

    Parameters
    ----------
    surface, sources
        As of `biharmonic_distances`.

    Returns
    -------
    ndarray of shape (s, n)
        ``sqrt(area sum_i (u_i(x) - u_i(y))^2 / lambda_i)`` over the modes outside the kernel, in
        length, with the area of the component. Infinite between components; parts that are
        fixed to zero somewhere count as one.

    Notes
    -----
    With all n modes of a mesh the sum is the effective resistance of its edges. There is no limit
    for finer meshes or more modes: two points of a surface never meet, and the square grows by
    about ``area / (2 pi) log k``. Compare values of one k only; `biharmonic_distances` converge.

    See Qiu and Hancock, *Clustering and Embedding Using Commute Times*, PAMI 29(11), 2007, and
    Fouss et al., *Random-Walk Computation of Similarities between Nodes of a Graph*, TKDE 19(3),
    2007.

    Examples
    --------
    Two points of mass 1, joined by a conductance of 1/2: the resistance is 2, the area too.

    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> U = np.array([[1.0, 1.0], [1.0, -1.0]]) / 2**0.5
    >>> sk.features.commute_time_distances(sk.Spectrum(np.array([0.0, 1.0]), U, np.ones(2)), [0])
    array([[0., 2.]])
    """
    spectrum = solved(surface)
    sources = check_sources("sources", sources, spectrum)
    modes = outside_kernel(spectrum)
    embedding = modes.eigenvectors / np.sqrt(modes.eigenvalues)
    labels = kernel_labels(spectrum)
    area = np.bincount(labels, spectrum.mass)[labels[sources]]
    distances = np.sqrt(area)[:, None] * cdist(embedding[sources], embedding)
    return _infinite_between(labels, sources, distances)


@checked
def farthest_points(surface: Solvable, count: int, *, start: int | None = None) -> Ints:
    """Pick points one after the other, each as far as possible from those before.

    Parameters
    ----------
    surface : Spectrum, TriangleMesh, PointCloud, path or Laplacian
        As of `heat_kernel_signature`; by its zero modes every component gets a point before any
        gets two.
    count : int
        Number of points, at most n.
    start : int, optional
        Index of the first point; by default the one farthest from the middle, in the sense of
        `biharmonic_distances` to the average of all points: a tip of the surface.

    Returns
    -------
    ndarray of shape (count,)
        Distinct indices, in the order in which they were picked. Without ties, they depend on the
        intrinsic geometry alone: two poses of a body without symmetries get the same places.

    Notes
    -----
    Farthest point sampling in `biharmonic_distances`; O(n k) per point. The points are within twice
    the best possible covering radius in that distance (Gonzalez, *Clustering to Minimize the
    Maximum Intercluster Distance*, Theoretical Computer Science 38, 1985).

    Examples
    --------
    >>> import spectra_kit as sk
    >>> laplacian = sk.robust_laplacian(sk.geometry.rectangle(height=1.0, n=100).geometry)
    >>> sk.features.farthest_points(sk.eigensolve(laplacian, 30), 2, start=0)  # opposite corners
    array([ 0, 99])
    """
    spectrum = solved(surface)
    check_count("count", count, low=1, high=spectrum.n)
    embedding, labels = _biharmonic_embedding(spectrum), kernel_labels(spectrum)
    from_middle = np.sum(embedding**2, axis=1)  # squared, as all that follows
    # Components without a point are farther than any distance; among their points, tips go first.
    gap = 4 * from_middle.max() + from_middle
    if start is not None:
        start = check_count("start", start, low=0, high=spectrum.n - 1)
    chosen = [int(np.argmax(gap)) if start is None else start]
    while len(chosen) < count:
        last = chosen[-1]
        distance = from_middle + from_middle[last] - 2 * (embedding @ embedding[last])
        gap = np.where(labels == labels[last], np.minimum(gap, distance), gap)
        gap[last] = -np.inf  # where points coincide, a distance may round below zero
        chosen.append(int(np.argmax(gap)))
    return np.array(chosen, dtype=np.int64)


def _biharmonic_embedding(spectrum: Spectrum) -> Floats:
    """Return ``u_i(x) / lambda_i``, (n, modes outside the kernel), in length."""
    modes = outside_kernel(spectrum)
    return np.asarray(modes.eigenvectors / modes.eigenvalues)


def kernel_labels(spectrum: Spectrum) -> Ints:
    """Return a label of each point, (n,): equal where the zero modes cannot tell them apart.

    These are the components, except that all points of components without a zero mode (fixed
    somewhere) share one label: they are joined by what they are fixed to.
    """
    rows = spectrum.eigenvectors[:, : spectrum.n_zero_modes]
    # Rows are equal inside a component and orthogonal between two, of squared length 1/area.
    size = np.maximum(np.sum(rows**2, axis=1), 1 / spectrum.area)
    labels = np.full(spectrum.n, -1)
    left = np.arange(spectrum.n)
    label = 0
    while len(left):
        first = left[0]
        apart = np.sum((rows[left] - rows[first]) ** 2, axis=1)
        same = apart < 0.5 * np.maximum(size[left], size[first])
        labels[left[same]] = label
        left = left[~same]
        label += 1
    return labels


def _infinite_between(labels: Ints, sources: Ints, distances: Floats) -> Floats:
    return np.where(labels[sources][:, None] == labels, distances, np.inf)
