"""What an operator refuses or tells of, said once for all of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_count, check_positive, quantity, real_array
from spectra_kit._core.warn import warn
from spectra_kit.errors import InvalidInputError, SplitSurfaceWarning
from spectra_kit.geometry.shapes import (
    Geometry,
    PointCloud,
    TriangleMesh,
    component_units,
    power_of_two,
)
from spectra_kit.operators.laplacian import Laplacian

_SMALLEST, _LARGEST = 1e-130, 1e130  # extents, of which squares and products are numbers
# Of the squared trace of second moments: above it points are on no line, whatever the rounding.
_SLIM = 1e-9
_MIXED = np.array([0x1E3779B97F4A7C15, 0x3F58476D1CE4E5B9, 0x14D049BB133111EB])  # odd, at random
_ASYMMETRY = 1e-8  # of the largest entry of a tensor
_FEW = 30  # neighbours on a plane: within three or four times their spacing
_NEAR = 2  # times as far
# Spread across to that along, of the points of a part no further from one than the next part: a
# line has none, and a third of a circle 0.08; half a disc has 0.28.
_LINE = 0.15
_SEEN = 1000  # points of a part that tell its shape near one of them


def check_mollify_factor(value: float) -> None:
    """Refuse factors that are not positive, or above 1."""
    if check_positive("mollify_factor", value) > 1:
        raise InvalidInputError(
            "mollify_factor",
            "be at most 1",
            f"{value:g}",
            advice="1e-5 is the default, and more changes the geometry by as much",
        )


def off_host(device: str) -> bool:
    """Whether a device is another than the host; refuse one that torch cannot use here."""
    if device == "cpu":  # which needs no torch
        return False
    from spectra_kit._sparse.torch_device import check_device

    check_device(device)
    return True


def of_shape(name: str, values: ArrayLike, shape: tuple[int, ...]) -> Floats:
    """Return `values` as a finite float64 array of this shape."""
    array = real_array(name, values)
    if array.shape != shape:
        raise InvalidInputError(name, f"have shape {shape}", array.shape)
    return array


def symmetric_tensors(name: str, values: ArrayLike, count: int) -> Floats:
    """Return symmetric tensors (count, 3, 3), of which a number is the same in all directions."""
    if np.ndim(values) == 1:
        return of_shape(name, values, (count,))[:, None, None] * np.eye(3)
    D = of_shape(name, values, (count, 3, 3))
    largest = np.abs(D).max(axis=(1, 2))
    skewed = np.abs(D - D.transpose(0, 2, 1)).max(axis=(1, 2)) > _ASYMMETRY * largest
    if skewed.any():
        raise InvalidInputError(
            name, "be symmetric", f"{quantity(skewed.sum(), 'tensor')} that is not"
        )
    return D


def check_faces_usable(mesh: TriangleMesh) -> None:
    """Refuse what no operator can give a mass: lone vertices and faces that are no triangles."""
    used = np.zeros(mesh.n, dtype=bool)
    used[mesh.faces] = True
    if not used.all():
        raise InvalidInputError(
            "mesh",
            "have a face at every vertex",
            f"{quantity((~used).sum(), 'vertex')} that no face uses (the first is"
            f" {int(np.argmin(used))})",
            advice="drop them with {}",
            remedies=("mesh.without_unreferenced()",),
        )
    check_three_corners(mesh)


def check_three_corners(mesh: TriangleMesh) -> None:
    """Refuse faces that name a vertex twice."""
    repeated = (mesh.faces == np.roll(mesh.faces, 1, axis=1)).any(axis=1)
    if repeated.any():
        raise InvalidInputError(
            "mesh",
            "have three corners to a face",
            f"{quantity(repeated.sum(), 'face')} with a vertex twice (the first is"
            f" {int(np.argmax(repeated))})",
            advice="drop them with {}",
            remedies=("mesh.without_degenerate_faces()",),
        )


def check_cloud_usable(cloud: PointCloud, n_neighbors: int) -> tuple[int, float]:
    """Refuse clouds on which no local triangulation exists.

    Return the neighbour count to use, and `unit_of` the cloud.
    """
    check_count("n_neighbors", n_neighbors, low=3)
    if cloud.n < 4:
        raise InvalidInputError("geometry", "have at least 4 points for a cloud Laplacian", cloud.n)
    unit = unit_of(cloud)
    points = cloud.points / unit
    check_distinct(points)
    columns = points.T.copy()  # a mean takes a fifth of the time along them
    columns -= columns.mean(axis=1, keepdims=True)
    moments = columns @ columns.T
    if np.trace(moments) ** 2 - (moments**2).sum() > _SLIM * np.trace(moments) ** 2:
        return min(n_neighbors, cloud.n - 1), unit
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if spread[1] <= 1e-9 * spread[0]:
        raise InvalidInputError(
            "geometry",
            "be a surface",
            f"points on one line (second to first extent {spread[1]:.1e} : {spread[0]:.1e})",
        )
    return min(n_neighbors, cloud.n - 1), unit


def unit_of(geometry: Geometry) -> float:
    """Return about the longest side of the box around the points, whose square must be a number.

    It is a power of two: coordinates in this unit are not rounded.
    """
    with np.errstate(over="ignore"):
        extent = float(np.ptp(geometry.points.T.copy(), axis=1).max())
    if not _SMALLEST < extent < _LARGEST:
        raise InvalidInputError(
            "geometry",
            f"have an extent between {_SMALLEST:g} and {_LARGEST:g}",
            f"{quantity(geometry.n, 'point')} within {extent:g}",
            advice="choose another unit of length",
        )
    return float(power_of_two(extent))


def units_of(mesh: TriangleMesh) -> NDArray[np.float64]:
    """Return such a length for the connected component of each vertex, shape (n,).

    A component that is no larger than a point takes that of the mesh.
    """
    unit, units = unit_of(mesh), component_units(mesh)
    if ((units > 0) & (units <= _SMALLEST)).any():
        raise InvalidInputError(
            "geometry",
            f"have components of an extent above {_SMALLEST:g}",
            f"one of about {units[units > 0].min():.1g}",
            advice="drop it, or choose another unit of length",
        )
    return np.where(units > 0, units, unit)


def mean_edges(mesh: TriangleMesh) -> NDArray[np.float64]:
    """Return the mean edge of the component of each vertex (n,); of one alone, a like length.

    In these units the library, which knows one mean edge, mollifies each component by its own.
    """
    units, labels = units_of(mesh), mesh.component_labels
    if not labels.any():
        return units
    low, high = mesh.unique_edges[0].T
    lengths = np.linalg.norm((mesh.points[high] - mesh.points[low]) / units[low, None], axis=1)
    means = np.bincount(labels[low], lengths) / np.bincount(labels[low])
    return units * np.where(means > 0, means, 1.0)[labels]


def check_distinct(points: NDArray[np.float64]) -> None:
    """Refuse exactly coincident points: they have no area of their own."""
    keys = np.sort((points + 0.0).view(np.int64) @ _MIXED)  # of equal points, -0.0 too, equal
    if (keys[1:] != keys[:-1]).all():
        return
    order = np.lexsort(points.T)
    same = (np.diff(points[order], axis=0) == 0).all(axis=1)
    if same.any():
        first, second = sorted(int(i) for i in order[np.argmax(same) :][:2])
        raise InvalidInputError(
            "geometry",
            "have distinct points",
            f"{quantity(same.sum(), 'duplicate point')} (such as {first} and {second})",
            advice="drop them with {}, or join the corners of a mesh with {}",
            remedies=("cloud.without_duplicates()", "mesh.with_merged_vertices()"),
        )


def warn_of_near_parts(laplacian: Laplacian, n_neighbors: int) -> None:
    """Say so where a cloud falls into parts that look like pieces or lines of one surface.

    The next part is no further than a few spacings of the points, or of the lines that they are on;
    or the part is a line itself, seen from as far as the next one.
    """
    if laplacian.n_components == 1:
        return
    points, labels = laplacian.points, laplacian.component_labels
    gaps = _gaps(points, labels)
    order = np.lexsort([gaps, labels])
    near = 0
    for part in np.split(order, np.cumsum(np.bincount(labels))[:-1]):
        offsets = points[part] - points[part[0]]  # that with the least gap comes first
        gap, distances = gaps[part[0]], np.linalg.norm(offsets, axis=1)
        offsets = offsets[np.argsort(distances)]
        distances.sort()
        few = _FEW
        while few < len(part) and _is_line(offsets[: few + 1]):
            few *= 2
        reach = _NEAR * distances[min(few, len(part) - 1)]
        near += gap <= reach or _is_line(offsets[distances <= gap])
    if near:
        some = "they lie" if near == laplacian.n_components else f"{near:,} of them lie"
        warn(
            f"the cloud falls into {laplacian.n_components:,} parts with an eigenvalue 0 each, and"
            f" {some} as near to the next as points or lines of one surface do to each other",
            SplitSurfaceWarning,
            advice=f"if they are one surface, raise `n_neighbors` above {n_neighbors}, or thin the"
            " points along their lines",
        )


def _is_line(offsets: Floats) -> bool:
    some = offsets[:: -(-len(offsets) // _SEEN)]
    spreads = np.linalg.svd(some - some.mean(axis=0), compute_uv=False) ** 2
    return bool(spreads[1:2].sum() <= _LINE * spreads[0])


def _gaps(points: Floats, labels: Ints) -> Floats:
    """Return how far the nearest point of another part is, (n,): the numbers differ in some bit."""
    from scipy.spatial import cKDTree  # slow to import

    gaps = np.full(len(points), np.inf)
    for bit in range(int(labels.max()).bit_length()):
        ones = (labels >> bit & 1).astype(bool)
        for here, there in ((ones, ~ones), (~ones, ones)):
            found = cKDTree(points[there]).query(points[here])[0]
            gaps[here] = np.minimum(gaps[here], found)
    return gaps
