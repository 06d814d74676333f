"""Distance solvers side by side: iterations, seconds from the arrays on, errors, agreement.

Data flows `contenders` (ours and other packages, under one interface) -> `process` (each in a
process of its own, warm) -> `measure` (everything on one mesh; `truth` has the exact distances,
kept on disk) and `ball` (rates on the sphere) -> `report`.
"""

from spectra_kit.benchmarks.geodesics.ball import measure_ball
from spectra_kit.benchmarks.geodesics.contenders import CONTENDERS
from spectra_kit.benchmarks.geodesics.measure import Settings, measure_mesh
from spectra_kit.benchmarks.geodesics.problems import NamedMesh, problems_named
from spectra_kit.benchmarks.geodesics.report import write_geodesic_report
from spectra_kit.benchmarks.geodesics.truth import ExactCache

__all__ = [
    "CONTENDERS",
    "ExactCache",
    "NamedMesh",
    "Settings",
    "measure_ball",
    "measure_mesh",
    "problems_named",
    "write_geodesic_report",
]
