"""A spectrum to turn and to leaf through: one HTML file that opens without a network."""

from spectra_kit.show.explorer.page import Explorer, write_explorer

__all__ = ["Explorer", "write_explorer"]
