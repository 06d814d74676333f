"""Subsamples: the well-spread points that dense surfaces are matched on, and the way back to all.

The search and all refinement see some thousands of points (after Magnet and Ovsjanikov, *Scalable
and Efficient Functional Map Computations on Dense Meshes*, 2023): the modes there, the area that
each of them stands for, and a triangulation. What remains costs little more than O(n).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from spectra_kit._core.records import Rebuilt
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import quantity
from spectra_kit._sparse.products import rows_of
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import InvalidInputError
from spectra_kit.maps.surface import Surface
from spectra_kit.operators.oriented import OrientedTriangles

_REACH = 2.0  # of a chosen point when it moves others, in covering radii


@dataclass(frozen=True, eq=False, kw_only=True)
class Subsample(Rebuilt):
    """All n points of a surface that is matched on s of them, at unit area."""

    spectrum: Spectrum  # on all points
    surface: Surface  # on all points
    chosen: Ints  # (s,) the well-spread points
    closest: Ints  # (n,) position in `chosen` of the closest one along the surface
    lift: sparse.csr_array  # (n, s): carries values at the chosen points to all; rows sum to one

    def at_chosen(self) -> tuple[Spectrum, Surface]:
        """Return the modes and the geometry at the chosen points.

        A chosen point stands for the area of the points closest to it, and the modes remain all but
        orthonormal.
        """
        whole, count = self.surface, len(self.chosen)
        mass = np.bincount(self.closest, whole.mass, count).astype(np.float64)
        points = whole.points[self.chosen]
        modes = Spectrum(
            self.spectrum.eigenvalues,
            self.spectrum.eigenvectors[self.chosen],
            mass,
            self.spectrum.certificate,
            self.spectrum.provenance,
        )
        faces, weights = image(whole.oriented, self.closest, count)
        i, j, k = points[faces].transpose(1, 0, 2)
        areas = 0.5 * np.linalg.norm(np.cross(j - i, k - i), axis=1)
        triangles = OrientedTriangles(faces, weights, areas, count, whole.oriented.consistent)
        return modes, Surface(points=points, mass=mass, oriented=triangles)

    def carried(self, bent: Floats, rotations: Floats, start: Floats) -> Floats:
        """Return where all points go if the chosen ones go to `bent`, turning by `rotations`.

        From `start`, (n, 3). Each chosen point moves its surroundings rigidly, and what several
        of them move is averaged (the embedded deformation of Sumner, Schmid and Pauly 2007).
        """
        offset = bent - np.einsum("sij,sj->si", rotations, start[self.chosen])
        turns = (self.lift @ rotations.reshape(-1, 9)).reshape(-1, 3, 3)
        return np.asarray(self.lift @ offset + np.einsum("nij,nj->ni", turns, start))


def thinned(unit: Spectrum, surface: Surface, count: int) -> Subsample:
    """Choose `count` points of a surface: more where the modes tell more, as on fingers.

    They are the farthest points along edges, where lengths are those of the metric in which modes
    are spread evenly: it is scaled by ``sum_i u_i(x)^2 / k``, the density that least squares in the
    modes ask of samples (Cohen and Migliorati, *Optimal weighted least-squares methods*, 2017).
    The numbering of the points does not matter. A few that no triangle would hold are left out.
    """
    from spectra_kit.geodesics._kernels import farthest_along_edges  # numba is slow to import

    density = np.einsum("nk,nk->n", unit.eigenvectors, unit.eigenvectors) / unit.k
    edges = neighbours(surface.oriented.faces, unit.n)
    i, j = np.repeat(np.arange(unit.n), np.diff(edges.indptr)), edges.indices
    apart = np.linalg.norm(surface.points[i] - surface.points[j], axis=1)
    edges.data = apart * np.sqrt(0.5 * (density[i] + density[j]))
    graph, first = rows_of(edges), np.array([density.argmax()])
    while True:
        chosen, closest, apart = farthest_along_edges(*graph, first, count)
        if (closest < 0).any():
            raise InvalidInputError(
                "geometry",
                "be connected, as its spectrum is",
                f"{quantity((closest < 0).sum(), 'point')} in pieces too small to be matched",
                advice="leave them out of both, by {}",
                remedies=("geometry.largest_component(mesh)",),
            )
        held = np.unique(image(surface.oriented, closest, count)[0])
        if len(held) == count:
            break
        first, count = chosen[held], len(held)
    return Subsample(
        spectrum=unit,
        surface=surface,
        chosen=chosen,
        closest=closest,
        lift=_lift(surface, chosen, closest, np.sqrt(density) / (_REACH * apart.max())),
    )


def neighbours(faces: Ints, n: int) -> sparse.csr_array:
    """Return which of n points are joined by a side of a triangle, in both directions: ones."""
    i, j = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    proper = i != j
    ones = np.ones(int(proper.sum()))
    one_way = sparse.coo_array((ones, (i[proper], j[proper])), shape=(n, n)).tocsr()
    both = sparse.csr_array(one_way + one_way.T)
    both.data[:] = 1.0
    return both


def around(faces: Ints, n: int) -> sparse.csr_array:
    """Return the same with each point as its own neighbour."""
    return sparse.csr_array(neighbours(faces, n) + sparse.eye_array(n))


def image(oriented: OrientedTriangles, closest: Ints, count: int) -> tuple[Ints, Floats]:
    """Return the triangles of the chosen points, (f, 3), and their weights.

    The map of each point to its closest chosen one is simplicial: it carries triangles to
    triangles, edges or points. Counted with their signs, the images of a closed surface are
    closed again: two that cover the same corners from opposite sides cancel.
    """
    faces = closest[oriented.faces]
    a, b, c = np.sort(faces, axis=1).T
    proper = (a < b) & (b < c)
    a, b, c, faces = a[proper], b[proper], c[proper], faces[proper]
    turned = faces[np.arange(len(faces)), (faces.argmin(axis=1) + 1) % 3] != b
    keys, which = np.unique((a * count + b) * count + c, return_inverse=True)
    signs = np.where(turned, -1.0, 1.0) * oriented.weights[proper]
    sums = np.bincount(which, signs, minlength=len(keys))
    kept = np.abs(sums) > 1e-9
    keys, sums = keys[kept], sums[kept]
    corners = np.column_stack([keys // count**2, keys // count % count, keys % count])
    out = np.where(sums[:, None] < 0, corners[:, [0, 2, 1]], corners)
    return out, np.abs(sums)


def _lift(surface: Surface, chosen: Ints, closest: Ints, scale: Floats) -> sparse.csr_array:
    """Return how much each point heeds the chosen ones of its cell and of those around, (n, s).

    Distances times the `scale` of each point are below 1 within reach.
    """
    n, count = len(closest), len(chosen)
    lift = sparse.csr_array(around(closest[surface.oriented.faces], count)[closest])
    i = np.repeat(np.arange(n), np.diff(lift.indptr))
    apart = surface.points[i] - surface.points[chosen[lift.indices]]
    squared = np.einsum("pr,pr->p", apart, apart) * scale[i] ** 2
    lift.data = np.maximum(1 - squared, 0.0) ** 3 + 1e-9 * (lift.indices == closest[i])
    lift.eliminate_zeros()
    lift.data /= np.repeat(lift.sum(axis=1), np.diff(lift.indptr))
    return lift
