"""Delaunay flips on half-edges; numba.

Half-edge ``3 t + c`` runs along side c of triangle t, from corner c to corner c + 1; its twin runs
the other way.
"""

from __future__ import annotations

import math

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from spectra_kit.linalg.compiled import compiled

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

_ROUNDING = 1e-9  # sums of cotangents this far below zero, relatively, are zero


@compiled(error_model="numpy")
def flip_to_delaunay(tails: Ints, lengths: Floats, twins: Ints, most: int) -> bool:
    """Flip edges until the two angles opposite each sum to at most pi; return if all do.

    Flipping lowers the Dirichlet energy (Rippa 1990), so it comes to an end but for rounding;
    after `most` flips it is given up. In place.
    """
    waiting = np.zeros(len(tails), np.bool_)
    stack = np.empty(len(tails), np.int32)
    top = 0
    for h in range(len(tails)):
        if h < twins[h] and _is_bad(lengths, h, twins[h] + 0):
            stack[top], waiting[h] = h, True
            top += 1
    flips = 0
    while top > 0:
        top -= 1
        h = stack[top] + 0  # of 64 bits: nothing is compiled for two kinds of integers
        waiting[h] = False
        g = twins[h] + 0
        if h // 3 == g // 3 or not _is_bad(lengths, h, g):
            continue
        if flips == most:
            return False
        _flip(tails, lengths, twins, h, g)
        flips += 1
        for outer in (_next(h), _previous(h), _next(g), _previous(g)):
            low = min(outer, twins[outer])
            if not waiting[low]:
                stack[top], waiting[low] = low, True
                top += 1
    return True


@register_jitable
def _flip(tails: Ints, lengths: Floats, twins: Ints, h: int, g: int) -> None:
    """Replace the edge ab of the faces abc (h: a to b) and bad (g) by cd.

    The faces become cdb (h: c to d) and dca; each outer half-edge moves by one place.
    """
    bc, ca, ad, db = _next(h), _previous(h), _next(g), _previous(g)
    a, b, c, d = tails[h], tails[g], tails[ca], tails[db]
    ab = lengths[h]
    length_bc, length_ca, length_ad, length_db = lengths[bc], lengths[ca], lengths[ad], lengths[db]
    cx = (ab * ab + length_ca * length_ca - length_bc * length_bc) / (2 * ab)
    dx = (ab * ab + length_ad * length_ad - length_db * length_db) / (2 * ab)
    height = 2 * (_area(lengths, h) + _area(lengths, g)) / ab
    lengths[h] = lengths[g] = math.hypot(cx - dx, height)
    tails[h], tails[g] = c, d
    old = (bc, ca, ad, db)
    new = (ca, ad, db, bc)
    partner = (twins[bc], twins[ca], twins[ad], twins[db])
    tails[new[0]], tails[new[1]], tails[new[2]], tails[new[3]] = b, c, a, d
    lengths[new[0]], lengths[new[1]] = length_bc, length_ca
    lengths[new[2]], lengths[new[3]] = length_ad, length_db
    for j in range(4):
        other = partner[j]
        for i in range(4):  # glued to another side of the same two faces: that has moved, too
            if partner[j] == old[i]:
                other = new[i]
        twins[new[j]], twins[other] = other, new[j]


@register_jitable
def _is_bad(lengths: Floats, h: int, g: int) -> bool:
    one, other = _cotangent(lengths, h), _cotangent(lengths, g)
    return one + other < -_ROUNDING * (1 + abs(one) + abs(other))


@register_jitable
def _cotangent(lengths: Floats, h: int) -> float:
    """Cotangent of the angle opposite half-edge `h`."""
    a, b, c = lengths[h], lengths[_next(h)], lengths[_previous(h)]
    return float((b * b + c * c - a * a) / (4 * _area(lengths, h)))


@register_jitable
def _area(lengths: Floats, h: int) -> float:
    a, b, c = lengths[h], lengths[_next(h)], lengths[_previous(h)]
    square = (a + b + c) * (b + c - a) * (c + a - b) * (a + b - c)
    return math.sqrt(max(square, 0.0)) / 4


@register_jitable
def _next(h: int) -> int:
    return h - 2 if h % 3 == 2 else h + 1


@register_jitable
def _previous(h: int) -> int:
    return h + 2 if h % 3 == 0 else h - 1
