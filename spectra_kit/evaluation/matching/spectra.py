"""Spectra of subjects by each backend, solved once and kept in a folder."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Literal

import numpy as np

from spectra_kit._types import Ints
from spectra_kit._version import VERSION
from spectra_kit.eigensolvers import Arpack, Neo, Polished, Refined, eigensolve
from spectra_kit.eigensolvers.base import Eigensolver
from spectra_kit.evaluation.matching.subjects import Subject
from spectra_kit.geometry import Geometry, TriangleMesh
from spectra_kit.geometry.shapes import distinct_rows
from spectra_kit.neo import NeoSubspace
from spectra_kit.neo.pretrained import load_pretrained
from spectra_kit.operators import Laplacian, delaunay_laplacian, robust_laplacian
from spectra_kit.spectra import Spectrum

Kind = Literal["mesh", "cloud"]

#: Backends by name: ARPACK, the network alone, polished once, and refined to the end.
BACKENDS = ("exact", "neo", "neo-polished", "neo-refined")
KINDS: tuple[Kind, ...] = ("mesh", "cloud")
_FORMAT = 1  # of the files; raise it where their meaning changes


def make_solver(backend: str, weights: str = "small") -> Eigensolver:
    """Return the solver that a backend names.

    Examples
    --------
    >>> from spectra_kit.evaluation.matching.spectra import make_solver
    >>> make_solver("exact")
    Arpack(...)
    """
    if backend == "exact":
        return Arpack()
    if backend == "neo":
        return Neo(weights=weights)
    start = NeoSubspace(weights)
    return Polished(start=start, sweeps=1) if backend == "neo-polished" else Refined(start=start)


def geometry_of(subject: Subject, kind: Kind) -> Geometry:
    """Return the mesh, or its vertices alone, of those at one place the first."""
    return subject.mesh if kind == "mesh" else subject.mesh.as_cloud().without_duplicates()


def points_of(subject: Subject, kind: Kind) -> tuple[Ints, Ints]:
    """Return the vertex of each point of `geometry_of`, and the point of each vertex."""
    if kind == "mesh":
        same = np.arange(subject.mesh.n)
        return same, same
    return distinct_rows(subject.mesh.points)


def operator_of(subject: Subject, kind: Kind) -> Laplacian:
    """Return the robust Laplacian of the mesh, or the Delaunay one of its vertices alone."""
    geometry = geometry_of(subject, kind)
    if isinstance(geometry, TriangleMesh):
        return robust_laplacian(geometry)
    return delaunay_laplacian(geometry)


def spectrum_path(
    folder: Path, subject: Subject, kind: Kind, backend: str, *, k: int, weights: str
) -> Path:
    """Return where a spectrum lies: named by a hash of all that decides it."""
    key: dict[str, object] = {"format": _FORMAT, "version": VERSION, "k": k, "kind": kind}
    key |= {"subject": subject.digest, "backend": backend}
    if backend != "exact":
        key["weights"] = load_pretrained(weights).sha256
    digest = hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()[:24]
    return folder / f"{subject.name}-{kind}-{backend}-{digest}.npz"


def solve_to(
    path: Path, subject: Subject, kind: Kind, backend: str, *, k: int, weights: str
) -> None:
    """Solve and write the spectrum to `path`, whole or not at all."""
    eigensolve(operator_of(subject, kind), k, make_solver(backend, weights)).save(path)


def load_spectrum(path: Path) -> Spectrum:
    """Read what `solve_to` wrote."""
    return Spectrum.load(path)
