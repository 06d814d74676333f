"""Spectra of thousands of shapes: whatever names them, whoever works, one store and one table.

=================  ============================================================================
`find_inputs`      files, patterns, folders and manifests become names with paths
`shard`            a part of them, for runs that share nothing but the store
`compute_all`      all of them into a store; failures are told beside results
`DaskEngine`       the processes of this machine, or of a cluster, as workers
`write_table`      a row for each shape, as CSV
=================  ============================================================================

On a command line: ``spectra-kit batch FOLDER --out STORE --csv table.csv``.
"""

from spectra_kit.batch.dask_engine import DaskEngine
from spectra_kit.batch.inputs import Input, find_inputs, shard
from spectra_kit.batch.run import BatchReport, Engine, Failed, Task, compute_all
from spectra_kit.batch.table import write_table

__all__ = [
    "BatchReport",
    "DaskEngine",
    "Engine",
    "Failed",
    "Input",
    "Task",
    "compute_all",
    "find_inputs",
    "shard",
    "write_table",
]
