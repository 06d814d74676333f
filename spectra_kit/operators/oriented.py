"""`oriented_triangles` and the area form: what tells a surface from its mirror image.

The Laplacian does not know which side of the surface is outside, so its spectrum is that of the
mirror image, too. The area form ``T[a, b, c] = integral of f_a df_b ^ df_c`` does: it changes sign.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from spectra_kit._core.checked import checked
from spectra_kit._core.records import Rebuilt, frozen
from spectra_kit._core.types import Bools, Floats, Ints
from spectra_kit._core.validate import check_count, check_faces, check_mass, quantity, real_array
from spectra_kit._core.warn import warn
from spectra_kit.errors import DoubtfulMatchWarning, InvalidInputError
from spectra_kit.geometry.normals import agree_on_signs, symmetric_votes, turn_outwards
from spectra_kit.geometry.shapes import GeometryLike, PointCloud, TriangleMesh
from spectra_kit.geometry.vectors import sums
from spectra_kit.geometry.winding import (
    FLIP,
    Sides,
    against_neighbours,
    pieces,
    sides_of,
    turn,
)
from spectra_kit.operators.checks import check_cloud_usable, check_faces_usable, units_of
from spectra_kit.operators.local_delaunay import local_triangles

_BLOCK = 1024  # triangles
# Volume over area^(3/2), 0.094 for a ball and 0.03 for a body; below it there is no inside.
_FLAT = 1e-9
_OPEN = 0.005  # the same where there is a boundary, seen from the middle


_NORMALS_VOTE = 0.1  # of a shared triangle's vote: it joins those that share none


@checked
@dataclass(frozen=True, eq=False, repr=False)
class OrientedTriangles(Rebuilt):
    """Triangles that all run counter-clockwise, seen from one side of the surface.

    Parameters
    ----------
    faces : array_like of shape (f, 3)
        Indices of points.
    weights : array_like of shape (f,)
        How often each triangle counts, positive: 1 for a mesh.
    areas : array_like of shape (f,)
        Area of each triangle, not negative, in length^2; only `skew` asks for it.
    n : int
        Number of points.
    consistent : float, default 1.0
        Share of the triangles that agree on the side: of a mesh, with all their neighbours, 1
        unless some cannot be turned so; of a cloud, with the windings that their corners see, a
        sign of how far its orientation can be trusted.

    Examples
    --------
    >>> from spectra_kit.operators import OrientedTriangles
    >>> triangles = OrientedTriangles([[0, 1, 2]], [1.0], [0.5], 3)
    >>> triangles.reversed().faces
    array([[0, 2, 1]])
    """

    faces: Ints
    weights: Floats
    areas: Floats
    n: int
    consistent: float = 1.0

    def __post_init__(self) -> None:
        n = check_count("n", self.n, low=3)
        faces = check_faces("faces", self.faces, n)
        weights = check_mass("weights", self.weights, len(faces))
        areas = real_array("areas", self.areas)
        if areas.shape != (len(faces),) or (areas < 0).any():
            raise InvalidInputError(
                "areas",
                f"hold {quantity(len(faces), 'number')} >= 0",
                f"shape {areas.shape} with {int((areas < 0).sum())} below 0",
            )
        for name, array in (("faces", faces), ("weights", weights), ("areas", areas)):
            object.__setattr__(self, name, frozen(array.copy()))

    def __repr__(self) -> str:
        return f"OrientedTriangles({len(self.faces)} on {self.n} points)"

    def reversed(self) -> OrientedTriangles:
        """Return the same triangles seen from the other side: those of a mirror image."""
        return replace(self, faces=self.faces[:, FLIP])


@checked
def oriented_triangles(geometry: GeometryLike, *, n_neighbors: int = 30) -> OrientedTriangles:
    """Return triangles of a surface that all turn the same way round.

    Parameters
    ----------
    geometry : TriangleMesh or PointCloud
        Faces of a mesh that are wound against their neighbours are turned, with a warning; so
        it is told where no turning makes faces agree, as on a Möbius strip, and `consistent` is
        below 1.
    n_neighbors : int, default 30
        Of a cloud: candidates for the triangles of a point, as in `intrinsic_delaunay`.

    Returns
    -------
    OrientedTriangles
        Of a mesh, its faces. Each piece is turned such that it encloses a positive volume, one
        with a boundary as seen from its middle; so a mirrored copy has the opposite winding,
        whether or not its faces were flipped with its points. Pieces that are nearly flat, or
        enclose nothing, keep the winding they came with, which a mirror does not change.

        Of a cloud, the triangles of its local Delaunay triangulations, each counted a third, as a
        good one is found by all its three corners. Each component is turned to enclose a positive
        volume, seen from its centroid, which an open sheet that is nearly flat does not decide.

    Notes
    -----
    Each point of a cloud triangulates its neighbourhood in a tangent frame of either hand. Points
    whose triangulations share triangles vote for one side by the windings of these, which sharp
    edges do not disturb as they do the votes of normals (Hoppe et al. 1992), and groups that agree
    vote together. Parts that came out inside out are found by their winding
    number (Barill et al. 2018). Where sheets are about as near to each other as the points of one,
    as in the hands of a coarse body, some triangles bridge them and `consistent` falls below 1;
    sheets a good deal nearer are taken for one, and it does not.

    Examples
    --------
    >>> from spectra_kit.geometry import TriangleMesh, sphere
    >>> from spectra_kit.operators import area_form, oriented_triangles
    >>> mesh = sphere(subdivisions=3).geometry
    >>> inside_out = TriangleMesh(mesh.points, mesh.faces[:, ::-1])
    >>> for one in (inside_out, mesh.as_cloud()):
    ...     print(area_form(oriented_triangles(one), mesh.points)[0, 1, 2])
    4.15
    4.15
    """
    if not isinstance(geometry, TriangleMesh):
        faces, areas, consistent = _oriented_local_triangles(geometry, n_neighbors)
        return OrientedTriangles(faces, np.full(len(faces), 1 / 3), areas, geometry.n, consistent)
    mesh = geometry
    check_faces_usable(mesh)
    sides = sides_of(mesh.faces, mesh.n)
    against = against_neighbours(sides)
    sides = sides.turned(against) if against.any() else sides
    faces = turn(mesh.faces, against)
    consistent = 1.0 - float(sides.clash[sides.edge].reshape(-1, 3).any(axis=1).mean())
    piece, closed = pieces(sides)
    unit = units_of(mesh)
    each = _signed_volumes(mesh.points / unit[:, None], faces, piece)
    volumes = np.bincount(piece, each).astype(np.float64)
    sizes = np.bincount(piece, mesh.face_areas / unit[faces[:, 0]] ** 2).astype(np.float64)
    faces = turn(faces, is_inside_out(volumes, sizes, closed)[piece])
    if against.any() or consistent < 1:
        _warn_of_winding(against, sides)
    return OrientedTriangles(faces, np.ones(len(faces)), mesh.face_areas, mesh.n, consistent)


def is_inside_out(volumes: Floats, areas: Floats, closed: Bools) -> Bools:
    """Tell which pieces of a surface are to be turned, by volumes seen from their middles."""
    return np.asarray(volumes < -np.where(closed, _FLAT, _OPEN) * areas**1.5)


def _warn_of_winding(against: Bools, sides: Sides) -> None:
    """Say what is made of a mesh of mixed winding: where it matters, sides may be in doubt."""
    turned, left = int(against.sum()), int(sides.clash.sum())
    found = []
    if turned:
        found.append(f"{quantity(turned, 'face')} wound against the others, turned for now")
    if left:
        found.append(f"{quantity(left, 'edge')} at which no turning makes faces agree")
    told = f"the mesh has {', and '.join(found)}; which side is out is told by the other faces"
    if not turned:  # a repair would change nothing
        warn(told, DoubtfulMatchWarning)
        return
    warn(
        told,
        DoubtfulMatchWarning,
        advice="{} turns faces for good",
        remedies=("geometry.repair(mesh)",),
    )


def _signed_volumes(points: Floats, faces: Ints, piece: Ints) -> Floats:
    """Volume of each face's tetrahedron over the middle of its piece, shape (f,), in length^3."""
    corners = points[faces]
    middle = sums(piece, corners.mean(axis=1), piece.max() + 1) / np.bincount(piece)[:, None]
    a, b, c = np.moveaxis(corners - middle[piece][:, None], 1, 0)
    return np.asarray(np.einsum("fr,fr->f", a, np.cross(b, c)) / 6)


