"""`ConstantKernel`: functions that are constant on each connected component."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.records import frozen
from spectra_kit._core.types import Floats, Ints


class ConstantKernel:
    """The kernel of a Neumann Laplacian, spanned by the indicator functions of its components.

    `labels` count the components of the points, (n,), from 0.
    """

    def __init__(self, labels: ArrayLike) -> None:
        self.labels: Ints = frozen(np.array(labels, dtype=np.int64))
        self._sizes = np.bincount(self.labels)
        #: Whether one component holds all points.
        self.whole: bool = len(self._sizes) == 1

    def means(self, values: Floats) -> Floats:
        """Return the mean of `values` (n,) on each component; 0 for a label without points."""
        if self.whole:
            return np.array([values.mean()])
        means: Floats = np.bincount(self.labels, values) / np.maximum(self._sizes, 1)
        return means

    def remove(self, values: Floats) -> Floats:
        """Return `values` (n,) less their mean on each component."""
        means = self.means(values)
        return values - (means if self.whole else means[self.labels])
