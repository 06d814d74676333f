"""Where the commands write: text or JSON to stdout, files and folders where it was asked for."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from math import isfinite
from pathlib import Path

from spectra_kit._core.files import is_special, naming, replace, temporary_folder, undivided
from spectra_kit._core.shown import printable
from spectra_kit.cli.options import Command
from spectra_kit.cli.progress import STDOUT, say, step
from spectra_kit.errors import InvalidInputError

REPORT = "report.json"


def check_output(path: Path | None, suffixes: Sequence[str], inputs: Iterable[Path]) -> None:
    """Refuse a bad output path before the work, not after it; and one that would eat an input."""
    if path is None:
        return
    cannot = f"cannot write {str(path)!r}"
    if path.suffix.lower() not in suffixes:
        known = " or ".join(suffixes)
        raise InvalidInputError("output", f"be a {known} file", repr(str(path)))
    if not path.parent.is_dir():
        raise InvalidInputError(
            f"{cannot}: there is no folder {str(path.parent)!r}", advice="make it first"
        )
    if path.is_dir():
        raise InvalidInputError(f"{cannot}: a folder has that name")
    if not os.access(path if is_special(path) else path.parent, os.W_OK):
        what = "it" if is_special(path) else f"the folder {str(path.parent)!r}"
        raise InvalidInputError(
            f"{cannot}: {what} is not yours to write to", advice="name another place"
        )
    if _is_among(path, inputs):
        raise InvalidInputError(
            "output", "not replace an input", f"{str(path)!r} as both", advice="name another file"
        )


def _is_among(path: Path, inputs: Iterable[Path]) -> bool:
    """Whether a file is one of the inputs, whatever its name: through links of either kind."""
    return path.exists() and any(file.exists() and path.samefile(file) for file in inputs)


def check_folder(
    folder: Path, files: Sequence[str], known: Sequence[str], inputs: Iterable[Path]
) -> None:
    """Refuse to write over an input, or beside files of an earlier run that would stay.

    `files` are the names that will be written, `known` all that the command ever writes.
    """
    elsewhere = "name another folder with --output"
    if not folder.parent.is_dir():
        raise InvalidInputError(
            f"cannot make {str(folder)!r}: there is no {str(folder.parent)!r}",
            advice="make that first",
        )
    if folder.exists() and not folder.is_dir():
        raise InvalidInputError(f"cannot make the folder {str(folder)!r}: a file has that name")
    if odd := [name for name in files if is_special(folder / name)]:
        raise InvalidInputError(
            str(folder),
            "hold plain files where the output goes",
            f"a pipe or a device as {', '.join(odd)}",
            advice=elsewhere,
        )
    inputs = list(inputs)
    there = [name for name in known if (folder / name).exists()]
    if taken := [name for name in files if _is_among(folder / name, inputs)]:
        raise InvalidInputError(
            "output",
            "not replace an input",
            f"{', '.join(taken)} in {str(folder)!r} as one",
            advice=elsewhere,
        )
    if left := [n for n in there if n not in files and not _is_among(folder / n, inputs)]:
        raise InvalidInputError(
            str(folder),
            "hold no other result",
            f"{', '.join(left)}, which would stay beside the new one",
            advice=f"remove what is old, or {elsewhere}",
        )


def tell(
    asked: Command,
    record: Mapping[str, object],
    *blocks: str,
    draw: Callable[[Path], object] | None = None,
    kept: str = "the numbers are whole",
) -> None:
    """Write a result to stdout, as an object or as blocks of text, and `draw` the picture of it.

    Text comes first: what ends the drawing early does not cost the numbers. JSON tells whether
    there is a picture, and comes after it, also where it ends early.
    """
    picture = getattr(asked, "picture", None)
    drawn = None
    if not asked.json:
        _print(printable("\n\n".join(blocks), lines=True) + "\n", now=picture is not None)
    try:
        if picture and draw:
            with drawing([picture], kept=kept):
                draw(picture)
            drawn = picture
    finally:
        if asked.json:
            told = {**record, "picture": drawn} if hasattr(asked, "picture") else record
            _print(as_json(told))
    if drawn and not asked.json:
        _print(f"\npicture: {printable(str(drawn))}\n")


def _print(text: str, *, now: bool = False) -> None:
    with naming(STDOUT):
        sys.stdout.write(text)
        if now:
            sys.stdout.flush()


def tell_folder(
    asked: Command,
    folder: Path,
    record: Mapping[str, object],
    *blocks: str,
    files: Sequence[str],
    pictures: Sequence[str],
    replacing: Sequence[str],
    write: Callable[[Path], object],
    draw: Callable[[Path], object],
) -> None:
    """Write a result and a report of it into a folder, draw it there, and say what was written.

    `write` and `draw` are handed the folder; the pictures of an earlier run, `replacing`, go.
    """
    with step(f"writing {folder}"), together(folder, replacing=replacing) as part:
        write(part)
        (part / REPORT).write_text(as_json(record))
    if pictures:
        paths = [folder / name for name in pictures]
        with drawing(paths, kept=f"the numbers in {folder} are whole"):
            draw(folder)
    written = [str(folder / name) for name in (*files, *pictures)]
    told = "\n".join(f"written: {path}" for path in written)
    tell(asked, {**record, "written": written}, *blocks, told)


def as_json(record: Mapping[str, object]) -> str:
    """Return JSON in which an array of numbers is one line; it knows no NaN: null stands for it."""
    return _indented(_plain(record), "") + "\n"


def _indented(value: object, margin: str) -> str:
    """Objects line by line, and lists of objects; whatever else on one line."""
    inner = margin + "  "
    if isinstance(value, dict) and value:
        parts = [f"{json.dumps(key)}: {_indented(item, inner)}" for key, item in value.items()]
        opening, closing = "{}"
    elif isinstance(value, list) and any(isinstance(item, dict) for item in value):
        parts = [_indented(item, inner) for item in value]
        opening, closing = "[]"
    else:
        return json.dumps(value, allow_nan=False)
    lines = ",\n".join(inner + part for part in parts)
    return f"{opening}\n{lines}\n{margin}{closing}"


def _plain(value: object) -> object:
    """Return `value` as JSON has it."""
    if hasattr(value, "tolist"):  # of NumPy
        value = value.tolist()
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    return None if isinstance(value, float) and not isfinite(value) else value


@contextmanager
def drawing(pictures: Sequence[Path], *, kept: str) -> Iterator[None]:
    """Show that pictures are drawn; where that ends early, say what is `kept` and what is missing.

    The numbers took longer than their pictures, and are whole: Ctrl-C does not throw them away.
    """
    before, done = [_state(path) for path in pictures], False
    try:
        with step("drawing"):
            yield
        done = True
    finally:
        if not done:
            drawn = zip(pictures, before, strict=True)
            missing = [str(path) for path, old in drawn if _state(path) in (None, old)]
            say(f"{kept}, but not drawn: {', '.join(missing)}")


def _state(path: Path) -> tuple[int, int] | None:
    """What changes when a file is replaced; None where there is none."""
    if not path.exists():
        return None
    status = path.stat()
    return status.st_ino, status.st_mtime_ns


@contextmanager
def together(folder: Path, *, replacing: Iterable[str] = ()) -> Iterator[Path]:
    """Yield an empty folder, whose files move into `folder` when the block ends well.

    So what is interrupted leaves nothing, or the whole result of an earlier run. The pictures of
    that run, `replacing`, go in the same moment: they would show another result than the numbers.
    No signal comes between; should the process be killed there, or the power fail, then the
    report is missing, which goes first and comes last: it never stands beside numbers of another
    run.
    """
    beside = folder if folder.is_dir() else folder.parent
    with ExitStack() as stack:
        with naming(folder):
            part = stack.enter_context(temporary_folder(beside))
        with naming(folder, part):
            yield part
        done = sorted(part.iterdir(), key=lambda path: path.name == REPORT)
        with undivided():
            folder.mkdir(exist_ok=True)
            for old in (REPORT, *replacing):
                (folder / old).unlink(missing_ok=True)
            for path in done:
                replace(path, folder / path.name)
