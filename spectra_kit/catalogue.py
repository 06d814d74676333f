"""What there is to choose from, by name: solvers, operators and subspaces.

Each name stands here once; the command line, its help and the studies read it here. What makes the
thing is imported when it is asked for, so that to list the names costs nothing.

>>> from spectra_kit.catalogue import OPERATORS, SOLVERS
>>> "knn" in OPERATORS
True
>>> SOLVERS["arpack"].summary
'Lanczos on a sparse factor, for a few modes'
>>> SOLVERS["arpack"](seed=1)
Arpack(tol=0.0, shift=0.1, seed=1, max_restarts=1000)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from types import MappingProxyType
from typing import Any


@dataclass(frozen=True)
class Entry:
    """A named thing; calling it makes one.

    Attributes
    ----------
    maker : str
        The public class or function that makes it, as ``"module:name"`` inside spectra_kit.
    summary : str
        What it is, in a few words.
    promise : {"exact", "to tolerance", "approximate", ""}
        Of a solver: what its answers are by default; see `eigen.Eigensolver`.
    """

    maker: str
    summary: str
    promise: str = ""

    @cached_property
    def made_by(self) -> Any:
        """The class or function itself, imported now."""
        module, _, name = self.maker.partition(":")
        return getattr(import_module(f"spectra_kit.{module}"), name)

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        """Make one, with the arguments of what makes it."""
        return self.made_by(*arguments, **options)


def _table(module: str, **entries: tuple[str, ...]) -> Mapping[str, Entry]:
    return MappingProxyType(
        {name: Entry(f"{module}.{maker}", *told) for name, (maker, *told) in entries.items()}
    )


#: Those that are exact, or go on to a tolerance, come first.
SOLVERS = _table(
    "eigen",
    automatic=("automatic:Automatic", "the cheapest for an accuracy", "exact"),
    arpack=("lanczos:Arpack", "Lanczos on a sparse factor, for a few modes", "exact"),
    lanczos=("lanczos:Lanczos", "block Lanczos around several shifts, for many", "exact"),
    refined=(
        "refined:Refined",
        "block iterations from any start, on a sparse factor",
        "to tolerance",
    ),
    dense=("dense:Dense", "LAPACK on the full matrix, for few points", "exact"),
    cascade=("cascade:Cascade", "few points solved, carried to all, smoothed", "approximate"),
    fourier=("rayleigh_ritz:RayleighRitz", "plane waves and Rayleigh-Ritz", "approximate"),
    neo=("neo:Neo", "the network and Rayleigh-Ritz", "approximate"),
)

OPERATORS = _table(
    "operators",
    robust=("assemble:robust_laplacian", "intrinsic Delaunay, of any mesh or cloud"),
    cotan=("assemble:cotan_laplacian", "the cotangents of a mesh as it is"),
    knn=("assemble:knn_laplacian", "the graph of nearest neighbours"),
    delaunay=("assemble:delaunay_laplacian", "local Delaunay triangles of points"),
)

SUBSPACES = MappingProxyType(
    {
        "fourier": Entry("eigen.subspaces:AmbientFourier", "plane waves"),
        "neo": Entry("neo:NeoSubspace", "what the network predicts"),
        "random": Entry("eigen.subspaces:RandomBasis", "white noise"),
        "given": Entry("eigen.subspaces:GivenBasis", "columns that are there"),
    }
)
