"""`ConstantKernel`: functions that are constant on each connected component."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from spectra_kit._core.records import frozen
from spectra_kit._core.types import Floats, Ints
from spectra_kit.errors import InvalidInputError


class ConstantKernel:
    """The kernel of a Neumann Laplacian, spanned by the indicator functions of its components.

    `labels` count the components of the points, (n,), from 0. Points labelled -1 are in no
    component of the kernel: a fixed point holds theirs down.
    """

    def __init__(self, labels: ArrayLike) -> None:
        array = np.asarray(labels)
        if array.ndim != 1 or array.dtype.kind not in "iu" or not array.size or array.min() < -1:
            raise InvalidInputError(
                "`labels` must be integers from -1 upwards, one for each point, got an array of"
                f" shape {array.shape} and dtype {array.dtype}"
                + (f" down to {array.min()}" if array.dtype.kind in "iu" and array.size else "")
            )
        self.labels: Ints = frozen(array.astype(np.int64))
        # Counted from -1, so that one `bincount` serves; the bin of -1 is never looked at.
        self._sizes = np.bincount(self.labels + 1)
        #: Whether one component holds all points.
        self.whole: bool = len(self._sizes) == 2 and self._sizes[0] == 0

    @property
    def n(self) -> int:
        """Number of points."""
        return len(self.labels)

    @property
    def dimension(self) -> int:
        """Number of components in the kernel that have points."""
        return int(np.count_nonzero(self._sizes[1:]))

    def means(self, values: Floats) -> Floats:
        """Return the mean of `values` (n,) on each component; 0 for a label without points."""
        if self.whole:
            return np.array([values.mean()])
        sums = np.bincount(self.labels + 1, values)
        means: Floats = sums[1:] / np.maximum(self._sizes[1:], 1)
        return means

    def remove(self, values: Floats) -> Floats:
        """Return `values` (n,) less their mean on each component; others as they are."""
        means = self.means(values)
        shift: Floats = means if self.whole else np.append(0.0, means)[self.labels + 1]
        return values - shift
