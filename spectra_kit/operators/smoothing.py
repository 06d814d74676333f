"""`smooth`: points flow along the mean curvature normal, in implicit steps."""

from __future__ import annotations

from typing import Annotated, Literal, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Bools, Floats, Ints
from spectra_kit._core.validate import as_indices, check_count, check_positive
from spectra_kit._core.warn import hearing
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import PointCloud, TriangleMesh
from spectra_kit.geometry.vectors import sums, unit_vectors
from spectra_kit.geometry.winding import sides_of
from spectra_kit.operators._held import factorised
from spectra_kit.operators.checks import units_of
from spectra_kit.operators.intrinsic import intrinsic_delaunay
from spectra_kit.operators.laplacian import Laplacian
from spectra_kit.operators.oriented import oriented_triangles

Kind = TypeVar("Kind", TriangleMesh, PointCloud)

_FLAT = 1e-9  # volume over area^(3/2), below which a closed part encloses nothing
_NEWTON, _ROUNDING = 30, 1e-12  # steps to the volume that was there; relative error


@checked
def smooth(
    geometry: Kind,
    *,
    time: float | None = None,
    steps: int = 1,
    fixed: Annotated[ArrayLike, NDArray[np.bool_]] = (),
    boundary: Literal["held", "free"] = "held",
    volume: Literal["kept", "free"] = "kept",
) -> Kind:
    """Let a surface flow along its mean curvature normal, which takes ripples out of it.

    Desbrun, Meyer, Schröder and Barr, *Implicit Fairing of Irregular Meshes using Diffusion and
    Curvature Flow*, SIGGRAPH 1999.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        With n points.
    time : float, optional
        How long it flows in all, in length^2. By default the square of the mean edge of its
        Delaunay triangles: ripples six edges long are halved, shorter ones fade, longer ones stay.
    steps : int, default 1
        Implicit steps that this takes; each makes the Laplacian of what the last one left. A ripple
        of eigenvalue lambda is divided by ``(1 + lambda time / steps)^steps``.
    fixed : array_like of int, or of bool and shape (n,), default ()
        Points that stay where they are.
    boundary : {"held", "free"}, default "held"
        Whether points on the boundary stay, too. A free one shrinks. Of a cloud, those that
        `intrinsic_delaunay` finds, about every other; the ones between draw in a little.
    volume : {"kept", "free"}, default "kept"
        Whether, after each step, the points of closed parts of a mesh that are not `fixed` move out
        along their normals, all by the same way, until the part encloses the volume that it had:
        the flow of Huisken, *The Volume Preserving Mean Curvature Flow*, J. reine angew. Math.
        1987.

    Returns
    -------
    TriangleMesh or PointCloud
        Of the same kind, with the same faces.

    Raises
    ------
    InvalidInputError
        If the flow is so long that a closed part has no volume left, or its points no distance.

    See Also
    --------
    spectra_kit.eigen.low_pass : The same by the lowest modes alone.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.geometry import sphere
    >>> from spectra_kit.operators import smooth
    >>> ball = sphere(subdivisions=3).geometry
    >>> noise = 0.03 * np.random.default_rng(0).standard_normal(ball.points.shape)
    >>> rough = ball.with_points(ball.points + noise)
    >>> for one in (rough, smooth(rough)):
    ...     print(np.linalg.norm(one.points, axis=1).std().round(3))
    0.03
    0.01
    """
    check_count("steps", steps, low=1)
    triangulation = intrinsic_delaunay(geometry)
    laplacian = triangulation.laplacian
    if time is None:
        time = float(triangulation.lengths.mean()) ** 2
    step = check_positive("time", time) / steps
    held, parts = np.zeros(geometry.n, dtype=bool), None
    held[as_indices("fixed", fixed, geometry.n)] = True
    if boundary == "held":
        held[getattr(geometry, "boundary_vertices", triangulation.boundary)] = True
    if volume == "kept" and isinstance(geometry, TriangleMesh):
        parts = _closed_parts(geometry, held)
    for done in range(steps):
        if done:
            with hearing():  # what there is to tell of the surface was told at the first step
                laplacian = intrinsic_delaunay(geometry).laplacian
        points = _stepped(laplacian, held, step)
        if parts is not None:
            points = parts.restored(points)
        geometry = geometry.with_points(points)
    return geometry


