"""Linear solvers of geodesic distances, and the modes of their coarse space."""

from __future__ import annotations

from typing import Literal

from spectra_kit._validate import check_count
from spectra_kit.cli import program
from spectra_kit.cli.options import NETWORK, refuse_given
from spectra_kit.cli.solving import check_solvers, refuse_solving, solve
from spectra_kit.errors import InvalidInputError
from spectra_kit.geodesics import Automatic, Direct, Iterative
from spectra_kit.operators import Laplacian
from spectra_kit.spectra import Spectrum

Solver = Automatic | Direct | Iterative
_COARSE: dict[str, Literal["additive", "projected", "none"]] = {
    "iterative": "additive",
    "projected": "projected",
    "plain": "none",
}


def check_solver(asked: program.Geodesic) -> None:
    """Refuse options of solvers that are not used, and solvers that lack what they need."""
    if asked.k is not None:
        check_count("-k", asked.k, low=1)
    if asked.spectrum:
        refuse_solving(asked)
    elif asked.solver:
        check_solvers(asked, asked.solver)
    elif not asked.compare:
        why = "without modes; choose what solves for them by --solver"
        refuse_given(asked, ("k", "rtol", "start", *NETWORK), why)
    if asked.method == "direct" and not asked.compare:
        refuse_given(asked, ["poisson_rtol"], "on a direct solver; choose another by --method")
    with_modes = bool(asked.spectrum or asked.solver)
    if asked.method == "projected" and not with_modes:
        raise InvalidInputError(
            "--method projected needs modes; choose what solves for them by --solver"
        )
    if asked.method in ("direct", "plain") and with_modes and not asked.compare:
        named = f"--spectrum {asked.spectrum}" if asked.spectrum else f"--solver {asked.solver}"
        raise InvalidInputError(
            f"--method {asked.method} has no use for modes, got {named}; leave one out"
        )


def linear_solver(asked: program.Geodesic, n_sources: int, modes: int) -> Solver:
    """Return the solver that ``--method`` names, with so many modes at most."""
    rtol = asked.poisson_rtol
    if asked.method == "auto":
        return Automatic(n_sources=n_sources, modes=modes, rtol=rtol)
    if asked.method == "direct":
        return Direct()
    return Iterative(coarse=_COARSE[asked.method], modes=modes, rtol=rtol)


def why_without_modes(asked: program.Geodesic, solver: Solver, n: int) -> str:
    """Return why a solver that may choose on n points leaves the modes alone; "" if it does not."""
    if not (asked.solver or asked.spectrum) or not isinstance(solver, Automatic):
        return ""
    chosen, reason = solver.choose(n, solver.n_sources)
    return f"not needed by the direct solver: {reason}" if isinstance(chosen, Direct) else ""


def number_of_modes(asked: program.Geodesic, laplacian: Laplacian, *, usual: int) -> int:
    """Return how many modes the coarse space has, those of eigenvalue 0 aside."""
    return usual if asked.k is None else max(asked.k - laplacian.kernel_dimension, 1)


def coarse_spectrum(asked: program.Geodesic, laplacian: Laplacian, modes: int) -> Spectrum | None:
    """Return the modes that were asked for, with those of eigenvalue 0; None if none were."""
    if asked.spectrum:
        spectrum = Spectrum.load(asked.spectrum)
        return spectrum if asked.k is None else spectrum.truncate(min(asked.k, spectrum.k))
    if not asked.solver:
        return None
    k = min(modes + laplacian.kernel_dimension, laplacian.n)
    return solve(laplacian, k, asked.solver, asked)
