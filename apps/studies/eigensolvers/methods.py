"""What is compared: a name for each backend, ours and those of other packages.

The latter make the call that their package makes, with that package's own options, on our (L, M);
nothing is tuned, for better or worse. Absolute shifts such as -0.01 suit surfaces of about unit
area, so `solves` scales every geometry to that.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import eigsh

from spectra_kit._core.types import Floats
from spectra_kit.catalogue import SOLVERS, SUBSPACES
from spectra_kit.eigen import Eigensolver
from spectra_kit.operators import Laplacian

# --- other packages ---

Pairs = tuple[Floats, Floats]


@dataclass(frozen=True, kw_only=True)
class ScipyEigsh:
    """``scipy.sparse.linalg.eigsh`` with its SuperLU factor.

    As called by pyFM 1.3.1 (``mesh/laplacian.py``) and geomfum 1.0.0 (``numerics/eig.py`` from
    ``LaplacianSpectrumFinder``): everything is scipy's default but ``sigma=-0.01``. These packages
    leave ``tol`` at 0, machine precision; ours do not go that far, so it is measured loosened too.
    """

    sigma: float = -0.01
    tol: float = 0.0

    def eigenpairs(self, laplacian: Laplacian, k: int) -> Pairs:
        L, M = _csc(laplacian)
        values, vectors = eigsh(L, k=k, M=M, sigma=self.sigma, tol=self.tol)
        return values, vectors


@dataclass(frozen=True, kw_only=True)
class DiffusionNetEigsh:
    """The same function as DiffusionNet calls it (``geometry.py``, ``compute_operators``).

    It adds eps to the diagonal of L, eps of the mean mass to M, and shifts by eps, towards the
    spectrum. Its eigenvalues carry the first, eps * n / area on average; negative ones are clipped.
    """

    eps: float = 1e-8

    def eigenpairs(self, laplacian: Laplacian, k: int) -> Pairs:
        mass = laplacian.mass + self.eps * laplacian.mass.mean()
        L = (laplacian.stiffness + self.eps * sparse.eye_array(laplacian.n)).tocsc()
        values, vectors = eigsh(L, k=k, M=sparse.diags_array(mass), sigma=self.eps)
        return np.clip(values, 0.0, None), vectors


@dataclass(frozen=True, kw_only=True)
class LapySolver:
    """``lapy.Solver(...).eigs``, version 1.7.0, with its Cholesky factor (``use_cholmod=True``).

    LaPy assembles finite elements of its own from a mesh; here it is given our (L, M) instead.
    """

    def eigenpairs(self, laplacian: Laplacian, k: int) -> Pairs:
        from lapy import Solver, TriaMesh

        # The constructor wants a mesh; its matrices are replaced at once.
        corners = np.eye(3), np.array([[0, 1, 2]])
        solver = Solver(TriaMesh(*corners), lump=True, use_cholmod=True)
        solver.stiffness, solver.mass = _csc(laplacian)
        values, vectors = solver.eigs(k=k)
        return values, vectors


@dataclass(frozen=True, kw_only=True)
class LibiglSpectra:
    """``igl.spectra.eigs`` for the smallest magnitudes: Lanczos of the Spectra library.

    As in libigl's tutorial, ``igl.spectra.eigs(-igl.cotmatrix(V, F), mass, k, EIGS_TYPE_SM)``; our
    L has that sign already. It shifts by 1e-8 and does not subtract that again.
    """

    def eigenpairs(self, laplacian: Laplacian, k: int) -> Pairs:
        from igl import spectra

        L, M = _csc(laplacian)
        vectors, values = spectra.eigs(L, M, k, spectra.EIGS_TYPE_SM)
        return values, vectors


def _csc(laplacian: Laplacian) -> tuple[sparse.csc_array, sparse.csc_array]:
    """Return L and M as these packages hold them."""
    mass = sparse.diags_array(laplacian.mass)
    return sparse.csc_array(laplacian.stiffness), sparse.csc_array(mass)


# --- who ---

#: The call that everybody writes: speeds are given as multiples of its.
BASELINE = "eigsh"


@dataclass(frozen=True, kw_only=True)
class Method:
    """A backend to measure."""

    make: Callable[[str], Eigensolver]  #: From the device, "cpu" or "cuda", to the backend.
    #: Where it stops: at a tolerance, "rounding" of float64, its package's "default", or "" for a
    #: prediction, which has no such test.
    stops: str = ""
    devices: tuple[str, ...] = ("cpu",)  #: Where it can run.
    #: Modules beyond the dependencies of this package, called as on PyPI, or nothing.
    needs: str = ""
    peer: bool = False  #: Whether it is another package's.
    #: Relative error of eigenvalues that it is asked for, in the mean over the modes; 0: not asked.
    accuracy: float = 0.0
    #: Whether it takes many times longer than the rest, and a quick comparison leaves it out.
    slow: bool = False
    network: bool = False  #: Whether it begins with what the network predicts.

    @property
    def present(self) -> bool:
        """Whether what it needs is installed."""
        return all(find_spec(name) for name in self.needs.split())


_RTOL, _AT_RTOL = 1e-6, "1e-6"  # of every method of ours that takes one
_LOOSE = "1e-2"
_EXACT = "rounding"


def _ours(
    name: str, *, neo: str = "", device: bool = False, stops: str = "", **options: Any
) -> Method:
    """Return a solver of the catalogue; one that goes to a tolerance goes to ours, or to `stops`.

    The network takes the place of its option `neo`; with `device` it has an option of that name.
    """
    solver = SOLVERS[name]
    if solver.promise == "to tolerance":
        stops = stops or _AT_RTOL
        options["rtol"] = float(stops)
    elif solver.promise == "exact" and "accuracy" not in options:
        stops = _EXACT

    def make(where: str) -> Eigensolver:
        placed = {"device": where} if device else {}
        start = {neo: SUBSPACES["neo"](**placed)} if neo else {}
        made: Eigensolver = solver(**options, **start, **placed)
        return made

    return Method(
        make=make,
        stops=stops,
        accuracy=options.get("accuracy", 0.0),
        devices=("cpu", "cuda") if device else ("cpu",),
        network=name == "neo" or bool(neo),
    )


def _waves(m: int, steps: int) -> Method:
    """Return plane waves in place of the network's functions, and so many steps of smoothing.

    Steps, target and places are those of `Neo`.
    """
    waves = SUBSPACES["fourier"](m=m, bandwidth=7.0)
    return _ours("cascade", subspace=waves, coarsest=sys.maxsize, max_steps=steps, device=True)


def _theirs(solver: Eigensolver, stops: str, *, needs: str = "", slow: bool = False) -> Method:
    return Method(make=lambda device: solver, stops=stops, needs=needs, peer=True, slow=slow)


#: Name -> backend, in the order of tables: predictions, solvers to a tolerance, other packages.
METHODS: dict[str, Method] = {
    # As many as the shipped network has functions, with the constant; and what takes its time.
    "fourier": _waves(257, 0),
    "fourier-smoothed": _waves(257, 20),
    "fourier-512": _waves(512, 0),
    "fourier-512-smoothed": _waves(512, 20),
    "neo": _ours("neo", device=True),
    "neo-2": _ours("neo", device=True, poses=2),
    "neo-raw": _ours("neo", device=True, max_steps=0),
    "neo-cap": _ours("neo", device=True, coarsest=2048),
    "neo-1e-5": _ours("neo", device=True, target=1e-5),
    "automatic-1e-2": _ours("automatic", device=True, accuracy=1e-2),
    "automatic-1e-3": _ours("automatic", device=True, accuracy=1e-3),
    "automatic-1e-5": _ours("automatic", device=True, accuracy=1e-5),
    "automatic-1e-8": _ours("automatic", device=True, accuracy=1e-8),
    "cascade-1e-2": _ours("cascade", device=True, target=1e-2),
    "cascade": _ours("cascade", device=True),
    "cascade-1e-5": _ours("cascade", device=True, target=1e-5),
    "refined": _ours("refined"),
    "refined-neo": _ours("refined", neo="start"),
    "refined-neo-1e-2": _ours("refined", neo="start", stops=_LOOSE),
    "refined-random": _ours("refined", start=SUBSPACES["random"](m=144)),
    "refined-random-1e-2": _ours("refined", start=SUBSPACES["random"](m=144), stops=_LOOSE),
    "arpack": _ours("arpack"),
    "lanczos": _ours("lanczos"),
    "eigsh": _theirs(ScipyEigsh(), _EXACT),
    "eigsh-1e-6": _theirs(ScipyEigsh(tol=_RTOL), _AT_RTOL),
    "eigsh-dnet": _theirs(DiffusionNetEigsh(), _EXACT),
    "lapy": _theirs(LapySolver(), _EXACT, needs="lapy cholespy"),
    "spectra": _theirs(LibiglSpectra(), "default", slow=True),
}
#: What tells where the network pays: predictions, starts, a cascade without it, and exact modes.
STARTS = tuple(
    name
    for name in METHODS
    if name.partition("-")[0] in ("fourier", "neo", "cascade", "refined", "lanczos")
    or name == BASELINE
)
#: What a quick comparison measures.
QUICK = tuple(name for name, method in METHODS.items() if not method.slow)


@dataclass(frozen=True)
class Contender:
    """A method on a device."""

    name: str  #: In `METHODS`.
    device: str = "cpu"  #: Where it runs.

    def __str__(self) -> str:
        return self.name if self.device == "cpu" else f"{self.name} ({self.device})"

    @property
    def method(self) -> Method:
        """What the name stands for."""
        return METHODS[self.name]

    @cached_property
    def solver(self) -> str:
        """Every option of the backend, whatever the device; "" where it is not installed."""
        return repr(self.method.make("cpu")) if self.method.present else ""


def contenders(names: Sequence[str], devices: Sequence[str] = ("cpu",)) -> list[Contender]:
    """Return methods on every device that they can run on, in the order of `METHODS`."""
    return [
        Contender(name, device)
        for device in devices
        for name, method in METHODS.items()
        if name in names and device in method.devices
    ]
