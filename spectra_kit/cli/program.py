"""The commands, in the order in which one meets them, and what each can be told."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from cyclopts import App, CycloptsError, Parameter
from cyclopts.exceptions import MissingArgumentError, UnusedCliTokensError

from spectra_kit.cli import options
from spectra_kit.cli.options import DEMO, Count, Indices, OnOne, Output, SolverName


@dataclass(frozen=True, kw_only=True)
class Info(OnOne):
    """Say what a file holds, what is wrong with it and what can be made of it."""

    outcome = "what a file holds"
    examples = ("info bunny.obj", "info scan.ply --repair", "info bunny.obj --json")
    keys = "input, kind, diagnosis, problems, operator"
    run = "info.info"

    operator: options.OperatorName | None = "delaunay"
    """Laplacian (default: delaunay, which of a mesh is robust with less memory)"""


@dataclass(frozen=True, kw_only=True)
class Spectrum(OnOne, options.Verified, options.Resolution):
    """Compute the lowest eigenvalues and eigenfunctions, each with a certificate of accuracy."""

    outcome = "certified modes"
    examples = (
        "spectrum bunny.obj -o bunny.npz",
        "spectrum bunny.obj --solver refined --rtol 1e-8 --verify",
        f"spectrum {DEMO} -k 24 --accuracy 1e-3 --picture spectrum.png",
    )
    keys = "input, geometry, eigenvalues, certificate, provenance, verdict, output, picture"
    run = "modes.spectrum"

    k: Count = 96
    solver: SolverName = "automatic"
    output: Output | None = None
    """write the spectrum to this .npz file (default: none)"""
    picture: Path | None = None
    """draw eigenvalues, Weyl's law and residuals (.png, .pdf, .svg) (default: none)"""
    modes: Indices | None = None
    """modes to show, counted from 0 (default: a handful)"""


@dataclass(frozen=True, kw_only=True)
class Shown(OnOne, options.Spared, options.Turned):
    """Modes that are drawn: those asked for are solved for, unless they are saved."""

    k: Count | None = None
    """number of modes (default: as many as are shown)"""
    solver: SolverName = "automatic"


@dataclass(frozen=True, kw_only=True)
class Modes(Shown, options.Resolution):
    """Draw modes on the surface, with their zero lines, eigenvalues and residuals."""

    outcome = "a picture of modes"
    examples = (
        "modes bunny.obj -o modes.png",
        "modes bunny.obj --spectrum bunny.npz --modes 1,5,20",
        f"modes {DEMO} -o modes.pdf --dpi 600",
    )
    keys = "input, geometry, eigenvalues, certificate, provenance, verdict, modes, picture"
    run = "modes.modes"

    output: Output = Path("modes.png")
    """the picture (.png, .pdf, .svg)"""
    modes: Indices | None = None
    """modes to show, counted from 0 (default: the first 12 that are not constant)"""
    columns: int | None = None
    """modes in a row (default: as fits)"""
    no_lines: bool = False
    """leave the zero lines out"""


@dataclass(frozen=True, kw_only=True)
class Animate(Shown):
    """Let modes swing, one after the other, in a GIF or an MP4."""

    outcome = "modes that swing"
    examples = (
        "animate bunny.obj -o modes.gif",
        "animate bunny.obj --spectrum bunny.npz --modes 7",
        f"animate {DEMO} -o modes.mp4 --width 720 --fps 30",
    )
    keys = "input, geometry, eigenvalues, certificate, provenance, verdict, modes, animation"
    run = "modes.animate"

    output: Output = Path("modes.gif")
    """the animation: .gif, or .mp4 where imageio-ffmpeg is installed"""
    modes: Indices | None = None
    """modes to show, counted from 0 (default: the first 6 that are not constant)"""
    seconds: float = 2.0
    """that each mode is shown"""
    fps: int = 20
    """frames per second"""
    width: int = 480
    """pixels"""


