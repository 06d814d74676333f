"""What maps should keep of a surface, as bending does: its handles, its rim, its symmetries."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from spectra_kit._core.types import Floats
from spectra_kit.maps.lengths import lengths_of
from spectra_kit.maps.placed import Placed


class Topology(NamedTuple):
    """Of one connected surface at unit area."""

    genus: int | None  # handles, once its holes are closed; None of a cloud, or if not a surface
    rim: float  # around its holes: 0 of a closed surface, and of a cloud


def topology_of(placed: Placed) -> Topology:
    """Return the genus and the rim of a mesh.

    ``2 - 2 g`` is the number of vertices less that of edges and more that of triangles, once each
    loop of the border is closed by a disc: holes of a scan are no handles. The rim is as long as
    that of the one round hole that leaves out as much as round ones of those lengths do together:
    its square is the sum of theirs, as many small holes are no cut.
    """
    faces, n = placed.oriented.faces, len(placed.points)
    if (placed.oriented.weights != 1).any():  # triangles of a cloud, or images of a dense surface
        return Topology(None, 0.0)
    sides = np.sort(np.concatenate([faces[:, [c - 1, c]] for c in range(3)]), axis=1)
    edges, uses = np.unique(sides, axis=0, return_counts=True)
    border = edges[uses == 1]
    graph = sparse.coo_array((np.ones(len(border)), border.T), shape=(n, n))
    hole = connected_components(graph, directed=False)[1][border[:, 0]]
    around = np.bincount(hole, lengths_of(placed.points, border), minlength=1)
    rim = float(np.linalg.norm(around))
    met = np.bincount(border.ravel(), minlength=n)
    if uses.max() > 2 or not np.isin(met, (0, 2)).all():
        return Topology(None, rim)
    euler = len(np.unique(faces)) - len(edges) + len(faces) + int(np.count_nonzero(around))
    return Topology((2 - euler) // 2 if euler % 2 == 0 else None, rim)


def compared(source: Placed, target: Placed) -> dict[str, Any]:
    """Return the topologies of both as `Match` has them."""
    one, other = topology_of(source), topology_of(target)
    known = one.genus is not None and other.genus is not None
    return {
        "genera": (one.genus, other.genus) if known else None,
        "rims": (one.rim, other.rim),
    }


def clustered(eigenvalues: Floats) -> float:
    """Return how much closer than by chance the lowest eigenvalues lie: about 1 by chance.

    Of a surface with more symmetries than two halves that are alike, and of one that is nearly so,
    eigenvalues come in twos, threes and more. By chance the i-th and the next differ by a factor
    whose logarithm is exponential with mean 1 / i (Weyl's law); the result is the mean over the
    lowest six of minus the logarithm of how likely that is to be so small. Bodies and animals have
    0.5 to 1.2, round shapes 1.8 and more.
    """
    lowest = eigenvalues[1 : _GAPS + 2]
    i = np.arange(1, len(lowest))
    gaps = np.maximum(np.diff(np.log(lowest)), _EQUAL)
    return float(-np.log(-np.expm1(-i * gaps)).mean())


_GAPS = 6
_EQUAL = 2e-3  # relative difference of eigenvalues that coarse meshes make of equal ones
