"""Pictures of functions on meshes and clouds, written as PNG without a display.

PyVista draws the panels off-screen in a process of its own, Matplotlib sets the page around them.
Neither is imported before a picture is drawn.
"""

from spectra_kit.viz.modes import plot_comparison
from spectra_kit.viz.page import Panel, plot_panels

__all__ = ["Panel", "plot_comparison", "plot_panels"]
