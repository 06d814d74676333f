"""What is solved, and what is measured of each method on it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from spectra_kit._core.files import atomic_path
from spectra_kit._core.fingerprint import shape_digest
from spectra_kit._core.validate import check_count
from spectra_kit.catalogue import OPERATORS, SOLVERS
from spectra_kit.eigen import Spectrum, eigensolve
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import sphere
from spectra_kit.operators import Laplacian
from studies.eigensolvers.methods import Contender
from studies.recipes import Recipe
from studies.shapes import read_operator, write_operator
from studies.store import Record
from studies.study import Result, Study
from studies.worker import clocked

#: Geometries, and the operator of each.
KINDS = {"mesh": "robust", "cloud": "delaunay"}

#: An estimate of an error is a good one within this factor.
FACTOR = 3.0
#: Relative errors above are the method's: what it is compared to is off by 1e-13 or so.
SEEN = 1e-11

_LARGE = 10_000, 20_000  # points; spheres of five and six subdivisions have 10,242 and 40,962


def clouds_of(
    sources: Sequence[str], sizes: Sequence[int], most: Sequence[int] = ()
) -> list[Recipe]:
    """Return clouds of every source at every size, or of the first so many sources at each.

    The only trait of a cloud is its size, by which they are summarised.
    """
    if most and len(most) != len(sizes):
        raise InvalidInputError("most", f"hold a number for each of {len(sizes)} sizes", len(most))
    for size in sizes:
        check_count("sizes", size, low=500)
    counts = most or [len(sources)] * len(sizes)
    return [
        Recipe(
            name=f"{Path(source).name}, {points:,} points",
            sources=(source,),
            steps=(("sample", points),),
            traits=(f"{points:,} points",),
        )
        for points, count in zip(sizes, counts, strict=True)
        for source in sources[:count]
    ]


def assemble(recipe: Recipe) -> tuple[Laplacian, str]:
    """Assemble the operator at unit area, its `seconds` of that alone; and hash the geometry."""
    geometry = recipe.make()
    start = time.perf_counter()
    assembled = OPERATORS[KINDS[recipe.kind]](geometry)
    seconds = time.perf_counter() - start
    laplacian = Laplacian(
        assembled.stiffness,  # of a surface: the same at every scale
        assembled.mass / assembled.area,
        assembled.points / np.sqrt(assembled.area),
        operator=assembled.operator,
        seconds=seconds,
    )
    return laplacian, shape_digest(geometry)


OPERATOR, EXACT = "operator", "exact eigenvalues"


@dataclass(frozen=True, eq=False, kw_only=True)
class Preparation(Study[str, Recipe]):
    """The operator of every problem, and its eigenvalues to machine precision, once for all."""

    name = "problem"
    # Nothing else decides them, and at 500,000 points they take minutes.
    sources = ("geometry/**/*.py", "operators/**/*.py", "eigen/lanczos.py")
    fresh = False
    contenders: Sequence[str] = (OPERATOR, EXACT)
    k: int  #: Modes.

    def facts(self, contender: str, problem: Recipe) -> dict[str, object]:
        k = self.k if contender == EXACT else None
        return {**problem.facts, "operator": KINDS[problem.kind], "k": k}

    def excuse(self, contender: str, problem: Recipe, before: Sequence[Result[str, Recipe]]) -> str:
        if contender == EXACT and not self.has(OPERATOR, problem):
            return "there is no operator"
        return problem.missing

    def measure(self, contender: str, problem: Recipe) -> Record:
        path = self.file(contender, problem, ".npz")
        files = {"files": [f"files/{path.name}"]}
        if contender == EXACT:
            laplacian = read_operator(self.file(OPERATOR, problem, ".npz"))
            with clocked():
                spectrum = eigensolve(laplacian, self.k, SOLVERS["automatic"](memory=1e3))
            with atomic_path(path) as part:
                np.savez(part, eigenvalues=spectrum.eigenvalues)
            return files
        ball = sphere(subdivisions=3).geometry  # so that no loading or compiling is measured
        OPERATORS[KINDS[problem.kind]](ball if problem.kind == "mesh" else ball.as_cloud())
        laplacian, digest = assemble(problem)
        write_operator(laplacian, path)
        facts = {"n": laplacian.n, "digest": digest, "assembly_seconds": laplacian.seconds}
        return {**facts, **files}

    def has(self, contender: str, problem: Recipe) -> bool:
        """Whether the operator, or the exact eigenvalues, of a problem are there."""
        return self.file(contender, problem, ".npz").exists()


Solved = Result[Contender, Recipe]


@dataclass(frozen=True, eq=False, kw_only=True)
class Solves(Study[Contender, Recipe]):
    """Every method on every problem, each time in a process of its own that is warm."""

    name = "solve"
    version = 3
    prepared: Preparation  #: Of the same problems.
    threads: int = 1  #: The same for every method.
    machine: str = ""  #: Whose seconds they are.

    def facts(self, contender: Contender, problem: Recipe) -> dict[str, object]:
        return {
            **self.prepared.facts(EXACT, problem),
            "compared": self.prepared.has(EXACT, problem),
            "solver": contender.solver,
            "device": contender.device,
            "threads": self.threads,
            "machine": self.machine,
        }

    def excuse(self, contender: Contender, problem: Recipe, before: Sequence[Solved]) -> str:
        """Leave out what is not there, and what has failed here."""
        if not contender.method.present:
            return f"not installed: pip install {contender.method.needs}"
        if not self.prepared.has(OPERATOR, problem):
            return problem.missing or "there is no operator"
        for result in before:
            if result.contender != contender or result.ok:
                continue
            if result.problem == problem:  # elsewhere each is tried: a larger one may be easier
                return result.reason
        return ""

    def measure(self, contender: Contender, problem: Recipe) -> Record:
        k, device = self.prepared.k, contender.device
        solver = contender.method.make(device)
        laplacian = read_operator(self.prepared.file(OPERATOR, problem, ".npz"))
        # So that no compiling, loading of weights or starting of a device is measured. Large
        # enough that no solver takes a shortcut that it will not take afterwards, and that who
        # chooses chooses the same.
        ball = sphere(subdivisions=4 + sum(laplacian.n >= size for size in _LARGE)).geometry
        eigensolve(OPERATORS["robust"](ball), min(k, 16), solver)
        # Kept with the operator by its first user, and any of them may be the first.
        _ = laplacian.kernel_dimension, laplacian.component_spacings
        with clocked(device=device) as clock:
            spectrum = eigensolve(laplacian, k, solver)
        certificate = spectrum.certificate
        assert certificate is not None
        residuals = certificate.relative_residuals
        return {
            "n": laplacian.n,
            "solver": contender.solver,
            "assembly_seconds": laplacian.seconds,
            "seconds": spectrum.provenance.solving_seconds,
            "stages": dict(spectrum.provenance.seconds),
            "waiting": clock.waited_seconds / clock.seconds,
            "iterations": spectrum.provenance.iterations,
            "peak_bytes": clock.peak_bytes,
            "device_peak_bytes": clock.device_peak_bytes,
            "residual_max": float(residuals.max()),
            "residual_median": float(np.median(residuals)),
            **self._errors(problem, spectrum, laplacian.kernel_dimension),
        }

    def _errors(self, problem: Recipe, spectrum: Spectrum, kernel: int) -> Record:
        """Compare eigenvalues by their place: one that is missed shifts, and tells, all above.

        Where there are estimates, the shares of those that are not within `FACTOR` of the true
        errors, and of those that are too low by more, among modes whose errors are above `SEEN`.
        """
        certificate = spectrum.certificate
        assert certificate is not None
        if kernel >= self.prepared.k or not self.prepared.has(EXACT, problem):
            return {}
        with np.load(self.prepared.file(EXACT, problem, ".npz")) as file:
            exact = file["eigenvalues"][kernel:]
        errors = np.abs(spectrum.eigenvalues[kernel:] - exact) / exact
        record: Record = {
            "eigenvalue_error": float(errors.mean()),
            "eigenvalue_error_max": float(errors.max()),
        }
        if certificate.errors is not None and (seen := errors > SEEN).any():
            ratio = certificate.errors[kernel:][seen] / errors[seen]
            low = ratio < 1 / FACTOR
            record |= {
                "estimated": int(seen.sum()),
                "apart": float((low | (ratio > FACTOR)).mean()),
                "low": float(low.mean()),
            }
        return record
