"""Spectra for the commands: solved for, or taken from a file."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from spectra_kit._validate import check_count, quantity
from spectra_kit.cli.inputs import EXTRA, assemble, load, solvers_named
from spectra_kit.cli.options import NETWORK, SOLVERS
from spectra_kit.cli.progress import say, step
from spectra_kit.cli.tables import (
    Record,
    comparison_record,
    comparison_verdict,
    spectrum_record,
)
from spectra_kit.cli.unused import refuse_given
from spectra_kit.eigensolvers import Eigensolver, RayleighRitz, eigensolve
from spectra_kit.eigensolvers.neo import Neo
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import Geometry
from spectra_kit.metrics import Comparison, compare_spectra, subspace_span_error
from spectra_kit.operators import Laplacian
from spectra_kit.spectra import Spectrum
from spectra_kit.subspaces import Subspace

# Those that stop when the residuals are small; the others stop after so much work.
EXACT = ("arpack", "multilevel", "refined", "lobpcg", "dense")
PREDICT = (*(name for name in SOLVERS if name not in EXACT), "rayleighritz")
_SMALL = 1e-3  # relative residuals up to here are exact; a solver may be asked for less
_SAME = (10.0, 1e-6)  # residuals of a saved mode may grow by this factor and this much


def prepare(arguments: argparse.Namespace) -> tuple[Geometry, Laplacian]:
    """Read the geometry and assemble its operator."""
    geometry = load(arguments)
    with step(f"assembling the Laplacian of {geometry.n:,} points"):
        laplacian = assemble(arguments, geometry)
    if laplacian.n_components > 1:
        # Corners that are not joined make a part of every face: each mode then lives on one.
        joined = geometry.n - len(np.unique(geometry.points, axis=0))
        if joined:
            say(
                f"warning: {quantity(joined, 'point')} lie exactly on earlier ones, and the surface"
                f" has {laplacian.n_components:,} parts; --repair joins such points"
            )
    return geometry, laplacian


def solve(laplacian: Laplacian, k: int, name: str, solver: Eigensolver) -> Spectrum:
    """Solve for `k` modes."""
    with step(f"solving for {quantity(k, 'mode')} by {name}"):
        return eigensolve(laplacian, k, solver)


def saved(path: Path, laplacian: Laplacian) -> Spectrum:
    """Read a spectrum, and make sure by its residuals that it is one of this operator."""
    with step(f"reading {path}"):
        spectrum = Spectrum.load(path)
        wrong = f"{path} holds modes of something else"
        hint = "give the file and the options it was made with, or leave --spectrum out"
        try:
            certified = spectrum.certify(laplacian)
        except InvalidInputError as error:
            raise InvalidInputError(f"{wrong}: {error}; {hint}") from error
        if spectrum.certificate is None:
            return certified
        factor, slack = _SAME
        now, then = certified.certificate, spectrum.certificate
        assert now is not None
        if (now.relative_residuals > factor * then.relative_residuals + slack).any():
            raise InvalidInputError(
                f"{wrong}: their relative residuals were up to"
                f" {then.relative_residuals.max():.1e} and are {now.relative_residuals.max():.1e}"
                f" by {laplacian.operator}; {hint}"
            )
        return spectrum


def shown_modes(asked: Sequence[int] | None, usual: Sequence[int], k: int) -> tuple[int, ...]:
    """The modes to show: those asked for, else the usual ones, up to k."""
    if asked is not None:
        return tuple(check_count("modes", i, low=0, high=k - 1) for i in asked)
    return tuple(sorted({i for i in usual if i < k})) or (k - 1,)


@dataclass(frozen=True, eq=False)
class Shown:
    """A geometry, its operator, modes of it, and which of them to show."""

    geometry: Geometry
    laplacian: Laplacian
    spectrum: Spectrum
    modes: tuple[int, ...]


def to_show(arguments: argparse.Namespace, usual: int) -> Shown:
    """Return modes to show: those asked for, else the first `usual` that are not constant."""
    if arguments.k is not None:
        check_count("k", arguments.k, low=1)
    for mode in arguments.modes or ():
        check_count("modes", mode, low=0)
    if arguments.spectrum:
        given = {"solver": "arpack", "rtol": None, "start": None, **NETWORK}
        refuse_given(arguments, given, "on modes of a file; leave --spectrum out")
    (solver,) = solvers_named(arguments, arguments.solver)
    geometry, laplacian = prepare(arguments)
    if arguments.spectrum:
        spectrum = saved(arguments.spectrum, laplacian)
        if arguments.k is not None:
            spectrum = spectrum.truncate(arguments.k)
    else:
        needed = max(arguments.modes) + 1 if arguments.modes else usual + laplacian.kernel_dimension
        k = min(needed, len(laplacian.free)) if arguments.k is None else arguments.k
        spectrum = solve(laplacian, max(k, 1), arguments.solver, solver)
    first = spectrum.n_zero_modes
    modes = shown_modes(arguments.modes, range(first, first + usual), spectrum.k)
    return Shown(geometry, laplacian, spectrum, modes)


def default_predictor() -> str:
    """Return the network where weights are shipped, else plane waves."""
    from spectra_kit.neo.pretrained import WEIGHTS

    return "neo" if WEIGHTS else "fourier"


@dataclass(frozen=True, eq=False)
class Compared:
    """Modes to compare with, others, what differs, and what the two are called."""

    reference: Spectrum
    predicted: Spectrum
    comparison: Comparison
    names: tuple[str, str]

    @property
    def caution(self) -> str:
        """What to keep in mind where the errors are not those against the truth; else empty."""
        if is_exact(self.reference):
            return ""
        if is_exact(self.predicted):
            return f"errors are those of the {self.names[0]}: the other side is {self.names[1]}"
        return f"errors are against the {self.names[0]}, not against exact modes"

    @property
    def verdict(self) -> str:
        """Whether eigenvalues are far off, in a line."""
        return comparison_verdict(self.comparison)

    def record(self) -> Record:
        """Everything, as JSON has it."""
        return {
            "reference": named_record(self.names[0], self.reference),
            "predicted": named_record(self.names[1], self.predicted),
            "comparison": comparison_record(self.comparison),
            "verdict": self.verdict,
        }


def alone_record(spectrum: Spectrum) -> Record:
    """Return the same of modes that are compared with none."""
    reference = named_record(name_of(spectrum), spectrum)
    return {
        "reference": reference,
        "predicted": None,
        "comparison": None,
        "verdict": reference["verdict"],
    }


def named_record(name: str, spectrum: Spectrum) -> Record:
    """Return a spectrum with its name, and whether it is exact."""
    return {"name": name, "exact": is_exact(spectrum), **spectrum_record(spectrum)}


def named_pair(arguments: argparse.Namespace) -> dict[str, Eigensolver]:
    """Return the solvers of the reference, unless it is saved, and of the prediction, if any."""
    if arguments.spectrum:
        given = {"against": "arpack"}
        refuse_given(arguments, given, "on modes of a file; leave --spectrum out")
    names = [] if arguments.spectrum else [arguments.against]
    if arguments.solver != "none":
        names.append(arguments.solver or default_predictor())
    return dict(zip(names, solvers_named(arguments, *names), strict=True))


def reference_modes(
    arguments: argparse.Namespace, laplacian: Laplacian, solvers: Mapping[str, Eigensolver]
) -> Spectrum:
    """Solve for the modes to compare with and a few more, or read them."""
    if arguments.spectrum:
        return saved(arguments.spectrum, laplacian)
    name, n_free = arguments.against, len(laplacian.free)
    check_count("k", arguments.k, low=1, high=n_free)
    return solve(laplacian, min(arguments.k + EXTRA, n_free), name, solvers[name])


def is_exact(spectrum: Spectrum) -> bool:
    """Whether a solver made it that goes on until its residuals are small, and they are."""
    return solver_of(spectrum) in EXACT and largest_residual(spectrum) <= _SMALL


def name_of(spectrum: Spectrum) -> str:
    """Return what to call modes by themselves: exact, predicted or neither, and by what."""
    solver = solver_of(spectrum)
    if is_exact(spectrum):
        return f"exact ({solver})"
    if solver in EXACT:
        return f"solved to {largest_residual(spectrum):.0e} ({solver})"
    if solver in PREDICT:
        return f"predicted ({solver})"
    return f"modes ({solver or 'solver unknown'})"


def largest_residual(spectrum: Spectrum) -> float:
    """Return the largest relative residual of a spectrum; infinite if it is not certified."""
    if spectrum.certificate is None:
        return float("inf")
    return float(spectrum.certificate.relative_residuals.max(initial=0.0))


def reference_name(spectrum: Spectrum) -> str:
    """Return what to call modes that others are compared with; exact only if they are."""
    name = name_of(spectrum)
    return name if is_exact(spectrum) else f"reference, {name}"


def solver_of(spectrum: Spectrum) -> str:
    """Return the name of the solver that made a spectrum, as ``--solver`` has it; "" if unknown."""
    made = spectrum.provenance.solver
    if made.startswith("RayleighRitz(subspace=AmbientFourier("):
        return "fourier"
    name = made.split("(")[0].lower()
    return "" if name == "user" else name


def _ritz_subspace(solver: Eigensolver) -> Subspace | None:
    """Return the subspace whose Ritz vectors on all points a solver returns, if it does so.

    `Capped` evaluates its own on a few points: what it spans on all of them was never used.
    """
    if isinstance(solver, RayleighRitz) or (isinstance(solver, Neo) and solver.cap is None):
        return solver.subspace
    return None


def compared(
    arguments: argparse.Namespace,
    laplacian: Laplacian,
    solvers: Mapping[str, Eigensolver],
    reference: Spectrum,
) -> Compared:
    """Predict the modes, and measure the errors."""
    k, predictor = min(arguments.k, reference.k), arguments.solver or default_predictor()
    wanted = min(k + EXTRA, len(laplacian.free))
    predicted = solve(laplacian, wanted, predictor, solvers[predictor])
    with step("comparing"):
        comparison = compare_spectra(reference, predicted, k=k)
        subspace = _ritz_subspace(solvers[predictor])
        if subspace is not None:
            error, dimension = subspace_span_error(subspace, laplacian, reference, predicted)
            comparison = replace(comparison, span_error=error[:k], span_dimension=dimension)
    names = reference_name(reference), name_of(predicted)
    return Compared(reference, predicted, comparison, names)
