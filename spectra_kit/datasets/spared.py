"""`Spared`: workers only where they finish sooner than this process alone."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from typing import Any

from spectra_kit._core.threads import usable_cores
from spectra_kit.datasets.run import Engine, Task, in_this_process


@dataclass(frozen=True)
class Spared:
    """Works here, and goes on with an engine once its start is worth it.

    A worker takes as long to start as this process took: its imports, and what the first task took
    more than the others. All of it comes twice: Dask is imported and started here, the workers
    after that. They gain the cores beside the threads that are busy here already. Seconds are those
    of processors, which other programs do not stretch.
    """

    engine: Engine

    def __call__(self, tasks: Iterable[Task]) -> Iterator[tuple[Task, Any | BaseException]]:
        """Do the tasks, in any order."""
        todo = list(tasks)
        imported, start, first = time.process_time(), time.perf_counter(), 0.0
        with closing(in_this_process(todo)) as results:
            for done, (task, result) in enumerate(results, start=1):
                yield task, result
                busy = time.process_time() - imported
                if done == 1:
                    first = busy
                    continue
                each = (busy - first) / (done - 1)
                threads = max(1.0, busy / (time.perf_counter() - start))
                left, begun = (len(todo) - done) * each, imported + max(first - each, 0.0)
                if left * (1 / threads - 1 / usable_cores()) > 2 * begun:
                    break
            else:
                return
        yield from self.engine(todo[done:])
