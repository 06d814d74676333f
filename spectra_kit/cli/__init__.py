"""The ``spectra-kit`` command; ``spectra-kit --help`` tells what it does.

Exit codes: 0 fine, 1 a bug of ours, 2 wrong usage or bad input or output, 3 a solver failed, 130
interrupted.

Its files take the library by its front door, ``import spectra_kit as sk``, which imports a room
once something of it is asked for; what has no public name is imported where it is used. So no help
waits for what only the command needs: that is imported before a command begins, as Ctrl-C in the
midst of an import would become an error of another kind.
"""

from spectra_kit.cli.entry import main

__all__ = ["main"]
