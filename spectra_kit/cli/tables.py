"""Results as text for people and as records for JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from spectra_kit._core.validate import quantity
from spectra_kit.cli.words import stem, told
from spectra_kit.eigen import Certificate, Spectrum
from spectra_kit.eigen.accuracy import DOUBTFUL, verdict
from spectra_kit.eigen.metrics import Comparison
from spectra_kit.geometry import Diagnosis, Geometry, TriangleMesh
from spectra_kit.operators import Laplacian

Record = dict[str, Any]


def kind(geometry: Geometry) -> str:
    """Return "mesh" or "cloud"."""
    return "mesh" if isinstance(geometry, TriangleMesh) else "cloud"


def headline(name: str, geometry: Geometry, laplacian: Laplacian) -> str:
    """What was solved, in two lines."""
    return f"{name}: {_size(geometry)}\n" + (
        f"{laplacian.operator}: area {laplacian.area:.6g},"
        f" {quantity(laplacian.n_components, 'component')}"
        + (f", {quantity(len(laplacian.fixed), 'fixed point')}" if len(laplacian.fixed) else "")
    )


def title(name: str, geometry: Geometry) -> str:
    """What a picture is of."""
    return f"{stem(name)}, {quantity(geometry.n, 'point')}"


def modes_table(spectrum: Spectrum, modes: Sequence[int]) -> str:
    """Number, eigenvalue and residuals of some modes."""
    certificate, errors = _certificate(spectrum), _certificate(spectrum).errors
    rows: list[tuple[str, ...]] = [("mode", "eigenvalue", "residual", "relative")]
    rows += [
        (
            str(i),
            f"{spectrum.eigenvalues[i]:.8g}",
            f"{certificate.residuals[i]:.1e}",
            f"{certificate.relative_residuals[i]:.1e}",
        )
        for i in modes
    ]
    if errors is not None:
        known = ("about", "at most")  # an estimate, a bound
        told = (f"{known[int(certificate.bounded[i])]} {errors[i]:.0e}" for i in modes)
        last = ["error", *told]
        rows = [(*row, cell) for row, cell in zip(rows, last, strict=True)]
    return align(rows)


def certificate_lines(spectrum: Spectrum) -> str:
    """The certificate and the times of one spectrum."""
    facts: Record = {"solver": spectrum.provenance.solver}
    if reason := spectrum.provenance.reason:
        facts["reason"] = reason
    facts["modes"] = spectrum.k
    facts |= _accuracy(spectrum) | {"lowest modes": _certificate(spectrum).completeness}
    if (errors := _certificate(spectrum).errors) is not None:
        bounded = int(_certificate(spectrum).bounded.sum())
        kind = f"bounds for {bounded} of {spectrum.k}, estimates for the others"
        if bounded in (0, spectrum.k):
            kind = "bounds" if bounded else "estimates"
        facts["relative errors"] = (
            f"{errors.mean():.0e} in the mean, up to {errors.max():.0e}; {kind}"
        )
    if _certificate(spectrum).excess is not None:  # residuals left doubts
        nothing = f"no eigenvalue is proved to be more than {DOUBTFUL:.0%} too high"
        facts["verdict"] = verdict(spectrum) or nothing
    return pairs(facts | {"seconds": seconds(spectrum.provenance.seconds)})


def comparison_table(
    names: tuple[str, str],
    reference: Spectrum,
    predicted: Spectrum,
    comparison: Comparison,
    modes: Sequence[int],
) -> str:
    """Eigenvalues, errors and relative residuals of some modes, by the first words of the names.

    Where both begin with one word, as two exact ones do, they are the first and the second.
    """
    ours, theirs = _certificate(reference), _certificate(predicted)
    left, right = (name.split()[0].rstrip(",") for name in names)
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
    return align(rows) + (note if any(i >= comparison.open_from for i in modes) else "")


def comparison_lines(
    names: tuple[str, str], reference: Spectrum, predicted: Spectrum, comparison: Comparison
) -> str:
    """Means over all modes, then the certificates and times of both sides."""
    k, zero = comparison.k, comparison.n_zero_modes
    moved = int((comparison.match != np.arange(k)).sum())
    means = pairs(
        {
            "span error": f"{comparison.mean_span_error:.2e}  mean of {quantity(k, 'mode')},"
            f" span of {quantity(comparison.span_dimension, 'function')}",
            "eigenvalue error": f"{comparison.mean_eigenvalue_error:.2e}"
            f"  mean of {quantity(k - zero, 'nonzero mode')}",
            "cluster error": f"{comparison.mean_cluster_error:.2e}"
            f"  mean of {quantity(comparison.open_from, 'mode')} in"
            f" {quantity(len(comparison.clusters), 'cluster')} of near-equal eigenvalues",
            "eigenvector error": f"{comparison.mean_vector_error:.2e}"
            f"  mean of {quantity(k, 'mode')} one by one, {moved} of them out of order",
        }
    )
    sides = (reference, predicted)
    times = [side.provenance.seconds for side in sides]
    rows = [["", *names], ["modes solved for", *(str(side.k) for side in sides)]]
    ours, theirs = map(_accuracy, sides)
    rows += [[fact, value, theirs[fact]] for fact, value in ours.items()]
    rows.append(["seconds in all", *(f"{sum(stages.values()):.2f}" for stages in times)])
    for stage in dict.fromkeys([*times[0], *times[1]]):
        told = [stages.get(stage) for stages in times]
        if max(t or 0.0 for t in told) >= 0.005:
            rows.append([f"  {stage}", *("" if t is None else f"{t:.2f}" for t in told)])
    return means + "\n\n" + align(rows, left=1)


def comparison_line(comparison: Comparison) -> str:
    """Three means in one line; eigenvectors as clusters, inside which any basis is as good."""
    return (
        f"{quantity(comparison.k, 'mode')}: mean span error {comparison.mean_span_error:.2g},"
        f" eigenvalue error {100 * comparison.mean_eigenvalue_error:.2g} %,"
        f" cluster error {comparison.mean_cluster_error:.2g}"
    )


def comparison_verdict(comparison: Comparison) -> str:
    """Say in a line whether eigenvalues are far off, and which is the farthest."""
    off = comparison.eigenvalue_error
    if not np.isfinite(off).any():
        return "no mode outside the kernel to compare"
    far, worst = int((off > DOUBTFUL).sum()), int(np.nanargmax(off))
    change = comparison.predicted_eigenvalues[worst] / comparison.eigenvalues[worst] - 1
    which = f"mode {worst}, by {100 * change:+,.{0 if far else 2}f} %"
    if not far:
        return f"farthest off is the eigenvalue of {which}"
    if comparison.match[worst] != worst:
        which += f" (it resembles mode {comparison.match[worst]} of the other side most)"
    return (
        f"doubtful: {far} of {quantity(comparison.k, 'eigenvalue')} are off by more than"
        f" {DOUBTFUL:.0%}, that of {which}"
    )


def diagnosis_lines(name: str, geometry: Geometry, diagnosis: Diagnosis) -> str:
    """What a file holds, and the problems that were found."""
    lower, upper = np.array(diagnosis.lower), np.array(diagnosis.upper)
    facts: Record = {"bounding box": " x ".join(f"{side:.6g}" for side in upper - lower)}
    if isinstance(geometry, TriangleMesh):
        facts |= {
            "area": f"{diagnosis.area:.6g}",
            "components": diagnosis.n_components,
            "Euler characteristic": diagnosis.euler_characteristic,
            "boundary edges": f"{diagnosis.boundary_edges:,}",
        }
    problems = "\n".join(f"  {told(text)}" for text in diagnosis.problems) or "  none"
    return f"{name}: {_size(geometry)}\n\n{pairs(facts)}\n\nproblems\n{problems}"


def operator_record(laplacian: Laplacian) -> Record:
    """What an operator makes of a geometry."""
    return {
        "operator": laplacian.operator,
        "operator area": float(laplacian.area),
        "operator components": laplacian.n_components,
        "zero modes": laplacian.kernel_dimension,
        "fixed points": len(laplacian.fixed),
        "eigenvalue spacing": float(laplacian.eigenvalue_spacing),
        "seconds": float(laplacian.seconds),
    }


def geometry_record(geometry: Geometry) -> Record:
    """Kind and size."""
    faces = {"faces": len(geometry.faces)} if isinstance(geometry, TriangleMesh) else {}
    return {"kind": kind(geometry), "points": geometry.n} | faces


def spectrum_record(spectrum: Spectrum) -> Record:
    """Everything but the eigenvectors and the mass."""
    certificate, provenance = _certificate(spectrum), spectrum.provenance
    return {
        "eigenvalues": spectrum.eigenvalues,
        "certificate": vars(certificate)
        | {"level": certificate.level, "count": certificate.count and vars(certificate.count)},
        "provenance": vars(provenance) | {"seconds": dict(provenance.seconds)},
        "verdict": verdict(spectrum),
    }


def comparison_record(comparison: Comparison) -> Record:
    """All errors, and their means."""
    means = ("span_error", "eigenvalue_error", "vector_error", "cluster_error")
    return vars(comparison) | {f"mean_{m}": getattr(comparison, f"mean_{m}") for m in means}


def pairs(facts: Mapping[str, object]) -> str:
    """Lines of name and value, values aligned."""
    width = max(len(name) for name in facts)
    return "\n".join(
        f"{name:{width}}  {f'{value:.6g}' if isinstance(value, float) else value}"
        for name, value in facts.items()
    )


def align(rows: Sequence[Sequence[str]], *, left: int = 0) -> str:
    """Return right-aligned columns, the first `left` of them left-aligned."""
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if i < left else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    )


def _size(geometry: Geometry) -> str:
    if isinstance(geometry, TriangleMesh):
        return f"mesh, {quantity(geometry.n, 'vertex')}, {quantity(len(geometry.faces), 'face')}"
    return f"cloud, {quantity(geometry.n, 'point')}"


def _certificate(spectrum: Spectrum) -> Certificate:
    assert spectrum.certificate is not None  # who solves or reads one certifies it
    return spectrum.certificate


def _accuracy(spectrum: Spectrum) -> dict[str, str]:
    certificate = _certificate(spectrum)
    expected = min(certificate.kernel_dimension, spectrum.k)
    return {
        "largest relative residual": f"{certificate.relative_residuals.max():.1e}",
        "orthonormality error": f"{certificate.orthonormality_error:.1e}",
        "zero modes": f"{certificate.n_zero_modes} of {expected}",
    }


def seconds(stages: Mapping[str, float]) -> str:
    """Return the sum, and what is worth telling of its parts."""
    listed = ", ".join(f"{name} {t:.2f}" for name, t in stages.items() if t >= 0.005)
    return f"{sum(stages.values()):.2f}" + (f"  ({listed})" if listed else "")
