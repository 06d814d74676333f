"""What the commands begin with: solvers by name, geometries from files, and their operators."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

from spectra_kit._validate import check_count, quantity
from spectra_kit.cli.options import DEMO, FORMATS, NETWORK, TAKERS, listed
from spectra_kit.cli.parser import did_you_mean
from spectra_kit.cli.progress import say, step
from spectra_kit.cli.unused import refuse_given
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
)
from spectra_kit.eigensolvers.neo import Neo
from spectra_kit.eigensolvers.starts import plane_waves
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import Geometry, TriangleMesh, creature, read, repair, sample
from spectra_kit.operators import (
    Laplacian,
    cotan_laplacian,
    delaunay_laplacian,
    knn_laplacian,
    robust_laplacian,
)
from spectra_kit.subspaces import AmbientFourier, RandomBasis, Subspace

# Both sides of a comparison are solved for a few modes more: pushed-out modes are found again,
# and a cluster that k cuts is known as one.
EXTRA = 6

_REMOVED = {
    "merged_points": "merged point",
    "degenerate_faces": "degenerate face",
    "duplicate_faces": "duplicate face",
    "unreferenced_vertices": "unreferenced vertex",
}


def _start(a: argparse.Namespace) -> Subspace:
    """Return the subspace that ``--start`` names; plane waves by default."""
    if a.start == "neo":
        return Neo(weights=a.weights, poses=a.poses, dtype=a.dtype, device=a.device).subspace
    if a.start == "random":
        return RandomBasis(m=a.k + max(a.k // 2, 2 * EXTRA), seed=a.seed)
    return dataclasses.replace(plane_waves(a.k), seed=a.seed)


def _rtol(a: argparse.Namespace) -> dict[str, Any]:
    """Return the tolerance, where one was asked for."""
    return {} if a.rtol is None else {"rtol": a.rtol}


SOLVERS: dict[str, Callable[[argparse.Namespace], Eigensolver]] = {
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


def solvers_named(arguments: argparse.Namespace, *names: str) -> list[Eigensolver]:
    """Return the solvers of these names; refuse options that none of them takes."""
    if "neo" not in names and arguments.start != "neo":
        refuse_given(arguments, NETWORK, "without the network; choose it by --solver neo")
    for option, takers in TAKERS.items():
        if getattr(arguments, option) is not None and not set(names) & set(takers):
            raise InvalidInputError(
                f"--{option} is for the solvers {listed(takers)}, got {listed(names)}; choose one"
                " of those by --solver, or leave it out"
            )
    return [SOLVERS[name](arguments) for name in names]


def load(arguments: argparse.Namespace) -> Geometry:
    """Read or make the geometry; repair and sample it where that was asked for."""
    geometry: Geometry
    if arguments.file == DEMO:
        pose = getattr(arguments, "pose", 0)
        with step("making the demo"):
            geometry = creature(arguments.points, seed=arguments.seed, pose=pose)
    else:
        _check_there(Path(arguments.file))
        with step(f"reading {arguments.file}"):
            geometry = read(arguments.file)
    if arguments.repair:
        with step("repairing"):
            repaired = repair(geometry)
        geometry = repaired.geometry
        counts = dataclasses.asdict(repaired.report)
        done = ", ".join(quantity(n, _REMOVED[what]) for what, n in counts.items() if n)
        say(f"repaired: {done or 'nothing to do'}")
    if arguments.cloud is not None:
        if not isinstance(geometry, TriangleMesh):
            raise InvalidInputError("--cloud samples a mesh, and this file holds a point cloud")
        check_count("--cloud", arguments.cloud, low=1)
        with step(f"sampling {arguments.cloud:,} points"):
            geometry = sample(geometry, arguments.cloud, seed=arguments.seed)
    return geometry


def _check_there(path: Path) -> None:
    """Refuse what is no file, or not there, and name the likeliest of those that are."""
    if path.is_dir():
        raise InvalidInputError(
            f"{path}: this is a folder, expected a file; name one that is in it"
        )
    if str(path) in ("-", "/dev/stdin") or (path.exists() and not path.is_file()):
        raise InvalidInputError(
            f"{path}: pipes are not read, expected a file whose name ends in its format"
            f" ({FORMATS}); save the data as one"
        )
    if path.exists() or not path.parent.is_dir():
        return
    if meant := did_you_mean(path.name, [other.name for other in path.parent.iterdir()]):
        raise InvalidInputError(f"{path}: there is no such file; {meant}")


def assemble(arguments: argparse.Namespace, geometry: Geometry) -> Laplacian:
    """Assemble the operator with its boundary condition."""
    chosen = arguments.operator or ("robust" if isinstance(geometry, TriangleMesh) else "delaunay")
    if chosen == "robust":
        laplacian = robust_laplacian(geometry)
    elif chosen == "knn":
        laplacian = knn_laplacian(geometry)
    elif chosen == "delaunay":
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
