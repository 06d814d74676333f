"""The commands that say what a shape is like, and what its parts are."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from spectra_kit._core.shown import printable
from spectra_kit._core.validate import check_count
from spectra_kit.cli import tables
from spectra_kit.cli.inputs import load
from spectra_kit.cli.options import (
    PICTURES,
    Count,
    OneFile,
    Output,
    Resolution,
    Solver,
    SolverName,
    Turned,
)
from spectra_kit.cli.output import check_output, tell_with_picture
from spectra_kit.cli.progress import counted, say, step
from spectra_kit.cli.solving import check_solvers, make_solver
from spectra_kit.cli.words import stem, told
from spectra_kit.errors import InvalidInputError
from spectra_kit.features import ShapeDNA, WaveKernelSignature
from spectra_kit.geometry import Geometry, PointCloud
from spectra_kit.learn import (
    Recipe,
    Segmentation,
    Segmenter,
    ShapeIndex,
    index_folder,
    load_labeller,
)


@dataclass(frozen=True, kw_only=True)
class SimilarOptions(OneFile, Solver, Turned, Resolution):
    """Find the shapes of a folder that are most like one, whatever their pose, size and place."""

    examples = (
        "similar cat.off animals",
        "similar cat.off animals --index known.safetensors -o like.png",
        "similar scan.ply animals --cloud 4000 --solver neo",
    )
    keys = "input, folder, indexed, left_out, neighbours, picture"
    operands = "FILE FOLDER [options]"

    folder: Path = field(kw_only=False)
    """meshes and point clouds to search"""
    k: Count = 96
    solver: SolverName = "automatic"
    count: int = 8
    """shapes to name"""
    index: Path | None = None
    """keep what was computed in this .safetensors file: only files that are new or have changed are
    embedded the next time (default: none)"""
    picture: Output | None = None
    """draw them (.png, .pdf, .svg) (default: none)"""


@dataclass(frozen=True, kw_only=True)
class LabelOptions(OneFile, Turned, Resolution):
    """Tell what a shape is, or what its parts are, by what a labeller has learned."""

    examples = (
        "label a.ply known.safetensors",
        "label body.obj bodies.safetensors -o parts.npz --picture p.png",
    )
    keys = "input, labeller, label, name, scores, parts, output, picture"
    operands = "FILE LABELLER [options]"

    labeller: Path = field(kw_only=False)
    """what learn.save_labeller wrote"""
    output: Output | None = None
    """write the labels of points and faces, and all scores, to this .npz file (default: none)"""
    picture: Path | None = None
    """draw the parts (.png, .pdf, .svg) (default: none)"""


def similar(asked: SimilarOptions) -> None:
    """Search a folder for the shapes that are most like one, and draw them."""
    check_count("--count", asked.count, low=1)
    check_count("-k", asked.k, low=4)
    if asked.picture:
        check_output(asked.picture, PICTURES, asked.inputs)
    if asked.index:
        check_output(asked.index, [".safetensors"], asked.inputs)
    check_solvers(asked, asked.solver)
    recipe = Recipe(
        embeddings=(
            WaveKernelSignature(count=32, width=1.5, first=3.0),
            ShapeDNA(count=min(45, asked.k - 1)),
        ),
        k=asked.k,
        solver=make_solver(asked.solver, asked, asked.k),
    )
    shape, _ = load(asked.file, asked)
    with step(f"embedding {asked.file}"):
        recipe.vector(shape)  # refused now, not after the folder
    known = ShapeIndex.load(asked.index) if asked.index and asked.index.is_file() else None
    with counted(f"embedding {asked.folder}", "file") as progress:
        index = index_folder(
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
        from spectra_kit.show import Page, Thumbnail, View, plot_thumbnails

        thumbnails = [Thumbnail(geometry=shape, lines=(stem(asked.file), "asked for"))]
        for near in found:
            other, _ = load(str(asked.folder / near.name), asked)
            thumbnails.append(
                Thumbnail(geometry=other, lines=(stem(near.name), f"{near.distance:.3f}"))
            )
        page = Page(f"Most like {stem(asked.file)}", dpi=asked.dpi)
        plot_thumbnails(thumbnails, path=path, view=View(up=asked.up, turn=asked.turn), page=page)

    tell_with_picture(
        asked,
        record,
        f"{asked.file}: nearest of {len(index.names)} shapes in {asked.folder}\n"
        "distance: mean difference of the numbers that tell shapes apart, each in its standard\n"
        "deviations over the folder",
        lines,
        picture=asked.picture,
        draw=draw,
    )


def label(asked: LabelOptions) -> None:
    """Tell what a shape is, or what its parts are; write and draw these."""
    shape, _ = load(asked.file, asked)
    labeller = load_labeller(asked.labeller)
    parts = isinstance(labeller, Segmenter)
    for given, option in ((asked.output, "--output"), (asked.picture, "--picture")):
        if given and not parts:
            raise InvalidInputError(
                option, "go with a labeller of points", "one of whole shapes", advice="leave it out"
            )
    if asked.output:
        check_output(asked.output, [".npz"], asked.inputs)
    if asked.picture:
        check_output(asked.picture, PICTURES, asked.inputs)
    unknown = dict.fromkeys(("label", "name", "scores", "parts", "output"))
    record: tables.Record = {"input": asked.file, "labeller": asked.labeller, **unknown}
    if not isinstance(labeller, Segmenter):
        with step("looking at it"):
            answer = labeller.classify(shape)
        record |= {"label": answer.label, "name": answer.name}
        record["scores"] = dict(zip(labeller.names, answer.scores.tolist(), strict=True))
        best = sorted(zip(answer.scores, labeller.names, strict=True), reverse=True)[:5]
        lines = "\n".join(
            f"{100 * score:6.1f} %  {printable(name)}" for score, name in best if score > 0
        )
        tell_with_picture(
            asked,
            record,
            f"{asked.file}: {printable(answer.name)}",
            lines,
            picture=None,
            draw=_nothing,
        )
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
    record["output"] = asked.output

    def draw(path: Path) -> None:
        from spectra_kit.show import Page, Thumbnail, View, plot_thumbnails

        thumbnail = Thumbnail(geometry=shape, labels=found.labels, lines=(stem(asked.file),))
        page = Page(dpi=asked.dpi)
        view = View(up=asked.up, turn=asked.turn)
        plot_thumbnails([thumbnail], path=path, view=view, page=page)

    lines = "\n".join(
        f"{100 * share:6.1f} %  {printable(name)}"
        for name, share in zip(found.names, shares, strict=True)
    )
    unit = "points" if isinstance(shape, PointCloud) else "area"
    tell_with_picture(
        asked, record, f"{asked.file}: share of the {unit}", lines, picture=asked.picture, draw=draw
    )


def _nothing(path: Path) -> None:
    """Draw nothing."""


def _write(path: Path, found: Segmentation) -> None:
    from spectra_kit._core.files import atomic_path

    arrays = {"labels": found.labels, "scores": found.scores, "names": np.array(found.names)}
    if found.face_labels is not None:
        arrays["face_labels"] = found.face_labels
    with atomic_path(path) as part:
        np.savez(part, **arrays)  # type: ignore[arg-type]


def _shares(shape: Geometry, found: Segmentation) -> list[float]:
    """Return the share of each class: of the area of a mesh, of the points of a cloud."""
    if isinstance(shape, PointCloud) or found.face_labels is None:
        weights, labels = np.ones(shape.n), found.labels
    else:
        weights, labels = shape.face_areas, found.face_labels
    total = np.bincount(labels, weights, minlength=len(found.names))
    return [float(share) for share in total / total.sum()]
