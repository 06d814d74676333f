"""The commands by name: what is typed as one of them, and the help of each."""

import io
import shutil
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from importlib import import_module
from typing import Any, Literal

from cyclopts import App, CycloptsError, Parameter
from cyclopts.exceptions import MissingArgumentError, UnusedCliTokensError

from spectra_kit.cli.options import DEMO, FORMATS, Command

#: In the order in which one meets them: what each gives, and how it is typed.
COMMANDS = {
    "info": ("what a file holds", "info bunny.obj"),
    "spectrum": ("certified modes", "spectrum bunny.obj -o bunny.npz"),
    "modes": ("a picture of modes", "modes bunny.obj -o modes.png"),
    "animate": ("modes that swing", "animate bunny.obj -o modes.gif"),
    "compare": ("predicted and exact", "compare bunny.obj -o errors.png"),
    "explore": ("modes in the browser", "explore bunny.obj -o bunny.html"),
    "match": ("corresponding points", "match cat.off lion.off -o maps"),
    "carry": ("labels along a map", "carry cat.off dog.off parts.npy"),
    "geodesic": ("distances along it", "geodesic bunny.obj --source 7"),
    "path": ("shortest ways", "path cat.off --source 7 --to 90"),
    "curvature": ("how it bends", "curvature bunny.obj"),
    "smooth": ("a smoother one", "smooth scan.ply -o smooth.ply"),
    "similar": ("shapes like it", "similar cat.off animals"),
    "label": ("names, and parts", "label a.ply known.safetensors"),
    "batch": ("many spectra", "batch scans --out store"),
    "match-all": ("many maps", "match-all store --pairs all"),
    "store": ("what a store holds", "store list store"),
    "completion": ("for your shell", "completion bash >> ~/.bashrc"),
}
_WIDTH = 80  # lines are shorter than this, or than a narrower terminal


class UsageError(Exception):
    """The command line was not understood; `command` is the one that it was for, if known."""

    def __init__(self, message: str, command: type[Command] | None) -> None:
        super().__init__(message)
        self.command = command


@dataclass(frozen=True, kw_only=True)
class CompletionOptions(Command):
    """Print what a shell needs to complete commands, options and file names."""

    examples = (
        "completion bash >> ~/.bashrc",
        "completion zsh > ~/.zfunc/_spectra-kit",
        "completion fish > ~/.config/fish/completions/spectra-kit.fish",
    )
    keys = "shell, script"
    operands = "SHELL"
    needs = ()
    solves = False

    shell: Literal["bash", "zsh", "fish"] = field(kw_only=False)
    """which one runs it"""


def completion(asked: CompletionOptions) -> None:
    """Print what a shell has to run."""
    from spectra_kit.cli.output import tell

    script = app(*COMMANDS).generate_completion(shell=asked.shell)
    tell(asked, {"shell": asked.shell, "script": script}, script.removesuffix("\n"))


# Where the function of a command is, and beside it what it can be told. Those of others wait, and
# rooms of the library.
_PLACES = {
    "info": "info.info",
    "spectrum": "modes.spectrum",
    "modes": "modes.modes",
    "animate": "modes.animate",
    "compare": "compare.compare",
    "explore": "explore.explore",
    "match": "match.match_shapes",
    "carry": "carry.carry",
    "geodesic": "geodesic.geodesic_distances",
    "path": "surface.shortest_paths",
    "curvature": "surface.curvature",
    "smooth": "surface.smooth",
    "similar": "learn.similar",
    "label": "learn.label",
    "batch": "batch.batch",
    "match-all": "match_all.match_pairs",
    "store": "batch.store",
    "completion": "program.completion",
}


def load(name: str) -> tuple[type[Command], Callable[[Any], None]]:
    """Return what a command can be told, and its function."""
    module, function = _PLACES[name].split(".")
    place = import_module(f"spectra_kit.cli.{module}")
    told = f"{name.title().replace('-', '')}Options"
    return getattr(place, told), getattr(place, function)


def _shown(default: object) -> object:
    """Return what the help shows of a default: nothing where a flag, or a list, is not given."""
    return None if default is False or default == () else default


def app(*names: str) -> App:
    """Return what reads the command line of these commands, and writes their help."""
    program = App(
        name="spectra-kit",
        version_flags=(),
        help_format="markdown",
        # Of an option that is given twice, the last one counts.
        default_parameter=Parameter(allow_repeating=True, negative="", show_default=_shown),
        print_error=False,
        exit_on_error=False,
    )
    for name in names:
        command, _ = load(name)
        examples = "\n".join(f"spectra-kit {line}" for line in command.examples)
        told = f"examples:\n```\n{examples}\n```\nkeys of the JSON object: {command.keys}"
        program.command(
            command,
            name=name,
            usage=command.usage.removeprefix("usage: "),
            help_epilogue=told,
        )
    return program


def parse(arguments: Sequence[str]) -> tuple[Any, Callable[[Any], None]]:
    """Return what a command line asks for, without the name of the program, and what does it.

    A `UsageError` tells what is not understood, and what may have been meant.
    """
    if not arguments:
        raise UsageError("a command is required", None)
    name = arguments[0]
    if name not in COMMANDS:
        near = [f'. Did you mean "{other}"?' for other in get_close_matches(name, COMMANDS, 1)]
        raise UsageError("".join([f'unknown command "{name}"', *near]), None)
    command, function = load(name)
    try:
        # A lone hyphen is no option, but what it means elsewhere.
        words = ["/dev/stdin" if word == "-" else word for word in arguments]
        found, bound, _ = app(name).parse_args(words)
    except CycloptsError as error:
        raise UsageError(_told(error, command), command) from error
    return found(*bound.args, **bound.kwargs), function


def _told(error: CycloptsError, command: type[Command]) -> str:
    """Say what is wrong with a command line, in one line and as the help has it."""
    if isinstance(error, MissingArgumentError) and error.keyword is None:
        return f"{command.operands.removesuffix(' [options]')} is required"
    if isinstance(error, UnusedCliTokensError):
        return f"unrecognized arguments: {' '.join(error.unused_tokens or ())}"
    return str(error).removesuffix(".")


def help_text(name: str | None) -> str:
    """Return the help of a command, or of the program: what goes in, what comes out, in order."""
    if name in COMMANDS:
        from rich.console import Console

        width = min(shutil.get_terminal_size().columns, _WIDTH) - 1
        console = Console(file=io.StringIO(), width=width, color_system=None)
        with console.capture() as captured:
            app(name).help_print([name], console=console)
        return captured.get()
    rows = COMMANDS.items()
    files = textwrap.fill(
        f"FILE: {FORMATS}; or {DEMO}, a made-up animal.", _WIDTH - 1, subsequent_indent="  "
    )
    lines = "\n".join(f"  {name:10}  {what:20}  spectra-kit {how}" for name, (what, how) in rows)
    return f"""\
usage: spectra-kit COMMAND FILE [options]      more: spectra-kit COMMAND --help
From a mesh or point cloud to its Laplace-Beltrami spectrum, and onwards:

{lines}

{files}
Exit codes: 0 fine, 1 bug, 2 bad usage or file, 3 solver failed, 130 Ctrl-C
"""
