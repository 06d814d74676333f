"""The commands, in the order in which one meets them, and what the help says of each."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module

from spectra_kit._version import VERSION
from spectra_kit.cli import arguments
from spectra_kit.cli.geodesic_options import add_geodesic_arguments
from spectra_kit.cli.options import DEMO, FORMATS
from spectra_kit.cli.parser import Parser


@dataclass(frozen=True)
class Command:
    """One of the commands.

    Attributes
    ----------
    name : str
        As typed.
    outcome : str
        What one gets, in a few words.
    purpose : str
        A sentence or two.
    examples : tuple of str
        Without the name of the program; the first one stands in the story.
    keys : str
        Of the object that ``--json`` prints.
    add_arguments : callable
        Fills a parser.
    run : str
        The module of this package, and in it the function that takes the parsed arguments.
    """

    name: str
    outcome: str
    purpose: str
    examples: tuple[str, ...]
    keys: str
    add_arguments: Callable[[argparse.ArgumentParser], None]
    run: str

    def load(self) -> Callable[[argparse.Namespace], None]:
        """Import what the command needs, and return its function."""
        module, _, function = self.run.partition(".")
        run: Callable[[argparse.Namespace], None]
        run = getattr(import_module(f"spectra_kit.cli.{module}"), function)
        return run

    @property
    def notes(self) -> str:
        """The end of the help."""
        return f"keys of the --json object:\n  {self.keys}"


COMMANDS = (
    Command(
        "info",
        "what a file holds",
        "Say what a file holds, what is wrong with it and what can be made of it.",
        ("info bunny.obj", "info scan.ply --repair", "info bunny.obj --json"),
        "input, kind, diagnosis, problems, operator",
        arguments.add_info_arguments,
        "commands.info",
    ),
    Command(
        "spectrum",
        "certified modes",
        "Compute the lowest eigenvalues and eigenfunctions, each with a certificate of\n"
        "its accuracy.",
        (
            "spectrum bunny.obj -o bunny.npz",
            "spectrum bunny.obj --solver multilevel --rtol 1e-8 --verify",
            f"spectrum {DEMO} -k 24 --picture spectrum.png",
        ),
        "input, geometry, eigenvalues, certificate, provenance, verdict,\n  output, picture",
        arguments.add_spectrum_arguments,
        "commands.spectrum",
    ),
    Command(
        "modes",
        "a picture of modes",
        "Draw modes on the surface, with their zero lines, eigenvalues and residuals.",
        (
            "modes bunny.obj -o modes.png",
            "modes bunny.obj --spectrum bunny.npz --modes 1,5,20",
            f"modes {DEMO} -o modes.pdf --dpi 600",
        ),
        "input, geometry, eigenvalues, certificate, provenance, verdict,\n  modes, picture",
        arguments.add_modes_arguments,
        "pictures.modes",
    ),
    Command(
        "animate",
        "modes that swing",
        "Let modes swing, one after the other, in a GIF or an MP4.",
        (
            "animate bunny.obj -o modes.gif",
            "animate bunny.obj --spectrum bunny.npz --modes 7",
            f"animate {DEMO} -o modes.mp4 --width 720 --fps 30",
        ),
        "input, geometry, eigenvalues, certificate, provenance, verdict,\n  modes, animation",
        arguments.add_animate_arguments,
        "pictures.animate",
    ),
    Command(
        "compare",
        "predicted and exact",
        "Set predicted modes beside exact ones: a table of errors, and a picture.",
        (
            "compare bunny.obj -o errors.png",
            "compare bunny.obj --spectrum bunny.npz --solver polished",
            f"compare {DEMO} --cloud 8000 --json",
        ),
        "input, geometry, reference, predicted, comparison, verdict, picture",
        arguments.add_compare_arguments,
        "commands.compare",
    ),
    Command(
        "explore",
        "modes in the browser",
        "Look at modes in the browser, exact and predicted side by side.",
        (
            "explore bunny.obj -o bunny.html",
            "explore bunny.obj --serve",
            f"explore {DEMO} -k 24 --solver none",
        ),
        "input, geometry, reference, predicted, comparison, verdict, explorer, url",
        arguments.add_explore_arguments,
        "explore.explore",
    ),
    Command(
        "match",
        "corresponding points",
        "Find the source point that each target point is, and judge the map.",
        (
            "match cat.off lion.off -o maps",
            "match cat.off lion.off --landmarks pairs.txt",
            f"match {DEMO} {DEMO} --points 2000",
        ),
        "source, target, landmarks, match, written",
        arguments.add_match_arguments,
        "match.match_shapes",
    ),
    Command(
        "geodesic",
        "distances along it",
        "Measure distances along a surface, and draw them with isolines.",
        (
            "geodesic bunny.obj --source 7",
            "geodesic bunny.obj --at 0.1 0.2 0.0 --farthest 3 -o far",
            f"geodesic {DEMO} --compare",
        ),
        "input, kind, points, faces, operator, operator area, operator components,\n"
        "  zero modes, fixed points, eigenvalue spacing, boundary, sources, solver,\n"
        "  choice, time_coefficient, time_step, iterations, relative_residual, heat,\n"
        "  seconds, spectrum, largest_distance, mean_distance, points_not_reached,\n"
        "  spectrum_unused, comparison, written",
        add_geodesic_arguments,
        "geodesic.geodesic_distances",
    ),
    Command(
        "completion",
        "for your shell",
        "Print what a shell needs to complete commands, options and file names.",
        (
            "completion bash >> ~/.bashrc",
            "completion zsh > ~/.zfunc/_spectra-kit",
            "completion tcsh >> ~/.tcshrc",
        ),
        "shell, script",
        arguments.add_completion_arguments,
        "completion.completion",
    ),
)


class StoryParser(Parser):
    """The parser of the whole program, whose help is the story."""

    def format_help(self) -> str:
        """What comes in, what goes out, and in which order one uses the commands."""
        lines = "\n".join(
            f"  {c.name:10}  {c.outcome:20}  spectra-kit {c.examples[0]}" for c in COMMANDS
        )
        return f"""\
usage: {self.usage}      more: spectra-kit COMMAND --help
From a mesh or point cloud to its Laplace-Beltrami spectrum, and onwards:

{lines}

FILE: {FORMATS}; or {DEMO}, a made-up animal.
Exit codes: 0 fine, 1 bug, 2 bad usage or file, 3 solver failed, 130 Ctrl-C
"""


def build_parser() -> StoryParser:
    """Return the parser of ``spectra-kit``."""
    parser = StoryParser("spectra-kit", usage="spectra-kit COMMAND FILE [options]")
    parser.add_argument("-h", "--help", action="help")
    parser.add_argument("--version", action="version", version=f"spectra_kit {VERSION}")
    subparsers = parser.add_subparsers(
        required=True, metavar="COMMAND", prog="spectra-kit", parser_class=Parser
    )
    for c in COMMANDS:
        subparser = subparsers.add_parser(
            c.name,
            help=c.outcome,
            usage=_USAGES.get(c.name, "%(prog)s FILE [options]"),
            purpose=c.purpose,
            examples=[f"spectra-kit {line}" for line in c.examples],
            notes=c.notes,
        )
        c.add_arguments(subparser)
        subparser.set_defaults(load=c.load, root=parser, parser=subparser)
    return parser


_USAGES = {
    "match": "%(prog)s SOURCE TARGET [options]",
    "completion": "%(prog)s SHELL",
}
