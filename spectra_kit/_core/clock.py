"""`Clock`: the wall time of a computation, stage by stage."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from types import MappingProxyType


class Clock:
    """Wall time from when it was made, in `seconds` by stage.

    `wait` is called before each look at the time: it waits for work that goes on after a call
    returned, as CUDA's does. Stages may have `spent` some before.
    """

    def __init__(
        self,
        wait: Callable[[], object] | None = None,
        *,
        spent: Mapping[str, float] = MappingProxyType({}),
    ) -> None:
        self._wait, self.seconds = wait, dict(spent)
        self._start = self._last = self._now()

    def stage(self, name: str) -> None:
        """Add the time since the last stage to that of `name`."""
        now = self._now()
        self.seconds[name] = self.seconds.get(name, 0.0) + now - self._last
        self._last = now

    @property
    def total(self) -> float:
        """Seconds since it was made."""
        return self._now() - self._start

    def _now(self) -> float:
        if self._wait is not None:
            self._wait()
        return time.perf_counter()
