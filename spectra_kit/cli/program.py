"""The commands, in the order in which one meets them, and what each takes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Annotated, Any, Literal

from cyclopts import App, CycloptsError, Group, Parameter
from cyclopts.exceptions import MissingArgumentError, UnusedCliTokensError

from spectra_kit.cli import geodesic_options, options, outputs
from spectra_kit.cli.options import DEMO, File, General, Operator, Reading, operand

Shell = Literal["bash", "zsh", "fish"]


@dataclass(frozen=True)
class _OfFile:
    file: Annotated[File, operand("FILE")]
    reading: Reading = Reading()
    general: General = General()


@dataclass(frozen=True)
class _OfOperator(_OfFile):
    operator: Operator = Operator()


@dataclass(frozen=True)
class Info(_OfOperator):
    """Say what a file holds, what is wrong with it and what can be made of it."""

    operator: options.LeanOperator = options.LeanOperator()


@dataclass(frozen=True)
class Spectrum(_OfOperator):
    """Compute the lowest eigenvalues and eigenfunctions, each with a certificate of accuracy."""

    solver: options.VerifiedSolver = options.VerifiedSolver()
    output: outputs.SpectrumOutput = outputs.SpectrumOutput()
    drawing: outputs.Resolution = outputs.Resolution()


@dataclass(frozen=True)
class Modes(_OfOperator):
    """Draw modes on the surface, with their zero lines, eigenvalues and residuals."""

    solver: options.ShownSolver = options.ShownSolver()
    output: outputs.ModesOutput = outputs.ModesOutput()
    drawing: outputs.Drawing = outputs.Drawing()


@dataclass(frozen=True)
class Animate(_OfOperator):
    """Let modes swing, one after the other, in a GIF or an MP4."""

    solver: options.ShownSolver = options.ShownSolver()
    output: outputs.AnimateOutput = outputs.AnimateOutput()
    drawing: outputs.View = outputs.View()


@dataclass(frozen=True)
class Compare(_OfOperator):
    """Set predicted modes beside exact ones: a table of errors, and a picture."""

    solver: options.Predictor = options.Predictor()
    output: outputs.CompareOutput = outputs.CompareOutput()
    drawing: outputs.Drawing = outputs.Drawing()


@dataclass(frozen=True)
class Explore(_OfOperator):
    """Look at modes in the browser, exact and predicted side by side."""

    solver: options.OptionalPredictor = options.OptionalPredictor()
    output: outputs.ExploreOutput = outputs.ExploreOutput()
    drawing: outputs.Upright = outputs.Upright()


@dataclass(frozen=True)
class Match:
    """Find the source point that each target point is, and judge the map."""

    source: Annotated[File, operand("SOURCE")]
    target: Annotated[File, operand("TARGET")]
    reading: Reading = Reading()
    known: options.Known = options.Known()
    operator: Operator = Operator()
    solver: options.MatchSolver = options.MatchSolver()
    output: outputs.MatchOutput = outputs.MatchOutput()
    drawing: outputs.FolderDrawing = outputs.FolderDrawing()
    general: General = General()


@dataclass(frozen=True)
class Geodesic(_OfFile):
    """Measure distances along a surface, and draw them with isolines."""

    sources: geodesic_options.Sources = geodesic_options.Sources()
    heat: geodesic_options.Heat = geodesic_options.Heat()
    solver: options.CoarseSolver = options.CoarseSolver()
    output: geodesic_options.GeodesicOutput = geodesic_options.GeodesicOutput()
    drawing: outputs.FolderDrawing = outputs.FolderDrawing()


@dataclass(frozen=True)
class Completion:
    """Print what a shell needs to complete commands, options and file names."""

    shell: Annotated[Shell, Parameter(name="SHELL", help="bash, zsh or fish", group=Group("input"))]
    general: General = General()


@dataclass(frozen=True)
class Command:
    """One of the commands.

    Attributes
    ----------
    asked : type
        A dataclass of groups of options; its docstring is what the command does.
    outcome : str
        What one gets, in a few words.
    examples : tuple of str
        Without the name of the program; the first one stands in the story.
    keys : str
        Of the object that ``--json`` prints.
    run : str
        The module of this package, and in it the function that takes what was asked for.
    operands : str
        What stands before the options.
    """

    asked: type
    outcome: str
    examples: tuple[str, ...]
    keys: str
    run: str
    operands: str = "FILE [options]"

    @property
    def name(self) -> str:
        """As typed."""
        return self.asked.__name__.lower()

    @property
    def usage(self) -> str:
        """One line; to list every option again would fill ten."""
        return f"usage: spectra-kit {self.name} {self.operands}"

    def load(self) -> Callable[[Any], None]:
        """Import what the command needs, and return its function."""
        module, _, function = self.run.partition(".")
        run: Callable[[Any], None]
        run = getattr(import_module(f"spectra_kit.cli.{module}"), function)
        return run


COMMANDS = (
    Command(
        Info,
        "what a file holds",
        ("info bunny.obj", "info scan.ply --repair", "info bunny.obj --json"),
        "input, kind, diagnosis, problems, operator",
        "info.info",
    ),
    Command(
        Spectrum,
        "certified modes",
        (
            "spectrum bunny.obj -o bunny.npz",
            "spectrum bunny.obj --solver multilevel --rtol 1e-8 --verify",
            f"spectrum {DEMO} -k 24 --picture spectrum.png",
        ),
        "input, geometry, eigenvalues, certificate, provenance, verdict, output, picture",
        "spectrum.spectrum",
    ),
    Command(
        Modes,
        "a picture of modes",
        (
            "modes bunny.obj -o modes.png",
            "modes bunny.obj --spectrum bunny.npz --modes 1,5,20",
            f"modes {DEMO} -o modes.pdf --dpi 600",
        ),
        "input, geometry, eigenvalues, certificate, provenance, verdict, modes, picture",
        "pictures.modes",
    ),
    Command(
        Animate,
        "modes that swing",
        (
            "animate bunny.obj -o modes.gif",
            "animate bunny.obj --spectrum bunny.npz --modes 7",
            f"animate {DEMO} -o modes.mp4 --width 720 --fps 30",
        ),
        "input, geometry, eigenvalues, certificate, provenance, verdict, modes, animation",
        "pictures.animate",
    ),
    Command(
        Compare,
        "predicted and exact",
        (
            "compare bunny.obj -o errors.png",
            "compare bunny.obj --spectrum bunny.npz --solver polished",
            f"compare {DEMO} --cloud 8000 --json",
        ),
        "input, geometry, reference, predicted, comparison, verdict, picture",
        "compare.compare",
    ),
    Command(
        Explore,
        "modes in the browser",
        (
            "explore bunny.obj -o bunny.html",
            "explore bunny.obj --serve",
            f"explore {DEMO} -k 24 --solver none",
        ),
        "input, geometry, reference, predicted, comparison, verdict, explorer, url",
        "explore.explore",
    ),
    Command(
        Match,
        "corresponding points",
        (
            "match cat.off lion.off -o maps",
            "match cat.off lion.off --landmarks pairs.txt",
            f"match {DEMO} {DEMO} --points 2000",
        ),
        "source, target, landmarks, match, written",
        "match.match_shapes",
        "SOURCE TARGET [options]",
    ),
    Command(
        Geodesic,
        "distances along it",
        (
            "geodesic bunny.obj --source 7",
            "geodesic bunny.obj --at 0.1 0.2 0.0 --farthest 3 -o far",
            f"geodesic {DEMO} --compare",
        ),
        "input, kind, points, faces, operator, operator area, operator components, zero modes,"
        " fixed points, eigenvalue spacing, heat_boundary, sources, method, choice,"
        " time_coefficient, time_step, iterations, relative_residual, heat, seconds, spectrum,"
        " largest_distance, mean_distance, points_not_reached, spectrum_unused, comparison,"
        " written",
        "geodesic.geodesic_distances",
    ),
    Command(
        Completion,
        "for your shell",
        (
            "completion bash >> ~/.bashrc",
            "completion zsh > ~/.zfunc/_spectra-kit",
            "completion fish > ~/.config/fish/completions/spectra-kit.fish",
        ),
        "shell, script",
        "completion.completion",
        "SHELL",
    ),
)
NAMED = {command.name: command for command in COMMANDS}


class UsageError(Exception):
    """The command line was not understood; `command` is the one that it was for, if known."""

    def __init__(self, message: str, command: Command | None) -> None:
        super().__init__(message)
        self.command = command


@dataclass(frozen=True)
class Asked:
    """What a command line asks for.

    Attributes
    ----------
    command : Command or None
        None is the whole program, of which there is only help.
    options : object, optional
        What the command is to do, of its type `asked`; without it help was asked for.
    """

    command: Command | None
    options: Any = None


@cache
def app() -> App:
    """Return what reads the command line, and writes completions for the shell."""
    program = App(
        name="spectra-kit",
        version_flags=(),
        default_parameter=Parameter(allow_repeating=True),  # the last one counts
        print_error=False,
        exit_on_error=False,
    )
    for command in COMMANDS:
        program.command(command.asked, name=command.name)
    return program


def parse(arguments: Sequence[str]) -> Asked:
    """Read a command line, without the name of the program.

    Raises
    ------
    UsageError
        If it is not understood; with what may have been meant.
    """
    command = NAMED.get(next(iter(arguments), ""))
    if not arguments:
        raise UsageError("a command is required", None)
    if {"-h", "--help"}.intersection(arguments):  # found here, it costs no console
        return Asked(command)
    try:
        # A lone hyphen is no option, but what it means elsewhere.
        words = ["/dev/stdin" if word == "-" else word for word in arguments]
        found, bound, _ = app().parse_args(words)
    except CycloptsError as error:
        raise UsageError(_told(error, command), command) from error
    return Asked(command, found(*bound.args, **bound.kwargs))


def _told(error: CycloptsError, command: Command | None) -> str:
    """Say what is wrong with a command line, in one line and as the help has it."""
    if command and isinstance(error, MissingArgumentError) and error.keyword is None:
        return f"{command.operands.removesuffix(' [options]')} is required"
    if isinstance(error, UnusedCliTokensError):
        return f"unrecognized arguments: {' '.join(error.unused_tokens or ())}"
    return str(error).removesuffix(".")
