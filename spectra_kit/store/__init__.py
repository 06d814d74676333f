"""Spectra of many shapes: a folder in which each is computed once, and what is computed of them.

===============  ==============================================================================
`SpectrumStore`  the folder: shapes, spectra and signatures, each under a hash of what made it
`Plan`           what is computed of every shape, and how
`complete`       a file, by its name: computed, unless the store has it already
`ShapeRecord`    what a store holds for a name
===============  ==============================================================================

>>> import tempfile
>>> import spectra_kit as sk
>>> store = sk.store.SpectrumStore(tempfile.mkdtemp())
>>> store.spectrum(sk.geometry.creature(600), sk.store.Plan(k=12)).k
12
"""

from spectra_kit.store.complete import Completed, complete
from spectra_kit.store.files import Damage, ShapeRecord, StoredEntry
from spectra_kit.store.plan import Plan
from spectra_kit.store.store import SpectrumStore

__all__ = [
    "Completed",
    "Damage",
    "Plan",
    "ShapeRecord",
    "SpectrumStore",
    "StoredEntry",
    "complete",
]
