"""Seeded random points on the surface of a mesh, uniform or denser around one spot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.checked import checked
from spectra_kit._core.records import Rebuilt
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_count, check_points, check_positive, real_array
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import MeshLike, PointCloud, TriangleMesh, box_unit

_MOST = 2**48  # points; more than any memory holds, but their bytes can be counted


@checked
@dataclass(frozen=True, kw_only=True)
class GaussianDensity:
    """Sampling density that falls off like a Gaussian around one point.

    Parameters
    ----------
    sigma : float, default 0.25
        Standard deviation, as a fraction of the diagonal of the bounding box.
    centre : tuple of 3 floats, optional
        Where the density peaks; by default a random point of the surface, drawn with the seed.

    Notes
    -----
    A face of area A and centroid x weighs ``A * exp(-0.5 * (|x - centre| / sigma)**2)``: the
    non-uniform sampling test of the NEO paper. Inside one face the density is constant.
    """

    sigma: float = 0.25
    centre: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        check_positive("sigma", self.sigma)
        if self.centre is not None:
            check_points("centre", [self.centre])


@checked
@dataclass(frozen=True, eq=False)
class Samples(Rebuilt):
    """Sampled points and the place on the mesh that each came from.

    Parameters
    ----------
    cloud : PointCloud
        The n sampled points.
    faces : ndarray of shape (n,)
        Index of the face each point lies on.
    barycentric : ndarray of shape (n, 3)
        Its weights on the three corners of that face; every row is >= 0 and sums to 1.
    corners : ndarray of shape (n, 3)
        The vertices at these corners.
    """

    cloud: PointCloud
    faces: Ints
    barycentric: Floats
    corners: Ints

    def interpolate(self, values: ArrayLike) -> Floats:
        """Carry a function from the vertices of the mesh to the samples, linearly in each face.

        A number or a row for each vertex; the same unit.
        """
        array = real_array("values", values)
        if array.ndim == 0 or len(array) <= self.corners.max():
            raise InvalidInputError(
                "values",
                "have one row for each vertex of the sampled mesh",
                f"shape {array.shape} while vertex {self.corners.max()} is in use",
            )
        return np.asarray(np.einsum("nc,nc...->n...", self.barycentric, array[self.corners]))


@checked
def sample(
    mesh: MeshLike,
    n: int,
    *,
    seed: int,
    density: Literal["uniform"] | GaussianDensity = "uniform",
) -> PointCloud:
    """Draw `n` independent random points on the surface.

    Parameters
    ----------
    mesh : TriangleMesh
        The surface; faces without area are never hit.
    n : int
        Number of points, at least 1.
    seed : int
        Same seed, same points.
    density : "uniform" or GaussianDensity, default "uniform"
        Uniform by area, or denser around one spot.

    Returns
    -------
    PointCloud
        Points of shape (n, 3) in the unit of the mesh.

    Examples
    --------
    >>> from spectra_kit.geometry import TriangleMesh, sample
    >>> square = TriangleMesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    >>> cloud = sample(square, 10_000, seed=0)
    >>> cloud.points.mean(axis=0).round(1)
    array([0.5, 0.5, 0. ])
    """
    return sample_with_origin(mesh, n, seed=seed, density=density).cloud


@checked
def sample_with_origin(
    mesh: MeshLike,
    n: int,
    *,
    seed: int,
    density: Literal["uniform"] | GaussianDensity = "uniform",
) -> Samples:
    """Draw the same points as `sample`, of the same arguments, and say where each lies.

    Returns
    -------
    Samples
        The cloud, with faces and barycentric weights: ``interpolate`` carries functions over.

    Notes
    -----
    A face is drawn by inversion of the cumulative weights, then a point in it by the square-root
    map of Osada et al., *Shape distributions*, ACM Trans. Graph. 21(4), 2002, section 4.1.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.geometry import TriangleMesh, sample_with_origin
    >>> mesh = TriangleMesh([[0, 0, 0], [2, 0, 0], [0, 2, 0]], [[0, 1, 2]])
    >>> samples = sample_with_origin(mesh, 5, seed=0)
    >>> bool(np.allclose(samples.interpolate(mesh.points), samples.cloud.points))
    True
    """
    check_count("n", n, low=1, high=_MOST)
    rng = np.random.default_rng(check_count("seed", seed, low=0))
    unit = box_unit(mesh.points)
    scaled = mesh.with_points(mesh.points / unit)
    weights = np.where(scaled.degenerate_faces(), 0.0, scaled.face_areas)
    if not weights.any():
        raise InvalidInputError(
            "mesh",
            "have area to be sampled",
            f"{len(mesh.faces)} faces that are all degenerate",
            advice="use `mesh.as_cloud()` for its vertices",
        )
    if isinstance(density, GaussianDensity):
        if density.centre is None:
            centre = _draw(scaled, 1, weights, rng).cloud.points[0]
        else:
            centre = np.array(density.centre) / unit
        sigma = density.sigma * np.linalg.norm(np.ptp(scaled.points, axis=0))
        centroids = scaled.points[scaled.faces].mean(axis=1)
        squared = np.sum(((centroids - centre) / sigma) ** 2, axis=1)
        # Only ratios count: the nearest face keeps its weight, so that not all underflow.
        nearest = squared[weights > 0].min()
        weights = weights * np.exp(-0.5 * np.maximum(squared - nearest, 0.0))
    return _draw(mesh, n, weights, rng)


def _draw(mesh: TriangleMesh, n: int, weights: Floats, rng: np.random.Generator) -> Samples:
    """Draw faces by weight, then a uniform point in each."""
    # Dividing makes the last entry exactly 1, above every draw in [0, 1); with side="right" a face
    # of weight zero spans an empty interval and cannot be hit.
    cumulative = np.cumsum(weights)
    faces = np.searchsorted(cumulative / cumulative[-1], rng.random(n), side="right")
    r, t = np.sqrt(rng.random(n)), rng.random(n)
    barycentric = np.column_stack([1 - r, r * (1 - t), r * t])
    corners = mesh.faces[faces]
    points = np.einsum("nc,ncd->nd", barycentric, mesh.points[corners])
    return Samples(PointCloud(points), faces, barycentric, corners)
