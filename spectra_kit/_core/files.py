"""Writing files so that a reader never meets half of one, and refusing one that was damaged."""

from __future__ import annotations

import atexit
import lzma
import os
import pickle
import secrets
import shutil
import signal
import stat
import struct
import tempfile
import threading
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from spectra_kit.errors import (
    InvalidFileError,
    InvalidInputError,
    InvalidSpectrumError,
    SpectraKitError,
)

_ENDING = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
_LONGEST_SUFFIX = 32  # bytes; no format has a longer one, and names have room for 255
_cleanups: list[tuple[int, Callable[[], object]]] = []  # with the process that they are of


@contextmanager
def atomic_path(path: str | os.PathLike[str], *, flush: bool = True) -> Iterator[Path]:
    """Yield a temporary path that takes the place of `path` once it is completely written.

    When the block ends well the file, in the same folder and with the same suffix, is flushed to
    the disk and renamed over `path` in one step, with the rights of the file that was there; when
    it raises, or the process is told to end, it is removed and `path` keeps its old content. A
    symbolic link is followed. A pipe or a device is not replaced but written to at the end. Without
    `flush` a loss of power may leave a file that is not whole: for what is checked and made again.
    """
    target = check_target(path)
    through = is_special(path)
    folder = Path(tempfile.gettempdir()) if through else target.parent
    suffix = target.suffix if len(os.fsencode(target.suffix)) <= _LONGEST_SUFFIX else ""
    part = folder / f".{secrets.token_hex(8)}{suffix}"
    private = through or target.exists()  # whose rights may be narrower than usual
    with cleaned(lambda: part.unlink(missing_ok=True)), naming(path, part):
        part.touch(0o600 if private else 0o666, exist_ok=False)
        yield part
        if through:
            with part.open("rb") as source, open(path, "wb") as sink:
                shutil.copyfileobj(source, sink)
            return
        if flush:
            with part.open("rb+") as file:
                os.fsync(file.fileno())
        replace(part, target)


def is_special(path: str | os.PathLike[str]) -> bool:
    """Whether `path` is a pipe or a device, to write to, never to replace; ``/proc`` followed."""
    return os.path.exists(path) and not os.path.isfile(path) and not os.path.isdir(path)


def replace(part: Path, target: Path) -> None:
    """Rename `part` over `target`, which hands on its owner and its rights, as far as they go."""
    try:
        old = target.stat()
    except OSError:  # none is there, or no more; or links that lead in a circle
        old = None
    if old is not None:
        # To give files away is the right of the superuser, and not everywhere.
        with suppress(OSError, AttributeError):
            os.chown(part, old.st_uid, old.st_gid)
        part.chmod(stat.S_IMODE(old.st_mode))
    os.replace(part, target)


@contextmanager
def temporary_folder(parent: Path | None = None) -> Iterator[Path]:
    """Yield a new folder in `parent`, by default where the system has its own; remove it after."""
    name = f".unfinished-{secrets.token_hex(4)}"
    folder = (parent or Path(tempfile.gettempdir())) / name
    with cleaned(lambda: shutil.rmtree(folder, ignore_errors=True)):
        folder.mkdir(0o700 if parent is None else 0o777)
        yield folder


@contextmanager
def cleaned(cleanup: Callable[[], object]) -> Iterator[None]:
    """Call `cleanup` after the block, also where SIGTERM or SIGHUP ends the process within it.

    Handlers that somebody else has set are left alone: they end the block in their own way.
    """
    entry, ours = (os.getpid(), cleanup), []
    _cleanups.append(entry)
    try:
        if threading.current_thread() is threading.main_thread():  # which alone may set handlers
            for number in _ENDING:
                if signal.getsignal(number) is signal.SIG_DFL:
                    signal.signal(number, _end)
                    ours.append(number)
        yield
    finally:
        cleanup()
        _cleanups.remove(entry)
        for number in ours:
            signal.signal(number, signal.SIG_DFL)


@atexit.register
def _clean() -> None:
    """Clean up what is not yet; also what Ctrl-C in the midst of cleaning up has left."""
    for process, cleanup in list(_cleanups):
        if process == os.getpid():  # not in a copy of it, which a fork makes
            cleanup()


def _end(number: int, frame: object) -> None:
    """Die of the signal, as who sent it expects, but tidily."""
    _clean()
    signal.signal(number, signal.SIG_DFL)
    os.kill(os.getpid(), number)


@contextmanager
def undivided() -> Iterator[None]:
    """Hold back Ctrl-C and the signals that end a process until the block has ended."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    held: list[int] = []
    before = {
        number: signal.signal(number, lambda number, _: held.append(number))
        for number in (signal.SIGINT, *_ENDING)
        if signal.getsignal(number) not in (signal.SIG_IGN, None)
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for number in held:
            signal.raise_signal(number)


@contextmanager
def naming(path: str | os.PathLike[str], part: Path | None = None) -> Iterator[None]:
    """Let an OSError of the block name `path`, not `part`, of which nobody has heard.

    Nor nothing, as one of a full disk does. One that names another file is about that.
    """
    try:
        yield
    except OSError as error:
        told = path if part is None or error.filename is None else error.filename
        error.filename = str(told).replace(str(part or path), str(path), 1)
        error.filename2 = None
        raise


# What parsers of JSON, npz, npy and zip raise of damaged bytes; RecursionError and
# NotImplementedError are RuntimeErrors, UnicodeDecodeError and JSONDecodeError are ValueErrors.
_DAMAGE = (
    ArithmeticError,
    AttributeError,
    EOFError,
    LookupError,
    RuntimeError,
    TypeError,
    ValueError,
    lzma.LZMAError,
    pickle.UnpicklingError,
    struct.error,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)


@contextmanager
def parsing(path: str | os.PathLike[str], what: str, *, remedy: str) -> Iterator[None]:
    """Refuse the file `path`, which the library wrote, if the block cannot take it apart.

    Nor make of it what it says: what is refused as an argument is the fault of the file here.
    """
    try:
        yield
    except (InvalidInputError, InvalidSpectrumError) as error:
        if isinstance(error, InvalidFileError):
            raise
        problem = InvalidInputError(error.argument, error.expected, error.got, advice=remedy)
        raise InvalidFileError(path, problem) from error
    except SpectraKitError:
        raise
    except (*_DAMAGE, OSError) as error:
        if isinstance(error, FileNotFoundError) and not Path(path).exists():
            absent = f"there is no such {what}; looked from {Path.cwd()}"
            raise InvalidFileError(path, absent) from error
        told = str(error).split("\n")[0] or type(error).__name__
        problem = InvalidInputError(f"not a whole {what} ({told})", advice=remedy)
        raise InvalidFileError(path, problem) from error


def check_target(path: str | os.PathLike[str]) -> Path:
    """Return the file that writing to `path` would write, links followed, if it can be written."""
    target = Path(os.path.realpath(path))
    if target.is_dir():
        raise InvalidInputError("path", "name a file", f"the folder {str(path)!r}")
    if not target.parent.is_dir():
        raise InvalidInputError(
            f"cannot write {str(path)!r}: the folder {str(target.parent)!r} does not exist"
        )
    return target
