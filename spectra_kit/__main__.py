"""``python -m spectra_kit`` is ``spectra-kit``."""

import os
import signal
import sys

_INTERRUPTED = 130


def main(argv: list[str] | None = None) -> int:
    """Run ``spectra-kit`` and return its exit code; Ctrl-C ends it quietly from the start on."""
    first = signal.getsignal(signal.SIGINT)
    if first is signal.default_int_handler:  # where it is ignored, it stays so
        # Imports must not meet a KeyboardInterrupt: some turn it into errors of their own.
        signal.signal(signal.SIGINT, lambda *_: os._exit(_INTERRUPTED))
    from spectra_kit.cli import main as command_line

    try:
        return command_line(argv, ready=lambda: signal.signal(signal.SIGINT, first))
    except KeyboardInterrupt:
        return _INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
