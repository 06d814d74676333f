"""`compiled_beside`: at the first call, loops are compiled in two processes.

``python -m spectra_kit._sparse.first_call`` compiles what a factor needs after its order is found,
which takes the caller as long. numba compiles one loop at a time in a process.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import numpy as np
from scipy import sparse

from spectra_kit._core.threads import thread_count
from spectra_kit._core.version import VERSION


@contextmanager
def compiled_beside() -> Iterator[None]:
    """Have a process compile while the block runs, once for a version and folder of loops."""
    process = None
    if thread_count() > 1 and sys.executable and not getattr(sys, "frozen", False):
        # Without the folder that the user is in, whose modules are not to be imported.
        command, nothing = [sys.executable, "-P", "-m", __name__], subprocess.DEVNULL
        with suppress(OSError):  # it only saves time
            if _is_first():
                process = subprocess.Popen(command, stdin=nothing, stdout=nothing, stderr=nothing)
    try:
        yield
    finally:
        if process is not None:
            process.terminate()
            process.wait()


def _is_first() -> bool:
    """Whether nobody has asked here before; fails where nothing can be kept."""
    from spectra_kit._core.compiled import cache_folder

    folder = cache_folder()
    if folder is None:
        return False
    folder.mkdir(parents=True, exist_ok=True)
    try:
        (folder / f"first_call-{VERSION}-{sys.implementation.cache_tag}").touch(exist_ok=False)
    except FileExistsError:
        return False
    return True


def main() -> None:
    """Compile, on the smallest matrix, whose elimination is known without loops that find it."""
    from spectra_kit._sparse.elimination import Elimination
    from spectra_kit._sparse.ldl import SparseLDL
    from spectra_kit._sparse.products import spmm

    matrix = sparse.csr_array(np.ones((1, 1)))
    none, one = np.empty(0, np.int32), np.array([0, 1], np.int32)
    known = Elimination(
        starts=one,
        columns=one[:1].copy(),
        order=one[:1].copy(),
        begins=one,
        first=np.zeros(2, np.int64),
        rows=none,
        above=np.full(1, -1, np.int32),
        panels=np.zeros(2, np.int64),
        subtrees=np.empty((0, 2), np.int64),
        work=np.empty(0, np.int64),
        sizes=np.array([[1, 0]]),
        places=none,
    )
    factor = SparseLDL(matrix, elimination=known)
    spmm(matrix, factor.solve(np.ones((1, 2))))
    _ = factor.lower


if __name__ == "__main__":
    main()
