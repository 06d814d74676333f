"""Draw every picture of the README and the documentation again.

    python apps/make_pictures.py                  # all, into docs/pictures
    python apps/make_pictures.py hero modes       # some
    python apps/make_pictures.py --out OUT --dpi 100
    python apps/make_pictures.py --data DATA real_modes real_comparison real_distance

Everything is computed here, from procedural surfaces; only those of `real_...` are of shapes that
people made, and are left out unless --data (or SPECTRA_KIT_DATA) names the folder that has them:
ood_public/koala.npz, spot.npz and hammer.npz, whose licences allow it. The two of the explorer are
screenshots and need Chromium and Playwright (extra `dev`); `convergence` shows the seconds of this
machine, `pareto` those that the study eigensolvers measured and apps/results keeps. Needs the
extra `dev`, and a few minutes.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import runpy
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from hero import draw_hero
from studies.plots import ParetoPoint, plot_pareto

import spectra_kit as sk
from spectra_kit import show
from spectra_kit.cli import main as spectra_kit_command
from spectra_kit.eigen.metrics import Comparison, compare_spectra
from spectra_kit.errors import SpectraKitError
from spectra_kit.features import farthest_points, heat_kernel_signature, heat_times
from spectra_kit.geometry import creature, creature_pair, sample
from spectra_kit.show.explorer import write_explorer

ROOT = Path(__file__).parents[1]
MEASURED = ROOT / "apps/results/cpu.json"  # eigensolvers.json of the study


@dataclass(frozen=True)
class Studio:
    """What several pictures share, computed when first asked for."""

    out: Path
    dpi: int
    data: Path | None = None

    def path(self, name: str) -> Path:
        """Where a picture goes."""
        return self.out / name

    def shape(self, name: str) -> sk.TriangleMesh:
        """A mesh that somebody made."""
        if self.data is None:
            raise sk.InvalidInputError("name the folder of real shapes with --data")
        mesh = sk.read(self.data / "ood_public" / f"{name}.npz", kind="mesh")
        assert isinstance(mesh, sk.TriangleMesh)
        return mesh

    @cached_property
    def animal(self) -> sk.TriangleMesh:
        """The demo."""
        return creature(12000, seed=0)

    @cached_property
    def exact(self) -> sk.Spectrum:
        """Its modes."""
        return sk.eigensolve(sk.robust_laplacian(self.animal), 96)

    @cached_property
    def predicted(self) -> sk.Spectrum:
        """As the network has them."""
        return sk.eigensolve(sk.robust_laplacian(self.animal), 96, sk.Neo())

    @cached_property
    def comparison(self) -> Comparison:
        """Of the two."""
        return compare_spectra(self.exact, self.predicted)

    @cached_property
    def pair(self) -> tuple[sk.TriangleMesh, sk.TriangleMesh, sk.Match]:
        """The animal in two poses, of other triangles, and the map found between them."""
        source, target, _ = creature_pair(8000, 7200, seed=1)
        prepared = [
            sk.prepare(sk.eigensolve(sk.robust_laplacian(mesh), 150), mesh)
            for mesh in (source, target)
        ]
        return source, target, sk.match(*prepared)

    @cached_property
    def nose(self) -> int:
        """The foremost vertex of the animal."""
        return int(self.animal.points[:, 0].argmax())


def hero(studio: Studio) -> None:
    """What the toolkit is for, on one strip."""
    draw_hero(
        studio.path("hero.png"),
        studio.animal,
        studio.exact,
        studio.predicted,
        studio.comparison,
        source=studio.nose,
        pair=studio.pair,
        dpi=studio.dpi,
    )


def modes(studio: Studio) -> None:
    """A gallery of modes."""
    show.plot_modes(
        studio.animal,
        studio.exact,
        path=studio.path("modes.png"),
        modes=(1, 2, 3, 5, 8, 12, 20, 33, 54),
        page=show.Page("The lowest modes of a surface, with their nodal lines", dpi=studio.dpi),
    )


def comparison(studio: Studio) -> None:
    """Exact, predicted, difference."""
    show.plot_comparison(
        studio.animal,
        studio.exact,
        studio.predicted,
        studio.comparison,
        path=studio.path("comparison.png"),
        modes=(5, 20, 50),
        names=("exact: Arpack()", "predicted: Neo()"),
        page=show.Page(dpi=studio.dpi),
    )


def cloud(studio: Studio) -> None:
    """Modes of points."""
    points = sample(studio.animal, 8000, seed=0)
    show.plot_modes(
        points,
        sk.eigensolve(sk.delaunay_laplacian(points), 40),
        path=studio.path("cloud.png"),
        modes=(2, 8, 33),
        page=show.Page("The same surface as 8,000 points", dpi=studio.dpi),
    )


def spectrum(studio: Studio) -> None:
    """Eigenvalues and what is certain of them."""
    show.plot_spectrum(
        {"Arpack()": studio.exact, "Neo()": studio.predicted},
        path=studio.path("spectrum.png"),
        page=show.Page("96 eigenvalues, exact and predicted", dpi=studio.dpi),
    )


def signatures(studio: Studio) -> None:
    """The heat kernel signature."""
    times = heat_times(studio.exact, 60)
    show.plot_signatures(
        studio.animal,
        heat_kernel_signature(studio.exact, times),
        times,
        path=studio.path("signatures.png"),
        points=farthest_points(studio.exact, 5),
        page=show.Page("Heat kernel signature", dpi=studio.dpi),
    )


def distance(studio: Studio) -> None:
    """Geodesic distances from the nose."""
    field = sk.HeatGeodesics(studio.animal, studio.exact).distance(studio.nose)
    show.plot_distance(
        studio.animal,
        field.distance,
        path=studio.path("distance.png"),
        sources=studio.animal.points[[studio.nose]],
        page=show.Page("Geodesic distances by the heat method", dpi=studio.dpi),
    )


def paths(studio: Studio) -> None:
    """Shortest ways from the nose."""
    from_nose = sk.geodesics.GeodesicPaths(studio.animal, studio.nose)
    show.plot_curves(
        studio.animal,
        [from_nose.to(int(tip)) for tip in farthest_points(studio.exact, 10)],
        path=studio.path("paths.png"),
        page=show.Page("Shortest paths from the nose", dpi=studio.dpi),
    )


def vectors(studio: Studio) -> None:
    """The field that turns least."""
    show.plot_vectors(
        studio.animal,
        sk.geodesics.smoothest_field(studio.animal),
        path=studio.path("vectors.png"),
        page=show.Page("The smoothest field of tangent vectors", dpi=studio.dpi),
    )


def curvature(studio: Studio) -> None:
    """How the animal bends."""
    bent = sk.operators.curvature(studio.animal)
    show.plot_fields(
        studio.animal,
        {"mean curvature": bent.mean, "Gaussian curvature": bent.gaussian},
        path=studio.path("curvature.png"),
        page=show.Page(dpi=studio.dpi),
    )


def match(studio: Studio) -> None:
    """A map between two poses."""
    source, target, found = studio.pair
    show.plot_correspondence(
        source,
        target,
        found.point_map,
        path=studio.path("match.png"),
        transfer="texture",
        names=("source", "target, textured by the map"),
        view=show.View("z"),
        page=show.Page(dpi=studio.dpi),
    )


def animation(studio: Studio) -> None:
    """Modes that swing."""
    show.animate_modes(
        studio.animal, studio.exact, path=studio.path("modes.gif"), modes=(2, 8, 20), width=320
    )


def real_modes(studio: Studio) -> None:
    """A gallery of modes of a toy."""
    mesh = studio.shape("koala")
    show.plot_modes(
        mesh,
        sk.eigensolve(sk.robust_laplacian(mesh), 40),
        path=studio.path("real_modes.png"),
        modes=(1, 5, 12, 33),
        columns=4,
        page=show.Page("Modes of a koala of 49,999 vertices", dpi=studio.dpi),
    )


def real_comparison(studio: Studio) -> None:
    """Exact, predicted, difference, of a cow that the network has not seen."""
    mesh = studio.shape("spot")
    laplacian = sk.robust_laplacian(mesh)
    exact, predicted = (sk.eigensolve(laplacian, 40, s) for s in (sk.Arpack(), sk.Neo()))
    show.plot_comparison(
        mesh,
        exact,
        predicted,
        compare_spectra(exact, predicted),
        path=studio.path("real_comparison.png"),
        modes=(20,),
        names=("exact: Arpack()", "predicted: Neo()"),
        page=show.Page(dpi=studio.dpi),
    )


def real_distance(studio: Studio) -> None:
    """Geodesic distances on a tool that was scanned."""
    mesh = studio.shape("hammer")
    source = int(mesh.points[:, 1].argmax())
    show.plot_distance(
        mesh,
        sk.HeatGeodesics(mesh).distance(source).distance,
        path=studio.path("real_distance.png"),
        sources=mesh.points[[source]],
        page=show.Page("Distances on a scanned hammer", dpi=studio.dpi),
    )


def convergence(studio: Studio) -> None:
    """How the solvers of the heat method's Poisson step converge."""
    with tempfile.TemporaryDirectory() as folder:
        command = ["geodesic", "demo", "--points", "30000", "--compare", "-o", folder]
        with contextlib.redirect_stdout(io.StringIO()):  # its table
            failed = spectra_kit_command([*command, "--dpi", str(studio.dpi)])
        if failed:
            raise SpectraKitError("`spectra-kit geodesic --compare` failed")
        shutil.copyfile(Path(folder) / "convergence.png", studio.path("convergence.png"))


