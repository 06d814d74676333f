"""Time the explorer's page in headless Chromium, without a graphics card.

    spectra-kit explore bunny.obj -o bunny.html
    python apps/studies/run.py explorer OUT bunny.html

Each step sets the slider and sends its event. It is "presented" when the second animation frame
after that begins, and "drawn" when the software renderer has finished, which frames do not wait
for. While the slider moves, slow renderers draw coarsely, and plot and table wait until it pauses;
the "sharp" frame is that at rest. Needs the extra `dev`, and Chromium.
"""

from __future__ import annotations

import argparse
import shutil
import statistics
from pathlib import Path

from spectra_kit._core.validate import check_count
from spectra_kit.errors import InvalidInputError, MissingDependencyError
from studies.machine import describe_machine
from studies.report import Table, write_report
from studies.store import Record

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


def measure_page(page: Path, steps: int) -> Record:
    """Open a page, as ``spectra-kit explore`` writes it, and move its slider.

    Returns lists ``opened``, ``presented``, ``drawn`` and ``sharp``, in milliseconds.
    """
    if not page.is_file():
        raise InvalidInputError("page", "be a file", str(page))
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        raise MissingDependencyError(
            "there is no Chromium to time the page in", advice="apt-get install chromium"
        )
    from playwright.sync_api import sync_playwright

    with sync_playwright() as tools:
        browser = tools.chromium.launch(executable_path=chromium, args=FLAGS)
        tab = browser.new_page(viewport={"width": 1440, "height": 900})
        tab.goto(page.resolve().as_uri())
        tab.wait_for_selector("body.ready", timeout=120_000)
        opened = tab.evaluate("performance.now()")
        measured: Record = tab.evaluate(MEASURE, steps)
        browser.close()
    return {"opened": [opened], **measured}


def options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("page", type=Path, metavar="HTML", help="as `spectra-kit explore` writes it")
    add("--steps", type=int, default=30, help="of the slider (%(default)s)")


def measure(args: argparse.Namespace) -> None:
    check_count("steps", args.steps, low=1)
    found = measure_page(args.page, args.steps)
    rows = [
        {"milliseconds": name, "median": statistics.median(took), "most": max(took)}
        for name, took in found.items()
    ]
    columns = {"milliseconds": "", "median": ".0f", "most": ".0f"}
    megabytes = args.page.stat().st_size / 1e6
    table = Table(f"A page of {megabytes:.1f} MB", rows, columns)
    write_report(args.out, "explorer", [], [table], describe_machine(), found=found)
