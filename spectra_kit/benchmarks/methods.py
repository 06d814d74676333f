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
    Chebyshev,
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
    stops : str
        Where it stops: at a tolerance, "rounding" of float64, its package's "default", or "" for
        a prediction, which has no such test.
    devices : tuple of str
        Where it can run.
    needs : str
        A module beyond the dependencies of this package, or nothing.
    pip : str
        What brings that module.
    peer : bool
        Whether it is another package's.
    slow : bool
        Whether it takes many times longer than the rest, and a quick comparison leaves it out.
    """

    make: Callable[[str], Eigensolver]
    stops: str = ""
    devices: tuple[str, ...] = ("cpu",)
    needs: str = ""
    pip: str = ""
    peer: bool = False
    slow: bool = False

    @property
    def options(self) -> str:
        """Every option of the backend, whatever the device; "" where it is not installed."""
        return repr(self.make("cpu")) if self.present else ""

    @property
    def present(self) -> bool:
        """Whether what it needs is installed."""
        return not self.needs or find_spec(self.needs) is not None


_BOTH = ("cpu", "cuda")
_RTOL = 1e-6  # of every method of ours that takes one
_AT_RTOL = "1e-6"
_EXACT = "rounding"

#: Name -> backend, in the order of tables: predictions, solvers to a tolerance, other packages.
METHODS: dict[str, Entry] = {
    "fourier": Entry(
        make=lambda device: RayleighRitz(subspace=AmbientFourier(m=320, bandwidth=7.0))
    ),
    "neo": Entry(make=lambda device: Neo(device=device), devices=_BOTH),
    "neo-2": Entry(make=lambda device: Neo(poses=2, device=device), devices=_BOTH),
    "neo-cap": Entry(make=lambda device: Neo(cap=4096, device=device), devices=_BOTH),
    "capped-neo-raw": Entry(
        make=lambda device: Capped(subspace=Neo().subspace, n_points=2048, sweeps=0, smoothing=0)
    ),
    "capped-neo-2k": Entry(make=lambda device: Capped(subspace=Neo().subspace, n_points=2048)),
    "capped-neo": Entry(make=lambda device: Capped(subspace=Neo().subspace)),
    "capped": Entry(make=lambda device: Capped()),
    "polished": Entry(make=lambda device: Polished()),
    "polished-neo": Entry(make=lambda device: Polished(start=Neo().subspace)),
    "multilevel": Entry(make=lambda device: Multilevel(rtol=_RTOL), stops=_AT_RTOL),
    "refined": Entry(make=lambda device: Refined(rtol=_RTOL), stops=_AT_RTOL),
    "refined-neo": Entry(
        make=lambda device: Refined(start=Neo().subspace, rtol=_RTOL), stops=_AT_RTOL
    ),
    "chebyshev": Entry(
        make=lambda device: Chebyshev(rtol=_RTOL, device=device),
        stops=_AT_RTOL,
        devices=_BOTH,
    ),
    "chebyshev-neo": Entry(
        make=lambda device: Chebyshev(start=Neo(device=device).subspace, rtol=_RTOL, device=device),
        stops=_AT_RTOL,
        devices=_BOTH,
    ),
    "lobpcg": Entry(make=lambda device: Lobpcg(rtol=_RTOL), stops=_AT_RTOL, slow=True),
    "lobpcg-amg": Entry(
        make=lambda device: Lobpcg(preconditioner="amg", rtol=_RTOL),
        stops=_AT_RTOL,
        needs="pyamg",
        pip="pyamg",
        slow=True,
    ),
    "arpack": Entry(make=lambda device: Arpack(), stops=_EXACT),
    "eigsh": Entry(make=lambda device: ScipyEigsh(), stops=_EXACT, peer=True),
    "eigsh-1e-6": Entry(make=lambda device: ScipyEigsh(tol=_RTOL), stops=_AT_RTOL, peer=True),
    "eigsh-dnet": Entry(make=lambda device: DiffusionNetEigsh(), stops=_EXACT, peer=True),
    "lapy": Entry(
        make=lambda device: LapySolver(), stops=_EXACT, needs="lapy", pip="lapy", peer=True
    ),
    "spectra": Entry(make=lambda device: LibiglSpectra(), stops="default", peer=True, slow=True),
    "lobpcg-pyamg": Entry(
        make=lambda device: PyamgLobpcg(rtol=_RTOL),
        stops=_AT_RTOL,
        needs="pyamg",
        pip="pyamg",
        peer=True,
        slow=True,
    ),
}
#: The call that everybody writes: speeds are given as multiples of its.
BASELINE = "eigsh"
#: What a quick comparison measures.
QUICK = tuple(name for name, entry in METHODS.items() if not entry.slow)
