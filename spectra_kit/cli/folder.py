"""Folders that a command fills with files of its own."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from spectra_kit._files import is_special, naming, replace, temporary_folder, undivided
from spectra_kit.cli.progress import say, step
from spectra_kit.errors import InvalidInputError


def check_folder(
    folder: Path, files: Sequence[str], known: Sequence[str], inputs: Iterable[Path]
) -> None:
    """Refuse to write over an input, or beside files of an earlier run that would stay.

    `files` are the names that will be written, `known` all that the command ever writes.
    """
    if not folder.parent.is_dir():
        raise InvalidInputError(
            f"cannot make {str(folder)!r}: there is no {str(folder.parent)!r}; make that first"
        )
    if folder.exists() and not folder.is_dir():
        raise InvalidInputError(f"cannot make the folder {str(folder)!r}: a file has that name")
    if odd := [name for name in files if is_special(folder / name)]:
        raise InvalidInputError(
            f"{str(folder)!r} must hold plain files where the output goes, got a pipe or a device"
            f" as {', '.join(odd)}; name another folder with --output"
        )
    read = {path.resolve() for path in inputs}
    if taken := [name for name in files if (folder / name).resolve() in read]:
        raise InvalidInputError(
            f"the output must not replace an input, got {', '.join(taken)} in {str(folder)!r} as"
            " one; name another folder with --output"
        )
    left = [
        name
        for name in known
        if name not in files and (folder / name).exists()
        if (folder / name).resolve() not in read
    ]
    if left:
        raise InvalidInputError(
            f"{str(folder)!r} must hold no other result, got {', '.join(left)}, which would stay"
            " beside the new one; remove what is old, or name another folder with --output"
        )


@contextmanager
def drawing(pictures: Sequence[Path], *, kept: str) -> Iterator[None]:
    """Show that pictures are drawn; where that ends early, say what is `kept` and what is missing.

    The numbers took longer than their pictures, and are whole: Ctrl-C does not throw them away.
    """
    before = [_state(path) for path in pictures]
    try:
        with step("drawing"):
            yield
    except BaseException:
        drawn = zip(pictures, before, strict=True)
        missing = [str(path) for path, old in drawn if _state(path) in (None, old)]
        say(f"{kept}, but not drawn: {', '.join(missing)}")
        raise


def _state(path: Path) -> tuple[int, int] | None:
    """What changes when a file is replaced; None where there is none."""
    if not path.exists():
        return None
    status = path.stat()
    return status.st_ino, status.st_mtime_ns


@contextmanager
def together(folder: Path, *, report: str, replacing: Iterable[str]) -> Iterator[Path]:
    """Yield an empty folder, whose files move into `folder` when the block ends well.

    So what is interrupted leaves nothing, or the whole result of an earlier run. The pictures of
    that run, `replacing`, go in the same moment: they would show another result than the numbers.
    No signal comes between; should the process be killed there, or the power fail, then `report`
    is missing, which goes first and comes last: it never stands beside numbers of another run.
    """
    beside = folder if folder.is_dir() else folder.parent
    with ExitStack() as stack:
        with naming(folder):
            part = stack.enter_context(temporary_folder(beside))
        yield part
        done = sorted(part.iterdir(), key=lambda path: path.name == report)
        with undivided():
            folder.mkdir(exist_ok=True)
            for old in (report, *replacing):
                (folder / old).unlink(missing_ok=True)
            for path in done:
                replace(path, folder / path.name)
