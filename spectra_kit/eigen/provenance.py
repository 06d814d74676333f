"""Where a spectrum comes from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from spectra_kit._core.checked import checked
from spectra_kit._core.validate import Rebuilt


@checked
@dataclass(frozen=True, kw_only=True)
class Provenance(Rebuilt):
    """Where a spectrum comes from.

    Attributes
    ----------
    solver, operator : str
        The backend with its hyper-parameters, that of the largest component where it was chosen for
        each; and how the matrices were built.
    seed : int or None
        The backend's random seed, where it has one.
    seconds : mapping of str to float
        Wall time of each stage: ``assembly``, the solver's own stages, ``certify``.
    input_hash : str
        BLAKE2b of stiffness, mass, points and fixed points: equal input, equal hash.
    version : str
        Version of spectra_kit.
    iterations : int or None
        Sweeps of an iterative backend, summed over the components; None where it does not count.
    accuracy : {"exact", "to tolerance", "approximate", ""}
        What the backend goes on for; empty where it does not say.
    name : str
        The backend's in the `catalogue`, else that of its class in lower case; empty for the user's
        own modes.
    reason : str
        Why this solver, where `eigen.Automatic` chose it; empty where the user did.
    """

    solver: str = "user"
    operator: str = "user"
    seed: int | None = None
    seconds: Mapping[str, float] = field(default_factory=dict, hash=False)
    input_hash: str = ""
    version: str = ""
    iterations: int | None = None
    accuracy: str = ""
    name: str = ""
    reason: str = ""

    def __post_init__(self) -> None:
        seconds = {str(stage): float(t) for stage, t in self.seconds.items()}
        object.__setattr__(self, "seconds", MappingProxyType(seconds))

    @property
    def choice(self) -> str:
        """The name of the solver, and the reason where it was chosen, in words."""
        return f"{self.name}: {self.reason}" if self.reason else self.name

    @property
    def solving_seconds(self) -> float:
        """Seconds of the solver alone: neither assembly nor certificate nor proof."""
        besides = {"assembly", "certify", "count", "verify"}
        return sum(t for stage, t in self.seconds.items() if stage not in besides)
