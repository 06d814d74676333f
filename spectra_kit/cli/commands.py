"""The three commands: each takes parsed arguments and writes to stdout."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from spectra_kit._validate import check_count
from spectra_kit.cli import tables
from spectra_kit.cli.options import DEMO, TAKERS, listed
from spectra_kit.eigensolvers import (
    Arpack,
    Capped,
    Dense,
    Eigensolver,
    Lobpcg,
    Multilevel,
    Polished,
    RayleighRitz,
    Refined,
    eigensolve,
    verify,
)
from spectra_kit.eigensolvers.neo import Neo
from spectra_kit.eigensolvers.refined import plane_waves
from spectra_kit.errors import ConvergenceError, InvalidInputError, OutOfMemoryError
from spectra_kit.geometry import (
    Geometry,
    TriangleMesh,
    creature,
    diagnose,
    read,
    repair,
    sample,
)
from spectra_kit.metrics import compare_spectra, subspace_span_error
from spectra_kit.operators import (
    Laplacian,
    cotan_laplacian,
    delaunay_laplacian,
    knn_laplacian,
    robust_laplacian,
)
from spectra_kit.subspaces import AmbientFourier, RandomBasis, Subspace

_SHOWN = (0, 1, 2, 5, 10, 25, 50)  # and the last
_DRAWN = (1, 2, 5, 10, 25)
# Both sides of a comparison are solved for a few modes more: pushed-out modes are found again,
# and a cluster that k cuts is known as one.
_EXTRA = 6


def _start(a: argparse.Namespace) -> Subspace:
    """Return the subspace that ``--start`` names; plane waves by default."""
    if a.start == "neo":
        return Neo(weights=a.weights, poses=a.poses, dtype=a.dtype, device=a.device).subspace
    if a.start == "random":
        return RandomBasis(m=a.k + max(a.k // 2, 2 * _EXTRA), seed=a.seed)
    return dataclasses.replace(plane_waves(a.k), seed=a.seed)


def _rtol(a: argparse.Namespace) -> dict[str, Any]:
    """Return the tolerance, where one was asked for."""
    return {} if a.rtol is None else {"rtol": a.rtol}


_SOLVERS: dict[str, Callable[[argparse.Namespace], Eigensolver]] = {
    "arpack": lambda a: Arpack(seed=a.seed),
    "multilevel": lambda a: Multilevel(seed=a.seed, **_rtol(a)),
    "refined": lambda a: Refined(start=_start(a), seed=a.seed, **_rtol(a)),
    "lobpcg": lambda a: Lobpcg(seed=a.seed, **_rtol(a)),
    "dense": lambda _: Dense(),
    "polished": lambda a: Polished(start=_start(a), seed=a.seed),
    "capped": lambda a: Capped(subspace=_start(a)),
    "fourier": lambda a: RayleighRitz(subspace=AmbientFourier(seed=a.seed)),
    "neo": lambda a: Neo(weights=a.weights, poses=a.poses, dtype=a.dtype, device=a.device),
}


def _solvers(arguments: argparse.Namespace, *names: str) -> list[Eigensolver]:
    """Return the solvers of these names; refuse options that none of them takes."""
    for option, takers in TAKERS.items():
        if getattr(arguments, option) is not None and not set(names) & set(takers):
            raise InvalidInputError(
                f"--{option} is for the solvers {listed(takers)}, got {listed(names)}; choose one"
                " of those by --solver, or leave it out"
            )
    return [_SOLVERS[name](arguments) for name in names]


def spectrum(arguments: argparse.Namespace) -> None:
    """Compute the lowest modes, show a few, save all."""
    if arguments.output:
        _check_output(arguments.output, ".npz")
    k = check_count("k", arguments.k, low=1)
    modes = _modes(arguments.modes, (*_SHOWN, k - 1), k)
    (solver,) = _solvers(arguments, arguments.solver)
    geometry, laplacian = _prepare(arguments)
    _progress(f"solving for {k} modes with {arguments.solver}")
    try:
        result = eigensolve(laplacian, k, solver)
    except (ConvergenceError, OutOfMemoryError) as error:
        if arguments.output and error.partial is not None:
            rescued = arguments.output.with_suffix(".partial.npz")
            error.partial.save(rescued)
            sys.stderr.write(f"the {error.partial.k} modes that converged: {rescued}\n")
        raise
    if arguments.verify:
        _progress("counting eigenvalues")
        result = verify(result, laplacian)
    if arguments.output:
        result.save(arguments.output)
    if arguments.json:
        _print_json(
            input=arguments.file,
            geometry=tables.geometry_record(geometry),
            **tables.spectrum_record(result),
            output=arguments.output and str(arguments.output),
        )
        return
    _print(
        tables.headline(arguments.file, geometry, laplacian),
        tables.modes_table(result, modes),
        tables.certificate_lines(result),
    )
    if arguments.output:
        _print(f"spectrum: {arguments.output}")


def compare(arguments: argparse.Namespace) -> None:
    """Set predicted modes beside exact ones, as a table and as a picture."""
    picture: Path | None = arguments.picture
    if picture:
        _check_output(picture, ".png")
    k = check_count("k", arguments.k, low=1)
    modes = _modes(arguments.modes, (*_SHOWN, k - 1), k)
    predictor = arguments.solver or _default_predictor()
    names = (arguments.against, predictor)
    solvers = dict(zip(names, _solvers(arguments, *names), strict=True))
    geometry, laplacian = _prepare(arguments)
    check_count("k", k, low=1, high=len(laplacian.free))
    spectra = {}
    for name, solver in solvers.items():
        _progress(f"solving for {k} modes with {name}")
        spectra[name] = eigensolve(laplacian, min(k + _EXTRA, len(laplacian.free)), solver)
    exact, predicted = spectra[arguments.against], spectra[predictor]
    _progress("comparing")
    comparison = compare_spectra(exact, predicted, k=k)
    subspace = getattr(solvers[predictor], "subspace", None)
    if subspace is not None:
        error, dimension = subspace_span_error(subspace, laplacian, exact, predicted)
        comparison = dataclasses.replace(comparison, span_error=error[:k], span_dimension=dimension)
    if not arguments.json:
        _print(
            tables.headline(arguments.file, geometry, laplacian),
            tables.comparison_table(exact, predicted, comparison, modes),
            tables.comparison_lines(arguments.against, exact, predictor, predicted, comparison),
        )
    if picture:
        from spectra_kit.viz import plot_comparison

        first = max(comparison.n_zero_modes - 1, 0)  # one constant function per component is dull
        _progress("drawing")
        plot_comparison(
            picture,
            geometry,
            exact,
            predicted,
            comparison,
            modes=_modes(arguments.modes, [i + first for i in _DRAWN], k),
            names=(f"exact: {arguments.against}", f"predicted: {predictor}"),
            title=f"{Path(arguments.file).stem}, {geometry.n:,} points",
            subtitle=tables.comparison_line(comparison),
        )
    if arguments.json:
        _print_json(
            input=arguments.file,
            geometry=tables.geometry_record(geometry),
            exact=tables.spectrum_record(exact),
            predicted=tables.spectrum_record(predicted),
            comparison=tables.comparison_record(comparison),
            picture=picture and str(picture),
        )
    elif picture:
        _print(f"picture: {picture}")


def info(arguments: argparse.Namespace) -> None:
    """Say what a file holds, what is wrong with it, and what the operator makes of it."""
    geometry = _load(arguments)
    diagnosis = diagnose(geometry)
    try:
        operator = tables.operator_record(_operator(arguments, geometry))
    except InvalidInputError as error:
        operator = {"refused": str(error)}
    if arguments.json:
        _print_json(
            input=arguments.file,
            kind=tables.kind(geometry),
            diagnosis=dataclasses.asdict(diagnosis),
            problems=list(diagnosis.problems),
            operator=operator,
        )
        return
    _print(tables.diagnosis_lines(arguments.file, geometry, diagnosis), tables.pairs(operator))


def _load(arguments: argparse.Namespace) -> Geometry:
    """Read or make the geometry; repair and sample it where that was asked for."""
    geometry: Geometry
    if arguments.file == DEMO:
        geometry = creature(arguments.points, seed=arguments.seed)
    else:
        _progress(f"reading {arguments.file}")
        geometry = read(arguments.file)
    if arguments.repair:
        repaired = repair(geometry)
        geometry = repaired.geometry
        counts = dataclasses.asdict(repaired.report)
        done = ", ".join(f"{n} {what.replace('_', ' ')}" for what, n in counts.items() if n)
        sys.stderr.write(f"repaired: {done or 'nothing to do'}\n")
    if arguments.cloud is not None:
        if not isinstance(geometry, TriangleMesh):
            raise InvalidInputError("--cloud samples a mesh, and this file holds a point cloud")
        geometry = sample(geometry, arguments.cloud, seed=arguments.seed)
    return geometry


def _operator(arguments: argparse.Namespace, geometry: Geometry) -> Laplacian:
    """Assemble the operator with its boundary condition."""
    chosen = arguments.operator or ("robust" if isinstance(geometry, TriangleMesh) else "delaunay")
    if chosen == "robust":
        laplacian = robust_laplacian(geometry)
    elif chosen == "knn":
        laplacian = knn_laplacian(geometry)
    elif chosen == "delaunay":
        if isinstance(geometry, TriangleMesh):
            raise InvalidInputError("--operator delaunay needs points; sample the mesh by --cloud")
        laplacian = delaunay_laplacian(geometry)
    elif isinstance(geometry, TriangleMesh):
        laplacian = cotan_laplacian(geometry)
    else:
        raise InvalidInputError("--operator cotan needs a mesh; use another for points")
    if arguments.boundary == "dirichlet":
        if not isinstance(geometry, TriangleMesh) or not len(geometry.boundary_vertices):
            raise InvalidInputError("--boundary dirichlet needs a mesh that has a boundary")
        laplacian = laplacian.dirichlet(geometry.boundary_vertices)
    return laplacian


def _prepare(arguments: argparse.Namespace) -> tuple[Geometry, Laplacian]:
    geometry = _load(arguments)
    _progress(f"assembling the Laplacian of {geometry.n:,} points")
    return geometry, _operator(arguments, geometry)


def _default_predictor() -> str:
    from spectra_kit.neo.pretrained import WEIGHTS

    return "neo" if WEIGHTS else "fourier"


def _modes(asked: Sequence[int] | None, usual: Sequence[int], k: int) -> tuple[int, ...]:
    """The modes to show: those asked for, else the usual ones, up to k."""
    if asked is not None:
        return tuple(check_count("modes", i, low=0, high=k - 1) for i in asked)
    return tuple(sorted({i for i in usual if i < k})) or (k - 1,)


def _check_output(path: Path, suffix: str) -> None:
    """Refuse a bad output path before the work, not after it."""
    if path.suffix.lower() != suffix:
        raise InvalidInputError(f"the output must be a {suffix} file, got {str(path)!r}")
    if not path.parent.is_dir():
        raise InvalidInputError(
            f"cannot write {str(path)!r}: there is no folder {str(path.parent)!r}"
        )


_START = time.perf_counter()


def _progress(text: str) -> None:
    """Tell a person at the terminal what goes on; say nothing to a file or a pipe."""
    if sys.stderr.isatty():
        sys.stderr.write(f"[{time.perf_counter() - _START:6.1f} s] {text}\n")


def _print(*blocks: str) -> None:
    sys.stdout.write("\n\n".join(blocks) + "\n")


def _print_json(**record: object) -> None:
    """JSON knows no NaN: null stands for it."""
    json.dump(_plain(record), sys.stdout, indent=2, allow_nan=False)
    sys.stdout.write("\n")


def _plain(value: object) -> object:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
