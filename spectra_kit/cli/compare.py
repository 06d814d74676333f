"""The command that sets predicted modes beside exact ones, and what the two are called."""

from dataclasses import dataclass, replace
from pathlib import Path

from spectra_kit._core.validate import check_count
from spectra_kit.cli import tables
from spectra_kit.cli.inputs import prepare
from spectra_kit.cli.options import (
    DEMO,
    PICTURES,
    Indices,
    OnOne,
    Output,
    Predictor,
    Resolution,
    SolverName,
    Turned,
    refuse_given,
)
from spectra_kit.cli.output import check_output, tell_with_picture
from spectra_kit.cli.progress import step
from spectra_kit.cli.solving import (
    EXTRA,
    SHOWN,
    check_solvers,
    make_solver,
    saved,
    shown_modes,
    solve,
)
from spectra_kit.eigen import Eigensolver, Neo, RayleighRitz, Spectrum
from spectra_kit.eigen.metrics import Comparison, compare_spectra, subspace_span_error
from spectra_kit.eigen.subspaces import Subspace
from spectra_kit.operators import Laplacian

_DRAWN = (1, 2, 5, 10, 25)
_SMALL = 1e-3  # relative residuals up to here are exact; a solver may be asked for less


@dataclass(frozen=True, kw_only=True)
class CompareOptions(OnOne, Predictor, Turned, Resolution):
    """Set predicted modes beside exact ones: a table of errors, and a picture."""

    examples = (
        "compare bunny.obj -o errors.png",
        "compare bunny.obj --spectrum bunny.npz --solver cascade",
        f"compare {DEMO} --cloud 8000 --json",
    )
    keys = "input, geometry, reference, predicted, comparison, verdict, picture"

    solver: SolverName | None = None
    picture: Output | None = None
    """draw exact | predicted | difference of the chosen modes (.png, .pdf, .svg) (default: none)"""
    modes: Indices | None = None
    """modes to show, counted from 0 (default: a handful)"""


def compare(asked: CompareOptions) -> None:
    """Set predicted modes beside exact ones, or others, as a table and as a picture."""
    if asked.picture:
        check_output(asked.picture, PICTURES, asked.inputs)
    check_pair(asked)
    shown_modes(asked.modes, (), asked.k)
    geometry, laplacian = prepare(asked)
    pair = compared(asked, laplacian, reference_modes(asked, laplacian))
    comparison, k = pair.comparison, pair.comparison.k
    shown = shown_modes(asked.modes, (*SHOWN, k - 1), k)

    def draw(path: Path) -> None:
        from spectra_kit.show import Page, View, plot_comparison

        first = max(comparison.n_zero_modes - 1, 0)  # one constant function per component is dull
        notes = [tables.comparison_line(comparison), *pair.cautions]
        plot_comparison(
            geometry,
            pair.reference,
            pair.predicted,
            comparison,
            path=path,
            modes=shown_modes(asked.modes, [i + first for i in _DRAWN], k),
            names=pair.names,
            view=View(asked.upwards, asked.turn),
            page=Page(tables.title(asked.file, geometry), "; ".join(notes), asked.dpi),
        )

    tell_with_picture(
        asked,
        {"input": asked.file, "geometry": tables.geometry_record(geometry), **pair.record()},
        tables.headline(asked.file, geometry, laplacian),
        tables.comparison_table(pair.names, pair.reference, pair.predicted, comparison, shown),
        tables.comparison_lines(pair.names, pair.reference, pair.predicted, comparison),
        f"verdict: {pair.verdict}",
        *pair.cautions,
        picture=asked.picture,
        draw=draw,
    )


@dataclass(frozen=True, eq=False)
class Compared:
    """Modes to compare with, others, and what differs."""

    reference: Spectrum
    predicted: Spectrum
    comparison: Comparison

    @property
    def names(self) -> tuple[str, str]:
        """What to call the two."""
        return reference_name(self.reference), name_of(self.predicted)

    @property
    def cautions(self) -> list[str]:
        """What to keep in mind where the errors are not those against the truth."""
        if is_exact(self.reference):
            return []
        if is_exact(self.predicted):
            return [f"errors are those of the {self.names[0]}: the other side is {self.names[1]}"]
        return [f"errors are against the {self.names[0]}, not against exact modes"]

    @property
    def verdict(self) -> str:
        """Whether eigenvalues are far off, in a line."""
        return tables.comparison_verdict(self.comparison)

    def record(self) -> tables.Record:
        """Everything, as JSON has it."""
        return {
            "reference": named_record(self.names[0], self.reference),
            "predicted": named_record(self.names[1], self.predicted),
            "comparison": tables.comparison_record(self.comparison),
            "verdict": self.verdict,
        }


def named_record(name: str, spectrum: Spectrum) -> tables.Record:
    """Return one side of a comparison as JSON has it."""
    return {"name": name, "exact": is_exact(spectrum), **tables.spectrum_record(spectrum)}


def _predictor(asked: Predictor) -> str:
    """Return the solver that predicts: by default the network where weights are shipped."""
    from spectra_kit.neo.pretrained import WEIGHTS

    return asked.solver or ("neo" if WEIGHTS else "fourier")


def check_pair(asked: Predictor) -> None:
    """Refuse options that neither the solver of the reference nor that of the prediction takes."""
    if asked.spectrum:
        refuse_given(asked, ["against"], "on modes of a file; leave --spectrum out")
    names = [] if asked.spectrum else [asked.against]
    if (predictor := _predictor(asked)) != "none":
        names.append(predictor)
    check_solvers(asked, *names)


def reference_modes(asked: Predictor, laplacian: Laplacian) -> Spectrum:
    """Solve for the modes to compare with and a few more, or read them."""
    if asked.spectrum:
        return saved(asked.spectrum, laplacian)
    n_free = len(laplacian.free)
    k = check_count("-k", asked.k, low=1, high=n_free)
    return solve(laplacian, min(k + EXTRA, n_free), asked.against, asked)


def compared(asked: Predictor, laplacian: Laplacian, reference: Spectrum) -> Compared:
    """Predict the modes, and measure the errors."""
    k, predictor = min(asked.k, reference.k), _predictor(asked)
    predicted = solve(laplacian, min(k + EXTRA, len(laplacian.free)), predictor, asked)
    with step("comparing"):
        comparison = compare_spectra(reference, predicted, k=k)
        subspace = ritz_subspace(make_solver(predictor, asked, asked.k))
        if subspace is not None:
            error, dimension = subspace_span_error(subspace, laplacian, reference, predicted)
            comparison = replace(comparison, span_error=error[:k], span_dimension=dimension)
    return Compared(reference, predicted, comparison)


def ritz_subspace(solver: Eigensolver) -> Subspace | None:
    """Return the subspace whose Ritz vectors on all points a solver returns, if it does so.

    Modes that were smoothed are in the span of none.
    """
    if isinstance(solver, Neo) and (solver.max_steps or solver.coarsest is not None):
        return None
    return solver.subspace if isinstance(solver, RayleighRitz | Neo) else None


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


def reference_name(spectrum: Spectrum) -> str:
    """Return what to call modes that others are compared with; exact only if they are."""
    name = name_of(spectrum)
    return name if is_exact(spectrum) else f"reference, {name}"


def _is_solved(spectrum: Spectrum) -> bool:
    return spectrum.provenance.accuracy in ("exact", "to tolerance")


def _largest_residual(spectrum: Spectrum) -> float:
    """Return the largest relative residual of a spectrum; infinite if it is not certified."""
    if spectrum.certificate is None:
        return float("inf")
    return float(spectrum.certificate.relative_residuals.max(initial=0.0))
