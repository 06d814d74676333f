"""The process that measures one contender, and may fail alone.

Started as ``python -m spectra_kit.benchmarks.geodesics.worker``: a JSON request on stdin, a JSON
answer as the last line on stdout. Libraries are loaded and compiled code is fetched from disk by
solving on a small sphere first, with the same contender.
"""

from __future__ import annotations

import gc
import json
import sys
import time
from typing import Any

import numpy as np

from spectra_kit.benchmarks.geodesics.contenders import CONTENDERS
from spectra_kit.eigensolvers import eigensolve
from spectra_kit.errors import SpectraKitError
from spectra_kit.geometry import TriangleMesh, read, sphere
from spectra_kit.operators import robust_laplacian
from spectra_kit.spectra import Spectrum

Answer = dict[str, Any]

_WARM_MODES = 8
# What libraries raise where a mesh is not to their taste.
_FAILURES = (SpectraKitError, RuntimeError, ValueError, MemoryError)


def answer(request: Answer, *, tidy: bool = False) -> Answer:
    """Measure what `process.measured` asks for; `tidy`, with no garbage to collect meanwhile."""
    contender = CONTENDERS[request["contender"]]
    mesh = read(request["mesh"], kind="mesh")
    assert isinstance(mesh, TriangleMesh)
    points, faces = np.array(mesh.points), np.array(mesh.faces)
    spectrum = Spectrum.load(request["spectrum"]) if request["spectrum"] else None
    many, sources = request["many"], request["sources"]

    ball = sphere(subdivisions=request["subdivisions"]).geometry
    modes = eigensolve(robust_laplacian(ball), _WARM_MODES) if spectrum is not None else None
    contender.build(np.array(ball.points), np.array(ball.faces), modes, many)([0] * len(sources))
    if tidy:
        gc.collect()

    start = time.perf_counter()
    try:
        found = contender.build(points, faces, spectrum, many)(sources)
    except _FAILURES as error:
        return {"failure": f"{type(error).__name__}: {error}"}
    seconds = time.perf_counter() - start
    if request["fields"]:
        np.save(request["fields"], [one.distance for one in found])
    return {
        "seconds": seconds,
        "iterations": [one.iterations for one in found],
        "choice": found[0].choice,
        "stages": dict(found[0].stages),
    }


if __name__ == "__main__":
    line = json.dumps(answer(json.loads(sys.stdin.read()), tidy=True))
    sys.stdout.write("\n" + line + "\n")