@dataclass(frozen=True, kw_only=True)
class Compare(OnOne, options.Predictor, options.Turned, options.Resolution):
    """Set predicted modes beside exact ones: a table of errors, and a picture."""

    outcome = "predicted and exact"
    examples = (
        "compare bunny.obj -o errors.png",
        "compare bunny.obj --spectrum bunny.npz --solver cascade",
        f"compare {DEMO} --cloud 8000 --json",
    )
    keys = "input, geometry, reference, predicted, comparison, verdict, picture"
    run = "compare.compare"

    solver: SolverName | None = None
    picture: Output | None = None
    """draw exact | predicted | difference of the chosen modes (.png, .pdf, .svg) (default: none)"""
    modes: Indices | None = None
    """modes to show, counted from 0 (default: a handful)"""


@dataclass(frozen=True, kw_only=True)
class Explore(OnOne, options.Predictor, options.Upright):
    """Look at modes in the browser, exact and predicted side by side."""

    outcome = "modes in the browser"
    examples = (
        "explore bunny.obj -o bunny.html",
        "explore bunny.obj --serve",
        f"explore {DEMO} -k 24 --solver none",
    )
    keys = "input, geometry, reference, predicted, comparison, verdict, explorer, url"
    run = "explore.explore"

    solver: options.OptionalName | None = None
    """what predicts, or none (default: neo)"""
    html: Output | None = None
    """the page to write: one file that needs no network (default: the name of FILE with .html, in
    the current folder)"""
    serve: bool = False
    """serve the page to this machine alone, too, until Ctrl-C"""
    max_points: int = 50_000
    """show at most so many points of a larger geometry"""
    port: int = 0
    """of --serve (default: a free one)"""
    no_browser: bool = False
    """with --serve, do not open a browser"""


@dataclass(frozen=True)
class _Pair(options.Reading):
    group = "input"

    source: Annotated[options.File, options.operand("SOURCE")]
    target: Annotated[options.File, options.operand("TARGET")]


@dataclass(frozen=True, kw_only=True)
class _Sides(options.Command):
    group = "input"

    sides: Literal["either", "kept", "reversed"] = "either"
    """whether the map may mirror (default: either, mirrored only if that is clearly better)"""


@dataclass(frozen=True, kw_only=True)
class _Known(_Sides, _Pair):
    group = "input"

    part: bool = False
    """SOURCE is a part, such as a scan that lacks a limb, and TARGET a whole: find which points of
    the whole have a partner on the part, too (covered.npy)"""
    landmarks: Path | None = None
    """corresponding points: a line for each with its number on the source and on the target,
    counted from 0"""
    aligned: bool = False
    """the shapes lie on each other, as two moments of a recording do: begin with nearest points,
    and search for no other map"""
    initial: Path | None = None
    """begin with this map, and search for no other: the source point of each target point, an .npy
    file"""
    truth: Path | None = None
    """the true source point of each target point, an .npy file to measure errors by (negative:
    unknown)"""


@dataclass(frozen=True, kw_only=True)
class Match(_Known, options.Operator, options.Solver, options.FolderDrawing):
    """Find the source point that each target point is, and judge the map."""

    outcome = "corresponding points"
    examples = (
        "match cat.off lion.off -o maps",
        "match scan.ply body.off --part -o parts",
        f"match {DEMO} {DEMO} --points 2000",
    )
    keys = "source, target, landmarks, match, written"
    run = "match.match_shapes"
    operands = "SOURCE TARGET [options]"

    k: Count = 150
    solver: SolverName = "automatic"
    output: Output = Path("match")
    """folder for the maps, the report and the pictures"""
    precise: bool = False
    """also find where on the triangles of SOURCE each target point lies: its barycentric
    coordinates, a sparse matrix of SciPy (precise_map.npz)"""


@dataclass(frozen=True, kw_only=True)
class _Sources(options.Command):
    group = "sources"

    source: Annotated[tuple[int, ...], Parameter(consume_multiple=True, metavar="INDEX ...")] = ()
    """points of the file, counted from 0"""
    at: Annotated[tuple[tuple[float, float, float], ...], Parameter(metavar="X Y Z")] = ()
    """the point of the surface nearest to this place (may be repeated)"""
    face: Annotated[
        tuple[tuple[float, float, float, float], ...], Parameter(metavar="F B0 B1 B2")
    ] = ()
    """a point of a face, by its barycentric coordinates (may be repeated)"""
    farthest: int = 0
    """add N points, each the farthest from all sources before it (the first, where there are none,
    from point 0)"""


