"""Measuring point maps on sets with known correspondences.

Data flows `subjects` (meshes with landmarks) -> `protocols` (pairs) -> `spectra` (of each backend)
-> `methods` (point maps) -> `measure` (errors) -> `runner` (side by side, remembered) -> `report`.
"""

from spectra_kit.evaluation.matching.figures import draw_extremes
from spectra_kit.evaluation.matching.measure import THRESHOLDS, PairResult, measure_pair
from spectra_kit.evaluation.matching.methods import METHODS, Outcome, Side
from spectra_kit.evaluation.matching.protocols import PROTOCOLS, Protocol, make_protocol
from spectra_kit.evaluation.matching.report import write_matching_report
from spectra_kit.evaluation.matching.runner import Run, Settings, make_tasks, run_tasks
from spectra_kit.evaluation.matching.spectra import BACKENDS, KINDS
from spectra_kit.evaluation.matching.subjects import (
    Subject,
    demo_subjects,
    subjects_in,
    truth_between,
)
from spectra_kit.evaluation.matching.summaries import Summary, summarize_runs
from spectra_kit.evaluation.matching.table import PairTable, Task

__all__ = [
    "BACKENDS",
    "KINDS",
    "METHODS",
    "PROTOCOLS",
    "THRESHOLDS",
    "Outcome",
    "PairResult",
    "PairTable",
    "Protocol",
    "Run",
    "Settings",
    "Side",
    "Subject",
    "Summary",
    "Task",
    "demo_subjects",
    "draw_extremes",
    "make_protocol",
    "make_tasks",
    "measure_pair",
    "run_tasks",
    "subjects_in",
    "summarize_runs",
    "truth_between",
    "write_matching_report",
]
