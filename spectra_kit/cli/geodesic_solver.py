"""Linear solvers of geodesic distances, and the modes of their coarse space."""

from __future__ import annotations

from spectra_kit._validate import check_count
from spectra_kit.cli import program
from spectra_kit.cli.options import NETWORK, CoarseSolver, refuse_given
from spectra_kit.cli.solving import check_solvers, refuse_solving, solve
from spectra_kit.errors import InvalidInputError
from spectra_kit.geodesics import Automatic, Direct, Iterative
from spectra_kit.operators import Laplacian
from spectra_kit.spectra import Spectrum


def check_solver(asked: program.Geodesic) -> None:
    """Refuse options of solvers that are not used, and solvers that lack what they need."""
    method, coarse, comparing = asked.heat.method, asked.solver, asked.output.compare
    named = f"--spectrum {coarse.spectrum}" if coarse.spectrum else f"--solver {coarse.solver}"
    with_modes = bool(coarse.spectrum or coarse.solver)
    if coarse.k is not None:
        check_count("-k", coarse.k, low=1)
    if coarse.spectrum:
        refuse_solving(coarse)
    elif coarse.solver:
        check_solvers(coarse, asked.reading.seed, coarse.solver)
    elif not comparing:
        why = "without modes; choose what solves for them by --solver"
        refuse_given(coarse, ("k", "rtol", "start", *NETWORK), why)
    if method == "direct" and not comparing:
        refuse_given(asked.heat, ["poisson_rtol"], "on a direct solver; choose another by --method")
    if method == "projected" and not with_modes:
        raise InvalidInputError(
            "--method projected needs modes; choose what solves for them by --solver"
        )
    if method in ("direct", "plain") and with_modes and not comparing:
        raise InvalidInputError(
            f"--method {method} has no use for modes, got {named}; leave one out"
        )


def linear_solver(
    asked: program.Geodesic, n_sources: int, modes: int
) -> Automatic | Direct | Iterative:
    """Return the solver that ``--method`` names, with so many modes at most."""
    rtol = asked.heat.poisson_rtol
    match asked.heat.method:
        case "auto":
            return Automatic(n_sources=n_sources, modes=modes, rtol=rtol)
        case "direct":
            return Direct()
        case "iterative":
            return Iterative(coarse="additive", modes=modes, rtol=rtol)
        case "projected":
            return Iterative(coarse="projected", modes=modes, rtol=rtol)
        case "plain":
            return Iterative(coarse="none", modes=modes, rtol=rtol)


def why_without_modes(asked: CoarseSolver, solver: Automatic | Direct | Iterative, n: int) -> str:
    """Return why a solver that may choose on n points leaves the modes alone; "" if it does not."""
    if not (asked.solver or asked.spectrum) or not isinstance(solver, Automatic):
        return ""
    chosen, reason = solver.choose(n, solver.n_sources)
    return f"not needed by the direct solver: {reason}" if isinstance(chosen, Direct) else ""


def number_of_modes(asked: CoarseSolver, laplacian: Laplacian, *, usual: int) -> int:
    """Return how many modes the coarse space has, those of eigenvalue 0 aside."""
    return usual if asked.k is None else max(asked.k - laplacian.kernel_dimension, 1)


def coarse_spectrum(asked: program.Geodesic, laplacian: Laplacian, modes: int) -> Spectrum | None:
    """Return the modes that were asked for, with those of eigenvalue 0; None if none were."""
    coarse = asked.solver
    if coarse.spectrum:
        spectrum = Spectrum.load(coarse.spectrum)
        return spectrum if coarse.k is None else spectrum.truncate(min(coarse.k, spectrum.k))
    if not coarse.solver:
        return None
    k = min(modes + laplacian.kernel_dimension, laplacian.n)
    return solve(laplacian, k, coarse.solver, coarse, asked.reading.seed)
