"""What a backend is: the `Eigensolver` protocol, what passes through it, and where many begin."""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches
from typing import Any, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.checked import MADE_OF
from spectra_kit._core.types import Floats
from spectra_kit.catalogue import SOLVERS
from spectra_kit.eigen.multigrid.coarse import Coarse
from spectra_kit.eigen.subspaces.ambient_fourier import AmbientFourier
from spectra_kit.eigen.subspaces.base import Subspace
from spectra_kit.errors import InvalidInputError
from spectra_kit.operators.laplacian import Laplacian

#: What a backend goes on for: until rounding, until the residuals asked for, or so much work.
Promise = Literal["exact", "to tolerance", "approximate"]


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
    errors : ndarray of shape (k,), optional
        Relative errors of the eigenvalues as an approximate backend estimates them.
    solver : Eigensolver, optional
        What solved, where a backend chose another one.
    reason : str, optional
        Why it chose this one.
    """

    eigenvalues: Floats
    eigenvectors: Floats
    seconds: Mapping[str, float] | None = None
    iterations: int | None = None
    errors: Floats | None = None
    solver: Eigensolver | None = None
    reason: str = ""


@runtime_checkable
class Eigensolver(Protocol):
    """A backend: a frozen dataclass of its hyper-parameters with this one method.

    Only `eigensolve` calls it: with a Neumann-like `Laplacian` that is connected (or, where points
    were fixed, one connected part of the free points), and 1 <= k <= n. It then checks, sorts and
    certifies what comes back, so a backend does none of that.

    A backend may have two more attributes. ``promise`` says what its answers are (`Promise`):
    where they are to be exact or to a tolerance, `eigensolve` counts the eigenvalues and completes
    what was missed. ``name`` is what `Provenance` calls it, if not its class in lower case.

    What gains from many operators at once may have a method ``begin(laplacians, k)``. It does what
    they share, and returns a function for each that does the rest: without arguments, in any
    thread, with the result of ``eigenpairs``. Only `eigensolve_many` calls it.
    """

    def eigenpairs(self, laplacian: Laplacian, k: int) -> Eigenpairs | tuple[Floats, Floats]:
        """Return the k lowest eigenpairs of `laplacian`.

        What stops short raises `NotConvergedError` with the pairs there are; `eigensolve` certifies
        them and raises `ConvergenceError`.
        """
        ...


def named(name: Any) -> Eigensolver:
    """Return the solver of a name in the catalogue, with its defaults."""
    if isinstance(name, str) and name in SOLVERS:
        solver: Eigensolver = SOLVERS[name]()
        return solver
    advice = "pass one such as Arpack()"
    if isinstance(name, str):
        near = get_close_matches(name, SOLVERS, 1)
        advice += f", or the name of one: {' or '.join(map(repr, near or SOLVERS))}"
    raise InvalidInputError("thing", "be an Eigensolver", name, advice=advice)


MADE_OF[Eigensolver] = named


class NotConvergedError(Exception):
    """A backend stopped short; carries the `Eigenpairs` that it has (possibly none).

    `converged` says which of them reached the tolerance, (k,) of bool; all do without it. `advised`
    are ``advice`` and ``remedies``, as of `SpectraKitError`.
    """

    def __init__(
        self,
        message: str,
        pairs: Eigenpairs | None = None,
        converged: NDArray[np.bool_] | None = None,
        **advised: Any,
    ) -> None:
        super().__init__(message)
        self.pairs, self.converged, self.advised = pairs, converged, advised


def check_dimension_of(part: object, laplacian: Laplacian) -> None:
    """Refuse a solver or subspace on a volume where it, or what it holds, knows no volumes."""
    if laplacian.dimension == 2 or part is None:
        return
    if getattr(part, "of_surfaces", False):
        expected, advice = "be given surfaces, which it has learned", "use Cascade()"
        raise InvalidInputError(type(part).__name__, expected, "a volume", advice=advice)
    parts = getattr(part, "parts", ())
    for held in (getattr(part, "subspace", None), getattr(part, "start", None), *parts):
        check_dimension_of(held, laplacian)


def set_device(solver: Any) -> None:
    """Let the device of a frozen solver be a name, of one that torch can use here."""
    object.__setattr__(solver, "device", str(solver.device))
    if solver.device != "cpu":  # which needs no torch
        from spectra_kit._sparse.torch_device import check_device

        check_device(solver.device)


def plane_waves(k: int) -> AmbientFourier:
    """Return a start for k modes that costs less than what it saves.

    The m functions grow with k, and the bandwidth like the frequency of mode k.
    """
    return AmbientFourier(m=max(64, round(2.7 * k)), bandwidth=0.7 * max(k, 24) ** 0.5)


def block_size(k: int, guard: float) -> int:
    """Return how many Ritz vectors to iterate on for k wanted ones."""
    return k + max(8, round(guard * k))


def basis_with_kernel(subspace: Subspace, operator: Laplacian | Coarse) -> NDArray[np.floating]:
    """Return the basis of `subspace`, of checked form, led by the constant where that is a mode."""
    mass = operator.mass if isinstance(operator, Laplacian) else operator.lumped
    basis = np.asarray(subspace(operator.points, mass))
    if basis.ndim != 2 or len(basis) != operator.n or basis.dtype.kind != "f":
        raise InvalidInputError(
            "subspace",
            f"return a real array of shape ({operator.n}, m)",
            f"{basis.shape} of {basis.dtype}",
        )
    first = basis[:, :1]  # none, of a basis without columns
    if not operator.kernel_dimension or (first[:1].any() and np.ptp(first) == 0):
        return basis  # most begin with the constant
    return np.column_stack([np.ones(operator.n, basis.dtype), basis])
