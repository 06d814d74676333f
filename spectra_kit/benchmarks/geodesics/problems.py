"""The meshes that are measured, with sources and spectra."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from spectra_kit._files import atomic_path
from spectra_kit.benchmarks.code import code_digest
from spectra_kit.benchmarks.geodesics.contenders import MODES
from spectra_kit.benchmarks.geodesics.truth import ExactCache
from spectra_kit.eigensolvers import Arpack, Eigensolver, Polished, eigensolve
from spectra_kit.eigensolvers.neo import Neo
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import TriangleMesh, read
from spectra_kit.operators import intrinsic_delaunay
from spectra_kit.spectra import Spectrum

#: How spectra are made.
EIGENSOLVERS: Mapping[str, Callable[[], Eigensolver]] = {
    "exact": Arpack,
    "neo": Neo,
    "neo-polished": lambda: Polished(start=Neo().subspace),
}


@dataclass(frozen=True, eq=False)
class NamedMesh:
    """A mesh and what to call it.

    Attributes
    ----------
    name : str
        For tables and files.
    mesh : TriangleMesh
        Every vertex in a face.
    """

    name: str
    mesh: TriangleMesh

    @cached_property
    def digest(self) -> str:
        """Hash of the mesh: what it is, wherever its file lies."""
        digest = hashlib.blake2b(digest_size=16)
        for array in (self.mesh.points, self.mesh.faces):
            digest.update(np.ascontiguousarray(array).data)
        return digest.hexdigest()


def problems_named(names: Iterable[str]) -> list[NamedMesh]:
    """Find meshes by the names of their files.

    Parameters
    ----------
    names : iterable of str
        Files, or names of those under ``$SPECTRA_KIT_DATA/ood_public``.

    Returns
    -------
    list of NamedMesh
        Without vertices that no face uses.

    Raises
    ------
    InvalidInputError
        If there is no such file, two have one name, or one is no mesh.
    """
    root = os.environ.get("SPECTRA_KIT_DATA")
    found: dict[str, NamedMesh] = {}
    for name in names:
        path = Path(name)
        if not path.is_file() and root:
            path = Path(root) / "ood_public" / f"{name}.npz"
        if not path.is_file():
            raise InvalidInputError(
                f"`meshes` must name files, or, where SPECTRA_KIT_DATA is set, meshes in"
                f" ood_public there; got {name!r}"
            )
        mesh = read(path, kind="mesh")
        assert isinstance(mesh, TriangleMesh)
        if path.stem in found:
            raise InvalidInputError(f"`meshes` must have names of their own, got {path.stem} twice")
        found[path.stem] = NamedMesh(path.stem, mesh.without_unreferenced())
    return list(found.values())


def choose_sources(model: NamedMesh, count: int, truth: ExactCache, *, seed: int) -> list[int]:
    """Draw half of the sources at random, the rest as far as possible from those before.

    Parameters
    ----------
    model : NamedMesh
        With n vertices.
    count : int
        How many.
    truth : ExactCache
        Of distances to the sources.
    seed : int
        Of the draw.

    Returns
    -------
    list of int
        Vertices, each once.
    """
    rng = np.random.default_rng(seed)
    drawn = rng.choice(model.mesh.n, (count + 1) // 2, replace=False)
    sources = [int(source) for source in drawn]
    while len(sources) < count:
        nearest = np.min([truth.distances(model.mesh, source) for source in sources], axis=0)
        nearest[np.isinf(nearest)] = -1.0  # other components have no errors to measure
        sources.append(int(nearest.argmax()))
    return sources


def spectrum_path(model: NamedMesh, kind: str, folder: Path) -> Path:
    """Solve for the modes of a mesh into a file, if the same solver and code have not done so.

    Parameters
    ----------
    model : NamedMesh
        The mesh.
    kind : str
        One of `EIGENSOLVERS`.
    folder : Path
        Must exist.

    Returns
    -------
    Path
        Of a `Spectrum` with `MODES` modes beyond the kernel, as far as there are.
    """
    solver = EIGENSOLVERS[kind]()  # its representation holds the hash of the weights
    key = f"{model.digest} {MODES} {solver!r} {code_digest()}"
    digest = hashlib.blake2b(key.encode(), digest_size=12).hexdigest()
    path = folder / f"{model.name}-{kind}-{digest}.npz"
    if not path.exists():
        laplacian = intrinsic_delaunay(model.mesh).laplacian
        k = min(MODES + laplacian.kernel_dimension, laplacian.n - 1)
        spectrum = eigensolve(laplacian, k, solver)
        with atomic_path(path) as part:
            spectrum.save(part)
    return path


def spectrum_seconds(path: Path) -> float:
    """Return what a spectrum took, its operator aside: that the distances need anyway."""
    seconds = Spectrum.load(path).provenance.seconds
    return sum(time for stage, time in seconds.items() if stage != "assembly")
