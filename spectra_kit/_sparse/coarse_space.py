"""Coarse spaces of known low modes: the part of a preconditioner that a factor does badly."""

from __future__ import annotations

from collections.abc import Callable
from operator import call
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray
from scipy import sparse

from spectra_kit._core.clock import Clock
from spectra_kit._core.threads import in_threads, ranges
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_mass
from spectra_kit._sparse._checks import check_matrix, check_vector
from spectra_kit._sparse.products import real_dtype, spmm
from spectra_kit.errors import InvalidInputError

_DEPENDENT = 1e-10  # share of the largest eigenvalue of the Gram matrix below which columns depend
_KERNEL = 1e-12  # share of the largest diagonal entry of A below which an energy is zero


def check_basis(basis: ArrayLike, kind: np.dtype[np.floating]) -> NDArray[Any]:
    """Return columns (n, k) as a finite C-ordered array of a kind, or refuse them."""
    array = np.asarray(basis)
    if array.ndim != 2 or array.shape[1] == 0 or array.shape[0] < array.shape[1]:
        raise InvalidInputError(
            "basis", "have shape (n, k) with 1 <= k <= n", array.shape, advice="modes are columns"
        )
    stored = np.ascontiguousarray(array, dtype=kind)
    # A sum over all of it is finite unless an entry is not; and needs no mask of its size.
    if not np.isfinite(np.sum(stored, dtype=np.float64)):
        raise InvalidInputError("basis", "be finite", "NaN or infinite values")
    return stored


def inverse_energy(basis: NDArray[Any], matrix: sparse.csr_array) -> tuple[Floats, int]:
    """Return a generalised inverse of ``E = Y^T A Y`` of shape (k, k), and its rank.

    In a basis W that makes ``Y W`` orthonormal: neither the units of its columns nor how skew they
    are to each other decide what is dropped.
    """
    if matrix.shape[0] != len(basis):
        raise InvalidInputError(
            "matrix",
            f"have shape ({len(basis)}, {len(basis)}), as `basis` has {len(basis)} rows",
            matrix.shape,
        )
    wide = basis.astype(np.float64, copy=False)
    gram = wide.T @ wide
    scale = 1 / np.sqrt(np.maximum(np.diag(gram), np.finfo(np.float64).tiny))
    values, vectors = np.linalg.eigh(scale[:, None] * gram * scale)
    kept = values > _DEPENDENT * values[-1]
    W = scale[:, None] * vectors[:, kept] / np.sqrt(values[kept])
    inner = W.T @ (wide.T @ spmm(matrix, wide)) @ W
    energies, turned = np.linalg.eigh((inner + inner.T) / 2)
    kept = energies > _KERNEL * matrix.diagonal().max()
    if not kept.any():
        raise InvalidInputError(
            f"`basis` must not lie in the kernel of `matrix`, but all of its {len(values)} columns"
            " have no energy"
        )
    W = W @ turned[:, kept]
    return (W / energies[kept]) @ W.T, int(kept.sum())


#: Rows of a range of `pcg` and its preconditioners: sums within one are never cut differently.
ROWS = 16_384
_WIDE = 32  # modes from which a range of rows is worth a thread


@runtime_checkable
class Preconditioner(Protocol):
    """Anything that applies a fixed symmetric positive (semi-)definite matrix near ``A^-1``."""

    def solve(self, rhs: Floats) -> Floats:
        """Return the product with `rhs` (n,), which is not written to, as a new array."""


class CoarseSpace:
    """``Q = Y E^-1 Y^T`` with ``E = Y^T A Y``: the exact solution of a system within span(Y).

    Y is the `basis` of shape (n, k), of any units, without the kernel of A: pass
    ``spectrum.nonzero().eigenvectors``. Either `energies` are the diagonal of E, where it has no
    other entries, as for Ritz vectors (their eigenvalues); or E is computed from the `matrix` A,
    and directions that depend on others to rounding, and those in the kernel of A, are dropped: so
    `dimension` is at most k.

    Reading Y is what an application costs; rounded to float32 it spans almost the same space, and
    convergence does not notice.
    """

    def __init__(
        self,
        basis: ArrayLike,
        *,
        energies: ArrayLike | None = None,
        matrix: sparse.csr_array | None = None,
        dtype: DTypeLike = np.float32,
    ) -> None:
        clock = Clock()
        kind = real_dtype("dtype", dtype)
        self._basis = check_basis(basis, kind)
        self.n, self.dimension = self._basis.shape
        # Wide, each range of rows is worth a thread; narrow, all together are, beside a factor.
        cuts = ranges(self.n, ROWS)
        self._shares = [cuts] if self._basis.shape[1] < _WIDE else [[cut] for cut in cuts]
        self._inverse: Floats | None = None
        self._reciprocal: Floats = np.ones(self.dimension)
        if energies is not None and matrix is None:
            self._reciprocal = 1 / check_mass("energies", energies, self.dimension)
        elif matrix is not None and energies is None:
            self._inverse, self.dimension = inverse_energy(self._basis, check_matrix(matrix))
        else:
            raise InvalidInputError(
                "`energies` or `matrix` must be given, got"
                f" {'neither' if matrix is None else 'both'}; eigenvalues serve as energies where"
                " the basis holds their eigenvectors"
            )
        self.seconds = clock.total

    def __repr__(self) -> str:
        return f"CoarseSpace(n={self.n}, dimension={self.dimension})"

    def solve(self, rhs: Floats) -> Floats:
        """Return ``Y E^-1 Y^T rhs``, the solution within the span; both of shape (n,)."""
        out = np.zeros(self.n)
        self.add_to(out, in_threads(call, self.restrictions(rhs)))
        return out

    def restrictions(self, rhs: Floats) -> list[tuple[Callable[..., Floats], Any, Any, Any]]:
        """Return calls, functions with their arguments, whose results add up to ``Y^T rhs``."""
        values = check_vector("rhs", rhs, self.n)
        return [(_restricted, self._basis, values, rows) for rows in self._shares]

    def add_to(self, out: Floats, restricted: list[Floats]) -> None:
        """Add ``Y E^-1 c`` to `out` (n,), with c (k,) the sum of `restricted`."""
        c = np.sum(restricted, axis=0)
        c = c * self._reciprocal if self._inverse is None else self._inverse @ c
        weights = c.astype(self._basis.dtype)
        in_threads(_prolong, ((self._basis, weights, out, rows) for rows in self._shares))


