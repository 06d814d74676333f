"""Results as text for people and as records for JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

import spectra_kit as sk
from spectra_kit._core.validate import quantity
from spectra_kit.cli.words import stem, told

if TYPE_CHECKING:
    from spectra_kit.geometry import Diagnosis, Geometry

Record = dict[str, Any]


def kind(geometry: Geometry) -> str:
    """Return "mesh" or "cloud"."""
    return "mesh" if isinstance(geometry, sk.TriangleMesh) else "cloud"


def headline(name: str, geometry: Geometry, laplacian: sk.Laplacian) -> str:
    """What was solved, in two lines."""
    return f"{size(name, geometry)}\n" + (
        f"{laplacian.operator}: area {laplacian.area:.6g},"
        f" {quantity(laplacian.n_components, 'component')}"
        + (f", {quantity(len(laplacian.fixed), 'fixed point')}" if len(laplacian.fixed) else "")
    )


def size(name: str, geometry: Geometry) -> str:
    """What it is and how large, in a line."""
    return f"{name}: {_size(geometry)}"


def page(asked: Any, geometry: Geometry, subtitle: str = "") -> sk.show.Page:
    """Return the page of a picture of one geometry: what it is of, and how fine."""
    title = f"{stem(asked.file)}, {quantity(geometry.n, 'point')}"
    return sk.show.Page(title, subtitle, asked.dpi)


def modes_table(spectrum: sk.Spectrum, modes: Sequence[int]) -> str:
    """Number, eigenvalue and residuals of some modes."""
    certificate, errors = certificate_of(spectrum), certificate_of(spectrum).errors
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


def certificate_lines(spectrum: sk.Spectrum) -> str:
    """The certificate and the times of one spectrum."""
    from spectra_kit.eigen.accuracy import DOUBTFUL, verdict

    facts: Record = {"solver": spectrum.provenance.solver}
    if reason := spectrum.provenance.reason:
        facts["reason"] = reason
    facts["modes"] = spectrum.k
    facts |= accuracy(spectrum) | {"lowest modes": certificate_of(spectrum).completeness}
    if (errors := certificate_of(spectrum).errors) is not None:
        bounded = int(certificate_of(spectrum).bounded.sum())
        kind = f"bounds for {bounded} of {spectrum.k}, estimates for the others"
        if bounded in (0, spectrum.k):
            kind = "bounds" if bounded else "estimates"
        facts["relative errors"] = (
            f"{errors.mean():.0e} in the mean, up to {errors.max():.0e}; {kind}"
        )
    if certificate_of(spectrum).excess is not None:  # residuals left doubts
        nothing = f"no eigenvalue is proved to be more than {DOUBTFUL:.0%} too high"
        facts["verdict"] = verdict(spectrum) or nothing
    return pairs(facts | {"seconds": seconds(spectrum.provenance.seconds)})


def diagnosis_lines(name: str, geometry: Geometry, diagnosis: Diagnosis) -> str:
    """What a file holds, and the problems that were found."""
    lower, upper = np.array(diagnosis.lower), np.array(diagnosis.upper)
    facts: Record = {"bounding box": " x ".join(f"{side:.6g}" for side in upper - lower)}
    if isinstance(geometry, sk.TriangleMesh):
        facts |= {
            "area": f"{diagnosis.area:.6g}",
            "components": diagnosis.n_components,
            "Euler characteristic": diagnosis.euler_characteristic,
            "boundary edges": f"{diagnosis.boundary_edges:,}",
        }
    problems = "\n".join(f"  {told(text)}" for text in diagnosis.problems) or "  none"
    return f"{name}: {_size(geometry)}\n\n{pairs(facts)}\n\nproblems\n{problems}"


def operator_record(laplacian: sk.Laplacian) -> Record:
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
    faces = {"faces": len(geometry.faces)} if isinstance(geometry, sk.TriangleMesh) else {}
    return {"kind": kind(geometry), "points": geometry.n} | faces


def spectrum_record(spectrum: sk.Spectrum) -> Record:
    """Everything but the eigenvectors and the mass."""
    from spectra_kit.eigen.accuracy import verdict

    certificate, provenance = certificate_of(spectrum), spectrum.provenance
    return {
        "eigenvalues": spectrum.eigenvalues,
        "certificate": vars(certificate)
        | {"level": certificate.level, "count": certificate.count and vars(certificate.count)},
        "provenance": vars(provenance) | {"seconds": dict(provenance.seconds)},
        "verdict": verdict(spectrum),
    }


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
    if isinstance(geometry, sk.TriangleMesh):
        return f"mesh, {quantity(geometry.n, 'vertex')}, {quantity(len(geometry.faces), 'face')}"
    return f"cloud, {quantity(geometry.n, 'point')}"


def certificate_of(spectrum: sk.Spectrum) -> sk.eigen.Certificate:
    """Return what is known of the errors."""
    assert spectrum.certificate is not None  # who solves or reads one certifies it
    return spectrum.certificate


def accuracy(spectrum: sk.Spectrum) -> dict[str, str]:
    """Residuals, and what was proved, by what the tables call them."""
    certificate = certificate_of(spectrum)
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
