"""`Spectrum`: the one object every eigensolver produces and every application consumes.

What is known of its modes stands in its `Certificate`, where they come from in its `Provenance`.
Eigensolvers are interchangeable, behind `eigensolve`.
"""

from spectra_kit.eigen import metrics as metrics
from spectra_kit.eigen.automatic import Automatic
from spectra_kit.eigen.base import Eigenpairs, Eigensolver, NotConvergedError
from spectra_kit.eigen.cascade import Cascade
from spectra_kit.eigen.certificate import Certificate, ModeCount, Provenance
from spectra_kit.eigen.counting import verify
from spectra_kit.eigen.dense import Dense
from spectra_kit.eigen.lanczos import Arpack, Lanczos
from spectra_kit.eigen.low_pass import low_pass
from spectra_kit.eigen.neo import Neo
from spectra_kit.eigen.rayleigh_ritz import RayleighRitz
from spectra_kit.eigen.refined import Refined
from spectra_kit.eigen.solve import eigensolve, eigensolve_many, spectrum
from spectra_kit.eigen.spectrum import Spectrum

__all__ = [
    "Arpack",
    "Automatic",
    "Cascade",
    "Certificate",
    "Dense",
    "Eigenpairs",
    "Eigensolver",
    "Lanczos",
    "ModeCount",
    "Neo",
    "NotConvergedError",
    "Provenance",
    "RayleighRitz",
    "Refined",
    "Spectrum",
    "eigensolve",
    "eigensolve_many",
    "low_pass",
    "spectrum",
    "verify",
]
