"""Draw chosen modes of a shape: exact | predicted | difference, and print their table.

Without arguments: the procedural demo animal, into compare_modes.png. The options are those of
``spectra-kit compare``.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from spectra_kit.cli import add_compare_arguments, compare, run


def main(argv: Sequence[str] | None = None) -> int:
    """Run the comparison and return the exit code."""
    parser = argparse.ArgumentParser(prog="compare_modes.py", description=__doc__)
    add_compare_arguments(parser, file="demo", picture="compare_modes.png")
    return run(compare, parser.parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