def pareto(studio: Studio) -> None:
    """Time and error of the solvers over the set of real shapes, as they were measured."""
    record = json.loads(MEASURED.read_text())
    machine, found = record["machine"], record["summaries"]["all"]
    points = []
    for one in found:
        method = record["methods"][one["method"]]
        exact = f"to {method['stops_at']}" if method["stops_at"] else "approximate"
        time, error = one["slowdown"], one["eigenvalue_error"]
        points.append(
            ParetoPoint(
                name=one["method"],
                group="other packages" if method["peer"] else exact,
                seconds=time["mean"],
                error=error["mean"],
                worst=(time["worst"], error["worst"]),
            )
        )
    plot_pareto(
        points,
        path=studio.path("pareto.png"),
        xlabel="time, eigsh = 1: geometric mean; bars lead to the worst",
        ylabel="mean relative error of the eigenvalues",
        page=show.Page(
            "Which solver when",
            f"{record['settings']['k']} modes of {found[0]['members']} real meshes and clouds;"
            f" {machine['cores']} cores, {machine['accelerator'] or 'no GPU'}",
            studio.dpi,
        ),
    )


def explorer(studio: Studio) -> None:
    """Screenshots of the explorer, light and dark."""
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        page_path = Path(folder) / "explorer.html"
        write_explorer(
            page_path,
            studio.animal,
            studio.exact,
            studio.predicted,
            comparison=studio.comparison,
            title="demo animal",
        )
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium") or shutil.which("google-chrome"),
            args=["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"],
        )
        for scheme, name in (("light", "explorer.png"), ("dark", "explorer_dark.png")):
            page = browser.new_page(
                viewport={"width": 1440, "height": 900},
                color_scheme=scheme,  # type: ignore[arg-type]
            )
            page.goto(page_path.as_uri())
            page.wait_for_selector("body.ready")
            for _ in range(20):
                page.keyboard.press("ArrowRight")
            page.wait_for_timeout(4000)  # what has moved is drawn coarsely for a while
            page.screenshot(path=studio.path(name))
            page.close()
        browser.close()


