"""Time the explorer's page in headless Chromium, without a graphics card.

    spectra-kit explore bunny.obj -o bunny.html
    python apps/benchmark_explorer.py bunny.html

Each step sets the slider and sends its event. It is "presented" when the second animation frame
after that begins, and "drawn" when the software renderer has finished, which frames do not wait
for. While the slider moves, slow renderers draw coarsely, and plot and table wait until it pauses;
the sharp frame is that at rest. Needs the extra `dev`, and Chromium.
"""

from __future__ import annotations

import argparse
import statistics
import sys
from collections.abc import Sequence
from pathlib import Path

from measure.command import exit_code, parser_of
from measure.explorer import measure_page

from spectra_kit._core.validate import check_count


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, print the table, return the exit code."""
    parser = parser_of("benchmark_explorer.py", __doc__)
    add = parser.add_argument
    add("page", type=Path, metavar="HTML", help="as `spectra-kit explore` writes it")
    add("--steps", type=int, default=30, help="of the slider (%(default)s)")
    args = parser.parse_args(argv)
    return exit_code(lambda: _measure(args))


def _measure(args: argparse.Namespace) -> None:
    check_count("steps", args.steps, low=1)
    found = measure_page(args.page, args.steps)
    print(f"{args.page.stat().st_size / 1e6:.1f} MB, open after {found['opened'] / 1000:.1f} s")
    for name, milliseconds in (
        ("a step, presented", found["presented"]),
        ("a step, drawn", found["drawn"]),
        ("at rest, drawn sharply", found["sharp"]),
    ):
        middle = statistics.median(milliseconds)
        print(f"{name:24} median {middle:6.0f} ms   max {max(milliseconds):6.0f} ms")


if __name__ == "__main__":
    sys.exit(main())
