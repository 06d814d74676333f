"""`AmbientFourier`: smooth functions of space, cut off by the surface; nothing is learned."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.checked import checked
from spectra_kit._core.threads import in_threads, ranges, single_threaded_blas
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_count, check_positive
from spectra_kit.eigen.subspaces.frame import canonical_frame

if TYPE_CHECKING:
    import torch

_ROWS = 4_096  # evaluated at a time: stays in the cache, and each thread takes the next


@checked
@dataclass(frozen=True, kw_only=True)
class AmbientFourier:
    """Constant, coordinates, cosines and sines of random plane waves in the canonical frame.

    The low eigenfunctions of most surfaces are nearly restrictions of smooth functions of space,
    so a few hundred plane waves of moderate frequency contain them to a few per mille. It needs no
    training and no weights: the rival that a learned subspace has to beat at equal m.

    Parameters
    ----------
    m : int, default 640
        Number of basis functions, at least 5.
    bandwidth : float, default 10.0
        Standard deviation of the wave vectors' components, in radians per unit of the canonical
        frame (in which the shape spans [-1, 1]). More for finer detail, at a larger m.
    seed : int, default 0
        Of the wave vectors.

    Notes
    -----
    The wave vectors are random Fourier features of a Gaussian kernel (Rahimi and Recht, *Random
    Features for Large-Scale Kernel Machines*, 2007).

    Examples
    --------
    >>> import numpy as np
    >>> from spectra_kit.eigen.subspaces import AmbientFourier
    >>> points = np.random.default_rng(0).standard_normal((100, 3))
    >>> AmbientFourier(m=64)(points, np.ones(100)).shape
    (100, 64)
    """

    m: int = 640
    bandwidth: float = 10.0
    seed: int = 0

    def __post_init__(self) -> None:
        check_count("m", self.m, low=5)
        check_positive("bandwidth", self.bandwidth)
        check_count("seed", self.seed, low=0)

    def __call__(self, points: Floats, mass: Floats) -> NDArray[np.float64]:
        """See `Subspace`."""
        posed = canonical_frame(points, mass).pose(points)
        waves = self._waves()
        n_cosines = waves.shape[1]
        n_sines = self.m - 4 - n_cosines
        basis = np.empty((len(points), self.m))
        basis[:, 0] = 1.0
        basis[:, 1:4] = posed

        def fill(rows: slice) -> None:
            phase = posed[rows] @ waves
            np.cos(phase, out=basis[rows, 4 : 4 + n_cosines])
            np.sin(phase[:, :n_sines], out=basis[rows, 4 + n_cosines :])

        with single_threaded_blas():
            in_threads(fill, ((slice(*rows),) for rows in ranges(len(posed), _ROWS)))
        return basis

    def functions(self, posed: torch.Tensor, mass: torch.Tensor) -> torch.Tensor:
        """Return cosines and sines alone, (b, n, m - 4), at posed points (b, n, 3)."""
        import torch

        phase = posed @ torch.from_numpy(self._waves()).to(posed)
        return torch.cat([phase.cos(), phase.sin()], dim=-1)[..., : self.m - 4]

    def _waves(self) -> Floats:
        """Return the wave vectors as columns."""
        n_cosines = (self.m - 3) // 2
        return np.random.default_rng(self.seed).standard_normal((3, n_cosines)) * self.bandwidth
