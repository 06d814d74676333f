"""The command that sets predicted modes beside exact ones, and what the two are called."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import spectra_kit as sk
from spectra_kit._core.validate import check_count, quantity
from spectra_kit.cli import options, solving, tables
from spectra_kit.cli.inputs import prepare
from spectra_kit.cli.output import check_output, tell
from spectra_kit.cli.progress import step

if TYPE_CHECKING:
    from spectra_kit.eigen.metrics import Comparison
    from spectra_kit.eigen.subspaces import Subspace

_DRAWN = (1, 2, 5, 10, 25)
_SMALL = 1e-3  # relative residuals up to here are exact; a solver may be asked for less


@dataclass(frozen=True, kw_only=True)
class CompareOptions(options.OnOne, options.Predictor, options.Turned, options.Resolution):
    """Set predicted modes beside exact ones: a table of errors, and a picture."""

    examples = (
        "compare bunny.obj -o errors.png",
        "compare bunny.obj --spectrum bunny.npz --solver cascade",
        f"compare {options.DEMO} --cloud 8000 --json",
    )
    keys = "input, geometry, reference, predicted, comparison, verdict, picture"

    solver: options.SolverName | None = None
    picture: options.Output | None = None
    """draw exact | predicted | difference of the chosen modes (.png, .pdf, .svg) (default: none)"""
    modes: options.Indices | None = None
    """modes to show, counted from 0 (default: a handful)"""


def compare(asked: CompareOptions) -> None:
    """Set predicted modes beside exact ones, or others, as a table and as a picture."""
    check_output(asked.picture, options.PICTURES, asked.inputs)
    check_pair(asked)
    solving.shown_modes(asked.modes, (), asked.k)
    geometry, laplacian = prepare(asked)
    pair = compared(asked, laplacian, reference_modes(asked, laplacian))
    comparison, k = pair.comparison, pair.comparison.k
    shown = solving.shown_modes(asked.modes, (*solving.SHOWN, k - 1), k)

    def draw(path: Path) -> None:
        first = max(comparison.n_zero_modes - 1, 0)  # one constant function per component is dull
        notes = [pair.line(), *pair.cautions]
        sk.show.plot_comparison(
            geometry,
            pair.reference,
            pair.predicted,
            comparison,
            path=path,
            modes=solving.shown_modes(asked.modes, [i + first for i in _DRAWN], k),
            names=pair.names,
            view=asked.view,
            page=tables.page(asked, geometry, "; ".join(notes)),
        )

    tell(
        asked,
        {"input": asked.file, "geometry": tables.geometry_record(geometry), **pair.record()},
        tables.headline(asked.file, geometry, laplacian),
        pair.table(shown),
        pair.means() + "\n\n" + pair.sides(),
        f"verdict: {pair.verdict()}",
        *pair.cautions,
        draw=draw,
    )


@dataclass(frozen=True, eq=False)
class Compared:
    """Modes to compare with, others, and what differs."""

    reference: "sk.Spectrum"
    predicted: "sk.Spectrum"
    comparison: "Comparison"

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

    def table(self, modes: Sequence[int]) -> str:
        """Eigenvalues, errors and residuals of some modes, by the first words of the names.

        Where both begin with one word, as two exact ones do, they are the first and the second.
        """
        comparison = self.comparison
        ours, theirs = map(tables.certificate_of, (self.reference, self.predicted))
        left, right = (name.split()[0].rstrip(",") for name in self.names)
        if left == right:
            left, right = "first", "second"
        rows = [
            ("", "eigenvalue", "", "", "error of", "of its", "outside", "relative", "residual"),
            ("mode", left, right, "change", "mode", "cluster", "span", left, right),
        ]
        for i in modes:
            true, guess = comparison.eigenvalues[i], comparison.predicted_eigenvalues[i]
            change = "" if i < comparison.n_zero_modes else f"{100 * (guess / true - 1):+.2g} %"
            rows.append(
                (
                    str(i) + ("*" if i >= comparison.open_from else ""),
                    f"{true:.6g}",
                    f"{guess:.6g}",
                    change,
                    f"{comparison.vector_error[i]:.1e}",
                    f"{comparison.cluster_error[i]:.1e}",
                    f"{comparison.span_error[i]:.1e}",
                    f"{ours.relative_residuals[i]:.1e}",
                    f"{theirs.relative_residuals[comparison.match[i]]:.1e}",
                )
            )
        note = "\n* its cluster of near-equal eigenvalues reaches past the last mode"
        return tables.align(rows) + (note if any(i >= comparison.open_from for i in modes) else "")

    def means(self) -> str:
        """Means of the errors over all modes."""
        one, k = self.comparison, self.comparison.k
        moved = int((one.match != np.arange(k)).sum())
        return tables.pairs(
            {
                "span error": f"{one.mean_span_error:.2e}  mean of {quantity(k, 'mode')},"
                f" span of {quantity(one.span_dimension, 'function')}",
                "eigenvalue error": f"{one.mean_eigenvalue_error:.2e}"
                f"  mean of {quantity(k - one.n_zero_modes, 'nonzero mode')}",
                "cluster error": f"{one.mean_cluster_error:.2e}"
                f"  mean of {quantity(one.open_from, 'mode')} in"
                f" {quantity(len(one.clusters), 'cluster')} of near-equal eigenvalues",
                "eigenvector error": f"{one.mean_vector_error:.2e}"
                f"  mean of {quantity(k, 'mode')} one by one, {moved} of them out of order",
            }
        )

    def sides(self) -> str:
        """Certificates and times of both sides."""
        both = (self.reference, self.predicted)
        rows = [["", *self.names], ["modes solved for", *(str(side.k) for side in both)]]
        ours, theirs = map(tables.accuracy, both)
        rows += [[fact, value, theirs[fact]] for fact, value in ours.items()]
        times = [side.provenance.seconds for side in both]
        rows.append(["seconds in all", *(f"{sum(stages.values()):.2f}" for stages in times)])
        for stage in dict.fromkeys([*times[0], *times[1]]):
            told = [stages.get(stage) for stages in times]
            if max(t or 0.0 for t in told) >= 0.005:
                rows.append([f"  {stage}", *("" if t is None else f"{t:.2f}" for t in told)])
        return tables.align(rows, left=1)

    def line(self) -> str:
        """Three means; eigenvectors as clusters, inside which any basis is as good."""
        one = self.comparison
        return (
            f"{quantity(one.k, 'mode')}: mean span error {one.mean_span_error:.2g},"
            f" eigenvalue error {100 * one.mean_eigenvalue_error:.2g} %,"
            f" cluster error {one.mean_cluster_error:.2g}"
        )

    def verdict(self) -> str:
        """Say in a line whether eigenvalues are far off, and which is the farthest."""
        from spectra_kit.eigen.accuracy import DOUBTFUL

        one, off = self.comparison, self.comparison.eigenvalue_error
        if not np.isfinite(off).any():
            return "no mode outside the kernel to compare"
        far, worst = int((off > DOUBTFUL).sum()), int(np.nanargmax(off))
        change = one.predicted_eigenvalues[worst] / one.eigenvalues[worst] - 1
        which = f"mode {worst}, by {100 * change:+,.{0 if far else 2}f} %"
        if not far:
            return f"farthest off is the eigenvalue of {which}"
        if one.match[worst] != worst:
            which += f" (it resembles mode {one.match[worst]} of the other side most)"
        return (
            f"doubtful: {far} of {quantity(one.k, 'eigenvalue')} are off by more than"
            f" {DOUBTFUL:.0%}, that of {which}"
        )

    def record(self) -> tables.Record:
        """Everything, as JSON has it."""
        one = self.comparison
        means = ("span_error", "eigenvalue_error", "vector_error", "cluster_error")
        return {
            "reference": named_record(self.names[0], self.reference),
            "predicted": named_record(self.names[1], self.predicted),
            "comparison": vars(one) | {f"mean_{m}": getattr(one, f"mean_{m}") for m in means},
            "verdict": self.verdict(),
        }


def named_record(name: str, spectrum: "sk.Spectrum") -> tables.Record:
    """Return one side of a comparison as JSON has it."""
    return {"name": name, "exact": is_exact(spectrum), **tables.spectrum_record(spectrum)}


def _predictor(asked: options.Predictor) -> str:
    """Return the solver that predicts: by default the network where weights are shipped."""
    from spectra_kit.neo.pretrained import WEIGHTS

    return asked.solver or ("neo" if WEIGHTS else "fourier")


def check_pair(asked: options.Predictor) -> None:
    """Refuse options that neither the solver of the reference nor that of the prediction takes."""
    if asked.spectrum:
        options.refuse_given(asked, ["against"], "on modes of a file; leave --spectrum out")
    names = [] if asked.spectrum else [asked.against]
    if (predictor := _predictor(asked)) != "none":
        names.append(predictor)
    solving.check_solvers(asked, *names)


def reference_modes(asked: options.Predictor, laplacian: "sk.Laplacian") -> "sk.Spectrum":
    """Solve for the modes to compare with and a few more, or read them."""
    if asked.spectrum:
        return solving.saved(asked.spectrum, laplacian)
    n_free = len(laplacian.free)
    k = check_count("-k", asked.k, low=1, high=n_free)
    return solving.solve(laplacian, min(k + solving.EXTRA, n_free), asked.against, asked)


def compared(
    asked: options.Predictor, laplacian: "sk.Laplacian", reference: "sk.Spectrum"
) -> Compared:
    """Predict the modes, and measure the errors."""
    from spectra_kit.eigen.metrics import compare_spectra, subspace_span_error

    k, predictor = min(asked.k, reference.k), _predictor(asked)
    predicted = solving.solve(
        laplacian, min(k + solving.EXTRA, len(laplacian.free)), predictor, asked
    )
    with step("comparing"):
        comparison = compare_spectra(reference, predicted, k=k)
        subspace = ritz_subspace(solving.make_solver(predictor, asked, asked.k))
        if subspace is not None:
            error, dimension = subspace_span_error(subspace, laplacian, reference, predicted)
            comparison = replace(comparison, span_error=error[:k], span_dimension=dimension)
    return Compared(reference, predicted, comparison)


def ritz_subspace(solver: "sk.eigen.Eigensolver") -> "Subspace | None":
    """Return the subspace whose Ritz vectors on all points a solver returns, if it does so.

    Modes that were smoothed are in the span of none.
    """
    if isinstance(solver, sk.Neo) and (solver.max_steps or solver.coarsest is not None):
        return None
    return solver.subspace if isinstance(solver, sk.RayleighRitz | sk.Neo) else None


def is_exact(spectrum: "sk.Spectrum") -> bool:
    """Whether a solver made it that goes on until its residuals are small, and they are."""
    return _is_solved(spectrum) and _largest_residual(spectrum) <= _SMALL


def name_of(spectrum: "sk.Spectrum") -> str:
    """Return what to call modes by themselves: exact, predicted or neither, and by what."""
    solver = spectrum.provenance.name
    if is_exact(spectrum):
        return f"exact ({solver})"
    if _is_solved(spectrum):
        return f"solved to {_largest_residual(spectrum):.0e} ({solver})"
    if spectrum.provenance.accuracy == "approximate":
        return f"predicted ({solver})"
    return f"modes ({solver or 'solver unknown'})"


def reference_name(spectrum: "sk.Spectrum") -> str:
    """Return what to call modes that others are compared with; exact only if they are."""
    name = name_of(spectrum)
    return name if is_exact(spectrum) else f"reference, {name}"


def _is_solved(spectrum: "sk.Spectrum") -> bool:
    return spectrum.provenance.accuracy in ("exact", "to tolerance")


def _largest_residual(spectrum: "sk.Spectrum") -> float:
    """Return the largest relative residual of a spectrum; infinite if it is not certified."""
    if spectrum.certificate is None:
        return float("inf")
    return float(spectrum.certificate.relative_residuals.max(initial=0.0))
