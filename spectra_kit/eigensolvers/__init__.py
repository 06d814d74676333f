"""Interchangeable eigensolvers behind `eigensolve`."""

from spectra_kit.eigensolvers.arpack import Arpack
from spectra_kit.eigensolvers.automatic import Automatic
from spectra_kit.eigensolvers.base import Eigenpairs, Eigensolver, NotConvergedError
from spectra_kit.eigensolvers.cascade import Cascade
from spectra_kit.eigensolvers.dense import Dense
from spectra_kit.eigensolvers.many import eigensolve_many
from spectra_kit.eigensolvers.neo import Neo
from spectra_kit.eigensolvers.rayleigh_ritz import RayleighRitz
from spectra_kit.eigensolvers.refined import Refined
from spectra_kit.eigensolvers.solve import eigensolve
from spectra_kit.eigensolvers.spectrum import spectrum
from spectra_kit.eigensolvers.verification import verify

__all__ = [
    "Arpack",
    "Automatic",
    "Cascade",
    "Dense",
    "Eigenpairs",
    "Eigensolver",
    "Neo",
    "NotConvergedError",
    "RayleighRitz",
    "Refined",
    "eigensolve",
    "eigensolve_many",
    "spectrum",
    "verify",
]
