"""Measure approximate solvers on real meshes: the paper's three errors, and the time.

Each mesh is sampled (``--points``), solved exactly by ARPACK and approximately by every solver
asked for; the table holds one row for each mesh and solver, and their means at the end.

    python apps/evaluate.py FOLDER --poses 1 4 --fourier 193 640
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from spectra_kit import (
    AmbientFourier,
    Neo,
    RayleighRitz,
    SpectraKitError,
    TriangleMesh,
    eigensolve,
    read,
    robust_laplacian,
)
from spectra_kit.geometry import repair, sample
from spectra_kit.geometry.io import READERS
from spectra_kit.metrics import compare_spectra, subspace_span_error

_HEADER = ("mesh", "solver", "functions", "span", "eigenvalue", "eigenvector", "seconds", "arpack")


def evaluate(path: Path, solvers: dict[str, Neo | RayleighRitz], *, points: int, k: int):
    """Yield (solver, functions, span, eigenvalue and eigenvector error, seconds, ARPACK's)."""
    mesh = repair(read(path, kind="mesh")).geometry
    assert isinstance(mesh, TriangleMesh)
    laplacian = robust_laplacian(sample(mesh, points, seed=0) if points else mesh)
    exact = eigensolve(laplacian, k)
    for name, solver in solvers.items():
        predicted = eigensolve(laplacian, k, solver)
        comparison = compare_spectra(exact, predicted)
        span, dimension = subspace_span_error(solver.subspace, laplacian, exact, predicted)
        yield (
            name,
            dimension,
            span.mean(),
            comparison.mean_eigenvalue_error,
            comparison.mean_vector_error,
            _solve_seconds(predicted),
            _solve_seconds(exact),
        )


def _solve_seconds(spectrum) -> float:
    """Everything but the assembly, which all solvers share."""
    return sum(t for stage, t in spectrum.provenance.seconds.items() if stage != "assembly")


def main(argv: Sequence[str] | None = None) -> int:
    """Evaluate and print; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("paths", nargs="+", type=Path, help="meshes, or folders of meshes")
    parser.add_argument("-k", type=int, default=96, help="modes (default %(default)s)")
    parser.add_argument(
        "--points", type=int, default=8192, help="sampled on each mesh (%(default)s); 0: vertices"
    )
    parser.add_argument("--weights", default="small", help="of neo (default %(default)s)")
    parser.add_argument("--poses", type=int, nargs="*", default=[1, 4], help="neo in so many poses")
    parser.add_argument(
        "--fourier", type=int, nargs="*", default=[193, 640], help="AmbientFourier with m functions"
    )
    parser.add_argument("--bandwidth", type=float, default=10.0, help="of these (%(default)s)")
    arguments = parser.parse_args(argv)
    files = [
        file
        for path in arguments.paths
        for file in (sorted(path.iterdir()) if path.is_dir() else [path])
        if not path.is_dir() or file.suffix.lower() in READERS
    ]
    try:
        solvers: dict[str, Neo | RayleighRitz] = {
            f"neo, poses={p}": Neo(weights=arguments.weights, poses=p) for p in arguments.poses
        }
        for m in arguments.fourier:
            subspace = AmbientFourier(m=m, bandwidth=arguments.bandwidth)
            solvers[f"fourier, m={m}"] = RayleighRitz(subspace=subspace)
        print("{:16}{:16}{:>10}{:>10}{:>12}{:>13}{:>9}{:>9}".format(*_HEADER))
        rows: dict[str, list[tuple[float, ...]]] = {name: [] for name in solvers}
        for file in files:
            for name, *figures in evaluate(file, solvers, points=arguments.points, k=arguments.k):
                rows[name].append(tuple(figures))
                _print_row(file.stem, name, figures)
        for name, figures in rows.items():
            _print_row(f"mean of {len(files)}", name, np.mean(figures, axis=0))
    except SpectraKitError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def _print_row(mesh: str, solver: str, figures: Sequence[float]) -> None:
    functions, span, value, vector, seconds, exact = figures
    print(
        f"{mesh:16}{solver:16}{functions:10.0f}{span:10.1e}{value:12.1e}{vector:13.1e}"
        f"{seconds:9.2f}{exact:9.2f}",
        flush=True,
    )


if __name__ == "__main__":
    sys.exit(main())
