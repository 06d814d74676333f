"""``python -m spectra_kit`` is ``spectra-kit``."""

import sys

from spectra_kit.cli import main

if __name__ == "__main__":
    sys.exit(main())
