"""`Carrier`: what lives on one surface, carried to another along a map between both."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from spectra_kit._core.checked import checked
from spectra_kit._core.records import cached
from spectra_kit._core.types import Bools, Floats, Ints
from spectra_kit._core.validate import check_faces, check_points, quantity, real_array
from spectra_kit.errors import InvalidInputError
from spectra_kit.geodesics.sources import FacePoint, spread
from spectra_kit.geometry import Geometry, GeometryLike, TriangleMesh
from spectra_kit.geometry.vectors import frames_of, sums, unit_vectors
from spectra_kit.maps.deform import rows_of
from spectra_kit.maps.places import (
    as_places,
    carried_values,
    check_rows,
    chosen,
    coded,
    faces_of,
    located,
    voted,
    weights_in,
)
from spectra_kit.maps.result import Match
from spectra_kit.maps.subsample import around
from spectra_kit.maps.surface import outward_normals
from spectra_kit.maps.transfer import Texture, deformed, textured
from spectra_kit.operators import (
    Laplacian,
    diffuse,
    gradient,
    oriented_triangles,
    robust_laplacian,
)
from spectra_kit.operators.checks import of_shape

_ROUNDED = 1e-9  # what weights that sum to 1 may lack
_CORNER = 1e-6  # barycentric: this near to a corner is that
_LOST = 3.0  # edges away from all that the map reaches, where nothing corresponds
_BLUR = 1.0  # edges over which a map is smoothed before it is differentiated
_CRUSHED = 0.1  # ratio of the stretches of a map below which directions mean nothing


class CarriedLabels(NamedTuple):
    """Labels, and how sure each is."""

    labels: Ints
    """Of each point or face; -1 where nothing corresponds."""
    confidence: Floats
    """Share of it and its neighbours that have its label; 0 where nothing corresponds."""


class _Side:
    """A surface as it is seen from the other."""

    def __init__(self, geometry: Geometry) -> None:
        self.geometry, self.n = geometry, geometry.n
        self.oriented = oriented_triangles(geometry)
        self.faces: Ints = self.oriented.faces
        area = float((self.oriented.areas * self.oriented.weights).sum())
        self.scale = np.sqrt(area) if area > 0 else 1.0

    @cached
    def rows(self) -> Floats:
        """Positions at unit area, and normals, (n, 6): far from each other on thin sheets."""
        return rows_of(self.geometry.points / self.scale, self.oriented)

    @cached
    def normals(self) -> Floats:
        """Of the points, (n, 3)."""
        return outward_normals(self.geometry.points, self.oriented)

    @cached
    def edge(self) -> float:
        """Mean length of an edge at unit area."""
        corners = self.geometry.points[self.faces] / self.scale
        return float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean())

    @cached
    def laplacian(self) -> Laplacian:
        """The robust one."""
        return robust_laplacian(self.geometry)

    def mesh(self, name: str, what: str) -> TriangleMesh:
        """Return the surface, if it is a mesh, as what asks for it needs."""
        if not isinstance(self.geometry, TriangleMesh):
            raise InvalidInputError(name, f"be a mesh, where {what} are carried", self.geometry)
        return self.geometry


@checked
class Carrier:
    """What lives on a source, carried to a target along a map; `back` carries it the other way.

    Parameters
    ----------
    source, target : TriangleMesh or PointCloud
        With n1 and n2 points, in any units.
    along : Match, array_like of shape (n2,) or sparse array of shape (n2, n1)
        A match, a point map, or a precise map. Of a match, that of `precise` is taken, where it was
        asked for, as it is smoother; where the target is not `covered`, nothing corresponds. Nor
        does it to rows of a precise map that are empty.

    Attributes
    ----------
    source, target : TriangleMesh or PointCloud
        As given.
    places : csr_array of shape (n2, n1)
        Where on the source each point of the target lies: weights of points.
    known : ndarray of bool of shape (n2,)
        Which points of the target have a place.

    Examples
    --------
    >>> import spectra_kit as sk
    >>> source, target, truth = sk.geometry.creature_pair(700, 600, seed=1)
    >>> carrier = sk.maps.Carrier(source, target, truth)
    >>> front = (source.points[:, 0] > 0).astype(int)
    >>> bool((carrier.labels(front).labels == front[truth]).all())
    True
    >>> carrier.back.values(target.points).shape  # where each point of the source is met
    (700, 3)
    """

    def __init__(
        self,
        source: GeometryLike,
        target: GeometryLike,
        along: Match | sparse.sparray | sparse.spmatrix | ArrayLike,
    ) -> None:
        self.source, self.target = source, target
        self._there, self._here = _Side(source), _Side(target)
        covered: Bools | None = None
        if isinstance(along, Match):
            covered = along.covered
            along = along.point_map if along.precise is None else along.precise
        self.places: sparse.csr_array = as_places("along", along, source.n, target.n)
        self.known: Bools = np.diff(self.places.indptr) > 0
        if covered is not None:
            self.known &= covered
        if not self.known.any():
            raise InvalidInputError("along", "lead somewhere", "no point with a partner")

    def __repr__(self) -> str:
        return f"Carrier({quantity(self.source.n, 'point')} to {self.target.n})"

    def values(self, values: ArrayLike) -> Floats:
        """Carry values of points (n1,) or (n1, ...): (n2,) or (n2, ...); NaN where none belongs.

        Colours, signals, descriptors, modes; and the points of the source themselves, which make
        the target in the pose of the source.
        """
        return carried_values(self.places, self.known, values)

    def labels(self, labels: ArrayLike) -> CarriedLabels:
        """Carry labels of points, integers (n1,), by the majority of weights: to (n2,)."""
        found, codes = coded("labels", labels, self.source.n, "point")
        beside = around(self._here.faces, self.target.n)
        return _told(found, voted(self.places, codes, len(found)), self.known, beside)

    def face_values(self, values: ArrayLike) -> Floats:
        """Carry values of faces (f1,) or (f1, ...), each from where its middle lies: to (f2, ...).

        NaN where nothing corresponds.
        """
        given, mesh = real_array("values", values), self._there.mesh("source", "values of faces")
        self._here.mesh("target", "values of faces")
        check_rows("values", given, len(mesh.faces))
        carried = given[self._middles].astype(np.float64)
        carried[self._middles < 0] = np.nan
        return carried

    def face_labels(self, labels: ArrayLike) -> CarriedLabels:
        """Carry labels of faces, integers (f1,), each from where its middle lies: to (f2,)."""
        mesh = self._there.mesh("source", "labels of faces")
        found, codes = coded("labels", labels, len(mesh.faces), "face")
        faces = self._here.mesh("target", "labels of faces").faces
        corners = sparse.csr_array(
            (np.ones(faces.size), faces.ravel(), np.arange(0, faces.size + 1, 3)),
            (len(faces), self.target.n),
        )
        beside = sparse.csr_array((corners @ corners.T) >= 2).astype(np.float64)  # or itself
        return _told(found, codes[self._middles], self._middles >= 0, beside)

    def landmarks(
        self, points: int | FacePoint | Sequence[int | FacePoint] | NDArray[np.integer]
    ) -> list[int | FacePoint | None]:
        """Carry points of the source: to vertices or `FacePoint` of the target, or cloud's points.

        None where nothing corresponds: more than three edges away from all that the map reaches.
        """
        owners, corners, shares, _ = spread(points, self.source, "points")
        rows = sums(owners, shares[:, None] * self._there.rows[corners], int(owners[-1]) + 1)
        places, near = self._met(rows)
        target = self.target
        named = target.faces if isinstance(target, TriangleMesh) else self._here.faces
        faces = faces_of(places, named)
        weights = weights_in(places, faces, named)
        found = list[int | FacePoint | None]()
        for i in range(len(rows)):
            if not near[i]:
                found.append(None)
            elif not isinstance(target, TriangleMesh) or weights[i].max() > 1 - _CORNER:
                row = slice(places.indptr[i], places.indptr[i + 1])
                found.append(int(places.indices[row][np.argmax(places.data[row])]))
            else:
                found.append(FacePoint(int(faces[i]), tuple(weights[i] / weights[i].sum())))
        return found

    @cached_property
    def back(self) -> Carrier:
        """The same from target to source: each point of the source lies where the map meets it."""
        places, near = self._met(self._there.rows)
        return Carrier(self.target, self.source, chosen(near, places))

    def then(self, other: Carrier) -> Carrier:
        """Return what carries from this source to the target of another that begins at this target.

        With two parts, each matched with a whole of their kind, from one to the other:
        ``Carrier(part, whole, found).then(Carrier(second, whole, found_too).back)``, of which
        `known` are the points of the second that the first has as well.
        """
        if not np.array_equal(other.source.points, self.target.points):
            expected = f"begin at the target of this, {quantity(self.target.n, 'point')}"
            raise InvalidInputError("other", expected, repr(other), advice="its `back` may do")
        shared = other.known & (other.places @ self.known >= 1 - _ROUNDED)
        if not shared.any():
            raise InvalidInputError(
                "other", "reach what this reaches", "two parts that have no point in common"
            )
        return Carrier(self.source, other.target, chosen(shared, other.places) @ self.places)

    def vectors(self, vectors: ArrayLike) -> Floats:
        """Carry tangent vectors of points (n1, 3): (n2, 3), stretched as the map stretches.

        Who takes a short step along one of them on the target sees its image step along that of the
        source. The map is smoothed over an edge for it. NaN where nothing corresponds, or where
        the map crushes the surface to a line.
        """
        given = of_shape("vectors", vectors, (self.source.n, 3))
        there = frames_of(unit_vectors(self.places @ self._there.normals))[:, :2]
        here = frames_of(self._here.normals)[:, :2]
        image, own = (
            np.stack([gradient(self.target, column) for column in self._blurred(points).T], axis=1)
            for points in (self.places @ self.source.points, self.target.points)
        )  # (n2, 3, 3)
        # Blurring makes limbs thinner: the target's own as their images.
        thinned = np.linalg.pinv(here @ own @ here.transpose(0, 2, 1), rcond=_CRUSHED)
        stretch = there @ image @ here.transpose(0, 2, 1) @ thinned
        u, s, v = np.linalg.svd(stretch)
        fine = self.known & (s[:, 1] > _CRUSHED * s[:, 0])
        s[~fine] = 1.0
        along = np.einsum("nra,na->nr", there, self.places @ given)
        carried = np.einsum("nba,nb->na", u, along) / s
        carried = np.einsum("nab,na,nbr->nr", v, carried, here)
        carried[~fine] = np.nan
        return np.asarray(carried)

    def texture(self, coordinates: ArrayLike, faces: ArrayLike) -> Floats:
        """Carry texture coordinates: to each corner of each face of the target, (f2, 3, 2).

        `coordinates` (t, 2) are named by `faces` (f1, 3), one for each corner of each face of the
        source, and jump where a seam is. A face of the target has all its corners on the side of a
        seam on which its middle lies. NaN where nothing corresponds.
        """
        mesh = self._there.mesh("source", "textures")
        triangles = self._here.mesh("target", "textures").faces
        uv = real_array("coordinates", coordinates)
        if uv.ndim != 2 or uv.shape[1] != 2:
            raise InvalidInputError("coordinates", "have shape (t, 2)", uv.shape)
        named = check_faces("faces", faces, len(uv))
        check_rows("faces", named, len(mesh.faces))
        images, corners = self.places @ self._there.rows, self._there.rows[mesh.faces]
        texture = Texture(uv, named, mesh.faces)
        found = textured(texture, self.places, triangles, self._middles, corners, images[triangles])
        found[self._middles < 0] = np.nan
        return found

    def deformation(self, points: ArrayLike) -> Floats:
        """Deform the target as the source was: to points (n2, 3), from those (n1, 3) it moved to.

        Each face turns and stretches as that of the source on which its middle lies, and points
        follow by least squares; where nothing corresponds it stays as stiff as it can. What changes
        is carried: of two bodies in one pose, the pose. Both may stand differently, and have other
        sizes.
        """
        source = self._there.mesh("source", "deformations")
        target = self._here.mesh("target", "deformations")
        moved = check_points("points", points)
        check_rows("points", moved, source.n)
        images = (self.places @ source.points)[self.known]
        own = target.points[self.known]
        centred = own - own.mean(axis=0), images - images.mean(axis=0)
        u, _, v = np.linalg.svd(centred[1].T @ centred[0])
        turn = u @ v  # takes directions of the target to those of the source; may mirror
        there = deformed(source, moved, target, self._middles, turn)
        step = (self.places @ (moved - source.points)) @ turn * self._here.scale / self._there.scale
        # A component goes where its points go; one without a partner, with all others.
        part, known = target.component_labels, self.known
        due = target.points + step - there
        counts = np.bincount(part[known], minlength=part.max() + 1)[:, None]
        shifts = sums(part[known], due[known], len(counts)) / np.maximum(counts, 1)
        lone = sums(part, target.points - there, len(counts)) / np.bincount(part)[:, None]
        shifts = np.where(counts > 0, shifts, lone + step[known].mean(axis=0))
        return np.asarray(there + shifts[part])

    @property
    def _limit(self) -> float:
        """How far from all that the map reaches something may lie, at unit area."""
        return _LOST * max(self._there.edge, self._here.edge)

    def _met(self, rows: Floats) -> tuple[sparse.csr_array, Bools]:
        """Return where on the target rows of the source are met, and whether near enough."""
        images = self.places @ self._there.rows
        places, apart = located(rows, images, self._here.faces, self.known, self._limit)
        return places, apart <= self._limit

    @cached
    def _middles(self) -> Ints:
        """The face of the source on which the middle of each face of the target lies, or -1."""
        faces, rows, everything = self._here.faces, self._there.rows, np.ones(self.source.n, bool)
        middles = (self.places @ rows)[faces].mean(axis=1)
        places, _ = located(middles, rows, self._there.faces, everything, self._limit)
        found = faces_of(places, self._there.faces)
        return np.where(self.known[faces].all(axis=1), found, -1)

    def _blurred(self, values: Floats) -> Floats:
        """Return values of the target's points (n2, c), spread over an edge.

        A map to points alone climbs stairs as high as edges of the source.
        """
        edge = self._here.edge
        if self.places.nnz == self.known.sum():
            edge = max(edge, self._there.edge)
        operator = self._here.laplacian
        if not self.known.all():
            some = np.flatnonzero(self.known)
            values = operator.solve(fixed=some, values=values[some])
        return diffuse(operator, values, (_BLUR * edge * self._here.scale) ** 2)


def _told(found: Ints, codes: Ints, known: Bools, beside: sparse.csr_array) -> CarriedLabels:
    """Return labels by their codes, and which share of what lies `beside` each has the same."""
    edges = beside.tocoo()
    i, j = edges.coords
    count = np.bincount(i, known[j], len(known))
    same = np.bincount(i, known[j] & (codes[i] == codes[j]), len(known))
    share = np.divide(same, count, out=np.zeros(len(known)), where=known & (count > 0))
    return CarriedLabels(np.where(known, found[codes], -1), share)
