"""Draw random surfaces of a training corpus on one sheet, and measure what the corpus is like.

Writes SHEET.png and, beside it, SHEET.json with the statistics that it prints as a table.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from spectra_kit.errors import SpectraKitError
from spectra_kit.geometry.shapes import TriangleMesh
from spectra_kit.training.families import FAMILIES
from spectra_kit.training.samples import sample_mesh
from spectra_kit.training.shards import open_shards
from spectra_kit.training.surfaces import join
from spectra_kit.training.survey import Survey, read_config, survey
from spectra_kit.viz.camera import View
from spectra_kit.viz.render import Scene, render

NAMES = (*FAMILIES, "pool")
PITCH = 2.3  # from one surface to the next, their half size being 1


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    parser = argparse.ArgumentParser(
        prog="inspect_corpus.py",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path, help="a corpus, as make_corpus.py writes it")
    parser.add_argument("sheet", type=Path, help="picture to write, .png")
    parser.add_argument("-n", type=int, default=100, help="surfaces on the sheet (%(default)s)")
    parser.add_argument(
        "--surveyed", type=int, default=300, help="samples to measure (%(default)s)"
    )
    parser.add_argument("--pool", type=Path, help="the pool of real meshes, if the corpus has some")
    parser.add_argument("--pool-split", default="train", help="its split (%(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of the choice (%(default)s)")
    options = parser.parse_args(argv)
    pool = {"pool": options.pool, "pool_split": options.pool_split}
    try:
        config = read_config(options.folder, **pool)
        labels = open_shards(options.folder).labels
        some = np.random.default_rng(options.seed).permutation(len(labels["index"]))[: options.n]
        chosen = sorted(some, key=lambda i: labels["family"][i] % len(NAMES))
        cells = [{name: int(label[i]) for name, label in labels.items()} for i in chosen]
        draw_sheet(options.sheet, [sample_mesh(config, cell) for cell in cells], cells)
        found = survey(options.folder, n=options.surveyed, seed=options.seed, **pool)
    except SpectraKitError as error:
        print(f"inspect_corpus: {error}", file=sys.stderr)
        return 1
    options.sheet.with_suffix(".json").write_text(json.dumps(found.as_json(), indent=1) + "\n")
    print(table(found))
    return 0


def draw_sheet(path: Path, meshes: Sequence[TriangleMesh], cells: Sequence[dict[str, int]]) -> None:
    """Draw all surfaces in rows, coloured and labelled by family, a star where points crowd."""
    columns = int(np.ceil(np.sqrt(1.2 * len(meshes))))
    places = [(i % columns * PITCH, -(i // columns) * PITCH) for i in range(len(meshes))]
    placed = [_placed(mesh, place) for mesh, place in zip(meshes, places, strict=True)]
    colours = plt.get_cmap("tab20")(np.arange(len(NAMES)) % 20)[:, :3]
    family = np.array([cell["family"] % len(NAMES) for cell in cells])
    values = np.repeat((2 * family + 1) / len(NAMES) - 1, [mesh.n for mesh in placed])
    everything = join(placed)
    scene = Scene(
        geometry=everything,
        functions=[values],
        rotation=np.eye(3),
        width=170 * columns,
        colours=np.round(255 * (0.35 + 0.65 * colours)).astype(np.uint8),
    )
    ((picture,),) = render([scene])
    _label(path, picture, everything, places, [_title(cell) for cell in cells])


def _placed(mesh: TriangleMesh, place: tuple[float, float]) -> TriangleMesh:
    """Turn a mesh to its best side and fit it into a square of side 2 around `place`."""
    points = mesh.points @ View().rotation(mesh).T
    points = points - (points.min(axis=0) + points.max(axis=0)) / 2
    points = points / np.abs(points).max()
    return mesh.with_points(points + [*place, 0.0])


def _title(cell: dict[str, int]) -> str:
    return NAMES[cell["family"] % len(NAMES)] + ("*" if cell["nonuniform"] else "")


def _label(
    path: Path,
    picture: NDArray[np.uint8],
    drawn: TriangleMesh,
    places: Sequence[tuple[float, float]],
    titles: Sequence[str],
) -> None:
    height, width = picture.shape[:2]
    (left, bottom), (right, top) = (f(drawn.points[:, :2], axis=0) for f in (np.min, np.max))
    figure = plt.figure(figsize=(width / 100, height / 100 + 0.2), dpi=100)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.imshow(picture, extent=(left, right, bottom, top))
    for (x, y), title in zip(places, titles, strict=True):
        axes.text(x, y + 1.13, title, ha="center", va="center", fontsize=7, color="0.3")
    axes.set_ylim(bottom, max(top, 1.2))
    axes.set_axis_off()
    figure.savefig(path)
    plt.close(figure)


def table(found: Survey) -> str:
    """Return the statistics as lines of text."""
    facts = found.as_json()
    lines = [f"{facts['samples']} samples, {facts['nonuniform']:.1%} of them not uniform", ""]
    lines += [f"{name:12s} {n:6d}" for name, n in found.counts.families.items()]
    lines += ["", "drawn again because of"]
    lines += [f"{name:12s} {n:6d}" for name, n in found.counts.rejected.items()]
    lines += ["", f"surfaces of {facts['surveyed']} random samples"]
    lines += [f"{name:14s} {facts[name]:6.1%}" for name in ("closed", "boundary", "several_parts")]
    genus = [t.genus for t in found.topologies if t.genus is not None]
    lines += [f"genus {g:<8d} {genus.count(g):6d}" for g in sorted(set(genus))]
    spreads = {"lambda_1 area": facts["lambda_1_area"]}
    spreads |= {f"{name} / Weyl": spread for name, spread in facts["weyl_ratio"].items()}
    head = next(iter(spreads.values()))
    lines += ["", f"{'':16s}" + "".join(f"{name:>9s}" for name in head)]
    lines += [
        f"{name:16s}" + "".join(f"{value:9.3f}" for value in spread.values())
        for name, spread in spreads.items()
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
