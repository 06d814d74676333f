"""What is measured: a name for each backend, ours and those of other packages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec

from spectra_kit.benchmarks.peers import (
    DiffusionNetEigsh,
    LapySolver,
    LibiglSpectra,
    PyamgLobpcg,
    ScipyEigsh,
)
from spectra_kit.eigensolvers import (
    Arpack,
    Capped,
    Eigensolver,
    Lobpcg,
    Multilevel,
    Neo,
    Polished,
    RayleighRitz,
    Refined,
)
from spectra_kit.subspaces import AmbientFourier


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A backend to measure.

    Attributes
    ----------
    make : callable
        From the device, "cpu" or "cuda", to the backend.
    devices : tuple of str
        Where it can run.
    needs : str
        A module beyond the dependencies of this package, or nothing.
    pip : str
        What brings that module.
    peer : bool
        Whether it is another package's.
    """

    make: Callable[[str], Eigensolver]
    devices: tuple[str, ...] = ("cpu",)
    needs: str = ""
    pip: str = ""
    peer: bool = False

    @property
    def present(self) -> bool:
        """Whether what it needs is installed."""
        return not self.needs or find_spec(self.needs) is not None


_BOTH = ("cpu", "cuda")
_RTOL = 1e-6  # of every method that takes one; without it they solve to machine precision

#: Name -> backend, in the order of tables: predictions, solvers to a tolerance, other packages.
METHODS: dict[str, Entry] = {
    "fourier": Entry(
        make=lambda device: RayleighRitz(subspace=AmbientFourier(m=320, bandwidth=7.0))
    ),
    "neo": Entry(make=lambda device: Neo(device=device), devices=_BOTH),
    "neo-2": Entry(make=lambda device: Neo(poses=2, device=device), devices=_BOTH),
    "neo-cap": Entry(make=lambda device: Neo(cap=4096, device=device), devices=_BOTH),
    "capped": Entry(make=lambda device: Capped()),
    "capped-neo": Entry(make=lambda device: Capped(subspace=Neo().subspace)),
    "polished": Entry(make=lambda device: Polished()),
    "polished-neo": Entry(make=lambda device: Polished(start=Neo().subspace)),
    "multilevel": Entry(make=lambda device: Multilevel(rtol=_RTOL)),
    "refined": Entry(make=lambda device: Refined(rtol=_RTOL)),
    "refined-neo": Entry(make=lambda device: Refined(start=Neo().subspace, rtol=_RTOL)),
    "chebyshev": Entry(
        make=lambda device: Refined(method="chebyshev", rtol=_RTOL, device=device), devices=_BOTH
    ),
    "lobpcg": Entry(make=lambda device: Lobpcg(rtol=_RTOL)),
    "lobpcg-amg": Entry(
        make=lambda device: Lobpcg(preconditioner="amg", rtol=_RTOL), needs="pyamg", pip="pyamg"
    ),
    "arpack": Entry(make=lambda device: Arpack()),
    "eigsh": Entry(make=lambda device: ScipyEigsh(), peer=True),
    "eigsh-dnet": Entry(make=lambda device: DiffusionNetEigsh(), peer=True),
    "lapy": Entry(make=lambda device: LapySolver(), needs="lapy", pip="lapy", peer=True),
    "spectra": Entry(make=lambda device: LibiglSpectra(), peer=True),
    "lobpcg-pyamg": Entry(
        make=lambda device: PyamgLobpcg(rtol=_RTOL), needs="pyamg", pip="pyamg", peer=True
    ),
}
#: The call that everybody writes: speeds are given as multiples of its.
BASELINE = "eigsh"
