"""Modes beside others: what is compared, what the two are called, and what differs."""

from __future__ import annotations

from dataclasses import dataclass, replace

from spectra_kit._validate import check_count
from spectra_kit.cli.options import Predictor, refuse_given
from spectra_kit.cli.progress import step
from spectra_kit.cli.solving import EXTRA, check_solvers, make_solver, saved, solve
from spectra_kit.cli.tables import (
    Record,
    comparison_record,
    comparison_verdict,
    spectrum_record,
)
from spectra_kit.eigensolvers import Eigensolver, Neo, RayleighRitz
from spectra_kit.metrics import Comparison, compare_spectra, subspace_span_error
from spectra_kit.operators import Laplacian
from spectra_kit.spectra import Spectrum
from spectra_kit.subspaces import Subspace

_SMALL = 1e-3  # relative residuals up to here are exact; a solver may be asked for less


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
            "reference": _named_record(self.names[0], self.reference),
            "predicted": _named_record(self.names[1], self.predicted),
            "comparison": comparison_record(self.comparison),
            "verdict": self.verdict,
        }


def alone_record(spectrum: Spectrum) -> Record:
    """Return the same of modes that are compared with none."""
    reference = _named_record(name_of(spectrum), spectrum)
    return {
        "reference": reference,
        "predicted": None,
        "comparison": None,
        "verdict": reference["verdict"],
    }


def _named_record(name: str, spectrum: Spectrum) -> Record:
    return {"name": name, "exact": is_exact(spectrum), **spectrum_record(spectrum)}


def predictor_of(asked: Predictor) -> str:
    """Return the solver that predicts: by default the network where weights are shipped."""
    from spectra_kit.neo.pretrained import WEIGHTS

    return asked.solver or ("neo" if WEIGHTS else "fourier")


def check_pair(asked: Predictor, seed: int) -> None:
    """Refuse options that neither the solver of the reference nor that of the prediction takes."""
    if asked.spectrum:
        refuse_given(asked, ["against"], "on modes of a file; leave --spectrum out")
    names = [] if asked.spectrum else [asked.against]
    if (predictor := predictor_of(asked)) != "none":
        names.append(predictor)
    check_solvers(asked, seed, *names)


def reference_modes(asked: Predictor, seed: int, laplacian: Laplacian) -> Spectrum:
    """Solve for the modes to compare with and a few more, or read them."""
    if asked.spectrum:
        return saved(asked.spectrum, laplacian)
    n_free = len(laplacian.free)
    k = check_count("-k", asked.k, low=1, high=n_free)
    return solve(laplacian, min(k + EXTRA, n_free), asked.against, asked, seed)


def compared(asked: Predictor, seed: int, laplacian: Laplacian, reference: Spectrum) -> Compared:
    """Predict the modes, and measure the errors."""
    k, predictor = min(asked.k, reference.k), predictor_of(asked)
    wanted = min(k + EXTRA, len(laplacian.free))
    predicted = solve(laplacian, wanted, predictor, asked, seed)
    with step("comparing"):
        comparison = compare_spectra(reference, predicted, k=k)
        subspace = ritz_subspace(make_solver(predictor, asked, asked.k, seed))
        if subspace is not None:
            error, dimension = subspace_span_error(subspace, laplacian, reference, predicted)
            comparison = replace(comparison, span_error=error[:k], span_dimension=dimension)
    return Compared(
        reference, predicted, comparison, (reference_name(reference), name_of(predicted))
    )


def ritz_subspace(solver: Eigensolver) -> Subspace | None:
    """Return the subspace whose Ritz vectors on all points a solver returns, if it does so.

    `Capped` evaluates its own on a few points: what it spans on all of them was never used.
    """
    if isinstance(solver, RayleighRitz) or (isinstance(solver, Neo) and solver.cap is None):
        return solver.subspace
    return None


def is_exact(spectrum: Spectrum) -> bool:
    """Whether a solver made it that goes on until its residuals are small, and they are."""
    return _is_solved(spectrum) and _largest_residual(spectrum) <= _SMALL


def name_of(spectrum: Spectrum) -> str:
    """Return what to call modes by themselves: exact, predicted or neither, and by what."""
    solver = spectrum.provenance.name
    if is_exact(spectrum):
        return f"exact ({solver})"
    if _is_solved(spectrum):
        return f"solved to {_largest_residual(spectrum):.0e} ({solver})"
    if spectrum.provenance.accuracy == "approximate":
        return f"predicted ({solver})"
    return f"modes ({solver or 'solver unknown'})"


def _is_solved(spectrum: Spectrum) -> bool:
    return spectrum.provenance.accuracy in ("exact", "to tolerance")


def reference_name(spectrum: Spectrum) -> str:
    """Return what to call modes that others are compared with; exact only if they are."""
    name = name_of(spectrum)
    return name if is_exact(spectrum) else f"reference, {name}"


def _largest_residual(spectrum: Spectrum) -> float:
    """Return the largest relative residual of a spectrum; infinite if it is not certified."""
    if spectrum.certificate is None:
        return float("inf")
    return float(spectrum.certificate.relative_residuals.max(initial=0.0))
