"""How the help looks: groups of options in two columns, and nothing that a pipe could not take."""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, get_args

from spectra_kit.cli.options import DEMO, FORMATS, Command
from spectra_kit.cli.program import COMMANDS, app

_WIDTH = 80  # lines are shorter than this, or than a narrower terminal
_SHOWN = (str, int, float, Path)  # defaults of these kinds
_COLUMN = 24  # where the text of an option begins
_GROUPS = ("input", "sources", "method", "operator", "solver", "workers",
           "output", "drawing", "general")  # fmt: skip


def help_text(command: type[Command] | None) -> str:
    """Return the help of a command: what it does, by example, and what it takes.

    Without one, that of the whole program: what comes in, what goes out, and in which order one
    uses the commands.
    """
    if command is None:
        return _story()
    width = min(shutil.get_terminal_size().columns, _WIDTH) - 1
    examples = "\n".join(f"  spectra-kit {line}" for line in command.examples)
    blocks = [
        command.usage,
        textwrap.fill(command.__doc__ or "", width),
        f"examples:\n{examples}",
        *_groups(command, width),
        "\n".join(["keys of the --json object:", *_wrapped(command.keys, width, 2)]),
    ]
    return "\n\n".join(blocks) + "\n"


def _story() -> str:
    lines = "\n".join(
        f"  {c.name:10}  {c.outcome:20}  spectra-kit {c.examples[0]}" for c in COMMANDS
    )
    return f"""\
usage: spectra-kit COMMAND FILE [options]      more: spectra-kit COMMAND --help
From a mesh or point cloud to its Laplace-Beltrami spectrum, and onwards:

{lines}

FILE: {FORMATS}; or {DEMO}, a made-up animal.
Exit codes: 0 fine, 1 bug, 2 bad usage or file, 3 solver failed, 130 Ctrl-C
"""


def _groups(command: type[Command], width: int) -> Iterator[str]:
    """Each group of options under its name, places before options."""
    options = app()[command.name].assemble_argument_collection(parse_docstring=True)
    for name in _GROUPS:
        members = [o for o in options if o.show and _group(command, o.field_info.name) == name]
        if not members:
            continue
        lines = [f"{name}:"]
        if note := command.notes.get(name):
            lines += [*_wrapped(note, width, 2), ""]
        if name == "general":
            lines += _lines("-h, --help", "show this and exit", width)
        for option in sorted(members, key=lambda o: o.index is None):
            lines += _lines(_head(option), _text(option), width)
        yield "\n".join(lines)


def _group(command: type[Command], option: str) -> str:
    """The group of the class that has an option first; what a command has alone is output."""
    classes = map(vars, reversed(command.__mro__))
    owner = next(c for c in classes if option in c.get("__annotations__", ()))
    return str(owner.get("group", "output"))


def _head(option: Any) -> str:
    """The names of an option and what it takes."""
    names = sorted(option.parameter.name, key=len)
    if option.index is not None:
        return str(names[0].lstrip("-"))
    if option.is_flag():
        return ", ".join(names)
    choices = option.get_choices()
    value = option.parameter.metavar or (f"{{{','.join(choices)}}}" if choices else _value(option))
    return ", ".join(f"{name} {value}" for name in names)


def _value(option: Any) -> str:
    kinds = {int: "N", float: "X", Path: "FILE", str: "NAME"}
    return next(
        word for kind, word in kinds.items() if kind in (*get_args(option.hint), option.hint)
    )


def _text(option: Any) -> str:
    """What an option does, and its default if it has one that this does not tell."""
    text, default = " ".join(option.parameter.help.split()), option.field_info.default
    if "(default" not in text and default is not False and isinstance(default, _SHOWN):
        text += f" (default: {f'{default:g}' if isinstance(default, float) else default})"
    if option.parameter.metavar and "one of" not in text and (names := option.get_choices()):
        text += f"; one of {', '.join(names)}"
    return text


def _lines(head: str, text: str, width: int) -> Sequence[str]:
    """Two columns; the second begins on the next line where the first is too long."""
    wrapped = _wrapped(text, width, _COLUMN)
    if len(head) + 4 > _COLUMN:
        return [f"  {head}", *wrapped]
    return [f"  {head}".ljust(_COLUMN) + wrapped[0][_COLUMN:], *wrapped[1:]]


def _wrapped(text: str, width: int, margin: int) -> list[str]:
    indent = " " * margin
    return textwrap.wrap(
        text, width, initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False
    )
