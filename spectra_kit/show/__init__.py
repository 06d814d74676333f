"""Pictures of functions and distances on geometries, of maps between them, and of spectra.

No display is needed: PyVista draws the panels off-screen in a process of its own, Matplotlib sets
the page around them. Neither is imported before a picture is drawn.
"""

from spectra_kit.show.animation import animate_modes
from spectra_kit.show.camera import View
from spectra_kit.show.convergence import SolverRun, plot_convergence
from spectra_kit.show.correspondence import MatchedPair, plot_correspondence, plot_correspondences
from spectra_kit.show.gallery import plot_fields, plot_panels
from spectra_kit.show.isolines import plot_distance
from spectra_kit.show.maps import plot_error_curves, plot_functional_map
from spectra_kit.show.modes import plot_comparison, plot_modes
from spectra_kit.show.page import Page
from spectra_kit.show.panels import Panel
from spectra_kit.show.pareto import ParetoPoint, pareto_front, plot_pareto
from spectra_kit.show.picture import Picture
from spectra_kit.show.portraits import Portrait, plot_portraits
from spectra_kit.show.signatures import plot_signatures
from spectra_kit.show.spectra import plot_spectrum

__all__ = [
    "MatchedPair",
    "Page",
    "Panel",
    "ParetoPoint",
    "Picture",
    "Portrait",
    "SolverRun",
    "View",
    "animate_modes",
    "pareto_front",
    "plot_comparison",
    "plot_convergence",
    "plot_correspondence",
    "plot_correspondences",
    "plot_distance",
    "plot_error_curves",
    "plot_fields",
    "plot_functional_map",
    "plot_modes",
    "plot_panels",
    "plot_pareto",
    "plot_portraits",
    "plot_signatures",
    "plot_spectrum",
]
