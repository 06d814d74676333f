"""From triangles in space to a glued, flipped surface of half-edges, and to its Laplacian.

Half-edge ``3 t + c`` runs along side c of triangle t, from corner c to corner c + 1; ``twins`` has
the one that it is glued to, which runs the other way. No surface here has a boundary.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from spectra_kit.errors import ConvergenceError
from spectra_kit.linalg.threads import in_threads

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

_BLOCK = 16_384  # points of one task: fixed, so that nothing depends on the number of threads
# Of a half-edge, before giving up. Clouds need 0.14 at most, but n slivers that fan out from one
# point, as in flat parts of technical models, n / 32.
_FLIPS = 1000
_CORNERS, _SIDES = [0, 1, 2, 0, 2, 1], [0, 1, 2, 2, 1, 0]  # of a front and its back


def front_and_back(
    points: Floats, triangles: Ints, lengths: Floats, *, sharpest: float
) -> tuple[Ints, Floats, Ints]:
    """Return corners and lengths of both faces of each triangle, shape (2 t, 3), and the twins.

    So the surface has no boundary and is oriented whatever the input. Triangles are glued to each
    other only if the cosine of the angle between them is below `sharpest`.
    """
    from spectra_kit.operators._cover import glue, sides_by_corner

    n = len(points)
    twins = np.empty(6 * len(triangles), dtype=np.int32)
    glued = (points, triangles, *sides_by_corner(triangles, n), sharpest, twins)
    in_threads(glue, ((*glued, first, min(first + _BLOCK, n)) for first in range(0, n, _BLOCK)))
    return triangles[:, _CORNERS].reshape(-1, 3), lengths[:, _SIDES].reshape(-1, 3), twins


def make_delaunay(corners: Ints, lengths: Floats, twins: Ints) -> None:
    """Flip edges, in place, until the angles opposite each sum to at most pi."""
    from spectra_kit.operators._cover import flip_to_delaunay

    most = _FLIPS * len(twins)
    if not flip_to_delaunay(corners.reshape(-1), lengths.reshape(-1), twins, most):
        raise ConvergenceError(
            "the triangles of `geometry` must become Delaunay by edge flips, got no end to them"
            f" after {most}; raise `mollify_factor`, or drop points that nearly coincide"
        )


def stiffness_and_mass(
    corners: Ints, lengths: Floats, twins: Ints, n: int, copies: int
) -> tuple[sparse.csr_array, Floats]:
    """Assemble the Laplacian of a surface on which each piece is there `copies` times."""
    from spectra_kit.operators._cover import edge_weights

    rows, columns, weights, mass = edge_weights(corners.reshape(-1), lengths.reshape(-1), twins, n)
    upper = sparse.csr_array((weights / copies, (rows, columns)), shape=(n, n))
    adjacency = upper + upper.T
    return sparse.diags_array(adjacency.sum(axis=1)) - adjacency, mass / copies
