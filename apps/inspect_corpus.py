"""Draw random surfaces of a training corpus on one sheet, and measure what the corpus is like.

Writes SHEET.png and, beside it, SHEET.json with the statistics that it prints as a table.
"""

from __future__ import annotations

import json
import sys
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from studies.command import exit_code, parser_of

from spectra_kit.errors import InvalidInputError
from spectra_kit.geometry.shapes import TriangleMesh
from spectra_kit.neo.train.corpus import (
    Corpus,
    claim,
    count,
    open_shards,
    read_fingerprint,
)
from spectra_kit.neo.train.families import FAMILIES
from spectra_kit.neo.train.samples import CorpusConfig, sample_mesh
from spectra_kit.neo.train.surfaces import join
from spectra_kit.show.camera import View
from spectra_kit.show.render import Scene, render

NAMES = (*FAMILIES, "pool")
PITCH = 2.3  # from one surface to the next, their half size being 1


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    parser = parser_of("inspect_corpus.py", __doc__)
    add = parser.add_argument
    add("folder", type=Path, help="a corpus, as make_corpus.py writes it")
    add("sheet", type=Path, help="picture to write, .png")
    add("-n", type=int, default=100, help="surfaces on the sheet (%(default)s)")
    add("--only", type=int, nargs="+", help="draw these samples, by index, such as the worst")
    add("--surveyed", type=int, default=300, help="samples to measure (%(default)s)")
    add("--pool", type=Path, help="the pool of real meshes, if the corpus has some")
    add("--pool-split", default="train", help="its split (%(default)s)")
    add("--seed", type=int, default=0, help="of the choice (%(default)s)")
    options = parser.parse_args(argv)
    return exit_code(lambda: _inspect(options))


def _inspect(options: Namespace) -> None:
    config = read_config(options.folder, options.pool, options.pool_split)
    corpus = open_shards(options.folder)
    order = np.random.default_rng(options.seed).permutation(len(corpus))
    some = sorted(order[: options.n], key=lambda i: corpus.labels["family"][i] % len(NAMES))
    if options.only is not None:
        some = _places(corpus, options.only)
    cells = labels_of(corpus, some)
    draw_sheet(options.sheet, [sample_mesh(config, cell) for cell in cells], cells)
    found = survey(corpus, config, order[: options.surveyed])
    options.sheet.with_suffix(".json").write_text(json.dumps(found, indent=1) + "\n")
    print(table(found))


def _places(corpus: Corpus, indices: Sequence[int]) -> list[int]:
    """Return where in a corpus the samples of these indices are."""
    there = {int(index): place for place, index in enumerate(corpus.labels["index"])}
    if missing := sorted(set(indices) - there.keys()):
        raise InvalidInputError("--only", f"be indices of the {len(there)} samples", missing)
    return [there[index] for index in indices]


def read_config(folder: Path, pool: Path | None = None, pool_split: str = "train") -> CorpusConfig:
    """Read the configuration that a corpus was made with; a pool is known by its content only."""
    path = folder / "corpus.json"
    if not path.is_file():
        raise InvalidInputError("folder", "hold a corpus with its corpus.json", folder)
    stored = read_fingerprint(path)
    names = ("seed", "n_points", "k", "shard_size", "nonuniform", "pool_share", "mesh_share")
    values = {name: stored[name] for name in names if name in stored}
    weights = stored.get("families", {})
    values["weights"] = {k: w for k, w in weights.items() if k in FAMILIES and w != FAMILIES[k][1]}
    config = CorpusConfig(pool=pool, pool_split=pool_split, **values)
    claim(folder, config)
    return config


def labels_of(corpus: Corpus, places: Sequence[int]) -> list[dict[str, int]]:
    """Return what the samples at these places of a corpus are."""
    return [{name: int(label[i]) for name, label in corpus.labels.items()} for i in places]


@dataclass(frozen=True)
class Topology:
    """Parts, boundary and genus of a mesh; the genus, of all parts, where it is closed."""

    parts: int
    closed: bool
    boundary: bool
    genus: int | None


def topology(mesh: TriangleMesh) -> Topology:
    """Find parts, boundary and genus; corners a millionth apart count as one."""
    size = float(np.ptp(mesh.points, axis=0).max()) or 1.0
    rounded = mesh.with_points(np.round(mesh.points / (1e-6 * size)) + 0.0)
    whole = rounded.with_merged_vertices()
    proper = (whole.faces != np.roll(whole.faces, 1, axis=1)).all(axis=1)
    whole = TriangleMesh(whole.points, whole.faces[proper]).without_unreferenced()
    edges, faces_of_edge = whole.unique_edges
    parts, closed = int(whole.component_labels.max()) + 1, bool((faces_of_edge == 2).all())
    twice = 2 * parts - (whole.n - len(edges) + len(whole.faces))  # Euler: 2 - 2 g for each part
    genus = twice // 2 if closed and twice >= 0 and twice % 2 == 0 else None
    return Topology(parts, closed, bool((faces_of_edge == 1).any()), genus)


