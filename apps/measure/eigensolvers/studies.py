"""What is solved, and what is measured of each method on it."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from measure.eigensolvers.methods import Contender
from measure.shapes import read_operator, shape_at, write_operator
from measure.store import Record
from measure.study import Result, Study
from measure.worker import clocked
from spectra_kit._validate import check_count
from spectra_kit.catalogue import OPERATORS, SOLVERS
from spectra_kit.eigensolvers import eigensolve
from spectra_kit.geometry import creature, sample, sphere
from spectra_kit.metrics import compare_spectra
from spectra_kit.operators import Laplacian
from spectra_kit.spectra import Spectrum

#: Geometries, and the operator of each.
KINDS = {"mesh": "robust", "cloud": "delaunay"}

_LARGE = 10_000  # points; a sphere of five subdivisions has 10,242


@dataclass(frozen=True)
class Problem:
    """One eigenproblem, by its recipe, scaled to unit area."""

    kind: str  #: A cloud is drawn uniformly from the surface of the mesh.
    points: int  #: To ask for; the demo animal meets it within 1 per cent. 0 for a file's own mesh.
    file: str = ""  #: A mesh; the demo animal without one.

    def __str__(self) -> str:
        return f"{self.kind}, {self.points:,} points" if self.points else self.kind

    @cached_property
    def facts(self) -> dict[str, object]:
        """All that decides the eigenproblem, as JSON."""
        model = "creature"
        if self.file:
            model = hashlib.blake2b(Path(self.file).read_bytes(), digest_size=12).hexdigest()
        return {
            "geometry": self.kind,
            "points": self.points,
            "model": model,
            "operator": KINDS[self.kind],
        }

    def assemble(self) -> Laplacian:
        """Assemble the operator and scale it to unit area; its `seconds` are of assembly alone."""
        mesh = shape_at(Path(self.file)).mesh if self.file else creature(self.points, seed=0)
        geometry = mesh if self.kind == "mesh" else sample(mesh, self.points, seed=0)
        start = time.perf_counter()
        assembled = OPERATORS[KINDS[self.kind]](geometry)
        seconds = time.perf_counter() - start
        return Laplacian(
            assembled.stiffness,  # of a surface: the same at every scale
            assembled.mass / assembled.area,
            assembled.points / np.sqrt(assembled.area),
            operator=assembled.operator,
            seconds=seconds,
        )


def problems(sizes: Iterable[int], kinds: Iterable[str] = KINDS, file: str = "") -> list[Problem]:
    """Return problems, smallest first within each kind; a file's own mesh has one size."""
    sizes = sorted({check_count("sizes", size, low=500) for size in sizes})
    return [
        Problem(kind, points, file)
        for kind in kinds
        for points in ((0,) if file and kind == "mesh" else sizes)
    ]


OPERATOR, EXACT = "operator", "exact modes"


@dataclass(frozen=True, eq=False, kw_only=True)
class Preparation(Study[str, Problem]):
    """The operator of every problem, and its modes to machine precision."""

    name = "problem"
    fresh = False
    contenders: Sequence[str] = (OPERATOR, EXACT)
    k: int  #: Modes.

    def facts(self, contender: str, problem: Problem) -> dict[str, object]:
        """See `Study`."""
        return {**problem.facts, "k": self.k if contender == EXACT else None}

    def excuse(
        self, contender: str, problem: Problem, before: Sequence[Result[str, Problem]]
    ) -> str:
        """See `Study`."""
        lost = contender == EXACT and not self.has(OPERATOR, problem)
        return "there is no operator" if lost else ""

    def measure(self, contender: str, problem: Problem) -> Record:
        """See `Study`."""
        path = self.file(contender, problem, ".npz")
        files = {"files": [f"files/{path.name}"]}
        if contender == EXACT:
            laplacian = read_operator(self.file(OPERATOR, problem, ".npz"))
            with clocked():
                spectrum = eigensolve(laplacian, self.k, SOLVERS["arpack"](tol=0.0))
            spectrum.save(path)
            return files
        ball = sphere(subdivisions=3).geometry  # so that no loading or compiling is measured
        OPERATORS[KINDS[problem.kind]](ball if problem.kind == "mesh" else ball.as_cloud())
        laplacian = problem.assemble()
        write_operator(laplacian, path)
        return {"n": laplacian.n, "assembly_seconds": laplacian.seconds, **files}

    def has(self, contender: str, problem: Problem) -> bool:
        """Whether the operator, or the exact modes, of a problem are there."""
        return self.file(contender, problem, ".npz").exists()


Solved = Result[Contender, Problem]


@dataclass(frozen=True, eq=False, kw_only=True)
class Solves(Study[Contender, Problem]):
    """Every method on every problem, each time in a process of its own that is warm."""

    name = "solve"
    prepared: Preparation  #: Of the same problems.
    threads: int = 1  #: The same for every method.
    machine: str = ""  #: Whose seconds they are.

    def facts(self, contender: Contender, problem: Problem) -> dict[str, object]:
        """See `Study`."""
        return {
            **problem.facts,
            "k": self.prepared.k,
            "compared": self.prepared.has(EXACT, problem),
            "solver": contender.solver,
            "device": contender.device,
            "threads": self.threads,
            "machine": self.machine,
        }

    def excuse(self, contender: Contender, problem: Problem, before: Sequence[Solved]) -> str:
        """Leave out what is not there, what has failed here, and what was too slow before."""
        if not contender.method.present:
            return f"not installed: pip install {contender.method.needs}"
        if not self.prepared.has(OPERATOR, problem):
            return "there is no operator"
        for result in before:
            status = result.record["status"]
            if result.contender != contender or result.problem.kind != problem.kind:
                continue
            if result.problem == problem and not result.ok:
                return result.reason
            if status == "stopped":
                return f"stopped at {result.problem.points:,} points: {result.reason}"
        return ""

    def measure(self, contender: Contender, problem: Problem) -> Record:
        """See `Study`."""
        k, device = self.prepared.k, contender.device
        solver = contender.method.make(device)
        laplacian = read_operator(self.prepared.file(OPERATOR, problem, ".npz"))
        # So that no compiling, loading of weights or starting of a device is measured. Large
        # enough that no solver takes a shortcut that it will not take afterwards.
        ball = sphere(subdivisions=4 if laplacian.n < _LARGE else 5).geometry
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
            **self._errors(problem, spectrum),
        }

    def _errors(self, problem: Problem, spectrum: Spectrum) -> Record:
        if not self.prepared.has(EXACT, problem):
            return {}
        exact = Spectrum.load(self.prepared.file(EXACT, problem, ".npz"), mmap=True)
        comparison = compare_spectra(exact, spectrum)
        return {
            "eigenvalue_error": comparison.mean_eigenvalue_error,
            "span_error": comparison.mean_span_error,
            # More than half of its energy is outside all that was found.
            "missed": int((comparison.span_error > 0.5).sum()),
        }
