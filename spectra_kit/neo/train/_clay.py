"""Limbs and balls melted together, many at once: most of what bodies are made of; numba.

Point by point within each of them, so that several points are done at once: twenty times as fast
as `smooth_union` of fields.
"""

from __future__ import annotations

import math

from numba.extending import register_jitable

from spectra_kit._core.compiled import compiled
from spectra_kit._core.types import Floats


@compiled()
def add_limbs(points: Floats, limbs: Floats, blend: float, values: Floats) -> None:
    """Melt limbs (m, 8) into a field (n,) at points (3, n); rows are both ends and both radii."""
    for j in range(len(limbs)):
        x, y, z = limbs[j, 0], limbs[j, 1], limbs[j, 2]
        u, v, w = limbs[j, 3] - x, limbs[j, 4] - y, limbs[j, 5] - z
        scale = 1 / max(u * u + v * v + w * w, 1e-12)
        radius, rise = limbs[j, 6], limbs[j, 7] - limbs[j, 6]
        for i in range(points.shape[1]):
            p, q, r = points[0, i] - x, points[1, i] - y, points[2, i] - z
            t = (p * u + q * v + r * w) * scale
            t = 0.0 if t < 0.0 else (1.0 if t > 1.0 else t)
            p, q, r = p - t * u, q - t * v, r - t * w
            value = math.sqrt(p * p + q * q + r * r) - (radius + rise * t)
            values[i] = _melted(values[i], value, blend)


@compiled()
def add_balls(points: Floats, balls: Floats, blend: float, values: Floats) -> None:
    """Melt ellipsoids (m, 15) likewise; rows are the centre, the radii and the axes, by rows."""
    for j in range(len(balls)):
        x, y, z = balls[j, 0], balls[j, 1], balls[j, 2]
        a, b, c = balls[j, 3], balls[j, 4], balls[j, 5]
        e, f, g = balls[j, 6], balls[j, 7], balls[j, 8]
        h, k, m = balls[j, 9], balls[j, 10], balls[j, 11]
        s, t, u = balls[j, 12], balls[j, 13], balls[j, 14]
        for i in range(points.shape[1]):
            p, q, r = points[0, i] - x, points[1, i] - y, points[2, i] - z
            p, q, r = (
                (p * e + q * h + r * s) / a,
                (p * f + q * k + r * t) / b,
                (p * g + q * m + r * u) / c,
            )
            length = math.sqrt(p * p + q * q + r * r)
            gradient = math.sqrt((p / a) ** 2 + (q / b) ** 2 + (r / c) ** 2)
            gradient = gradient if gradient > 1e-9 else 1e-9
            values[i] = _melted(values[i], length * (length - 1) / gradient, blend)


@register_jitable
def _melted(total: float, value: float, blend: float) -> float:
    """Return the smooth minimum of `smooth_union`; that of infinity and a value is the value."""
    near = 1 - abs(total - value) / blend if blend > 0 else 0.0
    near = near if near > 0.0 else 0.0
    return (total if total < value else value) - near**3 * (blend / 6)
