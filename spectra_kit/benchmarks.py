"""How long the exact eigensolver takes beside the call that everybody writes.

``python -m spectra_kit.benchmarks [FILE]`` times `Arpack` against ``scipy.sparse.linalg.eigsh``
with its default SuperLU factor, in one process, runs interleaved, at the same tolerance and shift,
on a mesh of about 35,000 vertices (the demo creature without FILE).
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import eigsh

from spectra_kit.eigensolvers import Arpack, eigensolve
from spectra_kit.errors import SpectraKitError
from spectra_kit.geometry import TriangleMesh, creature, read, repair
from spectra_kit.operators import Laplacian, robust_laplacian
from spectra_kit.spectrum import Spectrum

Floats = NDArray[np.float64]


def eigsh_superlu(laplacian: Laplacian, k: int, *, tol: float, shift: float) -> Spectrum:
    """Solve with scipy's ``eigsh`` in shift-invert mode as it comes, SuperLU inside."""
    sigma = -shift * laplacian.eigenvalue_spacing
    values, vectors = eigsh(
        sparse.csc_array(laplacian.stiffness),
        k,
        sparse.csc_array(sparse.diags_array(laplacian.mass)),
        sigma=sigma,
        tol=tol,
        v0=np.random.default_rng(0).standard_normal(laplacian.n),
    )
    return Spectrum(np.maximum(values, 0.0), vectors, laplacian.mass).certify(laplacian)


def compare(laplacian: Laplacian, k: int, *, tol: float, repeats: int) -> list[str]:
    """Return the lines of a table: solver, median and range of seconds, ratio, residual."""
    solver = Arpack(tol=tol)
    calls: dict[str, Callable[[], Spectrum]] = {
        "eigsh, SuperLU (scipy)": lambda: eigsh_superlu(laplacian, k, tol=tol, shift=solver.shift),
        "Arpack, Cholesky (spectra_kit)": lambda: eigensolve(laplacian, k, solver),
    }
    seconds: dict[str, list[float]] = {name: [] for name in calls}
    spectra: dict[str, Spectrum] = {}
    for _ in range(repeats):  # interleaved: a slow minute of the machine hits both alike
        for name, call in calls.items():
            start = time.perf_counter()
            spectra[name] = call()
            seconds[name].append(time.perf_counter() - start)
    baseline = statistics.median(next(iter(seconds.values())))
    lines = [f"{'':32}{'median s':>10}{'min':>8}{'max':>8}{'speed-up':>10}{'residual':>10}"]
    for name, times in seconds.items():
        certificate = spectra[name].certificate
        assert certificate is not None
        median = statistics.median(times)
        lines.append(
            f"{name:32}{median:10.2f}{min(times):8.2f}{max(times):8.2f}"
            f"{baseline / median:9.2f}x{certificate.relative_residuals.max():10.1e}"
        )
    first, second = (s.eigenvalues[1:] for s in spectra.values())
    lines.append(f"largest relative difference of eigenvalues: {abs(first / second - 1).max():.1e}")
    return lines


def main(argv: Sequence[str] | None = None) -> int:
    """Run the benchmark; see the module's docstring."""
    parser = argparse.ArgumentParser(prog="python -m spectra_kit.benchmarks", description=__doc__)
    parser.add_argument("file", nargs="?", help="a mesh; the demo creature without it")
    parser.add_argument("-k", type=int, default=96, help="number of modes (default 96)")
    parser.add_argument("--points", type=int, default=35_000, help="of the creature")
    parser.add_argument("--tol", type=float, default=1e-10, help="ARPACK's tolerance, both sides")
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args(argv)
    try:
        if options.file is None:
            mesh = creature(options.points, seed=0)
        else:
            geometry = repair(read(options.file, kind="mesh")).geometry
            assert isinstance(geometry, TriangleMesh)
            mesh = geometry
        laplacian = robust_laplacian(mesh)
        print(f"{mesh.n} vertices, k = {options.k}, tol = {options.tol:g}, {options.repeats} runs")
        print(*compare(laplacian, options.k, tol=options.tol, repeats=options.repeats), sep="\n")
    except SpectraKitError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
