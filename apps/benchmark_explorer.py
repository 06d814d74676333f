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
import shutil
import statistics
import sys
from collections.abc import Sequence
from pathlib import Path

FLAGS = [
    "--headless=new",
    "--no-sandbox",
    "--enable-unsafe-swiftshader",  # WebGL without a graphics card
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
]
# What the page itself is asked to do; milliseconds of each kind come back.
MEASURE = """async (steps) => {
  const slider = document.getElementById("slider"), { stage } = explorer;
  const gl = stage.renderer.getContext(), pixel = new Uint8Array(4);
  const next = () => new Promise(requestAnimationFrame);
  const drawn = () => gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
  const pause = (time) => new Promise(done => setTimeout(done, time));
  const timed = async (i, wait) => {
    const start = performance.now();
    slider.value = 1 + (i * 7) % Number(slider.max);
    slider.dispatchEvent(new Event("input"));
    await next();
    if (wait) drawn();
    else await next();
    const took = performance.now() - start;
    clearTimeout(stage.resting);
    return took;
  };
  const out = { presented: [], drawn: [], sharp: [] };
  do await pause(50); while (!stage.fine || stage.asked !== undefined);
  drawn();
  for (let i = 0; i < steps; i++) {
    out.presented.push(await timed(i, false));
    drawn();  // nothing of this step is left over for the next one
    await next();
  }
  for (let i = 0; i < steps; i++) {
    out.drawn.push(await timed(3 * i, true));
    await next();
  }
  for (let i = 0; i < 5; i++) {
    const start = performance.now();
    stage.detail(true);
    stage.paint();
    drawn();
    out.sharp.push(performance.now() - start);
    stage.detail(false);
    stage.paint();
    await pause(60);
  }
  return out;
}"""


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, print the table, return the exit code."""
    parser = argparse.ArgumentParser(
        prog="benchmark_explorer.py",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "page", type=Path, metavar="HTML", help="as `spectra-kit explore` writes it"
    )
    parser.add_argument("--steps", type=int, default=30, help="of the slider (%(default)s)")
    options = parser.parse_args(argv)
    if not options.page.is_file():
        parser.error(f"there is no file {options.page}")
    if options.steps < 1:
        parser.error(f"--steps must be at least 1, got {options.steps}")
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        parser.error("there is no Chromium to time the page in: apt-get install chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as tools:
        browser = tools.chromium.launch(executable_path=chromium, args=FLAGS)
        page = browser.new_page(viewport={"width": 1440, "height": 900})
        page.goto(options.page.resolve().as_uri())
        page.wait_for_selector("body.ready", timeout=120_000)
        opened = page.evaluate("performance.now()")
        measured = page.evaluate(MEASURE, options.steps)
        browser.close()
    print(f"{options.page.stat().st_size / 1e6:.1f} MB, open after {opened / 1000:.1f} s")
    for name, milliseconds in (
        ("a step, presented", measured["presented"]),
        ("a step, drawn", measured["drawn"]),
        ("at rest, drawn sharply", measured["sharp"]),
    ):
        middle = statistics.median(milliseconds)
        print(f"{name:24} median {middle:6.0f} ms   max {max(milliseconds):6.0f} ms")
    return 0


if __name__ == "__main__":
    sys.exit(main())
