"""`measured`: one measurement of one contender, in a process of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

Answer = dict[str, Any]

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
_WORKER = "spectra_kit.benchmarks.geodesics.worker"


def measured(
    contender: str,
    mesh: Path,
    sources: Sequence[int],
    *,
    threads: int,
    spectrum: Path | None = None,
    many: bool = False,
    fields: Path | None = None,
    subdivisions: int = 5,
    fresh: bool = True,
) -> Answer:
    """Measure one contender in a fresh process, after a warm-up.

    Parameters
    ----------
    contender : str
        One of `CONTENDERS`.
    mesh : Path
        An npz file of V and F.
    sources : sequence of int
        Vertices.
    threads : int
        For every library that counts them.
    spectrum : Path, optional
        The modes it is given.
    many : bool, default False
        Tell the contender all sources at once.
    fields : Path, optional
        Where the distances go, as an npy file of shape (s, n).
    subdivisions : int, default 5
        Of the sphere to warm up on; 5 have 10,242 points.
    fresh : bool, default True
        False measures in this process, on the threads it has.

    Returns
    -------
    dict
        ``seconds`` from the arrays to the last field, ``iterations``, ``choice`` and ``stages`` of
        the first; or ``failure``, a sentence.
    """
    request = {
        "contender": contender,
        "mesh": str(mesh),
        "sources": [int(source) for source in sources],
        "spectrum": str(spectrum or ""),
        "many": many,
        "fields": str(fields or ""),
        "subdivisions": subdivisions,
    }
    if not fresh:
        # Not above: a module that is to be run must not be there already.
        from spectra_kit.benchmarks.geodesics.worker import answer

        return answer(request)
    done = subprocess.run(
        [sys.executable, "-m", _WORKER],
        input=json.dumps(request),
        stdout=subprocess.PIPE,
        text=True,
        check=False,
        env={**os.environ, **dict.fromkeys(_THREADS, str(threads))},
    )
    lines = done.stdout.splitlines()
    if done.returncode or not lines:
        return {"failure": f"the process ended with code {done.returncode}"}
    found: Answer = json.loads(lines[-1])
    return found
