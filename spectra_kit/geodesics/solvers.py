"""How the linear systems of the heat method are solved: `Direct`, `Iterative`, `WithinMemory`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from spectra_kit._core.checked import checked
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_count, check_positive
from spectra_kit._sparse.coarse_space import (
    AdditiveTwoLevel,
    CoarseSpace,
    Preconditioner,
    ProjectedTwoLevel,
)
from spectra_kit._sparse.conjugate_gradients import pcg
from spectra_kit._sparse.constant_kernel import ConstantKernel
from spectra_kit._sparse.incomplete_cholesky import IncompleteCholesky
from spectra_kit._sparse.memory import factor_gigabytes
from spectra_kit._sparse.solution import LinearSolution
from spectra_kit.eigen import Spectrum
from spectra_kit.errors import InvalidInputError

_MODES = 24  # beyond these, the bytes of a mode cost more than its iterations
_DROP, _RELAXATION = 5e-3, 0.9
_RITZ = 0.1  # relative error of the energies up to which they serve a preconditioner


@checked
@dataclass(frozen=True, kw_only=True)
class Direct:
    """Complete Cholesky factors of both systems: tens of milliseconds a source once they are made.

    Examples
    --------
    >>> from spectra_kit.geodesics import Direct, geodesic_distance
    >>> from spectra_kit.geometry import sphere
    >>> geodesic_distance(sphere(subdivisions=3).geometry, 0, solver=Direct()).poisson.method
    'Cholesky'
    """

    name = "direct"


@checked
@dataclass(frozen=True, kw_only=True)
class Exact:
    """No linear system: `exact_distances`, which `geodesic_distance` takes on small meshes.

    Examples
    --------
    >>> from spectra_kit.geodesics import Exact, geodesic_distance
    >>> from spectra_kit.geometry import sphere
    >>> geodesic_distance(sphere(subdivisions=3).geometry, 0).solver == Exact()
    True
    """

    name = "exact"


@checked
@dataclass(frozen=True, kw_only=True)
class Iterative:
    """Conjugate gradients with an incomplete factor, and with the modes of a spectrum beside it.

    Parameters
    ----------
    coarse : {"additive", "projected", "none"}, default "additive"
        What the modes do: add their part of the solution to the preconditioner (Algorithm 2 of
        the NEO paper), are projected out of the residual, or nothing (Algorithm 1). Without a
        spectrum all are "none".
    modes : int, default 24
        How many modes at most, zero modes aside. More save iterations, and make each slower.
    drop : float or None, default 5e-3
        Entries of the factor below this share are dropped; None is level 0, as in the paper.
    relaxation : float, default 0.9
        Share of what is dropped that goes to the diagonal; 0 in the paper.
    rtol : float, default 1e-8
        Relative residual at which the Poisson step ends.
    max_iterations : int, optional
        Of the Poisson step.

    Notes
    -----
    Algorithm 1 of the NEO paper is ``Iterative(coarse="none", drop=None, relaxation=0.0)``, its
    Algorithm 2 ``Iterative(drop=None, relaxation=0.0, modes=96)`` with a spectrum. A relaxed
    factor (Gustafsson 1978) leaves less for the modes to do than one of level 0.

    Examples
    --------
    >>> from spectra_kit.geodesics import Iterative, geodesic_distance
    >>> from spectra_kit.geometry import sphere
    >>> paper = Iterative(coarse="none", drop=None, relaxation=0.0)
    >>> mesh = sphere(subdivisions=4).geometry
    >>> [geodesic_distance(mesh, 0, solver=s).poisson.iterations for s in (paper, Iterative())]
    [4..., 1...]
    """

    coarse: Literal["additive", "projected", "none"] = "additive"
    modes: int = _MODES
    drop: float | None = _DROP
    relaxation: float = _RELAXATION
    rtol: float = 1e-8
    max_iterations: int | None = None

    def __post_init__(self) -> None:
        check_count("modes", self.modes, low=1)
        _check_rtol(self.rtol)
        if self.drop is not None and self.drop != 0:
            check_positive("drop", self.drop)
        if not 0 <= self.relaxation <= 1:
            raise InvalidInputError("relaxation", "be in [0, 1]", f"{self.relaxation!r}")
        if self.max_iterations is not None:
            check_count("max_iterations", self.max_iterations, low=1)

    @property
    def name(self) -> str:
        """What it is, in words."""
        return "iterative" if self.coarse == "none" else f"two-level iterative ({self.coarse})"


@checked
@dataclass(frozen=True, kw_only=True)
class WithinMemory:
    """`Direct` where complete factors fit into memory, `Iterative` elsewhere.

    The factors take about as long as the iterations for one source.

    Parameters
    ----------
    memory : float, default 4.0
        GiB that complete factors may take: two, or more for other boundaries and triangles of
        very different sizes. Estimated first, then counted.
    modes : int, default 24
        How many modes the iterative solver uses at most.
    rtol : float, default 1e-8
        Relative residual at which it ends.

    Examples
    --------
    >>> from spectra_kit.geodesics import WithinMemory
    >>> WithinMemory().choose(100_000)
    (Direct(), 'factors of 100000 points fit into 4 GiB')
    """

    memory: float = 4.0
    modes: int = _MODES
    rtol: float = 1e-8

    def __post_init__(self) -> None:
        check_positive("memory", self.memory)
        check_count("modes", self.modes, low=1)
        _check_rtol(self.rtol)

    def choose(self, n: int, gigabytes: float | None = None) -> tuple[Direct | Iterative, str]:
        """Return the solver on n points, and why it is this one.

        `gigabytes` are GiB that the factors take; without them, about as much as two do on even
        triangles.
        """
        needed = 2 * factor_gigabytes(n) if gigabytes is None else gigabytes
        if needed <= self.memory:
            return Direct(), f"factors of {n} points fit into {self.memory:g} GiB"
        reason = f"factors would take {needed:.1f} GiB, more than {self.memory:g}"
        return Iterative(modes=self.modes, rtol=self.rtol), reason


Solver = Direct | Iterative | WithinMemory


def _check_rtol(rtol: float) -> None:
    if check_positive("rtol", rtol) >= 1:
        raise InvalidInputError("rtol", "be less than 1", rtol, advice="1e-8 is the default")


class IterativePoisson:
    """Conjugate gradients as `options` say; place i of the matrix is point ``order[i]``."""

    def __init__(
        self,
        matrix: sparse.csr_array,
        kernel: ConstantKernel,
        options: Iterative,
        spectrum: Spectrum | None,
        order: NDArray[np.int64],
    ) -> None:
        self._matrix, self._kernel = matrix, kernel
        self._preconditioner: Preconditioner = IncompleteCholesky(
            matrix,
            drop=options.drop,
            relaxation=options.relaxation,
            dtype=np.float32,
        )
        self._coarse = None
        if spectrum is not None and options.coarse != "none":
            exact = options.coarse == "projected"
            self._coarse = _coarse_space(matrix, spectrum, order, options.modes, exact=exact)
        if self._coarse is None:
            options = replace(options, coarse="none")
        elif options.coarse == "projected":
            self._preconditioner = ProjectedTwoLevel(self._preconditioner, self._coarse, matrix)
        else:
            self._preconditioner = AdditiveTwoLevel(self._preconditioner, self._coarse)
        #: As they came, but for modes that are not there.
        self.options = options

    def solutions(self, sides: Sequence[Floats]) -> list[LinearSolution]:
        """Solve for each, from the solution in the modes (the warm start of Algorithm 2)."""
        return [
            pcg(
                self._matrix,
                rhs,
                preconditioner=self._preconditioner,
                start=None if self._coarse is None else self._coarse.solve(rhs),
                kernel=self._kernel,
                rtol=self.options.rtol,
                max_iterations=self.options.max_iterations,
            )
            for rhs in sides
        ]


def _coarse_space(
    matrix: sparse.csr_array,
    spectrum: Spectrum,
    order: NDArray[np.int64],
    modes: int,
    *,
    exact: bool,
) -> CoarseSpace | None:
    """Return the span of the lowest modes outside the kernel; None if there are none.

    ``E = Y^T A Y`` is the diagonal of the eigenvalues for Ritz vectors of this very matrix. For
    those of another operator on the same points, or where it has to be exact, E is computed.
    """
    outside = spectrum.nonzero()
    count = min(modes, outside.k)
    if count == 0:
        return None
    Y, energies = outside.eigenvectors[order, :count], outside.eigenvalues[:count]
    if exact or not _are_ritz(matrix, Y, energies):
        return CoarseSpace(Y, matrix=matrix)
    return CoarseSpace(Y, energies=energies)


def _are_ritz(matrix: sparse.csr_array, Y: Floats, energies: Floats) -> bool:
    """Whether ``Y^T A Y`` is the diagonal of `energies`, by one random combination of modes."""
    c = np.random.default_rng(0).standard_normal(len(energies)) / np.sqrt(energies)
    wanted = energies * c
    error = (Y.T @ (matrix @ (Y @ c)) - wanted) / np.sqrt(energies)
    return bool(np.linalg.norm(error) <= _RITZ * np.sqrt(len(energies)))