@dataclass(frozen=True, kw_only=True)
class _Heat(options.Command):
    group = "method"

    method: Literal["auto", "direct", "iterative", "projected", "plain"] = "auto"
    """of the linear systems: direct, by a factor; or by conjugate gradients with incomplete
    Cholesky: plain, or with a coarse space of modes added (iterative) or projected out (projected)
    (default: auto, which solves none on meshes of at most 2,000 vertices, where exact distances are
    quick, and is direct where factors fit into memory)"""
    poisson_rtol: float = 1e-8
    """relative residual at which iterations stop"""
    time_coefficient: float = 1.0
    """the heat diffuses for X squared typical edge lengths; more is smoother"""
    heat_boundary: Literal["neumann", "dirichlet", "average"] = "neumann"
    """what heat does at a boundary: neumann, stay; dirichlet, leave; average, the mean of both"""


@dataclass(frozen=True, kw_only=True)
class Geodesic(options.OneFile, options.Spared, _Sources, _Heat, options.FolderDrawing):
    """Measure distances along a surface, and draw them with isolines."""

    outcome = "distances along it"
    examples = (
        "geodesic bunny.obj --source 7",
        "geodesic bunny.obj --at 0.1 0.2 0.0 --farthest 3 -o far",
        f"geodesic {DEMO} --compare",
    )
    keys = (
        "input, kind, points, faces, operator, operator area, operator components, zero modes,"
        " fixed points, eigenvalue spacing, heat_boundary, sources, method, choice,"
        " time_coefficient, time_step, iterations, relative_residual, heat, seconds, spectrum,"
        " largest_distance, mean_distance, points_not_reached, spectrum_unused, comparison,"
        " written"
    )
    run = "geodesic.geodesic_distances"
    notes: ClassVar[Mapping[str, str]] = {
        **options.FolderDrawing.notes,
        "sources": "the distance is to the nearest of them all; the demo has one by default",
        "solver": "of modes for the coarse space of the linear solver, which may do without",
    }

    k: Count | None = None
    """number of modes (default: 24 and those of eigenvalue 0; 96 with --compare)"""
    solver: SolverName | None = None
    """what solves for modes (default: none)"""
    output: Output = Path("geodesic")
    """folder for the distances, the report and the pictures"""
    compare: bool = False
    """also solve by every solver, and draw and print how each converges"""
    spacing: float | None = None
    """between two isolines (default: 20 to 40 lines)"""


@dataclass(frozen=True)
class _Searched(options.OneFile):
    group = "input"

    folder: Annotated[Path, Parameter(name="FOLDER", help="meshes and point clouds to search")]


@dataclass(frozen=True, kw_only=True)
class Similar(_Searched, options.Solver, options.Turned, options.Resolution):
    """Find the shapes of a folder that are most like one, whatever their pose, size and place."""

    outcome = "shapes like it"
    examples = (
        "similar cat.off animals",
        "similar cat.off animals --index known.safetensors -o like.png",
        "similar scan.ply animals --cloud 4000 --solver neo",
    )
    keys = "input, folder, indexed, left_out, neighbours, picture"
    run = "learn.similar"
    operands = "FILE FOLDER [options]"

    k: Count = 96
    solver: SolverName = "automatic"
    count: int = 8
    """shapes to name"""
    index: Path | None = None
    """keep what was computed in this .safetensors file: only files that are new or have changed are
    embedded the next time (default: none)"""
    picture: Output | None = None
    """draw them (.png, .pdf, .svg) (default: none)"""


@dataclass(frozen=True)
class _Labelled(options.OneFile):
    group = "input"

    labeller: Annotated[Path, Parameter(name="LABELLER", help="what learning.save_labeller wrote")]


@dataclass(frozen=True, kw_only=True)
class Label(_Labelled, options.Turned, options.Resolution):
    """Tell what a shape is, or what its parts are, by what a labeller has learned."""

    outcome = "names, and parts"
    examples = (
        "label a.ply known.safetensors",
        "label body.obj bodies.safetensors -o parts.npz --picture parts.png",
    )
    keys = "input, labeller, label, name, scores, parts, output, picture"
    run = "learn.label"
    operands = "FILE LABELLER [options]"

    output: Output | None = None
    """write the labels of points and faces, and all scores, to this .npz file (default: none)"""
    picture: Path | None = None
    """draw the parts (.png, .pdf, .svg) (default: none)"""


