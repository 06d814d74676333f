"""The Laplacian of a surface by the lengths of its edges, and what it connects; numba."""

from __future__ import annotations

import math

import numpy as np

from spectra_kit._core.compiled import compiled
from spectra_kit._core.types import Bools, Floats, Ints, Ints32


@compiled(error_model="numpy")
def cotangent_laplacian(
    tails: Ints32, lengths: Floats, twins: Ints32, names: Ints32, copies: int
) -> tuple[Ints32, Ints32, Floats, Floats]:
    """Return the stiffness, by rows with ascending columns and no zeros, and the lumped mass.

    Of one of the `copies`, with corner i at ``names[i]``, which `tails` are written over with.
    Entries that meet are added in the order of their edges, the same on both sides of the diagonal.
    """
    n = len(names)
    starts, areas = np.zeros(n + 1, np.int64), np.zeros(n)
    cotangents = np.empty(len(twins))
    for h in range(0, len(twins), 3):
        a, b, c = lengths[h], lengths[h + 1], lengths[h + 2]
        square = (a + b + c) * (b + c - a) * (c + a - b) * (a + b - c)
        area = math.sqrt(max(square, 0.0)) / 4
        cotangents[h] = (b * b + c * c - a * a) / (4 * area)
        cotangents[h + 1] = (c * c + a * a - b * b) / (4 * area)
        cotangents[h + 2] = (a * a + b * b - c * c) / (4 * area)
        for g in range(h, h + 3):
            areas[tails[g]] += area / 3
            starts[tails[g] + 1] += tails[g] != tails[twins[g]]
    for i in range(n):
        starts[i + 1] += starts[i]
    at = starts[:-1].copy()
    ends, weights = np.empty(starts[n], np.int32), np.empty(starts[n])
    for h in range(len(twins)):
        i, j = tails[h], tails[twins[h]]
        if h < twins[h] and i != j:
            weight = (cotangents[h] + cotangents[twins[h]]) / 2
            ends[at[i]], ends[at[j]] = j, i
            weights[at[i]] = weights[at[j]] = weight
            at[i] += 1
            at[j] += 1
    # Of each point add up the edges to one other, in place, where that is still near in memory.
    tail, place = 0, np.full(n, -1, np.int64)
    for i in range(n):
        first = tail
        for p in range(starts[i], starts[i + 1]):
            j, weight = ends[p], weights[p]
            if place[j] < first:
                place[j], ends[tail], weights[tail] = tail, j, 0.0
                tail += 1
            weights[place[j]] -= weight
        starts[i] = first
    starts[n] = tail
    own, mass, rows = np.empty(n, np.int64), np.empty(n), np.zeros(n + 1, np.int32)
    for i in range(n):
        place[names[i]], mass[names[i]] = i, areas[i] / copies
        rows[names[i] + 1] = starts[i + 1] - starts[i] + 1  # with a place for the diagonal
    for i in range(n):
        rows[i + 1] += rows[i]
        at[i] = rows[i]
    columns, entries = np.empty(tail + n, np.int32), np.empty(tail + n)
    for j in range(n):  # columns after columns: they ascend in each row
        columns[at[j]], entries[at[j]], own[j] = j, 0.0, at[j]
        at[j] += 1
        for p in range(starts[place[j]], starts[place[j] + 1]):
            i = names[ends[p]]
            columns[at[i]], entries[at[i]] = j, weights[p]
            at[i] += 1
    tail = 0
    for i in range(n):
        diagonal, first, rows[i] = 0.0, rows[i], tail
        for p in range(first, rows[i + 1]):
            diagonal -= entries[p]
        entries[own[i]] = diagonal
        for p in range(first, rows[i + 1]):
            if entries[p] / copies != 0:
                columns[tail], entries[tail] = columns[p], entries[p] / copies
                tail += 1
    rows[n] = tail
    for h in range(len(tails)):
        tails[h] = names[tails[h]]
    return rows, columns[:tail], entries[:tail], mass


@compiled()
def components(rows: Ints32, columns: Ints32) -> Ints:
    """Return the connected component of each point of a symmetric matrix, by its first point."""
    n = len(rows) - 1
    labels, stack, label = np.full(n, -1, np.int64), np.empty(n, np.int32), 0
    for first in range(n):
        if labels[first] >= 0:
            continue
        labels[first], stack[0], top = label, first, 1
        while top > 0:
            top -= 1
            i = stack[top]
            for p in range(rows[i], rows[i + 1]):
                if labels[columns[p]] < 0:
                    labels[columns[p]], stack[top] = label, columns[p]
                    top += 1
        label += 1
    return labels


@compiled(error_model="numpy")
def mark_outsized(triangles: Ints32, lengths: Floats, most: Floats, marked: Bools) -> None:
    """Mark first corners of triangles whose circle through the corners is larger than `most`."""
    for t in range(len(triangles)):
        a, b, c = lengths[t, 0], lengths[t, 1], lengths[t, 2]
        one, two = b / a, c / a
        square = (1 + one + two) * (one + two - 1) * (two + 1 - one) * (1 + one - two)
        area = a * (a * math.sqrt(max(square, 0.0)) / 2) / 2
        if a * b * c / (4 * area) > most[triangles[t, 0]]:
            marked[triangles[t, 0]] = True