def _restricted(basis: NDArray[Any], rhs: Floats, rows: list[tuple[int, int]]) -> Floats:
    """Return the share of some ranges of rows in ``Y^T rhs``, summed in float64."""
    from spectra_kit._sparse._krylov_kernels import restrict

    shares = np.empty((len(rows), basis.shape[1]), basis.dtype)
    for share, (start, stop) in zip(shares, rows, strict=True):
        restrict(basis, rhs, share, start, stop)
    total: Floats = shares.sum(axis=0, dtype=np.float64)
    return total


def _prolong(
    basis: NDArray[Any], weights: NDArray[Any], out: Floats, rows: list[tuple[int, int]]
) -> None:
    """Add the rows of ``Y @ weights`` to those of `out`."""
    from spectra_kit._sparse._krylov_kernels import prolong

    prolong(basis, weights, out, rows[0][0], rows[-1][1])


class AdditiveTwoLevel:
    """``M^-1 + Y E^-1 Y^T``: a base preconditioner and a coarse space, added.

    Algorithm 2 of the NEO paper is `pcg` with this preconditioner, started from
    ``coarse.solve(b)``. A low mode, of which M^-1 sees little, has an eigenvalue near one in this
    operator. Base and coarse part run side by side.
    """

    def __init__(self, base: Preconditioner, coarse: CoarseSpace) -> None:
        self.base, self.coarse = base, coarse
        self.seconds: float = getattr(base, "seconds", 0.0) + coarse.seconds

    def __repr__(self) -> str:
        return f"AdditiveTwoLevel({self.base!r}, {self.coarse!r})"

    def solve(self, rhs: Floats) -> Floats:
        """Return ``base.solve(rhs) + coarse.solve(rhs)``."""
        # The base is one task, as long as several ranges of a wide basis: it goes first.
        out: Floats
        out, *restricted = in_threads(
            call, [(self.base.solve, rhs), *self.coarse.restrictions(rhs)]
        )
        self.coarse.add_to(out, restricted)
        return out


class ProjectedTwoLevel:
    """``(I - Q A) M^-1 + Q`` with ``Q = Y E^-1 Y^T``: deflation that corrects itself.

    The energies of `coarse`, which is Q, must be those in `matrix`, which is A.

    A-DEF2 of Tang, Nabben, Vuik & Erlangga (*J. Sci. Comput.* 39, 2009). It acts as the symmetric
    balancing preconditioner on residuals without a component in span(Y), which is what `correct`
    makes of the first one, and CG keeps of the rest; ``+ Q`` removes what rounding brings back,
    so that an inexact Q does no harm, other than in plain deflation. One product with A more
    than `AdditiveTwoLevel`, and one part after the other.
    """

    def __init__(self, base: Preconditioner, coarse: CoarseSpace, matrix: sparse.csr_array) -> None:
        self._matrix = check_matrix(matrix)
        self.base, self.coarse = base, coarse
        self.seconds: float = getattr(base, "seconds", 0.0) + coarse.seconds

    def __repr__(self) -> str:
        return f"ProjectedTwoLevel({self.base!r}, {self.coarse!r})"

    def correct(self, residual: Floats) -> Floats:
        """Return ``Q residual``: added to x, it leaves no residual in span(Y)."""
        return self.coarse.solve(residual)

    def solve(self, rhs: Floats) -> Floats:
        """Return ``(I - Q A) base.solve(rhs) + coarse.solve(rhs)``."""
        z = self.base.solve(rhs)
        self.coarse.add_to(z, in_threads(call, self.coarse.restrictions(rhs - self._matrix @ z)))
        return z
