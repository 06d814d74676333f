"""What is compared: a name for each backend, ours and those of other packages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from typing import Any

from measure.eigensolvers import peers
from spectra_kit.catalogue import SOLVERS, SUBSPACES
from spectra_kit.eigensolvers import Eigensolver

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
    #: A module beyond the dependencies of this package, called as on PyPI, or nothing.
    needs: str = ""
    peer: bool = False  #: Whether it is another package's.
    #: Relative error of eigenvalues that it is asked for, in the mean over the modes; 0: not asked.
    accuracy: float = 0.0
    #: Whether it takes many times longer than the rest, and a quick comparison leaves it out.
    slow: bool = False

    @property
    def present(self) -> bool:
        """Whether what it needs is installed."""
        return not self.needs or find_spec(self.needs) is not None


_RTOL, _AT_RTOL = 1e-6, "1e-6"  # of every method of ours that takes one
_EXACT = "rounding"
_STOPS = {"exact": _EXACT, "to tolerance": _AT_RTOL}


def _ours(
    name: str, *, neo: str = "", device: bool = False, needs: str = "", **options: Any
) -> Method:
    """Return a solver of the catalogue; one that goes to a tolerance goes to ours.

    The network takes the place of its option `neo`; with `device` it has an option of that name.
    """
    solver = SOLVERS[name]
    if solver.promise == "to tolerance":
        options["rtol"] = _RTOL

    def make(where: str) -> Eigensolver:
        placed = {"device": where} if device else {}
        start = {neo: SUBSPACES["neo"](**placed)} if neo else {}
        made: Eigensolver = solver(**options, **start, **placed)
        return made

    return Method(
        make=make,
        stops="" if "accuracy" in options else _STOPS.get(solver.promise, ""),
        accuracy=options.get("accuracy", 0.0),
        devices=("cpu", "cuda") if device else ("cpu",),
        needs=needs,
    )


def _theirs(solver: Eigensolver, stops: str, *, needs: str = "", slow: bool = False) -> Method:
    return Method(make=lambda device: solver, stops=stops, needs=needs, peer=True, slow=slow)


#: Name -> backend, in the order of tables: predictions, solvers to a tolerance, other packages.
METHODS: dict[str, Method] = {
    "fourier": _ours("fourier", subspace=SUBSPACES["fourier"](m=320, bandwidth=7.0)),
    "neo": _ours("neo", device=True),
    "neo-2": _ours("neo", device=True, poses=2),
    "neo-raw": _ours("neo", device=True, smoothing=0),
    "neo-cap": _ours("neo", device=True, cap=2048),
    "automatic-1e-2": _ours("automatic", device=True, accuracy=1e-2),
    "automatic-1e-3": _ours("automatic", device=True, accuracy=1e-3),
    "automatic-1e-5": _ours("automatic", device=True, accuracy=1e-5),
    "automatic-1e-8": _ours("automatic", device=True, accuracy=1e-8),
    "cascade": _ours("cascade", device=True),
    "cascade-1e-5": _ours("cascade", device=True, target=1e-5),
    "refined": _ours("refined"),
    "refined-neo": _ours("refined", neo="start"),
    "arpack": _ours("arpack"),
    "eigsh": _theirs(peers.ScipyEigsh(), _EXACT),
    "eigsh-1e-6": _theirs(peers.ScipyEigsh(tol=_RTOL), _AT_RTOL),
    "eigsh-dnet": _theirs(peers.DiffusionNetEigsh(), _EXACT),
    "lapy": _theirs(peers.LapySolver(), _EXACT, needs="lapy"),
    "spectra": _theirs(peers.LibiglSpectra(), "default", slow=True),
}
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
