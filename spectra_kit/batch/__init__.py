"""Spectra of thousands of shapes: whatever names them, whoever works, one store and one table.

====================  =========================================================================
`find_inputs`         files, patterns, folders and manifests become names with paths
`compute_all`         all of them into a store; failures are told beside results
`write_table`         a row for each shape, as CSV
`find_pairs`          all shapes of a store with all others, or the pairs of a table
`match_all`           the maps of all of them into that store; `load_match` reads one
`write_match_table`   a row for each pair, as CSV
`shard`               a part of either, for runs that share nothing but the store
`DaskEngine`          the processes of this machine, or of a cluster, as workers
====================  =========================================================================

On a command line: ``spectra-kit batch FOLDER --out STORE --csv table.csv``, and then
``spectra-kit match-all STORE --pairs all --csv maps.csv``.
"""

from spectra_kit.batch.dask_engine import DaskEngine
from spectra_kit.batch.inputs import Input, Pair, find_inputs, shard
from spectra_kit.batch.match_all import FailedPair, MatchReport, match_all
from spectra_kit.batch.matched import Matched, Matching, load_match
from spectra_kit.batch.pairs import find_pairs
from spectra_kit.batch.run import BatchReport, Engine, Failed, Task, compute_all
from spectra_kit.batch.table import write_match_table, write_table

__all__ = [
    "BatchReport",
    "DaskEngine",
    "Engine",
    "Failed",
    "FailedPair",
    "Input",
    "MatchReport",
    "Matched",
    "Matching",
    "Pair",
    "Task",
    "compute_all",
    "find_inputs",
    "find_pairs",
    "load_match",
    "match_all",
    "shard",
    "write_match_table",
    "write_table",
]
