"""The factorisation of `SparseLDL`, compiled by numba on first use.

A front is a dense symmetric matrix of the columns of a supernode, which are eliminated in it, and
of the rows below them, whose Schur complement goes to the front of the parent in the elimination
tree (Duff and Reid, *The Multifrontal Solution of Indefinite Sparse Symmetric Linear Equations*,
ACM TOMS 9, 1983). Only upper triangles are kept, by rows: loops run over neighbours in memory.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from spectra_kit._core.compiled import compiled

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Longs = NDArray[np.int64]

# Rows of a front from which on BLAS multiplies, of so many columns and rows at a time. (Fronts of
# volumes are as large.)
_LARGE, WIDE = 256, 128


def _product(
    typing: Any, out: Any, left: Any, right: Any, start: Any, rows: Any, columns: Any, inner: Any
) -> Any:
    """Write (rows, inner) @ (columns, inner).T to `out`, of rows of both from `start` on.

    To the bit as `np.dot`, whose checks and copies would take half a second to compile.
    """
    build: Any = cgutils

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        def numbers(array: Any, skipped: Any) -> Any:
            return builder.bitcast(builder.gep(array.data, [skipped]), ir.IntType(8).as_pointer())

        def number(value: float) -> Any:
            place = build.alloca_once_value(builder, ir.Constant(ir.DoubleType(), value))
            return builder.bitcast(place, ir.IntType(8).as_pointer())

        def call(name: str, letters: str, *given: Any) -> None:
            every = (*(ir.Constant(ir.IntType(8), ord(letter)) for letter in letters), *given)
            kind = ir.FunctionType(ir.IntType(32), [one.type for one in every])
            builder.call(build.get_or_insert_function(builder.module, kind, name), every)

        arrays = zip(signature.args[:3], arguments[:3], strict=True)
        out, left, right = (context.make_array(kind)(context, builder, a) for kind, a in arrays)
        start, rows, columns, inner = arguments[3:]
        skipped, none = builder.mul(start, inner), ir.Constant(start.type, 0)
        a, b, c = numbers(left, skipped), numbers(right, skipped), numbers(out, none)
        last = builder.icmp_signed("==", columns, ir.Constant(columns.type, 1))
        with builder.if_else(last) as (one, several):
            with one:
                call("numba_xxdot", "d\0", inner, a, b, c)
            with several:  # by columns: the transposed product
                sizes = (columns, rows, inner, number(1.0))
                call("numba_xxgemm", "dtn", *sizes, b, inner, a, inner, number(0.0), c, columns)
        return context.get_dummy_value()

    return types.void(out, left, right, *[types.intp] * 4), generate


_multiply: Any = intrinsic(_product)  # numba's annotation of it is that of its definition


@compiled(_nrt=False, error_model="numpy")
def factorise(
    starts: Ints,
    columns: Ints,
    values: Floats,
    order: Ints,
    begins: Ints,
    first: Longs,
    rows: Ints,
    above: Ints,
    panels: Longs,
    subtrees: Longs,
    place: Ints,
    factor: Floats,
    pivots: Floats,
    updates: Floats,
    spots: Longs,
    subtree: int,
    local: Ints,
    behind: Ints,
    front: Floats,
    waiting: Floats,
    four: Floats,
    left: Floats,
    right: Floats,
    product: Floats,
) -> int:
    """Write L^T and D of ``(I + L) D (I + L)^T``; return the place of a bad pivot, or -1.

    Those of one subtree, and to `updates` what it has for the runs above, from ``spots[subtree]``
    on; or, with the number of subtrees, all that is above them. `place` inverts `order`. L^T is
    held by supernodes, from ``panels[s]`` on: for each of its columns what is right of the
    diagonal, in the columns behind it of the supernode and in those of `rows`.
    """
    apart, last = len(subtrees), len(begins) - 1
    s, ready = 0 * last, 0 * last  # of 64 bits, as what follows
    if subtree < apart:
        s, last, ready = subtrees[subtree, 0], subtrees[subtree, 1], apart
    top, high = 0, 0
    while s < last:
        if ready < apart and subtrees[ready, 0] == s:
            s = subtrees[ready, 1]
            for p in range(spots[ready], spots[ready + 1]):
                waiting[top] = updates[p]
                top += 1
            if spots[ready] < spots[ready + 1]:
                behind[high] = s - 1
                high += 1
            ready += 1
            continue
        a, b = begins[s], begins[s + 1]
        width, u = b - a, first[s + 1] - first[s]
        m = width + u
        for i in range(m):
            for j in range(i, m):
                front[i * m + j] = 0.0
        for j in range(a, b):
            local[j] = j - a
        for p in range(u):
            local[rows[first[s] + p]] = width + p
        for j in range(a, b):
            v = order[j]
            for p in range(starts[v], starts[v + 1]):
                i = place[columns[p]]
                if i >= j:
                    front[(j - a) * m + local[i]] += values[p]
        while high > 0 and above[behind[high - 1]] == s:
            high -= 1
            c = behind[high]
            low = first[c]
            k = first[c + 1] - low
            top -= k * (k + 1) // 2
            at = top
            for i in range(k):
                row = local[rows[low + i]] * m
                for j in range(i, k):
                    front[row + local[rows[low + j]]] += waiting[at + j - i]
                at += k - i
        is_large = m >= _LARGE
        for k0 in range(0, width, 4):
            is_four = k0 + 4 <= width  # which are taken from the rows below in one pass
            k1 = k0 + 4 if is_four else width
            # In a large front from the rows of its block alone, whose products BLAS takes from all.
            b0 = k0 // WIDE * WIDE
            b1 = m
            if is_large:
                b1 = b0 + WIDE if width > b0 + WIDE else width
            end = k1 if is_four else b1
            for k in range(k0, k1):
                pivot = front[k * m + k]
                if pivot == 0.0 or not abs(pivot) < np.inf:
                    return a + k  # type: ignore[no-any-return]  # `int` would be compiled
                pivots[a + k] = pivot
                scale = 1.0 / pivot
                row = four[k - k0]
                for j in range(k, m):
                    row[j] = front[k * m + j]
                for i in range(k + 1, end):
                    l0 = row[i] * scale
                    at = i * m
                    for j in range(i, m):
                        front[at + j] -= l0 * row[j]
            if is_four:
                r0, r1, r2, r3 = four[0], four[1], four[2], four[3]
                i0, i1 = 1.0 / pivots[a + k0], 1.0 / pivots[a + k0 + 1]
                i2, i3 = 1.0 / pivots[a + k0 + 2], 1.0 / pivots[a + k0 + 3]
                for i in range(k1, b1):
                    l0, l1, l2, l3 = r0[i] * i0, r1[i] * i1, r2[i] * i2, r3[i] * i3
                    rest = front[i * m + i : i * m + m]
                    f0, f1, f2, f3 = r0[i:m], r1[i:m], r2[i:m], r3[i:m]
                    for j in range(len(rest)):
                        rest[j] -= (l0 * f0[j] + l1 * f1[j]) + (l2 * f2[j] + l3 * f3[j])
            if is_large and k1 == b1:
                wide, low = b1 - b0, m - b1
                for k in range(wide):
                    scale, at = 1.0 / pivots[a + b0 + k], (b0 + k) * m + b1
                    for j in range(low):
                        right[j * wide + k] = front[at + j]
                        left[j * wide + k] = scale * front[at + j]
                for i0 in range(0, low, WIDE):
                    many, at = low - i0, (b1 + i0) * (m + 1)
                    few = WIDE if many > WIDE else many
                    _multiply(product, left, right, i0, few, many, wide)
                    for i in range(few):
                        for j in range(i, many):
                            front[at + j] -= product[i * many + j]
                        at += m
        at = panels[s]
        for k in range(width):
            scale = 1.0 / pivots[a + k]
            source, target = front[k * m + k + 1 : k * m + m], factor[at : at + m - k - 1]
            for j in range(len(target)):
                target[j] = source[j] * scale
            at += m - k - 1
        if u > 0:
            for i in range(width, m):
                for j in range(i, m):
                    waiting[top + j - i] = front[i * m + j]
                top += m - i
            behind[high] = s
            high += 1
        s += 1
    if subtree < apart:
        for p in range(top):
            updates[spots[subtree] + p] = waiting[p]
    return -1


@compiled(_nrt=False)
def factor_columns(begins: Ints, first: Longs, rows: Ints, starts: Longs, found: Ints) -> None:
    """Write where the columns of L start in the factor, and the row of each entry."""
    at = 0
    for s in range(len(begins) - 1):
        for j in range(begins[s], begins[s + 1]):
            starts[j] = at
            for i in range(j + 1, begins[s + 1]):
                found[at] = i
                at += 1
            for p in range(first[s], first[s + 1]):
                found[at] = rows[p]
                at += 1
    starts[begins[-1]] = at
