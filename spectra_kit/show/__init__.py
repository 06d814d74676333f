"""Pictures of functions and distances on geometries, of maps between them, and of spectra.

No display is needed: PyVista draws the panels off-screen in a process of its own, Matplotlib sets
the page around them. Neither is imported before a picture is drawn. A plot shows itself in a
notebook, and is written to the file that is given as its `path`.
"""

from spectra_kit.show.animation import animate_modes
from spectra_kit.show.camera import View
from spectra_kit.show.convergence import SolverRun, plot_convergence
from spectra_kit.show.curves import plot_curves, plot_vectors
from spectra_kit.show.cut import cut_open
from spectra_kit.show.fields import Panel, plot_fields, plot_panels
from spectra_kit.show.isolines import plot_distance
from spectra_kit.show.layout import Page
from spectra_kit.show.maps import (
    MatchedPair,
    plot_correspondence,
    plot_correspondences,
    plot_error_curves,
    plot_functional_map,
)
from spectra_kit.show.modes import plot_comparison, plot_modes
from spectra_kit.show.picture import Picture
from spectra_kit.show.signatures import plot_signatures
from spectra_kit.show.spectra import plot_spectrum
from spectra_kit.show.thumbnails import Thumbnail, plot_thumbnails

__all__ = [
    "MatchedPair",
    "Page",
    "Panel",
    "Picture",
    "SolverRun",
    "Thumbnail",
    "View",
    "animate_modes",
    "cut_open",
    "plot_comparison",
    "plot_convergence",
    "plot_correspondence",
    "plot_correspondences",
    "plot_curves",
    "plot_distance",
    "plot_error_curves",
    "plot_fields",
    "plot_functional_map",
    "plot_modes",
    "plot_panels",
    "plot_signatures",
    "plot_spectrum",
    "plot_thumbnails",
    "plot_vectors",
]