@checked
def area_form(oriented: OrientedTriangles, functions: ArrayLike) -> Floats:
    """Integrate ``f_a df_b ^ df_c`` for all triples of functions.

    Parameters
    ----------
    oriented : OrientedTriangles
        On n points.
    functions : array_like of shape (n, k)
        Values at the points, linear inside each triangle.

    Returns
    -------
    ndarray of shape (k, k, k)
        ``T[a, b, c]``, in the cube of the unit of the functions: a two-form needs no metric, so
        the unit of length does not enter. Antisymmetric in b and c; on a closed surface
        changes sign with every swap of two indices.

    Notes
    -----
    Exact for piecewise linear functions: a triangle (i, j, k) contributes the mean of f_a times
    ``((f_b(j) - f_b(i)) (f_c(k) - f_c(i)) - (f_b(k) - f_b(i)) (f_c(j) - f_c(i))) / 2``.
    A map that takes the functions to others and keeps their area form preserves orientation;
    the mirror image has the negative.

    Examples
    --------
    The volume of a body is the integral of x dy ^ dz over its surface:

    >>> from spectra_kit.geometry import sphere
    >>> from spectra_kit.operators import area_form, oriented_triangles
    >>> mesh = sphere(subdivisions=4).geometry
    >>> form = area_form(oriented_triangles(mesh), mesh.points)
    >>> print(form[0, 1, 2], form[0, 2, 1])
    4.18 -4.18
    """
    f = _functions("functions", functions, oriented.n)
    k = f.shape[1]
    form = np.zeros((k, k, k))
    for faces, weights in _blocks(oriented):
        total, first, second = _along_sides(f, faces)
        total *= weights / 6  # half the mean of f_a, times the weight
        for b in range(k - 1):
            two_form = first[b] * second[b + 1 :] - second[b] * first[b + 1 :]
            form[:, b, b + 1 :] += total @ two_form.T
    form -= form.transpose(0, 2, 1).copy()
    return form