def survey(corpus: Corpus, config: CorpusConfig, places: Sequence[int]) -> dict[str, Any]:
    """Count all labels of a corpus, and measure surfaces and spectra of the samples at `places`.

    A tenth of a second each. Eigenvalues are those times the area, so without unit.
    """
    found = [topology(sample_mesh(config, one)) for one in labels_of(corpus, places)]
    values = corpus.batch(places).arrays()["eigenvalues"].astype(np.float64)
    genus = [t.genus for t in found if t.genus is not None]
    weyl = values[:, 1:] / (4 * np.pi * np.arange(1, values.shape[1]))
    return {
        **asdict(count(corpus.labels)),
        "nonuniform": float(corpus.labels["nonuniform"].mean()),
        "meshes": float(corpus.labels["mesh"].mean()),
        "surveyed": len(found),
        "closed": float(np.mean([t.closed for t in found])),
        "boundary": float(np.mean([t.boundary for t in found])),
        "several_parts": float(np.mean([t.parts > 1 for t in found])),
        "genus": {str(g): genus.count(g) for g in sorted(set(genus))},
        "lambda_1_area": _spread(values[:, 1]),
        "weyl_ratio": {f"mode {i + 1}": _spread(weyl[:, i]) for i in _some(weyl.shape[1])},
    }


def _spread(values: NDArray[np.float64]) -> dict[str, float]:
    low, middle, high = np.quantile(values, [0.05, 0.5, 0.95])
    ends = {"min": values.min(), "5%": low, "median": middle, "95%": high, "max": values.max()}
    return {name: float(value) for name, value in ends.items()}


def _some(k: int) -> list[int]:
    """A few places of k, ever further apart."""
    return [i for i in (0, 1, 3, 9, 19, 39, 59, 79) if i < k] + [k - 1]


def draw_sheet(path: Path, meshes: Sequence[TriangleMesh], cells: Sequence[dict[str, int]]) -> None:
    """Draw all surfaces in rows, coloured and labelled by family, a star where points crowd.

    With the edges of those whose vertices are the sample, and their number.
    """
    columns = int(np.ceil(np.sqrt(1.2 * len(meshes))))
    places = [(i % columns * PITCH, -(i // columns) * PITCH) for i in range(len(meshes))]
    placed = [_placed(mesh, place) for mesh, place in zip(meshes, places, strict=True)]
    colours = plt.get_cmap("tab20")(np.arange(len(NAMES)) % 20)[:, :3]
    family = np.array([cell["family"] % len(NAMES) for cell in cells])
    values = np.repeat((2 * family + 1) / len(NAMES) - 1, [mesh.n for mesh in placed])
    everything = join(placed)
    edges = [
        mesh.points[mesh.unique_edges[0]]
        for mesh, cell in zip(placed, cells, strict=True)
        if cell["mesh"]
    ]
    scene = Scene(
        geometry=everything,
        functions=[values],
        rotation=np.eye(3),
        width=170 * columns,
        colours=np.round(255 * (0.35 + 0.65 * colours)).astype(np.uint8),
        lines=[np.concatenate(edges)] if edges else None,
        line_width=0.7,
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
    name = NAMES[cell["family"] % len(NAMES)] + ("*" if cell["nonuniform"] else "")
    return f"{name}, {cell['n']} vertices" if cell["mesh"] else name


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


def table(facts: dict[str, Any]) -> str:
    """Return the statistics as lines of text."""
    lines = [
        f"{facts['samples']} samples, {facts['meshes']:.1%} of them meshes,"
        f" {facts['nonuniform']:.1%} not uniform",
        "",
    ]
    lines += [f"{name:12s} {n:6d}" for name, n in facts["families"].items()]
    lines += ["", "drawn again because of"]
    lines += [f"{name:12s} {n:6d}" for name, n in facts["rejected"].items()]
    lines += ["", f"surfaces of {facts['surveyed']} random samples"]
    lines += [f"{name:14s} {facts[name]:6.1%}" for name in ("closed", "boundary", "several_parts")]
    lines += [f"genus {g:8s} {n:6d}" for g, n in facts["genus"].items()]
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
