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

# Share of zeros in what is eliminated together, and more up to so many columns: the rule of CHOLMOD
# (Chen, Davis, Hager and Rajamanickam, ACM TOMS 35, 2008), which has 0.8 and 0.1. On three real
# models of 23,000 to 90,000 points those save at most 6 % of the factor's time and take 7 to 17 %
# more memory; without any zeros it takes 8 to 36 % longer.
_ZEROS = 0.05
_NARROW = ((4, 1.0), (16, 0.4), (48, 0.15))
# Rows of a front from which on BLAS multiplies, of so many columns and rows at a time. (Fronts of
# volumes are as large.)
_LARGE, WIDE = 256, 128


@compiled(_nrt=False)
def elimination_tree(
    starts: Ints,
    columns: Ints,
    order: Ints,
    ordered: Ints,
    up: Ints,
    below: Ints,
    place: Ints,
    parent: Ints,
    above: Ints,
    child: Ints,
    sibling: Ints,
    new: Ints,
) -> None:
    """Write `order` in postorder, then the parent and the entries below the diagonal of columns.

    After Liu (*The Role of Elimination Trees in Sparse Factorization*, 1990). The last six, of n
    entries as all, are to work in.
    """
    n = len(order)
    for i in range(n):
        place[order[i]] = i
        parent[i] = above[i] = child[i] = -1
    for i in range(n):
        v = order[i]
        for p in range(starts[v], starts[v + 1]):
            k = place[columns[p]]
            while k != -1 and k < i:
                next_one = above[k]  # with short cuts
                above[k] = i
                if next_one == -1:
                    parent[k] = i
                k = next_one
    for i in range(n - 1, -1, -1):
        if parent[i] >= 0:
            sibling[i] = child[parent[i]]
            child[parent[i]] = i
    stack, count = above, 0  # `new`: place of a column in postorder
    for root in range(n):
        if parent[root] >= 0:
            continue
        top = 0
        stack[0] = root
        while top >= 0:
            i = stack[top]
            if child[i] >= 0:
                top += 1
                stack[top] = child[i]
                child[i] = sibling[child[i]]
            else:
                new[i] = count
                count += 1
                top -= 1
    seen = child
    for i in range(n):
        ordered[new[i]] = order[i]
        place[order[i]] = new[i]
        up[new[i]] = new[parent[i]] if parent[i] >= 0 else -1
        below[i], seen[i] = 0, -1
    for i in range(n):  # the entries of row i of L are a subtree: walk it once
        seen[i] = i
        v = ordered[i]
        for p in range(starts[v], starts[v + 1]):
            k = place[columns[p]]
            while k < i and seen[k] != i:
                seen[k] = i
                below[k] += 1
                k = up[k]


@compiled(_nrt=False)
def supernodes(parent: Ints, below: Ints, begins: Ints, kept: Ints) -> int:
    """Write n to `kept`, and where runs of columns begin that are eliminated together, from behind.

    They have the same rows below them, or nearly so: a few zeros cost less than small fronts.
    Returns how many were written; both of the last have room for n + 1.
    """
    n = len(parent)
    count = 0
    for j in range(n):
        if j == 0 or parent[j - 1] != j or below[j - 1] != below[j] + 1:
            begins[count] = j
            count += 1
    begins[count] = n
    # From the root down: the run [begins[s], end) joins the one behind it if that is its parent.
    kept[0] = n
    many = 1
    end = n
    zeros = 0.0
    for s in range(count - 1, -1, -1):
        a, b = begins[s], begins[s + 1]
        width = b - a
        joined = False
        if b < n and parent[b - 1] >= b and parent[b - 1] < end:
            behind = end - b
            more = zeros + width * float(behind + below[end - 1] - below[b - 1])
            total = width + behind
            entries = total * (total + 1) / 2 + float(total) * below[end - 1]
            share = more / entries
            joined = share < _ZEROS
            for wide, most in _NARROW:
                joined = joined or (total <= wide and share < most)
            if joined:
                zeros = more
        if not joined:
            if b < n:
                kept[many] = b
                many += 1
            end = b
            zeros = 0.0
    kept[many] = 0
    return many + 1


@compiled(_nrt=False)
def front_rows(
    starts: Ints,
    columns: Ints,
    order: Ints,
    parent: Ints,
    begins: Ints,
    rows: Ints,
    above: Ints,
    end: Longs,
    place: Ints,
    node: Ints,
    seen: Ints,
) -> None:
    """Write the rows below each supernode from ``end[s]`` on, which moves on, and its parent.

    The last three, of n entries, are to work in.
    """
    n, count = len(order), len(begins) - 1
    for s in range(count):
        for j in range(begins[s], begins[s + 1]):
            place[order[j]], node[j] = j, s
        seen[s] = -1
    for s in range(count):
        up = parent[begins[s + 1] - 1]
        above[s] = node[up] if up >= 0 else -1
    for i in range(n):  # it is a row of the supernodes on the way up from its entries to its own
        seen[node[i]] = i
        v = order[i]
        for p in range(starts[v], starts[v + 1]):
            k = place[columns[p]]
            if k < i:
                s = node[k] + 0
                while seen[s] != i:
                    seen[s] = i
                    rows[end[s]] = i
                    end[s] += 1
                    s = above[s] + 0


@intrinsic
def _multiply(
    typing: Any, out: Any, left: Any, right: Any, start: Any, rows: Any, columns: Any, inner: Any
) -> Any:
    """Write (rows, inner) @ (columns, inner).T to `out`, of rows of both from `start` on.

    To the bit as `np.dot`, whose checks and copies would take half a second to compile.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        def numbers(array: Any, skipped: Any) -> Any:
            return builder.bitcast(builder.gep(array.data, [skipped]), ir.IntType(8).as_pointer())

        def number(value: float) -> Any:
            place = cgutils.alloca_once_value(builder, ir.Constant(ir.DoubleType(), value))
            return builder.bitcast(place, ir.IntType(8).as_pointer())

        def call(name: str, letters: str, *given: Any) -> None:
            every = (*(ir.Constant(ir.IntType(8), ord(letter)) for letter in letters), *given)
            kind = ir.FunctionType(ir.IntType(32), [one.type for one in every])
            builder.call(cgutils.get_or_insert_function(builder.module, kind, name), every)

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
    factor: Floats,
    pivots: Floats,
    place: Ints,
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

    L^T is held by supernodes, from ``panels[s]`` on: for each of its columns what is right of the
    diagonal, in the columns behind it of the supernode and in those of `rows`.
    """
    n, count = len(order), len(begins) - 1
    for i in range(n):
        place[order[i]] = i
    top, high = 0, 0
    for s in range(count):
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
                    return a + k
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