@dataclass(frozen=True)
class _Many(options.Read):
    group = "input"

    paths: Annotated[
        tuple[str, ...],
        Parameter(name="INPUT", help="files, folders, quoted patterns, or a manifest: a .csv with"
                  " a column `file`, perhaps `name`, and more for the table"),
    ]  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Workers(options.Command):
    """Who works on many shapes, or on many pairs of them."""

    group = "workers"
    notes: ClassVar[Mapping[str, str]] = {
        "workers": "those of Dask; $DASK_ADDRESS is a scheduler, too"
    }

    nworkers: int | None = None
    """processes on this machine, 0 for none but this one (default: one for each core that may
    be used, once that is worth their start)"""
    nthreads: int = 1
    """shapes or pairs that each works on at a time"""
    memory_limit: Annotated[str, Parameter(metavar="SIZE")] = "auto"
    """of each process, such as 3GB"""
    scheduler: str | None = None
    """address of the scheduler of a cluster (default: none, workers on this machine)"""
    scheduler_file: Path | None = None
    """file in which a scheduler has written its address (default: none)"""
    shard: Annotated[str | None, Parameter(metavar="I/N")] = None
    """compute the I-th of N parts alone, as the tasks of a job array do (default: all)"""


@dataclass(frozen=True, kw_only=True)
class Batch(_Many, options.Operator, options.Solver, Workers):
    """Compute the spectra of many shapes into a store, each once, and a table of them."""

    outcome = "many spectra"
    examples = (
        "batch scans --out store",
        "batch 'scans/*.ply' --out store --csv table.csv --descriptors hks",
        "batch subjects.csv --out store --shard 3/100 --nworkers 0",
    )
    keys = "inputs, computed, known, failed, replaced, renewed, seconds, store, csv"
    run = "batch.batch"
    operands = "INPUT... --out STORE [options]"
    notes: ClassVar[Mapping[str, str]] = {
        **Workers.notes,
        "output": "what the store has already is not computed again; a table is replaced",
    }

    k: Count = 96
    solver: SolverName = "automatic"
    out: Annotated[Path, Parameter(alias="-o", metavar="STORE")]
    """folder of the store; made if it is missing"""
    csv: Path | None = None
    """write a row for each shape to this .csv file: eigenvalues, area, components, warnings
    (default: none)"""
    descriptors: Annotated[
        tuple[str, ...], Parameter(converter=options.words, n_tokens=1, metavar="NAME,...")
    ] = ()
    """also keep these: hks, wks, gps, dna (default: none)"""
    tensors: bool = False
    """also keep what networks ask for: Laplacians, frames and gradients"""
    precision: Literal["float64", "float32"] = "float64"
    """of eigenvectors, descriptors and tensors in the store"""
    strict: bool = False
    """stop at the first shape that fails"""


@dataclass(frozen=True)
class _Store(options.Command):
    group = "input"

    store: Annotated[Path, Parameter(name="STORE", help="a folder that `batch` has filled")]


@dataclass(frozen=True, kw_only=True)
class _Kept(_Store):
    group = "input"

    pairs: Annotated[Path, Parameter(metavar="all|FILE")]
    """all shapes with all others, each two once; or a .csv file with columns `source` and `target`,
    names of the store, and more for the table"""
    k: Count | None = None
    """number of modes: match the spectra that have so many (default: those there are)"""


@dataclass(frozen=True, kw_only=True)
class MatchAll(_Kept, _Sides, Workers):
    """Match shapes of a store in pairs, each once; the maps go into the store."""

    outcome = "many maps"
    examples = (
        "match-all store --pairs all",
        "match-all store --pairs pairs.csv --csv maps.csv",
        "match-all store --pairs all --together --csv maps.csv",
    )
    keys = (
        "pairs, computed, known, failed, ambiguous, not_convincing, groups, foreign, replaced,"
        " seconds, store, csv"
    )
    run = "match_all.match_pairs"
    operands = "STORE --pairs all|FILE [options]"
    notes: ClassVar[Mapping[str, str]] = {
        **Workers.notes,
        "output": "a map that is there is not searched for again; a table is replaced",
    }

    csv: Path | None = None
    """write a row for each pair to this .csv file: score, margin, doubts, key of the map
    (default: none)"""
    strict: bool = False
    """stop at the first pair that fails"""
    together: bool = False
    """match the shapes as one collection, by this process alone: maps agree over all cycles (cycle
    errors are in the table); groups of shapes that fit, and those that fit none, are named"""


