"""What is known of the modes of a spectrum, and where they come from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from spectra_kit._core.checked import checked
from spectra_kit._core.records import Rebuilt, frozen
from spectra_kit._core.types import Floats
from spectra_kit._core.validate import check_count, quantity, real_array
from spectra_kit.errors import InvalidInputError


@checked
@dataclass(frozen=True, kw_only=True)
class ModeCount(Rebuilt):
    """What counting the eigenvalues below a shift has proved; see `eigensolve` and `verify`.

    The i-th eigenvalue is the i-th lowest of the operator for all i < `verified`, repeated ones
    counted as often as they occur: none was missed. (Leading modes that `Spectrum.nonzero`
    dropped on purpose are not missing.) Where k cuts a cluster of eigenvalues, this holds to within
    the width of the cluster, which `radius` then covers.

    Attributes
    ----------
    verified : int
        Number of leading modes proved to be the lowest, with none missed between them.
    radius : float
        Each of their eigenvalues is exact to within this, in 1/length^2.
    floor : float
        Every eigenvalue beyond them is at least this, in 1/length^2.
    missing : int
        At least so many of the lowest modes are certainly not in the spectrum.
    added : int
        Modes that the solver had missed: the count told, and `eigensolve` found them.
    reason : str
        Why not all modes are verified; empty if they are.
    """

    verified: int
    radius: float
    floor: float
    missing: int = 0
    added: int = 0
    reason: str = ""

    def __post_init__(self) -> None:
        for name in ("verified", "missing", "added"):
            check_count(name, getattr(self, name), low=0)
        _check_magnitude("radius", self.radius)
        if np.isnan(self.floor):
            raise InvalidInputError("floor", "be a number", self.floor)

    def rescaled(self, square: float) -> ModeCount:
        """Return the same for eigenvalues divided by `square`."""
        return replace(self, radius=self.radius / square, floor=self.floor / square)


def _check_magnitude(name: str, value: float) -> None:
    """Refuse what no norm, no distance and no error can be."""
    if not value >= 0:
        raise InvalidInputError(name, "be at least 0", value)


@checked
@dataclass(frozen=True, eq=False, kw_only=True)
class Certificate(Rebuilt):
    """What was checked about each mode, against the operator itself.

    Attributes
    ----------
    residuals : ndarray of shape (k,)
        ``||L u - lambda M u|| / ||u||`` in the M^-1 and M norms, in 1/length^2. Some true
        eigenvalue lies within this distance of lambda (Weinstein's bound), whatever made the pair.
    relative_residuals : ndarray of shape (k,)
        ``residuals / max(lambda, spacing)``, with the typical gap between eigenvalues
        (``Laplacian.component_spacings``) of the component on which the mode lives;
        dimensionless, and meaningful for zero modes too.
    orthonormality_error : float
        Largest entry of ``|U^T M U - I|``.
    n_zero_modes : int
        Modes in the kernel of the operator: constant on components where that has no energy. A
        small eigenvalue does not make one.
    kernel_dimension : int
        Zero modes that the operator has: `Laplacian.kernel_dimension`.
    n_components : int
        Connected components of the operator.
    count : ModeCount, optional
        The proof, by a count of the eigenvalues, that none was missed. `eigensolve` makes it for
        solvers that are exact, or go on to a tolerance, by means of a factor; `verify` for any.
    excess : ndarray of shape (k,), optional
        By how much each eigenvalue is too high at least, relative to the true one; 0 where nothing
        is proved. `eigensolve` adds it where a relative residual is above 0.1, as those of
        predictions are.
    errors : ndarray of shape (k,), optional
        Relative error of each eigenvalue, as far as it is known: a bound, or an estimate, as
        `bounded` says; relative to what `relative_residuals` are. `Cascade` and `Neo` estimate it
        from residuals that they solve for, other spectra from residuals and gaps (Kato and Temple);
        of predictions with relative residuals above 0.1 they tell nothing. An estimate knows
        nothing of a mode that was passed over, and is too low on shapes that are thin beside the
        spacing of coarse levels, but for what counts of the eigenvalues refute.
    bounded : ndarray of bool, shape (k,)
        Whether the error is a bound, which takes a count of the eigenvalues and is proved up to the
        rounding of the matrices; otherwise it is an estimate. False without `errors`.

    Notes
    -----
    Residuals say that each pair is near *some* true pair. That none was skipped in between is not
    implied; without `count`, the number of zero modes is the only completeness check.
    """

    residuals: Floats
    relative_residuals: Floats
    orthonormality_error: float
    n_zero_modes: int
    kernel_dimension: int
    n_components: int
    count: ModeCount | None = None
    excess: Floats | None = None
    errors: Floats | None = None
    bounded: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))

    def __post_init__(self) -> None:
        for name in ("residuals", "relative_residuals", "excess", "errors"):
            if (given := getattr(self, name)) is not None:
                object.__setattr__(self, name, frozen(real_array(name, given)))
                _check_magnitude(name, getattr(self, name).min(initial=0.0))
        if self.residuals.ndim != 1 or self.relative_residuals.shape != self.residuals.shape:
            raise InvalidInputError(
                "relative_residuals",
                "have the same shape (k,) as `residuals`",
                f"{self.relative_residuals.shape} and {self.residuals.shape}",
            )
        shape, bounded = self.residuals.shape, np.asarray(self.bounded)
        if bounded.dtype != bool:
            raise InvalidInputError("bounded", "be an array of bool", f"one of {bounded.dtype}")
        bounded = frozen(bounded if bounded.size else np.zeros(shape, dtype=bool))
        object.__setattr__(self, "bounded", bounded)
        for name, array in (("excess", self.excess), ("errors", self.errors), ("bounded", bounded)):
            if array is not None and array.shape != shape:
                raise InvalidInputError(name, f"have the shape {shape} of `residuals`", array.shape)
        _check_magnitude("orthonormality_error", self.orthonormality_error)
        k = len(self.residuals)
        check_count("n_zero_modes", self.n_zero_modes, low=0, high=k)
        for name in ("kernel_dimension", "n_components"):
            check_count(name, getattr(self, name), low=0)
        if self.count is not None:
            check_count("verified", self.count.verified, low=0, high=k)

    @property
    def level(self) -> Literal["residuals", "verified"]:
        """How much is certain: ``verified`` if every mode is known to be the one it is taken for.

        With ``residuals`` alone, each mode is near a true one, and some may have been missed.
        A spectrum of no modes has nothing to verify.
        """
        return "verified" if 0 < self.n_verified == len(self.residuals) else "residuals"

    @property
    def n_verified(self) -> int:
        """Number of leading modes that are proved to be the lowest."""
        return self.count.verified if self.count else 0

    @property
    def summary(self) -> str:
        """How far the modes are verified, and the largest residual, in a few words."""
        known = f"{self.n_verified} of {len(self.residuals)} verified"
        if self.count is None:
            known = "not counted"
        elif self.level == "verified":
            known = "verified"
        return f"{known}, relative residuals up to {self.relative_residuals.max(initial=0.0):.1e}"

    def _facts(self) -> Mapping[str, object]:
        return {
            "modes": len(self.residuals),
            "largest relative residual": f"{self.relative_residuals.max(initial=0.0):.1e}",
            "orthonormality error": f"{self.orthonormality_error:.1e}",
            "zero modes": f"{self.n_zero_modes} of {self.kernel_dimension}",
            "connected components": self.n_components,
            "completeness": self.completeness,
        }

    @property
    def completeness(self) -> str:
        """What is known of modes that were missed, in words."""
        if self.count is None:
            return "not counted: modes may be missing between these"
        if self.level != "verified":
            return f"the first {self.count.verified} of {len(self.residuals)}; {self.count.reason}"
        added = quantity(self.count.added, "mode")
        found = f"; {added} that the solver had passed over added" if self.count.added else ""
        below = f" below {self.count.floor:.6g}" if self.count.floor > 0 else ""
        return f"all {len(self.residuals)}, none missed{below}{found}"


@checked
@dataclass(frozen=True, kw_only=True)
class Provenance(Rebuilt):
    """Where a spectrum comes from.

    Attributes
    ----------
    solver, operator : str
        The backend with its hyper-parameters, that of the largest component where it was chosen for
        each; and how the matrices were built.
    seed : int or None
        The backend's random seed, where it has one.
    seconds : mapping of str to float
        Wall time of each stage: ``assembly``, the solver's own stages, ``certify``.
    input_hash : str
        BLAKE2b of stiffness, mass, points, fixed points and dimension: equal input, equal hash.
    version : str
        Version of spectra_kit.
    iterations : int or None
        Sweeps of an iterative backend, summed over the components; None where it does not count.
    accuracy : {"exact", "to tolerance", "approximate", ""}
        What the backend goes on for; empty where it does not say.
    name : str
        The backend's in the `catalogue`, else that of its class in lower case; empty for the user's
        own modes.
    reason : str
        Why this solver, where `eigen.Automatic` chose it; empty where the user did.
    """

    solver: str = "user"
    operator: str = "user"
    seed: int | None = None
    seconds: Mapping[str, float] = field(default_factory=dict, hash=False)
    input_hash: str = ""
    version: str = ""
    iterations: int | None = None
    accuracy: str = ""
    name: str = ""
    reason: str = ""

    def __post_init__(self) -> None:
        seconds = {str(stage): float(t) for stage, t in self.seconds.items()}
        object.__setattr__(self, "seconds", MappingProxyType(seconds))

    @property
    def choice(self) -> str:
        """The name of the solver, and the reason where it was chosen, in words."""
        return f"{self.name}: {self.reason}" if self.reason else self.name

    @property
    def solving_seconds(self) -> float:
        """Seconds of the solver alone: neither assembly nor certificate nor proof."""
        besides = {"assembly", "certify", "count", "verify"}
        return sum(t for stage, t in self.seconds.items() if stage not in besides)
