"""Points put in order, and surfaces cut into parts, by the lowest modes."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.spatial.distance import cdist

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_count
from spectra_kit._core.warn import warn
from spectra_kit.errors import AmbiguousModesWarning, InvalidInputError
from spectra_kit.features._spectra import Solvable, outside_kernel, solved
from spectra_kit.features.distances import kernel_labels
from spectra_kit.geometry.vectors import sums

_PRESENT = 1e-3  # share of a mode on a component that is more than an error of the solver
_NEAR = 0.01  # relative distance of eigenvalues that a discretisation may part, or join
_EVEN = 1e-6  # relative third moment of a mode whose two ends are alike
_TRIES, _ROUNDS = 16, 100  # of k-means: starts, and steps from each
_AS_GOOD, _ELSEWHERE = 0.03, 0.1  # relative cost, and share of the area, of cuts that say little
_APART = 1e3  # of components, in extents of an embedding


@checked
def fiedler_order(surface: Solvable) -> Ints:
    """Put points in order along the first mode that is not constant: from one end to the other.

    Fiedler, *A property of eigenvectors of nonnegative symmetric matrices and its application to
    graph theory*, Czechoslovak Mathematical Journal 25, 1975.

    Parameters
    ----------
    surface : Spectrum, TriangleMesh, PointCloud, path or Laplacian
        As of `heat_kernel_signature`, with a mode outside the kernel on each component.

    Returns
    -------
    ndarray of shape (n,)
        Indices of points, one component after the other (those held at zero somewhere are one). The
        thinner end comes last: the sum of ``mass * u**3`` is positive. Where both ends are alike,
        the first point with half of the greatest magnitude is in the first half.

    Warns
    -----
    AmbiguousModesWarning
        If the next eigenvalue of a component is within a hundredth, as on spheres and squares.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> sheet = sk.geometry.rectangle(n=200, width=3.0, height=1.0).geometry
    >>> x = sheet.points[sk.features.fiedler_order(sheet), 0]
    >>> bool(abs(x[0] - x[-1]) == 3.0)
    True
    """
    spectrum = solved(surface)
    labels, modes = kernel_labels(spectrum), outside_kernel(spectrum)
    member = sparse.csr_array((spectrum.mass, (labels, np.arange(spectrum.n))))
    order, doubtful = [], False
    for part, share in enumerate(member @ modes.eigenvectors**2):
        points, there = np.flatnonzero(labels == part), np.flatnonzero(share > _PRESENT)
        if len(points) == 1:
            order.append(points)
            continue
        if not len(there):
            raise InvalidInputError(
                "surface",
                "have a mode outside the kernel on each component",
                f"none among {spectrum.k} on that of point {points[0]}",
                advice="compute more modes, or ask for one component",
            )
        near = there[modes.eigenvalues[there] <= (1 + _NEAR) * modes.eigenvalues[there[0]]]
        values, mass = modes.eigenvectors[np.ix_(points, near)], spectrum.mass[points, None]
        doubtful |= np.linalg.matrix_rank(np.sqrt(mass / share[near]) * values, tol=0.1) > 1
        order.append(points[np.argsort(_signed(values[:, 0], mass[:, 0]), kind="stable")])
    if doubtful:
        warn(
            "the first mode that is not constant is one of several of about one eigenvalue, of"
            " which any mix is a mode: an order by it says little",
            AmbiguousModesWarning,
        )
    return np.concatenate(order)


def _signed(mode: Floats, mass: Floats) -> Floats:
    """Return a mode with the sign that `fiedler_order` states."""
    mode = mode / np.abs(mode).max()
    lean = float(mass @ mode**3)
    if abs(lean) <= _EVEN * float(mass @ np.abs(mode**3)):
        lean = -float(mode[np.argmax(np.abs(mode) >= 0.5)])
    return mode if lean > 0 else -mode


@checked
def spectral_segments(surface: Solvable, parts: int, *, seed: int = 0) -> Ints:
    """Cut a surface into parts at its necks, by k-means in an embedding by its modes.

    The embedding is that of `diffusion_distances`, at the time ``1 / lambda`` of mode number
    ``parts - 1`` outside the kernel. (Rustamov, *Laplace-Beltrami Eigenfunctions for Deformation
    Invariant Shape Representation*, SGP 2007, takes the global point signature.)

    Parameters
    ----------
    surface : Spectrum, TriangleMesh, PointCloud, path or Laplacian
        As of `heat_kernel_signature`.
    parts : int
        How many; at least one for each component, as none spans two.
    seed : int, default 0
        Of the starts of k-means, of which the best of 16 counts.

    Returns
    -------
    ndarray of shape (n,)
        The part of each point, from 0, largest area first.

    Warns
    -----
    AmbiguousModesWarning
        If another start ended with a cut that is as good to 3 % and differs on a tenth of the area:
        samples of one surface may be cut in either way.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> found = sk.features.spectral_segments(sk.geometry.creature(1000), 4)
    >>> sorted(set(found.tolist()))
    [0, 1, 2, 3]
    """
    spectrum = solved(surface)
    labels, modes = kernel_labels(spectrum), outside_kernel(spectrum)
    check_count("parts", parts, low=int(labels.max()) + 1, high=spectrum.n)
    rng, mass = np.random.default_rng(check_count("seed", seed, low=0)), spectrum.mass
    time = 1 / modes.eigenvalues[min(max(parts - 1, 1), modes.k) - 1]
    rows = modes.eigenvectors * np.exp(-time * modes.eigenvalues)
    if labels.any():
        far = _APART * np.abs(rows).max() * np.eye(labels.max() + 1)
        rows = np.column_stack([rows, far[labels]])
    tries = sorted((_clusters(rows, mass, parts, rng) for _ in range(_TRIES)), key=lambda t: t[0])
    least, best = tries[0]
    close = [found for cost, found in tries if cost <= (1 + _AS_GOOD) * least]
    if any(_moved(best, found, mass, parts) > _ELSEWHERE for found in close):
        warn(
            f"the surface can be cut into {parts} parts elsewhere, about as well",
            AmbiguousModesWarning,
            advice="ask for another number of parts",
        )
    rank = np.argsort(np.argsort(-np.bincount(best, mass, minlength=parts), kind="stable"))
    return np.asarray(rank[best])


def _clusters(
    rows: Floats, mass: Floats, count: int, rng: np.random.Generator
) -> tuple[float, Ints]:
    """Group rows by k-means from one start, weighted by mass, which SciPy's is not.

    Arthur and Vassilvitskii, *k-means++: The Advantages of Careful Seeding*, SODA 2007.
    """
    gaps, centres = np.ones(len(rows)), np.empty((count, rows.shape[1]))
    for i in range(count):
        odds = np.cumsum(mass * gaps)
        centres[i] = rows[np.searchsorted(odds, rng.random() * odds[-1], side="right")]
        apart = np.square(rows - centres[i]).sum(axis=1)
        gaps = np.minimum(gaps, apart) if i else apart
    found = np.full(len(rows), -1)
    for _ in range(_ROUNDS):
        squared = cdist(rows, centres, "sqeuclidean")
        before, found = found, squared.argmin(axis=1)
        if np.array_equal(before, found):
            break
        weights = np.bincount(found, mass, count)
        full = weights > 0
        centres[full] = sums(found, mass[:, None] * rows, count)[full] / weights[full, None]
    return float(mass @ squared.min(axis=1)), found


def _moved(first: Ints, second: Ints, mass: Floats, count: int) -> float:
    """Return the share of the area on which two cuts differ, by the best names of parts."""
    from scipy.optimize import linear_sum_assignment  # slow to import

    both = sparse.csr_array((mass, (first, second)), (count, count)).toarray()
    return 1 - float(both[linear_sum_assignment(-both)].sum() / mass.sum())