@checked
def orientation_operator(
    oriented: OrientedTriangles, basis: ArrayLike, functions: ArrayLike
) -> Floats:
    """Integrate ``u_i df ^ du_j`` for pairs of basis functions and each function f.

    Parameters
    ----------
    oriented : OrientedTriangles
        On n points.
    basis : array_like of shape (n, k)
        Such as the eigenvectors of a `Spectrum`.
    functions : array_like of shape (n, p)
        Such as descriptors.

    Returns
    -------
    ndarray of shape (p, k, k)
        ``O[p, i, j]``, scale-free in the metric; antisymmetric in i and j on a closed surface.

    Notes
    -----
    The operator ``g -> n . (grad f x grad g)`` in the basis, which commutes with maps that keep
    the orientation; Ren, Poulenard, Wonka and Ovsjanikov, *Continuous and
    Orientation-preserving Correspondences via Functional Maps*, ACM TOG 2018, Section 4.

    Examples
    --------
    >>> from spectra_kit.geometry import sphere
    >>> from spectra_kit.operators import orientation_operator, oriented_triangles
    >>> mesh = sphere(subdivisions=4).geometry
    >>> operators = orientation_operator(oriented_triangles(mesh), mesh.points, mesh.points)
    >>> operators[0].round(2) + 0.0
    array([[ 0.  ,  0.  ,  0.  ],
           [ 0.  ,  0.  , -4.18],
           [ 0.  ,  4.18,  0.  ]])
    """
    u = _functions("basis", basis, oriented.n)
    f = _functions("functions", functions, oriented.n)
    operators = np.zeros((f.shape[1], u.shape[1], u.shape[1]))
    for faces, weights in _blocks(oriented):
        total, first, second = _along_sides(u, faces)
        total *= weights / 6
        _, along, across = _along_sides(f, faces)
        for p in range(len(operators)):
            operators[p] += total @ (along[p] * second - across[p] * first).T
    return operators


@checked
def skew(oriented: OrientedTriangles, f: ArrayLike, g: ArrayLike) -> Floats:
    """Return ``n · (grad f x grad g)`` at the points: it changes sign in a mirror.

    Parameters
    ----------
    oriented : OrientedTriangles
        On n points.
    f, g : array_like of shape (n,) or (n, p)
        Functions, paired column by column.

    Returns
    -------
    ndarray of shape (n,) or (n, p)
        In the units of f and g over length^2: the integral of ``df ^ dg`` over the triangles around
        a point, divided by their area; 0 where that is 0.

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.geometry import rectangle
    >>> from spectra_kit.operators import oriented_triangles, skew
    >>> mesh = rectangle(n=100).geometry
    >>> x, y = mesh.points[:, 0], mesh.points[:, 1]
    >>> bool(np.allclose(skew(oriented_triangles(mesh), 2 * x, y), 2))
    True
    """
    shape = np.shape(f)
    _, first, second = _along_sides(_functions("f", f, oriented.n), oriented.faces)
    _, along, across = _along_sides(_functions("g", g, oriented.n), oriented.faces)
    if first.shape != along.shape:
        raise InvalidInputError("g", f"have as many columns as `f`, {shape}", np.shape(g))
    share = oriented.weights * (first * across - second * along) / 2
    corners = oriented.faces.ravel()

    def around(values: Floats) -> Floats:
        return np.bincount(corners, np.repeat(values, 3), oriented.n).astype(np.float64)

    area = around(oriented.weights * oriented.areas)
    total = np.column_stack([around(column) for column in share])
    out = np.divide(total, area[:, None], out=np.zeros_like(total), where=area[:, None] > 0)
    return np.asarray(out.reshape(shape))


