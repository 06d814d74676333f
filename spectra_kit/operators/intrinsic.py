"""`IntrinsicTriangulation`: a surface by the lengths of its edges, flipped until Delaunay."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from spectra_kit._core.checked import checked
from spectra_kit._core.clock import Clock
from spectra_kit._core.records import Rebuilt, frozen, known
from spectra_kit._core.types import Floats, Ints, Ints32
from spectra_kit._core.validate import (
    check_indices,
    check_mass,
    check_positive,
    quantity,
    real_array,
)
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.seams import warn_of_seams
from spectra_kit.geometry.shapes import Geometry, GeometryLike, TriangleMesh
from spectra_kit.operators.checks import (
    check_faces_usable,
    check_mollify_factor,
    of_shape,
    off_host,
    warn_of_near_parts,
)
from spectra_kit.operators.laplacian import Laplacian
from spectra_kit.operators.triangle_calculus import areas, divergences, gradients, linear_mass

if TYPE_CHECKING:
    from spectra_kit.operators._cover import Cover, OrderedCloud
    from spectra_kit.operators.local_delaunay import FirstStars

_MOST = 0.9  # share of the edges that longer ones do not outweigh


@checked
@dataclass(frozen=True, eq=False, repr=False)
class IntrinsicTriangulation(Rebuilt):
    """Triangles known by their corners and side lengths alone, and the Laplacian they make.

    Build one with `intrinsic_delaunay`. The surface has no other shape in space than its points:
    two triangles may share all their corners, and a side may start and end at one point.

    Parameters
    ----------
    corners : array_like of shape (f, 3)
        Points at the corners of each triangle.
    lengths : array_like of shape (f, 3)
        ``lengths[:, c]`` is the side from corner c to corner c + 1, in the unit of the points.
    share : float
        How much each triangle counts in areas and energies: 1, or 1/2 where the surface is covered
        by a front and a back, or 1/6 where each triangle was also found by three points.
    boundary : array_like of shape (b,)
        Points on the boundary of the surface. Of a cloud, about every other point along it.
    laplacian : Laplacian
        Of piecewise linear functions on these triangles, Neumann, on n points.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> triangulation = sk.intrinsic_delaunay(sk.geometry.sphere(subdivisions=3).geometry)
    >>> height = triangulation.points[:, 2]
    >>> energy = height @ triangulation.divergence(triangulation.gradient(height))
    >>> print(round(energy, 2), round(height @ triangulation.laplacian.stiffness @ height, 2))
    8.33 8.33
    """

    corners: Ints32
    lengths: Floats
    share: float
    boundary: Ints
    laplacian: Laplacian

    def __post_init__(self) -> None:
        n = self.laplacian.n
        corners = np.asarray(self.corners)
        check_indices("corners", corners, n)
        lengths = real_array("lengths", self.lengths)
        if corners.ndim != 2 or corners.shape[1] != 3 or lengths.shape != corners.shape:
            raise InvalidInputError(
                "lengths", f"have the shape (f, 3) of `corners`, {corners.shape}", lengths.shape
            )
        if not (lengths > 0).all():
            raise InvalidInputError(
                "lengths",
                "be positive",
                f"{quantity((lengths <= 0).sum(), 'entry')} <= 0",
                advice="`intrinsic_delaunay` lengthens the sides of degenerate triangles",
            )
        boundary = np.unique(check_indices("boundary", self.boundary, n))
        object.__setattr__(self, "corners", frozen(corners.astype(np.int32)))
        object.__setattr__(self, "lengths", frozen(lengths.copy()))
        object.__setattr__(self, "share", check_positive("share", self.share))
        object.__setattr__(self, "boundary", frozen(boundary))

    def __repr__(self) -> str:
        return f"IntrinsicTriangulation({len(self.corners)} triangles on {self.n} points)"

    @property
    def points(self) -> Floats:
        """Where the corners are in space, shape (n, 3)."""
        return self.laplacian.points

    @property
    def n(self) -> int:
        """Number of points."""
        return len(self.points)

    @property
    def operator(self) -> str:
        """How this was made, for the record."""
        return self.laplacian.operator

    @property
    def seconds(self) -> float:
        """Time spent on making it, the Laplacian included."""
        return self.laplacian.seconds

    @cached_property
    def face_areas(self) -> Floats:
        """Area of each triangle, shape (f,), in length^2; not multiplied by `share`."""
        return frozen(areas(self.lengths))

    @property
    def area(self) -> float:
        """Area of the surface, in length^2."""
        return self.share * float(self.face_areas.sum())

    @property
    def consistent_mass(self) -> sparse.csr_array:
        """The mass of piecewise linear functions as it is, not lumped; (n, n), in length^2."""
        return linear_mass(self.corners, self.share * self.face_areas, self.n)

    @cached_property
    def spacings(self) -> Floats:
        """Typical length of the edges of each connected component, shape (n_components,).

        Their mean; or, where a few long ones make that larger, what nine of ten do not exceed.
        Components are those of `laplacian`.
        """
        parts = [self.lengths]
        if self.laplacian.n_components > 1:
            labels = self.laplacian.component_labels[self.corners[:, 0]]
            order = np.argsort(labels, kind="stable")
            parts = np.split(self.lengths[order], np.cumsum(np.bincount(labels))[:-1])
        # Without a boundary, each edge is two sides.
        return frozen(np.array([min(part.mean(), np.quantile(part, _MOST)) for part in parts]))

    def gradient(self, values: ArrayLike) -> Floats:
        """Return the gradient (f, 2) of a piecewise linear function (n,), one in each triangle.

        In the unit of `values` over length, in a frame of each triangle: x runs along side 0, y
        points to corner 2. Frames of different triangles have nothing to do with each other.
        """
        return gradients(self.corners, self.lengths, of_shape("values", values, (self.n,)))

    def divergence(self, vectors: ArrayLike) -> Floats:
        """Return the integrated divergence (n,), with its sign turned: the adjoint of `gradient`.

        Of vectors (f, 2) in its frames. For any function v, ``v @ divergence(X)`` is the integral
        of ``<grad v, X>`` over the surface, so ``divergence(gradient(u))`` is ``laplacian.stiffness
        @ u``.
        """
        field = of_shape("vectors", vectors, (len(self.corners), 2))
        return np.asarray(self.share * divergences(self.corners, self.lengths, field, self.n))


@checked
def intrinsic_delaunay(
    geometry: GeometryLike,
    *,
    mollify_factor: float = 1e-5,
    n_neighbors: int = 30,
    device: str = "cpu",
) -> IntrinsicTriangulation:
    """Triangulate a mesh or a point cloud by Delaunay triangles on its own surface.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        With n points. A mesh may have any edges (non-manifold, of inconsistent winding, on a
        boundary), slivers, and copies of triangles, which count as often as they are there; each
        vertex has a face. Points of a cloud are distinct, and not all on one line.
    mollify_factor : float, default 1e-5
        Intrinsic mollification of (near) degenerate triangles, relative to their mean side.
    n_neighbors : int, default 30
        Of a cloud: neighbours that define the tangent plane of a point and are candidates for its
        triangles; capped at n - 1. Fewer than 30 miss triangles of random points, more may bridge
        a gap. Where they lie on one line, as in rings, lines and slices of a scan, more of them
        are asked by themselves, up to 960.
    device : str, default "cpu"
        Where neighbours, planes and stars of a cloud are found, by torch: "cuda". All that follows,
        what is asked of neighbours on a line, and all of a mesh is the host's.

    Returns
    -------
    IntrinsicTriangulation
        Its Laplacian has edge weights that are not negative beyond rounding. The same bits whatever
        the number of threads.

    Raises
    ------
    ConvergenceError
        If the edge flips do not end, which rounding could do to a degenerate geometry; none is
        known.

    Warns
    -----
    SplitSurfaceWarning
        If a cloud falls into parts that look like pieces, or lines, of one surface.

    Notes
    -----
    Triangles that continue each other at an edge are glued, and edges are flipped until the two
    angles opposite each sum to at most pi. Where a mesh is not closed and of one winding, each
    triangle has a front and a back, and one that is alone at an edge has them glued to each other:
    Sharp and Crane, *A Laplacian for Nonmanifold Triangle Meshes*, SGP 2020.

    Each point of a cloud contributes its star in the tangential Delaunay complex (Boissonnat and
    Ghosh, *Manifold reconstruction using tangential Delaunay complexes*, Discrete Comput. Geom.
    2014), with a third of each triangle's energy and area. Glued in cyclic order,
    as by the library robust_laplacian, equal triangles, of which a consistent triangulation has
    three, would become pillows that the flips deflate.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> triangulation = sk.intrinsic_delaunay(sk.geometry.rectangle(n=100).geometry)
    >>> round(triangulation.area, 3), len(triangulation.boundary)
    (1.618, 36)
    """
    from spectra_kit.operators._cover import mesh_cover, ordered_cloud  # numba is slow to import

    clock = Clock()
    check_mollify_factor(mollify_factor)
    on_device = off_host(device)
    if not isinstance(geometry, TriangleMesh):
        ordered = ordered_cloud(geometry, n_neighbors)
        first = None
        if on_device:
            from spectra_kit.operators._device_stars import first_stars

            (first,) = first_stars([ordered.points], ordered.n_neighbors, device)
        return cloud_triangulation(ordered, first, clock.total, mollify_factor)
    check_faces_usable(geometry)
    warn_of_seams(geometry)
    operator = f"delaunay_laplacian(mesh, mollify_factor={mollify_factor:g})"
    cover = mesh_cover(geometry, mollify_factor)
    return _of_cover(cover, geometry, operator, clock.total)


def cloud_triangulation(
    ordered: OrderedCloud, first: FirstStars | None, spent: float, mollify_factor: float = 1e-5
) -> IntrinsicTriangulation:
    """Go on from what the first neighbours tell, unless that is still to be found.

    So many seconds were `spent` before.
    """
    from spectra_kit.operators._cover import cloud_cover

    clock = Clock()
    cover, neighbors = cloud_cover(ordered, mollify_factor, first), ordered.n_neighbors
    operator = f"delaunay_laplacian(mollify_factor={mollify_factor:g}, n_neighbors={neighbors})"
    found = _of_cover(cover, ordered.cloud, operator, spent + clock.total)
    warn_of_near_parts(found.laplacian, neighbors)
    return found


def _of_cover(
    cover: Cover, geometry: Geometry, operator: str, seconds: float
) -> IntrinsicTriangulation:
    from spectra_kit.operators._assembly import components

    stiffness, fixed = cover.stiffness, np.empty(0, dtype=np.int64)
    for buffer in (stiffness.data, stiffness.indices, stiffness.indptr):
        buffer.flags.writeable = False
    laplacian = known(
        Laplacian,
        stiffness=stiffness,
        mass=check_mass("mass", cover.mass, geometry.n),
        points=geometry.points,
        operator=operator,
        seconds=seconds,
        fixed=fixed,
        consistent_mass=None,
        dimension=2,
        component_labels=components(stiffness.indptr, stiffness.indices),
    )
    return known(
        IntrinsicTriangulation,
        corners=cover.corners,
        lengths=cover.lengths,
        share=1 / cover.copies,
        boundary=cover.boundary,
        laplacian=laplacian,
    )
