"""Eigensolvers side by side: time, memory and accuracy of every backend and of other packages.

Data flows `problems` (a geometry at a number of points, its operator) and `methods` (backends, and
the `peers` wrapped as backends) -> `measure` (each in a process of its own, see `worker`) ->
`results` (medians, exponents) -> `report` (JSON, tables, plots).
"""

from spectra_kit.benchmarks.machine import describe_machine
from spectra_kit.benchmarks.measure import Settings, measure
from spectra_kit.benchmarks.methods import METHODS, Entry
from spectra_kit.benchmarks.problems import Problem
from spectra_kit.benchmarks.report import write_report
from spectra_kit.benchmarks.results import Result, fit_exponent, summarize

__all__ = [
    "METHODS",
    "Entry",
    "Problem",
    "Result",
    "Settings",
    "describe_machine",
    "fit_exponent",
    "measure",
    "summarize",
    "write_report",
]
