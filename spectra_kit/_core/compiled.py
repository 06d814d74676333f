"""`compiled`: numba's compiler for the loops of this house, its results kept for the next process.

numba would keep them beside the sources. A package must not write into its own folder: what is
left there after `pip uninstall` shadows the next installation.
"""

from __future__ import annotations

import gc
import hashlib
import os
import pickle
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba.core.caching import _Cache
from numba.core.compiler import CompileResult
from numba.core.event import Event, Listener, register
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps
from numba.misc.appdirs import AppDirs

from spectra_kit._core import compiling
from spectra_kit._core.files import atomic_path

F = TypeVar("F", bound=Callable[..., Any])


def compiled(**options: Any) -> Callable[[F], F]:
    """Return a decorator that has numba compile a function when it is first called.

    With the `options` of `numba.njit`; the interpreter lock is released inside. The function must
    not use compiled functions of other files: what is kept is found again by the text of its own.
    """

    def decorate(function: F) -> F:
        if function.__code__.co_freevars:
            raise TypeError(
                f"{function.__qualname__} must not use variables of the function around it, which"
                " are not in its text; pass them as arguments"
            )
        dispatcher: Any = numba.njit(nogil=True, **options)(function)
        with suppress(OSError):  # no text, as in a notebook: nothing to find it by
            dispatcher._cache = _Kept(function)
        return dispatcher  # type: ignore[no-any-return]

    return decorate


def cache_folder() -> Path | None:
    """Return the folder of compiled functions: in NUMBA_CACHE_DIR, or in the user's cache folder.

    None where the user has no home.
    """
    if chosen := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(chosen, "spectra_kit").absolute()
    users = AppDirs(appname="spectra_kit", appauthor=False)  # type: ignore[no-untyped-call]
    folder = Path(users.user_cache_dir)
    return folder if folder.is_absolute() else None


class _Kept(_Cache):
    """A file for each signature, which is named after all that its content depends on.

    So there is nothing to go stale, and processes that write at once write the same. numba's own
    files have an index, which two processes can leave pointing at the wrong code. A folder that
    cannot be read, written or found costs compiling again, never a result.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        text = Path(function.__code__.co_filename).read_bytes()
        self._name = f"{function.__module__}.{function.__qualname__}"
        self._origin = (hashlib.sha256(text).hexdigest(), sys.version, numba.__version__)

    @property
    def cache_path(self) -> str:
        return str(cache_folder())

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return what was kept for a signature, or None."""
        path = self._path(sig, target_context.codegen())
        if path is None:
            return None
        try:
            content = path.read_bytes()
        except OSError:
            return None
        digest, kept = content[:32], content[32:]
        if hashlib.sha256(kept).digest() != digest:  # a machine that lost its power, a bad disk
            return None
        # What runs needs memory. What compiles needs more, which takes 0.2 s to import: numba does
        # that itself, where it refreshes the context.
        rtsys.initialize(target_context)
        parts = pickle.loads(kept)
        return CompileResult._rebuild(target_context, *parts)  # type: ignore[no-untyped-call]

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what a signature was compiled to."""
        path = self._path(sig, data.codegen)
        if path is None or data.library.has_dynamic_globals:  # addresses of this process
            return
        kept = dumps(data._reduce())  # type: ignore[no-untyped-call]
        with suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            with atomic_path(path) as part:
                part.write_bytes(hashlib.sha256(kept).digest() + kept)

    def _path(self, sig: Any, codegen: Any) -> Path | None:
        folder = cache_folder()
        key = repr((self._origin, sig, codegen.magic_tuple()))
        name = f"{self._name}-{hashlib.sha256(key.encode()).hexdigest()[:32]}.nbc"
        return folder and folder / name

    def enable(self) -> None:
        """Nothing to do: numba asks for it, as for the next two."""

    disable = flush = enable


class _Compiling(Listener):
    """Tells of what is compiled, and keeps the collector of garbage from looking at it.

    There is none before the end, but so many objects that looking takes a tenth of the time.
    """

    def __init__(self) -> None:
        self._collects: list[bool] = []  # one within another

    def on_start(self, event: Event) -> None:
        """One of ours begins; what it calls is compiled within, and is not."""
        if _is_kept(event):
            self._collects.append(gc.isenabled())
            gc.disable()
            compiling.tell(True)

    def on_end(self, event: Event) -> None:
        """It has ended, or failed."""
        if _is_kept(event):
            if self._collects.pop():
                gc.enable()
            compiling.tell(False)


def _is_kept(event: Event) -> bool:
    return isinstance(getattr(event.data["dispatcher"], "_cache", None), _Kept)  # loops have none


register("numba:compile", _Compiling())  # type: ignore[no-untyped-call]
