"""`Spectrum`: the one object every eigensolver produces and every application consumes.

What is known of its modes stands in its `Certificate`, where they come from in its `Provenance`.
"""

from spectra_kit.spectra.certificate import Certificate, ModeCount
from spectra_kit.spectra.provenance import Provenance
from spectra_kit.spectra.spectrum import Spectrum

__all__ = ["Certificate", "ModeCount", "Provenance", "Spectrum"]