def architecture(studio: Studio) -> None:
    """The packages and what they import."""
    drawn = runpy.run_path(str(ROOT / "docs" / "architecture.py"))
    drawn["draw_architecture"](studio.path("architecture.svg"))


PICTURES: dict[str, Callable[[Studio], None]] = {
    draw.__name__: draw
    for draw in (
        hero,
        modes,
        comparison,
        cloud,
        spectrum,
        signatures,
        distance,
        paths,
        vectors,
        curvature,
        match,
        animation,
        real_modes,
        real_comparison,
        real_distance,
        convergence,
        pareto,
        explorer,
        architecture,
    )
}


def main(argv: Sequence[str] | None = None) -> int:
    """Draw what was asked for; return the exit code."""
    parser = argparse.ArgumentParser(
        prog="make_pictures.py",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help=f"some of: {', '.join(PICTURES)} (default: all)"
    )
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "pictures", help="%(default)s")
    parser.add_argument("--dpi", type=int, default=120, help="of the pages (%(default)s)")
    root = os.environ.get("SPECTRA_KIT_DATA")
    parser.add_argument("--data", type=Path, default=root, help="folder of real shapes")
    options = parser.parse_args(argv)
    if unknown := sorted(set(options.names) - set(PICTURES)):
        parser.error(f"no pictures {', '.join(unknown)}; there are {', '.join(PICTURES)}")
    options.out.mkdir(parents=True, exist_ok=True)
    studio = Studio(options.out, options.dpi, options.data)
    for name in options.names or PICTURES:
        start = time.perf_counter()
        if not options.names and name.startswith("real_") and studio.data is None:
            print(f"{name}: left out, name the folder of real shapes with --data", file=sys.stderr)
            continue
        PICTURES[name](studio)
        print(f"{name}: {time.perf_counter() - start:.1f} s", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
