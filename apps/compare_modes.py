"""Draw exact and predicted modes of a demo animal beside each other; print a table of errors.

    python apps/compare_modes.py

is `spectra-kit compare demo -o compare_modes.png`; with arguments it is `spectra-kit compare`.
"""

import sys

from spectra_kit.__main__ import main

if __name__ == "__main__":
    sys.exit(main(["compare", *(sys.argv[1:] or ["demo", "-o", "compare_modes.png"])]))