@dataclass(frozen=True)
class _Looked(options.Command):
    group = "input"

    action: Annotated[
        Literal["list", "verify", "clean"],
        Parameter(name="ACTION", help="list names; verify that every file is whole; clean away what"
                  " is of other releases"),
    ]  # fmt: skip
    store: Annotated[Path, Parameter(name="STORE", help="the folder")]


@dataclass(frozen=True, kw_only=True)
class Store(_Looked):
    """Look into a store of spectra: list what is there, read all of it, or remove what is old."""

    group = "output"
    outcome = "what a store holds"
    examples = ("store list store", "store verify store --remove", "store clean store")
    keys = "store, entries, bytes, shapes, damaged, removed"
    run = "batch.store"
    operands = "ACTION STORE [options]"
    notes: ClassVar[Mapping[str, str]] = {}

    remove: bool = False
    """of verify: take out what is damaged, to be computed again"""
    unnamed: bool = False
    """of clean: also what belongs to no name any more, as of files that have changed"""


@dataclass(frozen=True)
class Completion(options.Command):
    """Print what a shell needs to complete commands, options and file names."""

    group = "input"
    outcome = "for your shell"
    examples = (
        "completion bash >> ~/.bashrc",
        "completion zsh > ~/.zfunc/_spectra-kit",
        "completion fish > ~/.config/fish/completions/spectra-kit.fish",
    )
    keys = "shell, script"
    run = "info.completion"
    operands = "SHELL"

    shell: Annotated[
        Literal["bash", "zsh", "fish"], Parameter(name="SHELL", help="bash, zsh or fish")
    ]


COMMANDS = (
    Info,
    Spectrum,
    Modes,
    Animate,
    Compare,
    Explore,
    Match,
    Geodesic,
    Similar,
    Label,
    Batch,
    MatchAll,
    Store,
    Completion,
)
NAMED: dict[str, type[options.Command]] = {command.name: command for command in COMMANDS}


class UsageError(Exception):
    """The command line was not understood; `command` is the one that it was for, if known."""

    def __init__(self, message: str, command: type[options.Command] | None) -> None:
        super().__init__(message)
        self.command = command


@cache
def app() -> App:
    """Return what reads the command line, and writes completions for the shell."""
    program = App(
        name="spectra-kit",
        version_flags=(),
        # Of an option that is given twice, the last one counts.
        default_parameter=Parameter(allow_repeating=True, negative=""),
        print_error=False,
        exit_on_error=False,
    )
    for command in COMMANDS:
        program.command(command, name=command.name)
    return program


def parse(arguments: Sequence[str]) -> Any:
    """Return the command that a command line asks for, without the name of the program.

    Raises
    ------
    UsageError
        If it is not understood; with what may have been meant.
    """
    if not arguments:
        raise UsageError("a command is required", None)
    try:
        # A lone hyphen is no option, but what it means elsewhere.
        words = ["/dev/stdin" if word == "-" else word for word in arguments]
        found, bound, _ = app().parse_args(words)
    except CycloptsError as error:
        command = NAMED.get(arguments[0])
        raise UsageError(_told(error, command), command) from error
    return found(*bound.args, **bound.kwargs)


def _told(error: CycloptsError, command: type[options.Command] | None) -> str:
    """Say what is wrong with a command line, in one line and as the help has it."""
    if command and isinstance(error, MissingArgumentError) and error.keyword is None:
        return f"{command.operands.removesuffix(' [options]')} is required"
    if isinstance(error, UnusedCliTokensError):
        return f"unrecognized arguments: {' '.join(error.unused_tokens or ())}"
    return str(error).removesuffix(".")
