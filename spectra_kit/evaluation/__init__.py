"""Measuring approximate solvers against exact ones: cases, measurements, studies, reports.

Data flows `models` (surfaces) -> `cases` (points on them, an operator) and `methods` (subspaces)
-> `bench` (measures one on the other, and remembers) -> `studies` (questions) -> `report`.
"""

from spectra_kit.evaluation.bench import Bench, Failure, Measurement
from spectra_kit.evaluation.cases import Case
from spectra_kit.evaluation.curves import Curve, training_curve
from spectra_kit.evaluation.figures import draw_worst
from spectra_kit.evaluation.methods import Method, Weights, fourier, joined, neo
from spectra_kit.evaluation.models import Model, demo_models, models_in, procedural_models
from spectra_kit.evaluation.report import write_report, write_summary, write_training
from spectra_kit.evaluation.studies import STUDIES, Answer, Settings, run_study

__all__ = [
    "STUDIES",
    "Answer",
    "Bench",
    "Case",
    "Curve",
    "Failure",
    "Measurement",
    "Method",
    "Model",
    "Settings",
    "Weights",
    "demo_models",
    "draw_worst",
    "fourier",
    "joined",
    "models_in",
    "neo",
    "procedural_models",
    "run_study",
    "training_curve",
    "write_report",
    "write_summary",
    "write_training",
]
