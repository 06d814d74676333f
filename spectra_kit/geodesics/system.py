"""`System`: a triangulation with its points in an order that is good for solvers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import reverse_cuthill_mckee

from spectra_kit._core.types import Bools, Floats, Ints32
from spectra_kit._core.warn import warn
from spectra_kit._sparse.elimination import Elimination
from spectra_kit._sparse.incomplete_cholesky import untidy
from spectra_kit.errors import DoubtfulDistanceWarning
from spectra_kit.geodesics.heat_step import Heat
from spectra_kit.operators.intrinsic import IntrinsicTriangulation
from spectra_kit.operators.triangle_calculus import apexes, areas

_FLAT = 1e-9  # relative differences of heat in a triangle that are no direction, but rounding
_RARE = 0.01  # share of the surface
COARSER = 8  # times the length of a step: larger triangles take the next one
_LEVEL = 0.05  # share of such triangles that deserves a warning; a few lie at any source's antipode


@dataclass(frozen=True, eq=False, repr=False)
class System:
    """What both steps of the heat method work on; place i in memory holds point ``order[i]``.

    All points of a triangulation of `n`, or those of one component; in the order of the input,
    unless neighbours are scattered over memory (as in a shuffled mesh or most clouds), where
    incomplete factors are bad and everything waits for memory: then reverse Cuthill-McKee.
    `corners`, `lengths` and `share` are those of `IntrinsicTriangulation`; `unit` (m,) is the
    length that counts as 1: the spacing of the component of each point.
    """

    n: int
    order: NDArray[np.int64]
    stiffness: sparse.csr_array
    mass: Floats
    points: Floats
    labels: NDArray[np.int64]
    corners: Ints32
    lengths: Floats
    share: float
    inside: Bools  # not on the boundary
    unit: Floats

    @staticmethod
    def of(triangulation: IntrinsicTriangulation, component: int | None = None) -> System:
        """Lay out a triangulation, or one component of it."""
        laplacian = triangulation.laplacian
        n, stiffness, corners = laplacian.n, laplacian.stiffness, triangulation.corners
        lengths, labels = triangulation.lengths, laplacian.component_labels
        order = np.arange(n)
        if component is not None:
            order = np.flatnonzero(labels == component)
            here = labels[corners[:, 0]] == component
            stiffness = sparse.csr_array(stiffness[order][:, order])
            corners, lengths = corners[here], lengths[here]
        if untidy(stiffness):
            better = reverse_cuthill_mckee(stiffness, symmetric_mode=True).astype(np.int64)
            stiffness = sparse.csr_array(stiffness[better][:, better])
            stiffness.sort_indices()
            order = order[better]
        place = np.empty(n, dtype=np.int32)
        place[order] = np.arange(len(order))
        inside = np.ones(n, dtype=bool)
        inside[triangulation.boundary] = False
        unit = triangulation.spacings[labels[order]]
        corners = place[corners]
        return System(
            n,
            order,
            stiffness,
            laplacian.mass[order] / unit**2,
            laplacian.points[order] / unit[:, None],
            labels[order],
            corners,
            lengths / unit[corners[:, :1]],
            triangulation.share,
            inside[order],
            unit,
        )

    @cached_property
    def elimination(self) -> Elimination:
        """What factors of matrices with the pattern of `stiffness` have in common."""
        return Elimination.of(self.stiffness)

    @cached_property
    def sizes(self) -> NDArray[np.int64]:
        """Of each triangle, k for which its longest side is at most ``8**(k + 1)``, shape (f,).

        Those of one k > 0 that cover next to nothing of the surface count among the next larger
        ones that do, or the largest: each k costs a factor.
        """
        steps = np.log(self.lengths.max(axis=1, initial=1.0)) / np.log(COARSER)
        sizes = np.asarray(np.ceil(steps - 1).clip(0), dtype=np.int64)
        if not sizes.any():
            return sizes
        covered = np.bincount(sizes, areas(self.lengths))
        worth = np.union1d(0, np.flatnonzero(covered > _RARE * covered.sum()))
        return np.asarray(worth[np.searchsorted(worth, sizes).clip(max=len(worth) - 1)])

    @cached_property
    def _triangles(self) -> dict[int, tuple[Ints32, Floats, Floats]]:
        """Corners, lengths and apexes of the triangles of each of `sizes`."""
        whole = self.corners, self.lengths, apexes(self.lengths)
        found = np.unique(self.sizes).tolist()
        if len(found) == 1:
            return {found[0]: whole}
        corners, lengths, tops = whole
        masks = {size: self.sizes == size for size in found}
        return {k: (corners[here], lengths[here], tops[here]) for k, here in masks.items()}

    def outwards(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return `values` (m,) in the order of the input, 0 at points of other components."""
        found = np.zeros(self.n, values.dtype)
        found[self.order] = values
        return found

    def flow(self, heats: Mapping[int, Heat], at_zero: Bools) -> Floats:
        """Return the integrated divergence of the unit vectors in which heat flows, shape (n,).

        Through triangles of one of `sizes` flows the heat of its step; the points `at_zero` are
        sources. All in the order of memory.
        """
        from spectra_kit.geodesics._kernels import divergence_of_directions

        found, level = np.zeros(len(self.order)), 0
        for size, heat in heats.items():
            if size not in self._triangles:
                continue
            part, still = divergence_of_directions(
                *self._triangles[size],
                heat.values,
                heat.exponents,
                _FLAT,
                at_zero,
            )
            found, level = found + part, level + still
        if level > _LEVEL * len(self.corners) + 4:
            warn(
                f"heat is the same all over {level} of {len(self.corners)} triangles, where no"
                " distance can be told from it",
                DoubtfulDistanceWarning,
                advice="lower `time_coefficient`",
            )
        return np.multiply(self.share, found)
