"""The commands that say what a shape is like, and what its parts are."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import spectra_kit as sk
from spectra_kit._core.files import atomic_path
from spectra_kit._core.shown import printable
from spectra_kit._core.validate import check_count
from spectra_kit.cli import options, solving, tables
from spectra_kit.cli.inputs import load
from spectra_kit.cli.output import check_output, tell
from spectra_kit.cli.progress import counted, say, step
from spectra_kit.cli.words import stem, told
from spectra_kit.errors import InvalidInputError

if TYPE_CHECKING:
    from spectra_kit.geometry import Geometry
    from spectra_kit.learn import Segmentation


@dataclass(frozen=True, kw_only=True)
class SimilarOptions(options.OneFile, options.Solver, options.Turned, options.Resolution):
    """Find the shapes of a folder that are most like one, whatever their pose, size and place."""

    examples = (
        "similar cat.off animals",
        "similar cat.off animals --index known.safetensors -o like.png",
        "similar scan.ply animals --cloud 4000 --solver neo",
    )
    keys = "input, folder, indexed, left_out, neighbours, picture"
    operands = "FILE FOLDER [options]"
    needs = ("learn",)

    folder: Path = field(kw_only=False)
    """meshes and point clouds to search"""
    k: options.Count = 96
    solver: options.SolverName = "automatic"
    count: int = 8
    """shapes to name"""
    index: Path | None = None
    """keep what was computed in this .safetensors file: only files that are new or have changed are
    embedded the next time (default: none)"""
    picture: options.Output | None = None
    """draw them (.png, .pdf, .svg) (default: none)"""


@dataclass(frozen=True, kw_only=True)
class LabelOptions(options.OneFile, options.Turned, options.Resolution):
    """Tell what a shape is, or what its parts are, by what a labeller has learned."""

    examples = (
        "label a.ply known.safetensors",
        "label body.obj bodies.safetensors -o parts.npz --picture p.png",
    )
    keys = "input, labeller, label, name, scores, parts, output, picture"
    operands = "FILE LABELLER [options]"
    needs = ("learn",)

    labeller: Path = field(kw_only=False)
    """what learn.save_labeller wrote"""
    output: options.Output | None = None
    """write the labels of points and faces, and all scores, to this .npz file (default: none)"""
    picture: Path | None = None
    """draw the parts (.png, .pdf, .svg) (default: none)"""


def similar(asked: SimilarOptions) -> None:
    """Search a folder for the shapes that are most like one, and draw them."""
    check_count("--count", asked.count, low=1)
    check_count("-k", asked.k, low=4)
    check_output(asked.picture, options.PICTURES, asked.inputs)
    check_output(asked.index, [".safetensors"], asked.inputs)
    solving.check_solvers(asked, asked.solver)
    recipe = sk.learn.Recipe(
        embeddings=(
            sk.features.WaveKernelSignature(count=32, width=1.5, first=3.0),
            sk.features.ShapeDNA(count=min(45, asked.k - 1)),
        ),
        k=asked.k,
        solver=solving.make_solver(asked.solver, asked, asked.k),
    )
    shape, _ = load(asked.file, asked)
    with step(f"embedding {asked.file}"):
        recipe.vector(shape)  # refused now, not after the folder
    known = sk.learn.ShapeIndex.load(asked.index) if asked.index and asked.index.is_file() else None
    with counted(f"embedding {asked.folder}", "file") as progress:
        index = sk.learn.index_folder(
            asked.folder,
            recipe,
            known=known,
            load=lambda file: load(file, asked)[0],
            progress=progress,
        )
    if asked.index:
        index.save(asked.index)
    left_out = {name: told(error) for name, error in index.failures.items()}
    for name, reason in left_out.items():
        say(f"warning: left out: {name}: {reason}")
    if not index.names:
        raise InvalidInputError(
            f"no file of {str(asked.folder)!r} could be embedded", advice="see the warnings above"
        )
    with step("searching"):
        found = index.nearest(shape, count=asked.count)
    record = {
        "input": asked.file,
        "folder": asked.folder,
        "indexed": len(index.names),
        "left_out": left_out,
        "neighbours": [near._asdict() for near in found],
    }
    lines = "\n".join(f"{near.distance:8.3f}  {printable(near.name)}" for near in found)

    def draw(path: Path) -> None:
        pictures = [sk.show.Thumbnail(geometry=shape, lines=(stem(asked.file), "asked for"))]
        for near in found:
            other, _ = load(str(asked.folder / near.name), asked)
            lines = (stem(near.name), f"{near.distance:.3f}")
            pictures.append(sk.show.Thumbnail(geometry=other, lines=lines))
        _draw(asked, path, pictures, f"Most like {stem(asked.file)}")

    tell(
        asked,
        record,
        f"{asked.file}: nearest of {len(index.names)} shapes in {asked.folder}\n"
        "distance: mean difference of the numbers that tell shapes apart, each in its standard\n"
        "deviations over the folder",
        lines,
        draw=draw,
    )


def _draw(
    asked: SimilarOptions | LabelOptions,
    path: Path,
    pictures: "list[sk.show.Thumbnail]",
    title: str = "",
) -> None:
    view = sk.show.View(up=asked.up, turn=asked.turn)
    page = sk.show.Page(title, dpi=asked.dpi)
    sk.show.plot_thumbnails(pictures, path=path, view=view, page=page)


def label(asked: LabelOptions) -> None:
    """Tell what a shape is, or what its parts are; write and draw these."""
    shape, _ = load(asked.file, asked)
    labeller = sk.learn.load_labeller(asked.labeller)
    parts = isinstance(labeller, sk.learn.Segmenter)
    for given, option in ((asked.output, "--output"), (asked.picture, "--picture")):
        if given and not parts:
            raise InvalidInputError(
                option, "go with a labeller of points", "one of whole shapes", advice="leave it out"
            )
    check_output(asked.output, [".npz"], asked.inputs)
    check_output(asked.picture, options.PICTURES, asked.inputs)
    unknown = dict.fromkeys(("label", "name", "scores", "parts"))
    record: tables.Record = {"input": asked.file, "labeller": asked.labeller, **unknown}
    record["output"] = asked.output
    if not isinstance(labeller, sk.learn.Segmenter):
        with step("looking at it"):
            answer = labeller.classify(shape)
        record |= {"label": answer.label, "name": answer.name}
        record["scores"] = dict(zip(labeller.names, answer.scores.tolist(), strict=True))
        best = sorted(zip(answer.scores, labeller.names, strict=True), reverse=True)[:5]
        lines = [_share(score, name) for score, name in best if score > 0]
        tell(asked, record, f"{asked.file}: {printable(answer.name)}", "\n".join(lines))
        return
    with step("looking at its points"):
        found = labeller.segment(shape)
    if asked.output:
        with step(f"writing {asked.output}"):
            _write(asked.output, found)
    shares = _shares(shape, found)
    record["parts"] = [
        {"label": i, "name": name, "share": share}
        for i, (name, share) in enumerate(zip(found.names, shares, strict=True))
    ]

    def draw(path: Path) -> None:
        named = (stem(asked.file),)
        _draw(asked, path, [sk.show.Thumbnail(geometry=shape, labels=found.labels, lines=named)])

    lines = [_share(share, name) for name, share in zip(found.names, shares, strict=True)]
    unit = "points" if isinstance(shape, sk.PointCloud) else "area"
    tell(asked, record, f"{asked.file}: share of the {unit}", "\n".join(lines), draw=draw)


def _share(share: float, name: str) -> str:
    return f"{100 * share:6.1f} %  {printable(name)}"


def _write(path: Path, found: "Segmentation") -> None:
    arrays = {"labels": found.labels, "scores": found.scores, "names": np.array(found.names)}
    if found.face_labels is not None:
        arrays["face_labels"] = found.face_labels
    with atomic_path(path) as part:
        np.savez(part, **arrays)  # type: ignore[arg-type]


def _shares(shape: "Geometry", found: "Segmentation") -> list[float]:
    """Return the share of each class: of the area of a mesh, of the points of a cloud."""
    if isinstance(shape, sk.PointCloud) or found.face_labels is None:
        weights, labels = np.ones(shape.n), found.labels
    else:
        weights, labels = shape.face_areas, found.face_labels
    total = np.bincount(labels, weights, minlength=len(found.names))
    return [float(share) for share in total / total.sum()]
