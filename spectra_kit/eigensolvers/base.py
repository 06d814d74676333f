"""What a backend is: the `Eigensolver` protocol and what passes through it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from spectra_kit.operators.laplacian import Laplacian

Floats = NDArray[np.float64]


class Eigenpairs(NamedTuple):
    """What a backend returns; a plain ``(eigenvalues, eigenvectors)`` does as well.

    Attributes
    ----------
    eigenvalues : ndarray of shape (k,)
        In any order.
    eigenvectors : ndarray of shape (n, k)
        M-orthonormal columns.
    seconds : mapping of str to float, optional
        Wall time of the backend's own stages, where it tells them apart.
    iterations : int, optional
        How many an iterative backend took.
    """

    eigenvalues: Floats
    eigenvectors: Floats
    seconds: Mapping[str, float] | None = None
    iterations: int | None = None


class Eigensolver(Protocol):
    """A backend: a frozen dataclass of its hyper-parameters with this one method.

    Only `eigensolve` calls it: with a Neumann-like `Laplacian` that is connected (or, where points
    were fixed, one connected part of the free points), and 1 <= k <= n. It then checks, sorts and
    certifies what comes back, so a backend does none of that.
    """

    def eigenpairs(self, laplacian: Laplacian, k: int) -> Eigenpairs | tuple[Floats, Floats]:
        """Return the k lowest eigenpairs of `laplacian`.

        Raises
        ------
        NotConvergedError
            With the pairs that did converge; `eigensolve` certifies them and raises
            `ConvergenceError`.
        """
        ...


class NotConvergedError(Exception):
    """A backend stopped short; carries the `Eigenpairs` that it trusts (possibly none)."""

    def __init__(self, message: str, pairs: Eigenpairs | None = None) -> None:
        super().__init__(message)
        self.pairs = pairs
