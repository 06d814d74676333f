"""The process that measures one method on one problem, and may be stopped or killed alone.

Started as ``python -m spectra_kit.benchmarks.worker``: one JSON request a line on stdin, one
JSON answer a line on stdout. Whatever libraries print goes to stderr.
"""

from __future__ import annotations

import gc
import json
import os
import resource
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from spectra_kit.benchmarks.methods import METHODS
from spectra_kit.benchmarks.problems import OPERATORS, Problem, read_operator, write_operator
from spectra_kit.eigensolvers import Arpack, Eigensolver, eigensolve
from spectra_kit.errors import ConvergenceError, SpectraKitError
from spectra_kit.geometry import sphere
from spectra_kit.metrics import compare_spectra
from spectra_kit.operators import Laplacian, robust_laplacian
from spectra_kit.spectra import Spectrum

Answer = dict[str, Any]

_LARGE = 10_000  # points; a sphere of five subdivisions has 10,242
# What libraries raise when a problem is too large or too hard for them; torch and SuperLU raise
# RuntimeError where memory ends, ARPACK's and LAPACK's errors are RuntimeError and ValueError.
_FAILURES = (SpectraKitError, RuntimeError, ValueError, MemoryError)


def assemble(recipe: Answer, operator: str) -> Answer:
    """Assemble the operator of a problem into its file, if it is not there."""
    if not Path(operator).exists():
        problem = Problem(**recipe)
        # So that no loading or compiling is measured.
        ball = sphere(subdivisions=3).geometry
        OPERATORS[problem.operator](ball if problem.kind == "mesh" else ball.as_cloud())
        write_operator(problem.assemble(), Path(operator))
    laplacian = read_operator(Path(operator))
    return {
        "status": "ok",
        "n": laplacian.n,
        "entries": int(laplacian.stiffness.nnz),
        "components": laplacian.n_components,
        "assembly_seconds": laplacian.seconds,
    }


def refer(operator: str, exact: str, k: int) -> Answer:
    """Solve to machine precision into a file, if it is not there."""
    if not Path(exact).exists():
        eigensolve(read_operator(Path(operator)), k, Arpack(tol=0.0)).save(exact)
    return {"status": "ok"}


class Runner:
    """A method that is warm, on an operator that is loaded."""

    def __init__(self, method: str, device: str, operator: str, exact: str, k: int) -> None:
        self.solver: Eigensolver = METHODS[method].make(device)
        self.device, self.exact, self.k = device, exact, k
        self.laplacian: Laplacian = read_operator(Path(operator))
        self.spectrum: Spectrum | None = None
        # So that no compiling, loading of weights or starting of a device is measured. Large
        # enough that no solver takes a shortcut that it will not take afterwards.
        ball = sphere(subdivisions=4 if self.laplacian.n < _LARGE else 5).geometry
        eigensolve(robust_laplacian(ball), min(k, 16), self.solver)
        # Kept with the operator by its first user, and any of them may be the first.
        _ = self.laplacian.kernel_dimension, self.laplacian.component_spacings

    def solve(self, keep: bool) -> Answer:
        """Solve once; keep the modes for `compare` if they will be compared."""
        gc.collect()
        before = _reset_peak(self.device)
        start, waited = time.perf_counter(), _waited()
        try:
            spectrum = eigensolve(self.laplacian, self.k, self.solver)
        except ConvergenceError as error:
            return _failure(f"{error.n_converged} of {self.k} modes converged: {error}", start)
        except _FAILURES as error:
            return _failure(f"{type(error).__name__}: {error}", start)
        wall, waited = time.perf_counter() - start, _waited() - waited
        memory, device_memory = _peak(self.device)
        certificate = spectrum.certificate
        assert certificate is not None
        residuals = certificate.relative_residuals
        self.spectrum = spectrum if keep else None
        return {
            "status": "ok",
            "seconds": spectrum.provenance.solving_seconds,
            "wall_seconds": wall,
            "waited_seconds": waited,
            "stages": dict(spectrum.provenance.seconds),
            "iterations": spectrum.provenance.iterations,
            "peak_bytes": max(memory - before, 0),
            "device_peak_bytes": device_memory,
            "residual_max": float(residuals.max()),
            "residual_median": float(np.median(residuals)),
        }

    def compare(self) -> Answer:
        """Measure what was solved and kept against the exact modes, and drop it."""
        assert self.spectrum is not None
        comparison = compare_spectra(Spectrum.load(self.exact, mmap=True), self.spectrum)
        self.spectrum = None
        return {
            "status": "ok",
            "eigenvalue_error": _number(comparison.mean_eigenvalue_error),
            "span_error": _number(comparison.mean_span_error),
            # More than half of its energy is outside all that was found.
            "missed": int((comparison.span_error > 0.5).sum()),
        }


def _failure(reason: str, start: float) -> Answer:
    seconds = time.perf_counter() - start
    return {"status": "failed", "reason": reason, "wall_seconds": seconds}


def _number(value: float) -> float | None:
    return None if np.isnan(value) else float(value)


def _reset_peak(device: str) -> int:
    """Forget the peak of memory so far and return what is resident now, in bytes."""
    if device == "cuda":
        import torch

        torch.cuda.reset_peak_memory_stats()
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:  # not Linux, or not allowed: the difference of two peaks must do
        return _peak("cpu")[0]
    return _status("VmRSS")


def _peak(device: str) -> tuple[int, int]:
    """Largest resident memory since then, and the device's, in bytes."""
    device_peak = 0
    if device == "cuda":
        import torch

        device_peak = int(torch.cuda.max_memory_allocated())
    if Path("/proc/self/status").exists():
        return _status("VmHWM"), device_peak
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit, device_peak


def _waited() -> float:
    """Seconds that the main thread could have run but had no core, 0 where nobody counts them."""
    try:
        return int(Path("/proc/self/schedstat").read_text().split()[1]) / 1e9
    except OSError:
        return 0.0


def _status(field: str) -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    [line] = [line for line in lines if line.startswith(f"{field}:")]
    return int(line.split()[1]) * 1024


def main() -> None:
    """Answer requests until stdin ends."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # whatever else is printed must not come between the answers
    runner: Runner | None = None
    for line in sys.stdin:
        request = json.loads(line)
        kind = request.pop("do")
        try:
            if kind == "assemble":
                answer = assemble(**request)
            elif kind == "refer":
                answer = refer(**request)
            elif kind == "load":
                runner = Runner(**request)
                answer = {"status": "ok", "solver": repr(runner.solver)}
            else:
                assert runner is not None
                answer = runner.solve(**request) if kind == "solve" else runner.compare()
        except (*_FAILURES, ImportError) as error:
            answer = {"status": "failed", "reason": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    main()
