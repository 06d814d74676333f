"""`match_components`: surfaces of several parts, each part mapped to the one it corresponds to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from spectra_kit._core.checked import checked
from spectra_kit._core.many import about
from spectra_kit._core.records import Rebuilt
from spectra_kit._core.types import Floats, Ints
from spectra_kit._core.validate import check_count
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import Component, MeshLike, TriangleMesh, components
from spectra_kit.maps.match import LastSteps, matched_from
from spectra_kit.maps.prepare import LOWEST_K, Prepared, prepared, truncated
from spectra_kit.maps.result import DEFAULT, Match, MatchOptions
from spectra_kit.maps.search import searched

_LEAST = 100  # points of a part that can be matched: smaller ones have no partner
_LINE = 1e-9  # of the square of its length: a part of less area is none


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class ComponentMatch(Rebuilt):
    """Which part of a source each part of a target is, and which point each point.

    Attributes
    ----------
    point_map : ndarray of shape (n2,)
        The source point of each target point, counted in the whole surfaces; -1 in parts without a
        partner.
    partner : ndarray of shape (t,)
        The part of the source that each part of the target is, in the order of
        `geometry.components`; -1 where none is convincing.
    matches : dict of (int, int) to Match
        Of a part of the source and one of the target, each in one at most: the pairs that score
        best together, convincing or not. Their points count within the parts.
    confidence : ndarray of shape (t,)
        Of the match of each part of the target; 0 of one that is in none.
    """

    point_map: Ints
    partner: Ints
    matches: dict[tuple[int, int], Match]
    confidence: Floats

    def __repr__(self) -> str:
        found, lost = int((self.partner >= 0).sum()), int((self.partner < 0).sum())
        return f"ComponentMatch({found} parts with a partner, {lost} without)"


@checked
def match_components(
    source: MeshLike,
    target: MeshLike,
    *,
    mirrored: bool | None = None,
    k: int = 150,
    options: MatchOptions = DEFAULT,
) -> ComponentMatch:
    """Find which part of the source each part of the target is, and match these.

    Parameters
    ----------
    source, target : TriangleMesh
        Of any number of connected parts, wherever they stand and whatever their sizes: each is
        taken at unit area. Parts of fewer than 100 points, or without area, have no partner.
    mirrored, k, options
        As of `match`.

    Returns
    -------
    ComponentMatch
        Each part of the target with one of the source at most, and with none where their match is
        not convincing. The search is that of `match` for every part of the one with every part of
        the other, and takes as long.

    Warns
    -----
    DoubtfulMatchWarning
        For each two parts that are left for each other and are not a convincing match. It begins
        with their numbers, which are the attribute ``where``, as of errors.

    Examples
    --------
    >>> import numpy as np
    >>> import spectra_kit as sk
    >>> animal, ring = sk.geometry.creature(500), sk.geometry.torus(n=500).geometry
    >>> both = sk.TriangleMesh(
    ...     np.vstack([animal.points, ring.points + 3]),
    ...     np.vstack([animal.faces, ring.faces + animal.n]),
    ... )
    >>> found = sk.maps.match_components(both, sk.geometry.creature(500, pose=1), mirrored=False)
    >>> found.partner, bool((found.point_map < animal.n).all())
    (array([0]), True)
    """
    check_count("k", k, low=LOWEST_K)
    parts1, parts2 = _parts("source", source), _parts("target", target)
    sides = [_prepared("source", parts1), _prepared("target", parts2)]
    pairs = [(i, j) for i in sides[0] for j in sides[1]]
    ready, found = {}, {}
    for i, j in pairs:
        fewer = min(sides[0][i].spectrum.k, sides[1][j].spectrum.k)
        ready[i, j] = truncated(sides[0][i], fewer), truncated(sides[1][j], fewer)
        found[i, j] = searched(*ready[i, j], mirrored, options)
    # One badly matched pair shall not decide about the others: ratios count.
    scores = np.log([found[pair][0][0].score for pair in pairs])
    rows, columns = linear_sum_assignment(scores.reshape(len(sides[0]), len(sides[1])))
    chosen = [
        pairs[row * len(sides[1]) + column] for row, column in zip(rows, columns, strict=True)
    ]
    matches = {}
    for i, j in chosen:
        with about(f"part {i} of the source and part {j} of the target"):
            matches[i, j] = matched_from(*ready[i, j], found[i, j], LastSteps(k), options)
    point_map, partner = np.full(target.n, -1), np.full(len(parts2), -1)
    confidence = np.zeros(len(parts2))
    for (i, j), match in matches.items():
        confidence[j] = match.confidence
        if match.convincing:
            partner[j] = i
            point_map[parts2[j].vertex_index] = parts1[i].vertex_index[match.point_map]
    return ComponentMatch(
        point_map=point_map,
        partner=partner,
        matches=matches,
        confidence=confidence,
    )


def _parts(name: str, mesh: TriangleMesh) -> list[Component]:
    """Return the parts of a mesh, one of which can be matched."""
    parts = components(mesh)
    if not any(_is_large(part.mesh) for part in parts):
        largest = max((part.mesh.n for part in parts), default=0)
        raise InvalidInputError(name, f"have a part of {_LEAST} points or more", largest)
    return parts


def _prepared(name: str, parts: list[Component]) -> dict[int, Prepared]:
    """Return the parts that can be matched, by their numbers."""
    ready = {}
    for i, part in enumerate(parts):
        if _is_large(part.mesh):
            with about(f"part {i} of the {name}"):
                ready[i] = prepared(part.mesh)
    return ready


def _is_large(mesh: TriangleMesh) -> bool:
    """Whether a part can be matched: of enough points, and not all on a line."""
    return mesh.n >= _LEAST and mesh.area > _LINE * float(np.ptp(mesh.points, axis=0).max()) ** 2
