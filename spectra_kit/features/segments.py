"""Points put in order, and surfaces cut into parts, by the lowest modes."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.spatial.distance import cdist

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_count
from spectra_kit._core.warn import warn
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import AmbiguousModesWarning, InvalidInputError
from spectra_kit.features._spectra import Solvable, outside_kernel, solved
from spectra_kit.features.distances import kernel_labels

_PRESENT = 1e-3  # share of a mode on a component that is more than an error of the solver
_NEAR = 0.01  # relative distance of eigenvalues that a discretisation may part, or join
_EVEN = 1e-6  # relative third moment of a mode whose two ends are alike
_TRIES, _ROUNDS = 16, 100  # of k-means: starts, and steps from each
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
        Indices of all points: one component after the other, in the order of their first points,
        and in each by ascending values. The end that comes last is the one on which the mode has
        the greater values, on less area: of a body with a tail, the tail. (The sum of ``mass *
        u**3`` is positive; where both ends are alike, the first point that has half of the greatest
        magnitude is in the first half.) Components that are held at zero somewhere count as one,
        and are ordered from there inwards.

    Warns
    -----
    AmbiguousModesWarning
        If the next eigenvalue of a component is within a hundredth, as on spheres and squares: then
        any mix of two modes is one, and an order by it says nothing.

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
    shares = member @ modes.eigenvectors**2
    order, doubtful = [], 0
    for part, share in enumerate(shares):
        points = np.flatnonzero(labels == part)
        there = np.flatnonzero(share > _PRESENT)
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
        doubtful += np.linalg.matrix_rank(np.sqrt(mass / share[near]) * values, tol=0.1) > 1
        order.append(points[np.argsort(_signed(values[:, 0], mass[:, 0]), kind="stable")])
    if doubtful:
        warn(
            "the first mode that is not constant is one of two or more with about the same"
            " eigenvalue, which can be mixed: an order by it says little",
            AmbiguousModesWarning,
        )
    return np.concatenate(order)


def _signed(mode: Floats, mass: Floats) -> Floats:
    """Return a mode with the sign that `fiedler_order` states."""
    mode = mode / np.abs(mode).max()
    size = np.abs(mode)
    lean = float(mass @ mode**3)
    if abs(lean) <= _EVEN * float(mass @ size**3):
        lean = -float(mode[np.argmax(size >= size.max() / 2)])
    return mode if lean > 0 else -mode


@checked
def spectral_segments(surface: Solvable, parts: int, *, seed: int = 0) -> Ints:
    """Cut a surface into parts at its necks, by k-means in an embedding by its modes.

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

    Notes
    -----
    The embedding is that of `diffusion_distances`, at the time ``1 / lambda`` of mode number
    `parts` outside the kernel: heat has then evened out within parts of about that number, and not
    between them. (Rustamov, *Laplace-Beltrami Eigenfunctions for Deformation Invariant Shape
    Representation*, SGP 2007, does so by the global point signature.)

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> mesh = sk.geometry.creature(1000)
    >>> np.bincount(sk.features.spectral_segments(mesh, 6)).sum()
    1000
    """
    spectrum = solved(surface)
    spectrum = spectrum.rescale(spectrum.area**-0.5)
    labels = kernel_labels(spectrum)
    check_count("parts", parts, low=int(labels.max()) + 1, high=spectrum.n)
    check_count("seed", seed, low=0)
    rows = _embedded(spectrum, parts)
    if labels.any():
        far = _APART * np.abs(rows).max() * np.eye(labels.max() + 1)
        rows = np.column_stack([rows, far[labels]])
    found = _clusters(rows, spectrum.mass, parts, np.random.default_rng(seed))
    areas = np.bincount(found, spectrum.mass, minlength=parts)
    rank = np.empty(parts, dtype=np.int64)
    rank[np.argsort(-areas, kind="stable")] = np.arange(parts)
    return rank[found]


def _embedded(spectrum: Spectrum, parts: int) -> Floats:
    """Return points in the space where k-means groups them."""
    modes = outside_kernel(spectrum)
    time = 1 / modes.eigenvalues[min(parts, modes.k) - 1]
    return np.asarray(modes.eigenvectors * np.exp(-time * modes.eigenvalues))


def _clusters(rows: Floats, mass: Floats, count: int, rng: np.random.Generator) -> Ints:
    """Group rows by k-means, weighted by mass, which SciPy's is not."""
    least, best = np.inf, np.zeros(len(rows), dtype=np.int64)
    for _ in range(_TRIES):
        centres = _spread(rows, mass, count, rng)
        found = best
        for _ in range(_ROUNDS):
            squared = cdist(rows, centres, "sqeuclidean")
            before, found = found, squared.argmin(axis=1)
            weights = np.bincount(found, mass, minlength=count)
            sums = (
                sparse.csr_array((mass, (found, np.arange(len(rows)))), (count, len(rows))) @ rows
            )
            full = weights > 0
            centres[full] = sums[full] / weights[full, None]
            if np.array_equal(before, found):
                break
        cost = float(mass @ squared.min(axis=1))
        if cost < least:
            least, best = cost, found
    return best


def _spread(rows: Floats, mass: Floats, count: int, rng: np.random.Generator) -> Floats:
    """Return rows to start from, each likely to be far from those before.

    Arthur and Vassilvitskii, *k-means++: The Advantages of Careful Seeding*, SODA 2007.
    """
    chosen: list[int] = []
    gaps = np.ones(len(rows))
    for _ in range(count):
        odds = np.cumsum(mass * gaps)
        chosen.append(int(np.searchsorted(odds, rng.random() * odds[-1], side="right")))
        apart = np.square(rows - rows[chosen[-1]]).sum(axis=1)
        gaps = np.minimum(gaps, apart) if len(chosen) > 1 else apart
    return rows[chosen].copy()
