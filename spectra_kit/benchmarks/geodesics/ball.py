"""`measure_ball`: errors on the unit sphere, where distances are arcs, and their rates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spectra_kit._types import Floats
from spectra_kit.benchmarks.geodesics.contenders import CONTENDERS, DIRECT, PLAIN, ROBUST
from spectra_kit.benchmarks.geodesics.truth import relative_errors
from spectra_kit.geometry import sphere

Record = dict[str, Any]

_SOURCES = 4


def measure_ball(subdivisions: Sequence[int] = (3, 4, 5, 6), *, seed: int = 0) -> Record:
    """Measure errors of distances on spheres of more and more points, as meshes and as clouds.

    Parameters
    ----------
    subdivisions : sequence of int
        Of the icosahedron; clouds have as many points, drawn at random.
    seed : int, default 0
        Of the clouds and sources.

    Returns
    -------
    dict
        ``points``, and under ``mesh`` and ``cloud`` for each contender the mean and largest
        relative errors, averaged over sources.

    Examples
    --------
    >>> from spectra_kit.benchmarks.geodesics import measure_ball
    >>> errors = measure_ball([2, 3])["mesh"]["direct"]["mean"]
    >>> errors[1] < 0.6 * errors[0]
    True
    """
    rng = np.random.default_rng(seed)
    balls = [sphere(subdivisions=count).geometry for count in subdivisions]
    record: Record = {"points": [ball.n for ball in balls], "mesh": {}, "cloud": {}}
    for ball in balls:
        directions = rng.standard_normal((ball.n, 3))
        cloud = directions / np.linalg.norm(directions, axis=1)[:, None]
        sources = rng.choice(ball.n, _SOURCES, replace=False).tolist()
        for name in (DIRECT, ROBUST, PLAIN):
            _append(record["mesh"], name, np.array(ball.points), np.array(ball.faces), sources)
        for name in (DIRECT, ROBUST):
            _append(record["cloud"], name, cloud, None, sources)
    return record


def _append(
    table: Record,
    name: str,
    points: Floats,
    faces: NDArray[np.int64] | None,
    sources: list[int],
) -> None:
    found = CONTENDERS[name].build(points, faces, None, False)(sources)
    errors = [
        relative_errors(
            one.distance, np.arccos(np.clip(points @ points[source], -1, 1)), np.ones(len(points))
        )
        for one, source in zip(found, sources, strict=True)
    ]
    row = table.setdefault(name, {"mean": [], "largest": []})
    row["mean"].append(float(np.mean([e.mean for e in errors])))
    row["largest"].append(float(np.mean([e.largest for e in errors])))
