"""The ``spectra-kit`` command; ``spectra-kit --help`` tells what it does.

Exit codes: 0 fine, 1 a bug of ours, 2 wrong usage or bad input or output, 3 a solver failed, 130
interrupted.
"""

from spectra_kit.cli.entry import main

__all__ = ["main"]