def _functions(name: str, values: ArrayLike, n: int) -> Floats:
    """Return `values` as finite columns of shape (n, k); one function may come as (n,)."""
    f = real_array(name, values)
    if f.ndim not in (1, 2) or len(f) != n:
        raise InvalidInputError(name, f"have shape ({n}, k), one row for each point", f.shape)
    return f.reshape(n, -1)


def _blocks(oriented: OrientedTriangles) -> Iterator[tuple[Ints, Floats]]:
    """Yield faces and weights of some triangles at a time: their functions stay in the cache."""
    for start in range(0, len(oriented.faces), _BLOCK):
        block = slice(start, start + _BLOCK)
        yield oriented.faces[block], oriented.weights[block]


def _along_sides(f: Floats, faces: Ints) -> tuple[Floats, Floats, Floats]:
    """Return (k, faces): the sum over the corners, the rises along the first and the last side."""
    a, b, c = (f[corner].T for corner in faces.T)
    return np.add(a + b, c, order="C"), np.subtract(b, a, order="C"), np.subtract(c, a, order="C")


def _oriented_local_triangles(cloud: PointCloud, n_neighbors: int) -> tuple[Ints, Floats, float]:
    """Return triangles of shape (f, 3), their areas, and the share whose corners agree."""
    from scipy.spatial import cKDTree  # slow to import

    n_neighbors, unit = check_cloud_usable(cloud, n_neighbors)
    # Neighbours in space become neighbours in memory; any unit of length becomes about 1.
    order = cKDTree(cloud.points).indices
    points = cloud.points[order] / unit
    faces = local_triangles(points, n_neighbors)[0].astype(np.int64)
    owners = faces[:, 0]
    a, b, c = (points[faces[:, i]] for i in range(3))
    doubled: Floats = np.cross(b - a, c - a)
    vectors: Floats = np.zeros((cloud.n, 3))
    np.add.at(vectors, owners, doubled / 6)  # a third of the area of each triangle
    votes = _votes(faces, vectors, cloud.n)
    signs, labels = agree_on_signs(votes)
    signs = turn_outwards(points, vectors, signs, labels, votes)
    turned = signs[owners] < 0
    faces[turned] = faces[turned][:, FLIP]
    sides = np.einsum("fr,fcr->fc", doubled, vectors[faces] * signs[faces][:, :, None])
    sides *= signs[owners][:, None]
    agree = float((sides > 0).all(axis=1).mean()) if len(faces) else 0.0
    return order[faces], 0.5 * unit**2 * np.linalg.norm(doubled, axis=1), agree


def _votes(faces: Ints, vectors: Floats, n: int) -> sparse.csr_array:
    """Count for each pair of points how often both wind a triangle alike, less how often unlike."""
    a, b, c = faces.T
    even = ((a < b) & (b < c)) | ((b < c) & (c < a)) | ((c < a) & (a < b))
    winding = np.where(even, 1.0, -1.0)
    corners = np.sort(faces, axis=1)
    order = np.lexsort(corners.T)
    corners, owners, winding = corners[order], a[order], winding[order]
    pairs, values = [], []
    for step in (1, 2):  # a triangle is in those of three points at most
        same = np.flatnonzero((corners[step:] == corners[:-step]).all(axis=1))
        pairs.append(np.column_stack([owners[same], owners[same + step]]))
        values.append(winding[same] * winding[same + step])
    sides = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    unit = vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300)
    pairs.append(sides)
    values.append(_NORMALS_VOTE * np.einsum("er,er->e", unit[sides[:, 0]], unit[sides[:, 1]]))
    i, j = np.concatenate(pairs).T
    return symmetric_votes(n, i, j, np.concatenate(values))
