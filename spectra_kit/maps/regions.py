"""Regions of a whole that a part of another surface may be: the rest of it beyond its limbs.

Points at the ends of limbs are local maxima of the biharmonic distance to all others. What lies
within a distance of one or two of them is taken off the whole, or is all that is left. Of such
regions those are likely whose points have the wave kernel signatures that the points of the part
have, whichever point has which. The modes of a region come from those of the whole, as in partial
functional maps (Rodola et al., *Partial Functional Correspondence*, CGF 2017): it costs no solve.
Eigenvalues alone find regions, too (Rampini et al., *Correspondence-Free Region Localization for
Partial Shape Similarity via Hamiltonian Spectrum Alignment*, 3DV 2019), but of other people's
bodies they find the wrong ones more often.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.sparse.csgraph import dijkstra

from spectra_kit._core.types import Bools, Floats, Ints
from spectra_kit._sparse.ritz import ritz_pairs
from spectra_kit.eigen import Spectrum
from spectra_kit.features import wave_kernel_signature
from spectra_kit.geometry import TriangleMesh, largest_component
from spectra_kit.maps.geodesic import edge_graph
from spectra_kit.maps.prepare import Prepared
from spectra_kit.operators import cotan_laplacian

LEAST_POINTS = 200  # of a region that can be matched
_APART = 0.3  # at unit area, the distance between ends of limbs: toes of a foot are one
_ENDS = 8  # ends of limbs, at most
_SHARES = 1 / (1 + np.exp(-np.linspace(-3.2, 0.6, 11)))  # of the area: taken off, or left
_RITZ = 150  # modes of the whole that make those of a region
_FEW = 20  # eigenvalues that are compared
_COMPARED, _ENERGIES, _QUANTILES = 40, 30, 40  # modes, and what is compared of their signatures
_DEPENDENT = 1e-2  # relative; functions smaller on the region, or nearly dependent, are left out


@dataclass(frozen=True, eq=False)
class Region:
    """A connected region of a surface as a mesh of its own."""

    mesh: TriangleMesh
    vertices: Ints  # (n,): of the surface, ascending
    area: float  # of the surface's 1

    def inside(self, n: int) -> Bools:
        """Tell which of the n vertices of the surface are in it."""
        out = np.zeros(n, dtype=bool)
        out[self.vertices] = True
        return out


def region(whole: Prepared, kept: Bools) -> Region | None:
    """Return the largest piece of the triangles with at least two corners kept, if there is one.

    Not of those with three: they would all lie on one side of the line between the vertices.
    """
    mesh = mesh_of(whole)
    faces = mesh.faces[kept[mesh.faces].sum(axis=1) >= 2]
    if not len(faces):
        return None
    return _piece(whole, TriangleMesh(mesh.points, faces))


def _piece(whole: Prepared, mesh: TriangleMesh) -> Region:
    """Return the largest piece of a mesh of some of the triangles of a whole."""
    piece = largest_component(mesh)
    return Region(piece.mesh, piece.vertex_index, piece.mesh.area / mesh_of(whole).area)


def mesh_of(side: Prepared) -> TriangleMesh:
    """Return the mesh that a surface was prepared of, at unit area."""
    assert side.surface is not None
    return TriangleMesh(side.surface.points, side.surface.oriented.faces)


def likely_regions(part: Prepared, whole: Prepared, count: int) -> list[Region]:
    """Return `count` regions of the whole, or all there are: those likest to the part.

    By the mean difference of the logarithms of wave kernel signatures, the lowest with the lowest,
    the next with the next, and by that of eigenvalues; in turn, the likest first. Regions of a
    family differ in their area alone, so each names one by each measure. The whole is a family.
    """
    k = min(_COMPARED, part.spectrum.k, whole.spectrum.k)
    wanted = _seen(part.spectrum.truncate(k))

    def unlikeness(piece: Region) -> tuple[float, float]:
        operator = cotan_laplacian(piece.mesh)
        basis = whole.spectrum.eigenvectors[piece.vertices, :_RITZ]
        pairs = ritz_pairs(operator.stiffness, operator.mass, basis, k, rank_tol=_DEPENDENT)
        if len(pairs.eigenvalues) < k:  # too small for the modes of the whole to tell
            return np.inf, np.inf
        values = np.append(0.0, pairs.eigenvalues[1:])
        found = Spectrum(values, pairs.eigenvectors, operator.mass)
        seen = _seen(found.rescale(found.area**-0.5))
        return float(np.abs(seen[0] - wanted[0]).mean()), float(np.abs(seen[1] - wanted[1]).mean())

    families = [family for family in _families(whole) if family]
    measured = [[(unlikeness(piece), piece) for piece in family] for family in families]
    ranked = []
    for way in (0, 1):
        best = [min(family, key=lambda found: found[0][way]) for family in measured]
        ranked.append([piece for _, piece in sorted(best, key=lambda found: found[0][way])])
    in_turn = [piece for pair in zip(*ranked, strict=True) for piece in pair]
    return list(dict.fromkeys(in_turn))[:count]


def _seen(unit: Spectrum) -> tuple[Floats, Floats]:
    """Return the logarithms that are compared: of `_signatures`, and of eigenvalues."""
    return np.log(_signatures(unit)), np.log(unit.eigenvalues[1:_FEW])


def _signatures(unit: Spectrum) -> Floats:
    """Return quantiles of wave kernel signatures over the area, (q, e), for each energy."""
    signatures = wave_kernel_signature(unit, count=_ENERGIES)
    order = np.argsort(signatures, axis=0)
    ranked = np.take_along_axis(signatures, order, axis=0)
    shares = np.cumsum(unit.mass[order], axis=0) / unit.area
    at = (np.arange(_QUANTILES) + 0.5) / _QUANTILES
    columns = [np.interp(at, x, y) for x, y in zip(shares.T, ranked.T, strict=True)]
    return np.column_stack(columns)


def limb_ends(whole: Prepared) -> Ints:
    """Return the points at the ends of limbs, the farthest from all others first.

    Local maxima of the mean squared biharmonic distance to all points, which is
    ``sum(u^2 / lambda^2)`` over the modes and a constant; see `features.biharmonic_distances`.
    """
    spectrum = whole.spectrum.nonzero()
    far = ((spectrum.eigenvectors / spectrum.eigenvalues) ** 2).sum(axis=1)
    graph = edge_graph(mesh_of(whole))
    around = np.maximum.reduceat(far[graph.indices], graph.indptr[:-1])
    tops = np.flatnonzero(far >= around)
    tops = tops[np.argsort(-far[tops], kind="stable")]
    apart = dijkstra(graph, directed=False, indices=tops)[:, tops]
    ends: list[int] = []
    for i in range(len(tops)):
        if (apart[i, ends] > _APART).all():
            ends.append(i)
    return tops[ends[:_ENDS]]


def _families(whole: Prepared) -> Iterator[list[Region]]:
    """Yield the whole, then regions beyond, and within, a distance of one or two ends of limbs."""
    yield [_piece(whole, mesh_of(whole))]
    mass, graph = whole.spectrum.mass, edge_graph(mesh_of(whole))
    ends = limb_ends(whole)
    distances = dijkstra(graph, directed=False, indices=ends)
    for count in (1, 2):
        for chosen in combinations(range(len(ends)), count):
            order = np.argsort(distances[list(chosen)].min(axis=0), kind="stable")
            place = np.empty(len(order))
            place[order] = np.cumsum(mass[order])
            for kept in (place[None] > _SHARES[:, None], place[None] <= _SHARES[:, None]):
                pieces = (region(whole, row) for row in kept)
                wanted = kept @ mass
                yield [
                    piece
                    for piece, area in zip(pieces, wanted, strict=True)
                    if piece is not None
                    and piece.area > 0.9 * area
                    and len(piece.vertices) >= LEAST_POINTS
                ]
