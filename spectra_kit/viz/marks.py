"""Balls that mark points of a geometry."""

from __future__ import annotations

import numpy as np

from spectra_kit._types import Floats, Ints
from spectra_kit.geometry.reference import sphere
from spectra_kit.geometry.shapes import Geometry, PointCloud, TriangleMesh


def with_balls(geometry: Geometry, centres: Floats, radius: float) -> tuple[Geometry, Ints]:
    """Return a geometry with balls of a radius around `centres` (b, 3) after its own points.

    And the number of the ball that each of its points belongs to, -1 for the first n.
    """
    ball = sphere(subdivisions=3 if isinstance(geometry, TriangleMesh) else 2).geometry
    owner = np.append(np.full(geometry.n, -1), np.repeat(np.arange(len(centres)), ball.n))
    points = np.vstack([geometry.points, *(radius * ball.points + centre for centre in centres)])
    if not isinstance(geometry, TriangleMesh):
        return PointCloud(points), owner
    faces = [ball.faces + geometry.n + i * ball.n for i in range(len(centres))]
    return TriangleMesh(points, np.vstack([geometry.faces, *faces])), owner
