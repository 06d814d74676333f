"""Linear solvers and spectra of geodesic distances, as the command line names them."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Literal

from spectra_kit._validate import quantity
from spectra_kit.cli.geodesic_options import SPECTRA
from spectra_kit.cli.options import listed
from spectra_kit.cli.progress import step
from spectra_kit.cli.unused import refuse_given
from spectra_kit.eigensolvers import Arpack, Eigensolver, Polished, eigensolve
from spectra_kit.eigensolvers.neo import Neo
from spectra_kit.errors import InvalidInputError
from spectra_kit.geodesics import Automatic, Direct, Iterative
from spectra_kit.operators import Laplacian
from spectra_kit.spectra import Spectrum

_COARSE: dict[str, Literal["additive", "projected", "none"]] = {
    "iterative": "additive",
    "projected": "projected",
    "plain": "none",
}
_EIGENSOLVERS: dict[str, Callable[[argparse.Namespace], Eigensolver]] = {
    "exact": lambda a: Arpack(seed=a.seed),
    "neo": lambda a: Neo(weights=a.weights),
    "neo-polished": lambda a: Polished(start=Neo(weights=a.weights).subspace, seed=a.seed),
}


def linear_solver(arguments: argparse.Namespace) -> Automatic | Direct | Iterative:
    """Return the solver that ``--solver`` names."""
    rtol, modes = arguments.rtol, arguments.modes or Iterative().modes
    if arguments.solver == "auto":
        return Automatic(n_sources=arguments.farthest + 1, modes=modes, rtol=rtol)
    if arguments.solver == "direct":
        return Direct()
    return Iterative(coarse=_COARSE[arguments.solver], modes=modes, rtol=rtol)


def why_without_modes(
    arguments: argparse.Namespace, solver: Automatic | Direct | Iterative, n: int
) -> str:
    """Return why a solver that may choose on n points leaves the modes alone; "" if it does not."""
    if arguments.spectrum == "none" or not isinstance(solver, Automatic):
        return ""
    chosen, reason = solver.choose(n, solver.n_sources)
    return f"not needed by the direct solver: {reason}" if isinstance(chosen, Direct) else ""


def check_spectrum(arguments: argparse.Namespace) -> None:
    """Refuse a spectrum that is neither a name nor a file, or that the solver has no use for."""
    name, solver = arguments.spectrum, arguments.solver
    if name not in SPECTRA and not Path(name).is_file():
        raise InvalidInputError(
            f"--spectrum must be {listed(SPECTRA)} or an npz file, got {name!r}, and there is no"
            " such file"
        )
    if not name.startswith("neo") and not arguments.compare:
        refuse_given(arguments, {"weights": "small"}, "without the network; add --spectrum neo")
    if solver == "direct" and not arguments.compare:
        refuse_given(arguments, {"rtol": 1e-8}, "on a direct solver; choose another by --solver")
    if solver == "projected" and name == "none":
        raise InvalidInputError("--solver projected needs modes; choose some by --spectrum")
    if solver in ("direct", "plain") and name != "none" and not arguments.compare:
        raise InvalidInputError(
            f"--solver {solver} has no use for a spectrum, got --spectrum {name}; leave one out"
        )


def spectrum_named(
    name: str, arguments: argparse.Namespace, laplacian: Laplacian, modes: int
) -> Spectrum | None:
    """Return what a name of ``--spectrum`` stands for, with so many modes beyond the kernel."""
    if name == "none":
        return None
    if name not in _EIGENSOLVERS:
        return Spectrum.load(name)
    k = min(modes + laplacian.kernel_dimension, laplacian.n)
    with step(f"solving for {quantity(k, 'mode')}, {name}"):
        return eigensolve(laplacian, k, _EIGENSOLVERS[name](arguments))
