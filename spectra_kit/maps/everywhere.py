"""The last step of a match: from the points that it was found on to all points."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from spectra_kit._core.threads import thread_count
from spectra_kit._core.types import Floats, Ints
from spectra_kit.maps.convert import Correspondence
from spectra_kit.maps.dense import nearest_within, neighbours
from spectra_kit.maps.elastic import bend_onto, mirror_image, rows_of
from spectra_kit.maps.options import MatchOptions
from spectra_kit.maps.placed import Placed
from spectra_kit.maps.prepare import CURVATURE_SCALE, Prepared, curvatures

# Goals on a dense target are exact, so that the bent surface may follow them closely in the end. On
# five pairs of bodies errors fell by 3 per cent, as with five rounds.
_FINE_ROUNDS = 3


def by_bending(
    source: Prepared,
    target: Prepared,
    way_there: Ints,
    *,
    mirrored: bool,
    options: MatchOptions,
) -> tuple[Ints, Floats, Floats]:
    """Return which source point each target point meets once the source is bent onto the target.

    With it, where all source points and all target points then are: positions and normals,
    (n1, 6) and (n2, 6). `way_there` leads from the points that the source is matched on to those of
    the target; both have a geometry.
    """
    assert source.surface is not None
    onto = all_placed(target)
    if target.dense is not None:
        way_there = target.dense.chosen[way_there]
    bent = bend_onto(
        source.surface,
        onto,
        way_there,
        mirrored=mirrored,
        fine_rounds=0 if target.dense is None else _FINE_ROUNDS,
        options=options,
    )
    points, oriented = bent.points, bent.start.oriented
    if source.dense is not None:
        start = mirror_image(source.dense.placed) if mirrored else source.dense.placed
        points = source.dense.carried(points, bent.rotations, start.points)
        oriented = start.oriented
    here, there = rows_of(points, oriented), rows_of(onto.points, onto.oriented)
    return _met(here, there), here, there


def by_modes(
    source: Prepared, target: Prepared, found: Correspondence
) -> tuple[Ints, Floats, Floats]:
    """Return which source point is nearest to each target point in modes and curvature.

    With it, these of all source points and of all target points, (n1, d) and (n2, d). A point of a
    dense surface looks around where the points around it went.
    """
    C = found.functional_map
    here = source.whole.eigenvectors[:, : C.shape[1]] @ C.T
    there = target.whole.eigenvectors[:, : len(C)]
    if (both := curvatures(source, target)) is not None:
        lifted = (
            curved if side.dense is None else side.dense.lift @ curved
            for side, curved in zip((source, target), both, strict=True)
        )
        here, there = (
            np.hstack([rows, CURVATURE_SCALE * curved])
            for rows, curved in zip((here, there), lifted, strict=True)
        )
    if source.dense is None and target.dense is None:
        return found.point_map, here, there
    s1, s2 = source.spectrum.n, target.spectrum.n
    went = sparse.csr_array((np.ones(s2), (np.arange(s2), found.point_map)), shape=(s2, s1))
    ways = sparse.csr_array(_around(target) @ went @ _around(source))
    point_map = nearest_within(ways, (here, _cells(source)), (there, _cells(target)))
    return point_map, here, there


def all_placed(side: Prepared) -> Placed:
    """Return the geometry of all points of a surface that has one."""
    placed = side.surface if side.dense is None else side.dense.placed
    assert placed is not None
    return placed


def on_matched(source: Prepared, target: Prepared, point_map: Ints) -> Ints:
    """Return the map of all points between the points that the surfaces are matched on."""
    if target.dense is not None:
        point_map = point_map[target.dense.chosen]
    return point_map if source.dense is None else source.dense.closest[point_map]


def _met(here: Floats, there: Floats) -> Ints:
    """Return the row of `here` nearest to each of `there`."""
    return np.asarray(cKDTree(here).query(there, workers=thread_count())[1], dtype=np.int64)


def _cells(side: Prepared) -> Ints:
    """Return the position of the matched point that stands for each point."""
    return np.arange(side.spectrum.n) if side.dense is None else side.dense.closest


def _around(side: Prepared) -> sparse.csr_array:
    """Return which of the points that a surface is matched on are neighbours, or the same."""
    assert side.surface is not None
    n = side.spectrum.n
    return sparse.csr_array(neighbours(side.surface.oriented.faces, n) + sparse.eye_array(n))
