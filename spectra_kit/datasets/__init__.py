"""Many shapes, each computed once: a store, and runs that fill it.

===============  ==============================================================================
`SpectrumStore`  a folder: shapes, spectra, signatures and maps, under a hash of what made them
`Plan`           what is computed of every shape, and how
`complete`       a file, by its name: computed, unless the store has it already
`find_inputs`    files, patterns, folders and manifests become names with paths
`compute_all`    all of them into a store; failures are told beside results
`find_pairs`     all shapes of a store with all others, or the pairs of a table
`match_all`      the maps of all of them into that store; `load_match` reads one
`write_table`    a row for each shape, or for each pair, as CSV; `write_distances` by ShapeDNA
`shard`          a part of either, for runs that share nothing but the store
`DaskEngine`     the processes of this machine, or of a cluster, as workers
===============  ==============================================================================

>>> import tempfile
>>> import spectra_kit as sk
>>> store = sk.datasets.SpectrumStore(tempfile.mkdtemp())
>>> store.spectrum(sk.geometry.creature(600), sk.datasets.Plan(k=12)).k
12

On a command line: ``spectra-kit batch FOLDER --out STORE --csv table.csv``, and then
``spectra-kit match-all STORE --pairs all --csv maps.csv``.
"""

import lazy_loader

# The names stand in __init__.pyi: who computes shapes need not wait for what matches them.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
