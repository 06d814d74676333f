"""Points spread over a surface of which only the spectrum is known."""

from __future__ import annotations

import numpy as np

from spectra_kit._checked import checked
from spectra_kit._types import Ints
from spectra_kit._validate import check_count
from spectra_kit.descriptors.distances import biharmonic_embedding, kernel_labels
from spectra_kit.spectra import Spectrum


@checked
def farthest_points(spectrum: Spectrum, count: int, *, start: int | None = None) -> Ints:
    """Pick points one after the other, each as far as possible from those before.

    Parameters
    ----------
    spectrum : Spectrum
        k modes, zero modes among them, so that every component gets a point before any gets two.
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

    Raises
    ------
    InvalidInputError
        If `count` or `start` is out of range, or all modes are zero modes.

    Notes
    -----
    Farthest point sampling (Gonzalez, *Clustering to minimize the maximum intercluster distance*,
    1985) in `biharmonic_distances`; O(n k) per point. The points are within twice the best possible
    covering radius in that distance.

    References
    ----------
    T. F. Gonzalez, "Clustering to minimize the maximum intercluster distance", Theoretical
    Computer Science 38, 1985.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> laplacian = sk.robust_laplacian(sk.geometry.rectangle(height=1.0, n=100).geometry)
    >>> sk.descriptors.farthest_points(sk.eigensolve(laplacian, 30), 2, start=0)  # opposite corners
    array([ 0, 99])
    """
    check_count("count", count, low=1, high=spectrum.n)
    embedding, labels = biharmonic_embedding(spectrum), kernel_labels(spectrum)
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