def _stepped(laplacian: Laplacian, held: Bools, step: float) -> Floats:
    """Solve ``(M + step L) x' = M x`` for the points that are not held."""
    try:
        factor = factorised(laplacian, -1 / step, held)
    except InvalidInputError as error:
        raise _too_long() from error
    # For the way that each point takes: none, to rounding, where the surface is flat.
    pull = -(laplacian.stiffness @ laplacian.points)
    return np.asarray(laplacian.points + factor.solve(np.where(held[:, None], 0.0, pull)))


def _too_long() -> InvalidInputError:
    return InvalidInputError(
        "time",
        "leave each part of the surface more than a point",
        advice="choose less of it",
    )


class _ClosedParts(NamedTuple):
    """Parts of a mesh that enclose a volume, in units of their own."""

    faces: Ints  # (f, 3), seen from outside
    part: Ints  # (n,), of each vertex
    free: Floats  # (n, 1), 1 or 0
    units: Floats  # (n, 1)
    volumes: Floats  # of each part, 0 where it encloses nothing

    def measured(self, points: Floats) -> tuple[Floats, Floats]:
        """Return the volume of each part, and its gradient by the points (n, 3)."""
        part, n = self.part, len(points)
        middles = sums(part, points, part.max() + 1) / np.bincount(part)[:, None]
        x = (points - middles[part]) / self.units
        a, b, c = np.moveaxis(x[self.faces], 1, 0)
        shares = np.repeat(np.cross(b - a, c - a) / 6, 3, axis=0)
        slopes = sums(self.faces.ravel(), shares, n)
        return np.bincount(part, np.einsum("nr,nr->n", x, slopes)) / 3, slopes

    def restored(self, points: Floats) -> Floats:
        """Return points moved out along their normals, in each part as far as its volume asks."""
        volumes, slopes = self.measured(points)
        normals, way = self.free * unit_vectors(slopes), np.zeros(len(volumes))
        for _ in range(_NEWTON):
            moved = points + way[self.part, None] * self.units * normals
            volumes, slopes = self.measured(moved)
            lost = np.where(self.volumes > 0, self.volumes - volumes, 0.0)
            if (np.abs(lost) <= _ROUNDING * self.volumes).all():
                return np.asarray(moved)
            rate = np.bincount(self.part, np.einsum("nr,nr->n", normals, slopes))
            if not (rate[lost != 0] > 0).all():
                break
            way += np.divide(lost, rate, np.zeros_like(way), where=lost != 0)
        raise _too_long()


def _closed_parts(mesh: TriangleMesh, held: Bools) -> _ClosedParts | None:
    """Return the parts without a boundary and of two sides; None if there are none."""
    part = mesh.component_labels
    opened = np.zeros(part.max() + 1, dtype=bool)
    edges, counts = mesh.unique_edges
    opened[part[edges[counts % 2 == 1, 0]]] = True
    if opened.all():
        return None
    faces = oriented_triangles(mesh).faces
    sides = sides_of(faces, mesh.n)
    opened[part[sides.edges[sides.surplus != 0, 0]]] = True  # of one side, as a Klein bottle
    faces = faces[~opened[part[faces[:, 0]]]]
    units = units_of(mesh)[:, None]
    free = np.where(held, 0.0, 1.0)[:, None]
    bare = _ClosedParts(faces, part, free, units, np.zeros(len(opened)))
    volumes, slopes = bare.measured(mesh.points)
    areas = np.bincount(part, np.linalg.norm(slopes, axis=1))  # the slopes are a third of them
    return bare._replace(volumes=np.where(volumes > _FLAT * areas**1.5, volumes, 0.0))
