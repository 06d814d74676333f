"""What is solved: a geometry at a number of points, and its operator, scaled to unit area."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from spectra_kit._files import atomic_path, parsing
from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry import Geometry, TriangleMesh, creature, read, repair, sample
from spectra_kit.operators import Laplacian, delaunay_laplacian, robust_laplacian

#: Name -> assembly of (L, M).
OPERATORS: dict[str, Callable[[Any], Laplacian]] = {
    "robust": robust_laplacian,
    "delaunay": delaunay_laplacian,
}
KINDS = {"mesh": "robust", "cloud": "delaunay"}  # and the operator of each


@dataclass(frozen=True, kw_only=True)
class Problem:
    """One eigenproblem, by its recipe.

    Attributes
    ----------
    kind : {"mesh", "cloud"}
        A cloud is drawn uniformly from the surface of the mesh.
    points : int
        To ask for; the demo mesh meets it within 1 per cent. Of a file's mesh it is the number
        of vertices, whatever was asked for.
    operator : str
        A name in `OPERATORS`, the one of that kind in `KINDS`.
    file : str
        A mesh; the demo animal without one.

    Raises
    ------
    InvalidInputError
        If the kind or the operator is unknown, or the operator is for the other kind.

    Examples
    --------
    >>> from spectra_kit.benchmarks import Problem
    >>> laplacian = Problem(kind="cloud", points=600, operator="delaunay").assemble()
    >>> laplacian.n, round(laplacian.area, 9)
    (600, 1.0)
    """

    kind: str
    points: int
    operator: str
    file: str = ""

    def __post_init__(self) -> None:
        for name, options in (("kind", tuple(KINDS)), ("operator", tuple(OPERATORS))):
            if getattr(self, name) not in options:
                raise InvalidInputError(
                    f"`{name}` must be one of {options}, got {getattr(self, name)!r}"
                )
        if self.operator != KINDS[self.kind]:
            raise InvalidInputError(
                f"`operator` of a {self.kind} must be {KINDS[self.kind]}, got {self.operator}"
            )

    def key(self) -> dict[str, object]:
        """All that decides the eigenproblem, as JSON."""
        model = "creature"
        if self.file:
            model = hashlib.blake2b(Path(self.file).read_bytes(), digest_size=12).hexdigest()
        return {
            "geometry": self.kind,
            "points": self.points,
            "model": model,
            "operator": self.operator,
        }

    def geometry(self) -> Geometry:
        """Make the mesh or draw the cloud."""
        if self.file:
            mesh = repair(read(self.file, kind="mesh")).geometry
            assert isinstance(mesh, TriangleMesh)
        else:
            mesh = creature(self.points, seed=0)
        return mesh if self.kind == "mesh" else sample(mesh, self.points, seed=0)

    def assemble(self) -> Laplacian:
        """Assemble the operator and scale it to unit area.

        Returns
        -------
        Laplacian
            Its `seconds` are those of the assembly alone.
        """
        geometry = self.geometry()
        start = time.perf_counter()
        assembled = OPERATORS[self.operator](geometry)
        seconds = time.perf_counter() - start
        return Laplacian(
            assembled.stiffness,  # of a surface: the same at every scale
            assembled.mass / assembled.area,
            assembled.points / np.sqrt(assembled.area),
            operator=assembled.operator,
            seconds=seconds,
        )


def write_operator(laplacian: Laplacian, path: Path) -> None:
    """Write a Neumann operator to an ``.npz`` file, whole or not at all."""
    L = laplacian.stiffness
    with atomic_path(path) as part:
        np.savez(
            part,
            data=L.data,
            indices=L.indices,
            indptr=L.indptr,
            mass=laplacian.mass,
            points=laplacian.points,
            seconds=laplacian.seconds,
            operator=laplacian.operator,
        )


def read_operator(path: Path) -> Laplacian:
    """Read what `write_operator` wrote."""
    with parsing(path, "operator", remedy="delete it"), np.load(path) as file:
        n = len(file["mass"])
        stiffness = sparse.csr_array((file["data"], file["indices"], file["indptr"]), shape=(n, n))
        return Laplacian(
            stiffness,
            file["mass"],
            file["points"],
            operator=str(file["operator"]),
            seconds=float(file["seconds"]),
        )
