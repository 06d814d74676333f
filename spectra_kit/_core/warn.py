"""Warnings: told at the line that called the package, or collected for who tells them."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from spectra_kit.errors import Advice, SpectraKitWarning

#: Which of several things warnings are about that do not say it themselves: see `many.about`.
place = ContextVar("place", default="")
_heard: ContextVar[list[SpectraKitWarning] | None] = ContextVar("_heard", default=None)


@contextmanager
def hearing() -> Iterator[list[SpectraKitWarning]]:
    """Collect what `warn` says inside, instead of saying it: in this thread, and in no other.

    `warnings.catch_warnings` changes what all threads of a process do.
    """
    heard: list[SpectraKitWarning] = []
    token = _heard.set(heard)
    try:
        yield heard
    finally:
        _heard.reset(token)


def warn(
    message: str,
    category: type[SpectraKitWarning],
    *,
    advice: Advice = "",
    remedies: tuple[str, ...] = (),
    where: str = "",
) -> None:
    """Warn at the line that called the package, however deep inside the reason was found."""
    told = category(message, advice=advice, remedies=remedies)
    told.where = where or place.get()
    tell(told)


def tell(told: SpectraKitWarning) -> None:
    """Say a warning that is made, or was heard."""
    if (heard := _heard.get()) is not None:
        heard.append(told)
        return
    level, frame = 1, sys._getframe()
    while frame.f_back and frame.f_globals["__name__"].partition(".")[0] == "spectra_kit":
        level, frame = level + 1, frame.f_back
    warnings.warn(told, stacklevel=level)
