"""Inner loops over the graph of an operator, compiled by numba on first use.

A *connected ball* of a point holds what a walk along the edges of the graph reaches without
leaving the Euclidean ball: two sheets that pass close to each other stay apart, and distances
are not distorted by the edges.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from spectra_kit._core.compiled import compiled

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int32]
Longs = NDArray[np.int64]


@register_jitable
def _longer(array: NDArray[Any], room: int) -> NDArray[Any]:
    """Return a copy with room for more."""
    longer = np.empty(room, array.dtype)
    for t in range(len(array)):  # slices would have their error messages compiled
        longer[t] = array[t]
    return longer


@register_jitable
def _ball(
    starts: Ints,
    neighbours: Ints,
    points: Floats,
    centre: int,
    radius: float,
    mark: int,
    seen: Ints,
    ball: Ints,
    rim: Ints,
) -> tuple[int, int]:
    """Write the connected ball of a point to `ball`, and the points just outside to `rim`.

    Return how many there are of each. In `seen`, all of them get the `mark`, which none has yet.
    """
    x, y, z = points[centre]
    seen[centre], ball[0] = mark, centre
    first, last, beyond = 0, 1, 0
    while first < last:
        i = ball[first]
        first += 1
        for p in range(starts[i], starts[i + 1]):
            j = neighbours[p]
            if seen[j] == mark:
                continue
            seen[j] = mark
            dx, dy, dz = points[j, 0] - x, points[j, 1] - y, points[j, 2] - z
            if dx * dx + dy * dy + dz * dz < radius * radius:
                ball[last] = j
                last += 1
            else:
                rim[beyond] = j
                beyond += 1
    return last, beyond


@compiled()
def cover(starts: Ints, neighbours: Ints, points: Floats, radius: float) -> Ints:
    """Return centres whose connected balls of `radius` cover all points.

    No centre lies in the ball of an earlier one. The next centre is taken from the front, the
    points just outside the balls so far, oldest first: they pack more evenly than random ones.
    """
    n = len(points)
    covered, queued = np.empty(n, np.bool_), np.empty(n, np.bool_)
    seen = np.empty(n, np.int32)  # last centre whose ball was asked about this point
    for i in range(n):  # `np.zeros` and `np.full` would have to be compiled
        covered[i] = queued[i] = False
        seen[i] = -1
    front, ball, rim = np.empty(n, np.int32), np.empty(n, np.int32), np.empty(n, np.int32)
    centres = np.empty(n, np.int32)
    head = tail = count = 0
    for seed in range(n):  # the first point starts the front; others only if it cannot reach them
        if not covered[seed] and not queued[seed]:
            queued[seed] = True
            front[tail] = seed
            tail += 1
        while head < tail:
            centre = front[head] + 0  # of 64 bits: nothing is compiled for two kinds
            head += 1
            if covered[centre]:
                continue
            many, beyond = _ball(starts, neighbours, points, centre, radius, count, seen, ball, rim)
            for p in range(many):
                covered[ball[p]] = True
            for p in range(beyond):
                j = rim[p]
                if not queued[j] and not covered[j]:
                    queued[j] = True
                    front[tail] = j
                    tail += 1
            centres[count] = centre
            count += 1
    return centres[:count].copy()


@compiled()
def balls(
    starts: Ints,
    neighbours: Ints,
    points: Floats,
    centres: Longs,
    radius: float,
    first: int,
    last: int,
) -> tuple[Ints, Ints]:
    """Return how many points are in the connected ball of each centre, and which they are.

    Of the centres `first` to `last`.
    """
    n = len(points)
    seen = np.empty(n, np.int32)
    for i in range(n):
        seen[i] = -1
    members = np.empty(n + 16 * n * (last - first) // len(centres), np.int32)
    counts = np.empty(last - first, np.int32)
    ball, rim = np.empty(n, np.int32), np.empty(n, np.int32)
    total = 0
    for k in range(first, last):
        many, _ = _ball(starts, neighbours, points, centres[k], radius, k, seen, ball, rim)
        if total + many > len(members):
            members = _longer(members, 2 * len(members) + many)
        for t in range(many):
            members[total + t] = ball[t]
        total += many
        counts[k - first] = many
    return counts, members[:total].copy()


@compiled(error_model="numpy")
def interpolate(
    points: Floats,
    centres: Floats,
    starts: Longs,
    columns: Ints,
    radius: float,
    flat: float,
    first: int,
    last: int,
    out: Floats,
) -> None:
    """Write moving-least-squares weights for the points `first` to `last` to `out`.

    Weights of the centres ``columns[starts[i]:starts[i + 1]]`` at point i: those of a fit by a
    function linear in the tangent plane, that is along the two widest axes of these centres; an
    axis with less than `flat` times the variance of the widest is left out.
    """
    mean, slope, offset = np.empty(3), np.empty(3), np.empty(3)
    spread, axes = np.empty((3, 3)), np.empty((3, 3))
    for i in range(first, last):
        here = slice(starts[i], starts[i + 1])
        near, weights = columns[here], out[here]
        total = 0.0
        mean[:] = 0.0
        for p in range(len(near)):
            q = 0.0
            for a in range(3):
                q += (points[i, a] - centres[near[p], a]) ** 2
            q /= radius * radius
            # Zero with two derivatives at the edge of the ball: no kink where a centre drops out.
            weights[p] = max(1 - q, 0.0) ** 3 / (1 + q)
            total += weights[p]
            for a in range(3):
                mean[a] += weights[p] * centres[near[p], a]
        for a in range(3):
            mean[a] /= total
        spread[:] = 0.0
        for p in range(len(near)):
            weights[p] /= total
            for a in range(3):
                offset[a] = centres[near[p], a] - mean[a]
            for a in range(3):
                for b in range(3):
                    spread[a, b] += weights[p] * offset[a] * offset[b]
        _diagonalize(spread, axes)
        widest = max(spread[0, 0], spread[1, 1], spread[2, 2])
        normal = 0
        for e in range(1, 3):
            if spread[e, e] < spread[normal, normal]:
                normal = e
        slope[:] = 0.0
        for e in range(3):
            # Where a centre is alone all is rounding, and slopes would be of any size.
            if e == normal or spread[e, e] <= max(flat * widest, 1e-6 * radius * radius):
                continue
            along = 0.0
            for a in range(3):
                along += axes[a, e] * (points[i, a] - mean[a])
            for a in range(3):
                slope[a] += axes[a, e] * along / spread[e, e]
        for p in range(len(near)):
            tilt = 1.0
            for a in range(3):
                tilt += slope[a] * (centres[near[p], a] - mean[a])
            weights[p] *= tilt


@register_jitable
def _diagonalize(matrix: Floats, axes: Floats) -> None:
    """Diagonalise a symmetric 3 x 3 `matrix` in place by Jacobi rotations; `axes` by columns."""
    axes[:] = 0.0
    for a in range(3):
        axes[a, a] = 1.0
    for _ in range(10):
        off = matrix[0, 1] ** 2 + matrix[0, 2] ** 2 + matrix[1, 2] ** 2
        if off <= 1e-32 * (matrix[0, 0] ** 2 + matrix[1, 1] ** 2 + matrix[2, 2] ** 2):
            break
        for p in range(2):
            for q in range(p + 1, 3):
                if matrix[p, q] == 0:
                    continue
                theta = (matrix[q, q] - matrix[p, p]) / (2 * matrix[p, q])
                t = 1 / (abs(theta) + np.sqrt(theta * theta + 1))
                if theta < 0:
                    t = -t
                c = 1 / np.sqrt(t * t + 1)
                s = t * c
                for a in range(3):
                    x, y = matrix[a, p], matrix[a, q]
                    matrix[a, p], matrix[a, q] = c * x - s * y, s * x + c * y
                for a in range(3):
                    x, y = matrix[p, a], matrix[q, a]
                    matrix[p, a], matrix[q, a] = c * x - s * y, s * x + c * y
                for a in range(3):
                    x, y = axes[a, p], axes[a, q]
                    axes[a, p], axes[a, q] = c * x - s * y, s * x + c * y


@compiled()
def galerkin_rows(
    restrict_starts: Ints,
    members: Ints,
    shares: Floats,
    starts: Ints,
    neighbours: Ints,
    stiffness: Floats,
    mass_starts: Ints,
    mass_neighbours: Ints,
    mass: Floats,
    lift_starts: Ints,
    centres: Ints,
    weights: Floats,
    first: int,
    last: int,
) -> tuple[Ints, Ints, Floats, Floats]:
    """Return rows of the upper triangles of ``P^T L P`` and ``P^T M P``, of one pattern.

    As counts of entries, their columns, and both values. P^T, L, M and P are given by rows, those
    of P with ascending columns.
    """
    n, m = len(lift_starts) - 1, len(restrict_starts) - 1
    energy, weight = np.empty(n), np.empty(n)  # a row of P^T L and one of P^T M
    reached, touched = np.empty(n, np.int32), np.empty(n, np.bool_)
    row_energy, row_mass = np.empty(m), np.empty(m)
    columns, known = np.empty(m, np.int32), np.empty(m, np.bool_)
    for j in range(n):
        energy[j], weight[j], touched[j] = 0.0, 0.0, False
    for c in range(m):
        row_energy[c], row_mass[c], known[c] = 0.0, 0.0, False
    counts = np.empty(last - first, np.int32)
    room = 64 * (last - first) + m
    found, energies, masses = np.empty(room, np.int32), np.empty(room), np.empty(room)
    total = 0
    for i in range(first, last):
        many = 0
        for p in range(restrict_starts[i], restrict_starts[i + 1]):
            r, share = members[p], shares[p]
            for q in range(starts[r], starts[r + 1]):
                j = neighbours[q]
                if not touched[j]:
                    touched[j] = True
                    reached[many] = j
                    many += 1
                energy[j] += share * stiffness[q]
            for q in range(mass_starts[r], mass_starts[r + 1]):
                j = mass_neighbours[q]
                if not touched[j]:
                    touched[j] = True
                    reached[many] = j
                    many += 1
                weight[j] += share * mass[q]
        count = 0
        for p in range(many):
            j = reached[p]
            a, b = energy[j], weight[j]
            energy[j] = weight[j] = 0.0
            touched[j] = False
            for q in range(lift_starts[j + 1] - 1, lift_starts[j] - 1, -1):
                c = centres[q]
                if c < i:
                    break
                if not known[c]:
                    known[c] = True
                    columns[count] = c
                    count += 1
                row_energy[c] += a * weights[q]
                row_mass[c] += b * weights[q]
        if total + count > room:
            room = 2 * room + count
            found, energies = _longer(found, room), _longer(energies, room)
            masses = _longer(masses, room)
        for p in range(count):
            c = columns[p]
            found[total], energies[total], masses[total] = c, row_energy[c], row_mass[c]
            row_energy[c] = row_mass[c] = 0.0
            known[c] = False
            total += 1
        counts[i - first] = count
    return counts, found[:total], energies[:total], masses[:total]
