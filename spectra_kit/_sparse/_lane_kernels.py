"""What `SparseLDL` and `Pencil` do for eight at a time, compiled by numba on first use.

What is read of a factor is worth little arithmetic for one right-hand side: the solve waits for
memory. For eight there is as much to read and eight times as much to do with it, if the processor
takes their numbers as one vector. And of a small factor most time goes to finding its places, which
eight shifts share. Compilers do not see that loops over the eight may be such, as arrays might
overlap; so `Lanes` are vectors of LLVM itself.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic, models, register_model
from numpy.typing import NDArray

from spectra_kit._core.compiled import compiled

Ints = NDArray[np.int32]
Longs = NDArray[np.int64]
Reals = NDArray[np.float64] | NDArray[np.float32]

#: Right-hand sides or shifts that go together: the longest vectors there are, of float64.
LANES = 8
#: What `solve_lanes` does: ``I + L``, then ``D (I + L)^T``; with what subtrees have for the others.
DOWN, UP, MEET = 1, 2, 4
_FUSED = ("contract",)  # one rounding for a product and its sum, where the processor can


class Lanes(types.Type):
    """A number of each of the right-hand sides."""

    def __init__(self, dtype: Any, count: int) -> None:
        self.dtype, self.count = dtype, count
        super().__init__(name=f"Lanes({dtype}, {count})")


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        number = dmm.lookup(fe_type.dtype).get_value_type()
        super().__init__(dmm, fe_type, _vector(number, fe_type.count))  # type: ignore[no-untyped-call]


def _lanes(array: Any) -> Lanes:
    """Return what a row of an array of shape (n, 8), or an entry of one of shape (n,), is."""
    return Lanes(array.dtype, 1 if array.ndim == 1 else LANES)


def _vector(number: Any, count: int) -> Any:
    return number if count == 1 else ir.VectorType(number, count)


def _instruction(define: Callable[..., Any]) -> Any:
    """Return what compiled loops call; numba's annotation of it is that of its definition."""
    return intrinsic(define)


def _row(context: Any, builder: Any, kind: Any, array: Any, i: Any) -> tuple[Any, int]:
    """Return a pointer to row i of an array of lanes as a vector, and its alignment."""
    start, count = context.make_array(kind)(context, builder, array).data, _lanes(kind).count
    place = builder.gep(start, [builder.mul(i, context.get_constant(types.intp, count))])
    vector = _vector(start.type.pointee, count).as_pointer()
    return builder.bitcast(place, vector), kind.dtype.bitwidth // 8


def _in_all_lanes(builder: Any, number: Any, vector: Any) -> Any:
    """Return a number as a vector."""
    if vector == number.type:
        return number
    unknown = ir.Constant(vector, ir.Undefined)
    index = ir.IntType(32)
    first = builder.insert_element(unknown, number, ir.Constant(index, 0))
    zeros = ir.Constant(ir.VectorType(index, LANES), [0] * LANES)
    return builder.shuffle_vector(first, unknown, zeros)


@_instruction
def _take(typing: Any, array: Any, i: Any) -> Any:
    """Row i of an array of lanes."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place, alignment = _row(context, builder, signature.args[0], *arguments)
        return builder.load(place, align=alignment)

    return _lanes(array)(array, types.intp), generate


@_instruction
def _put(typing: Any, array: Any, i: Any, lanes: Any) -> Any:
    """Write row i of an array of lanes."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place, alignment = _row(context, builder, signature.args[0], *arguments[:2])
        builder.store(arguments[2], place, align=alignment)
        return context.get_dummy_value()

    return types.void(array, types.intp, lanes), generate


@_instruction
def _zero(typing: Any, array: Any, i: Any) -> Any:
    """Whether row i of an array of lanes is zero; NaN is not."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place, alignment = _row(context, builder, signature.args[0], *arguments)
        row = builder.load(place, align=alignment)
        some = builder.fcmp_unordered("!=", row, ir.Constant(row.type, None))
        if some.type != ir.IntType(1):
            some = builder.bitcast(some, ir.IntType(LANES))
        return builder.icmp_unsigned("==", some, ir.Constant(some.type, 0))

    return types.boolean(array, types.intp), generate


@_instruction
def _copy(typing: Any, target: Any, i: Any, source: Any, j: Any) -> Any:
    """Write row j of one array to row i of another."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        there, _ = _row(context, builder, signature.args[0], *arguments[:2])
        here, alignment = _row(context, builder, signature.args[2], *arguments[2:])
        builder.store(builder.load(here, align=alignment), there, align=alignment)
        return context.get_dummy_value()

    return types.void(target, types.intp, source, types.intp), generate


@_instruction
def _plus(typing: Any, x: Any, i: Any, y: Any, j: Any) -> Any:
    """``x[i] + y[j]`` of two rows."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        one, _, other, _ = signature.args
        x, i, y, j = arguments
        places = _row(context, builder, one, x, i), _row(context, builder, other, y, j)
        return builder.fadd(*(builder.load(place, align=size) for place, size in places))

    return _lanes(x)(x, types.intp, y, types.intp), generate


@_instruction
def _less(typing: Any, x: Any, array: Any, i: Any, y: Any) -> Any:
    """``x - array[i] * y`` of two rows."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        x, array, i, y = arguments
        numbers = context.make_array(signature.args[1])(context, builder, array).data
        factor = builder.load(builder.gep(numbers, [i]))
        product = builder.fmul(_in_all_lanes(builder, factor, y.type), y, flags=_FUSED)
        return builder.fsub(x, product, flags=_FUSED)

    return x(x, array, types.intp, y), generate


@_instruction
def _times(typing: Any, factor: Any, x: Any) -> Any:
    """``factor * x`` of a row."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        factor, x = arguments
        return builder.fmul(_in_all_lanes(builder, factor, x.type), x)

    return x(x.dtype, x), generate


@_instruction
def _all(typing: Any, array: Any, i: Any) -> Any:
    """``array[i]`` of numbers in all lanes."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array, i = arguments
        start = context.make_array(signature.args[0])(context, builder, array).data
        number = builder.load(builder.gep(start, [i]))
        return _in_all_lanes(builder, number, _vector(number.type, LANES))

    return Lanes(array.dtype, LANES)(array, types.intp), generate


@_instruction
def _over(typing: Any, x: Any, y: Any) -> Any:
    """``x / y`` of two rows."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fdiv(*arguments)

    return x(x, y), generate


@_instruction
def _scaled(typing: Any, x: Any, array: Any, i: Any) -> Any:
    """``x * array[i]`` of two rows."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        x, array, i = arguments
        place, alignment = _row(context, builder, signature.args[1], array, i)
        return builder.fmul(x, builder.load(place, align=alignment))

    return x(x, array, types.intp), generate


@_instruction
def _without(typing: Any, x: Any, factor: Any, array: Any, i: Any) -> Any:
    """``x - factor * array[i]`` of three rows."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        x, factor, array, i = arguments
        place, alignment = _row(context, builder, signature.args[2], array, i)
        product = builder.fmul(factor, builder.load(place, align=alignment), flags=_FUSED)
        return builder.fsub(x, product, flags=_FUSED)

    return x(x, factor, array, types.intp), generate


# All arrays are the caller's: each kind that is made here takes long to compile.
@compiled(_nrt=False)
def solve_lanes(
    order: Ints,
    begins: Ints,
    first: Longs,
    rows: Ints,
    panels: Longs,
    outside: Ints,
    factor: Reals,
    inverse: Reals,
    rhs: Reals,
    out: Reals,
    y: Reals,
    entries: Reals,
    work: Reals,
    spans: Longs,
    what: int,
    left: int,
    right: int,
) -> None:
    """Write the solution of ``P (I + L) D (I + L)^T P^T x = rhs`` to `out`, both (n, s).

    For the columns `left` to `right`, as many as there are lanes in `y` at most, (., 8) or (.,),
    whose `entries` are seen by themselves; one takes a third to two thirds of the time of eight.
    All lanes do the same, so that the bits of a solution do not depend on the others. Only for runs
    in `spans`, (j, 2). Rows of `y` behind the n are those `outside` of subtrees, as the runs of
    these know them: zeros at first, which are added to the others, and then taken from them, where
    subtrees are to `MEET`.

    In `work`, of as many lanes, the rows of a run of columns lie side by side; four of these
    columns are read in one pass.
    """
    n, many, beyond = len(order), right - left, len(outside)
    lanes = len(entries) // (n + beyond)
    if what & DOWN:
        for j in range(len(spans)):
            for i in range(begins[spans[j, 0]], begins[spans[j, 1]]):
                for c in range(many):
                    # No lane has a zero with a sign.
                    entries[i * lanes + c] = rhs[order[i], left + c] + 0.0
                for c in range(many, lanes):
                    entries[i * lanes + c] = 0.0
        if what & MEET:
            for i in range(beyond):
                _put(y, outside[i], _plus(y, outside[i], y, n + i))
        for j in range(len(spans)):
            for s in range(spans[j, 0], spans[j, 1]):
                a, width, low = begins[s], begins[s + 1] - begins[s], first[s]
                u = first[s + 1] - low
                m = width + u
                nothing = True
                for k in range(width):
                    nothing = nothing and _zero(y, a + k)
                if nothing:  # as in most runs where few entries of `rhs` are not zero
                    continue
                for k in range(width):
                    _copy(work, k, y, a + k)
                for k in range(u):
                    _copy(work, width + k, y, rows[low + k])
                k, p0 = 0, panels[s] - 1  # p0 + j: entry k + j of column k; p1 + j: of the next one
                while k + 4 <= width:
                    p1 = p0 + m - k - 2
                    p2 = p1 + m - k - 3
                    p3 = p2 + m - k - 4
                    w0 = _take(work, k)
                    w1 = _less(_take(work, k + 1), factor, p0 + 1, w0)
                    w2 = _less(_less(_take(work, k + 2), factor, p0 + 2, w0), factor, p1 + 2, w1)
                    w3 = _less(_less(_take(work, k + 3), factor, p0 + 3, w0), factor, p1 + 3, w1)
                    w3 = _less(w3, factor, p2 + 3, w2)
                    _put(work, k + 1, w1)
                    _put(work, k + 2, w2)
                    _put(work, k + 3, w3)
                    for j in range(4, m - k):
                        x = _less(_less(_take(work, k + j), factor, p0 + j, w0), factor, p1 + j, w1)
                        _put(work, k + j, _less(_less(x, factor, p2 + j, w2), factor, p3 + j, w3))
                    p0 = p3 + m - k - 1
                    k += 4
                while k < width:
                    w0 = _take(work, k)
                    for j in range(1, m - k):
                        _put(work, k + j, _less(_take(work, k + j), factor, p0 + j, w0))
                    p0 += m - k - 1
                    k += 1
                for k in range(width):
                    _copy(y, a + k, work, k)
                for k in range(u):
                    _copy(y, rows[low + k], work, width + k)
    if what & UP:
        for j in range(len(spans) - 1, -1, -1):
            for s in range(spans[j, 1] - 1, spans[j, 0] - 1, -1):
                a, width, low = begins[s], begins[s + 1] - begins[s], first[s]
                u = first[s + 1] - low
                m = width + u
                for k in range(width):
                    _put(work, k, _times(inverse[a + k], _take(y, a + k)))
                for k in range(u):
                    _copy(work, width + k, y, rows[low + k])
                k, p0 = width, panels[s + 1] - 1
                while k % 4 > 0:
                    k -= 1
                    p0 -= m - k - 1
                    w0 = _take(work, k)
                    for j in range(1, m - k):
                        w0 = _less(w0, factor, p0 + j, _take(work, k + j))
                    _put(work, k, w0)
                while k > 0:
                    k -= 4
                    p0 -= 4 * (m - k) - 10
                    p1 = p0 + m - k - 2
                    p2 = p1 + m - k - 3
                    p3 = p2 + m - k - 4
                    w0, w1 = _take(work, k), _take(work, k + 1)
                    w2, w3 = _take(work, k + 2), _take(work, k + 3)
                    for j in range(4, m - k):
                        x = _take(work, k + j)
                        w0, w1 = _less(w0, factor, p0 + j, x), _less(w1, factor, p1 + j, x)
                        w2, w3 = _less(w2, factor, p2 + j, x), _less(w3, factor, p3 + j, x)
                    w2 = _less(w2, factor, p2 + 3, w3)
                    w1 = _less(_less(w1, factor, p1 + 2, w2), factor, p1 + 3, w3)
                    w0 = _less(_less(w0, factor, p0 + 1, w1), factor, p0 + 2, w2)
                    w0 = _less(w0, factor, p0 + 3, w3)
                    _put(work, k, w0)
                    _put(work, k + 1, w1)
                    _put(work, k + 2, w2)
                    _put(work, k + 3, w3)
                for k in range(width):
                    _copy(y, a + k, work, k)
        if what & MEET:
            for i in range(beyond):
                _copy(y, n + i, y, outside[i])
        for j in range(len(spans)):
            for i in range(begins[spans[j, 0]], begins[spans[j, 1]]):
                for c in range(many):
                    out[order[i], left + c] = entries[i * lanes + c]


@compiled(_nrt=False)
def shifted_pivots(
    starts: Ints,
    columns: Ints,
    values: Reals,
    mass: Reals,
    order: Ints,
    begins: Ints,
    first: Longs,
    rows: Ints,
    above: Ints,
    place: Ints,
    shifts: Reals,
    pivots: Reals,
    local: Ints,
    behind: Ints,
    front: Reals,
    waiting: Reals,
) -> None:
    """Write the `pivots` (n, 8) that factors of ``L - sigma M`` have, for `shifts` sigma of (1, 8).

    Of the factors nothing else is kept. The entries of L and M are `values` and `mass`; all else is
    as in `factorise`, with eight numbers in each row of `front` and `waiting`. Where a pivot is
    zero, what follows in its lane is not finite.
    """
    sigma, one = _take(shifts, 0), _take(shifts, 1)
    top, high = 0, 0
    for s in range(len(begins) - 1):
        a, width, low = begins[s], begins[s + 1] - begins[s], first[s]
        u = first[s + 1] - low
        m = width + u
        for i in range(m):
            for j in range(i, m):
                _put(front, i * m + j, _take(shifts, 2))
        for j in range(width):
            local[a + j] = j
        for p in range(u):
            local[rows[low + p]] = width + p
        for j in range(width):
            v = order[a + j]
            for p in range(starts[v], starts[v + 1]):
                i = place[columns[p]]
                if i >= a + j:
                    _put(front, j * m + local[i], _less(_all(values, p), mass, p, sigma))
        while high > 0 and above[behind[high - 1]] == s:
            high -= 1
            c = first[behind[high]]
            k = first[behind[high] + 1] - c
            top -= k * (k + 1) // 2
            at = top
            for i in range(k):
                row = local[rows[c + i]] * m
                for j in range(i, k):
                    to = row + local[rows[c + j]]
                    _put(front, to, _plus(front, to, waiting, at + j - i))
                at += k - i
        for k0 in range(0, width, 4):
            is_four = k0 + 4 <= width  # which are taken from the rows below in one pass
            k1 = k0 + 4 if is_four else width
            for k in range(k0, k1):
                at = k * m
                inverse = _over(one, _take(front, at + k))
                _copy(pivots, a + k, front, at + k)
                for i in range(k + 1, k1 if is_four else m):
                    l0 = _scaled(inverse, front, at + i)
                    for j in range(i, m):
                        to = i * m + j
                        _put(front, to, _without(_take(front, to), l0, front, at + j))
            if is_four:
                p0 = k0 * m
                p1, p2, p3 = p0 + m, p0 + 2 * m, p0 + 3 * m
                i0 = _over(one, _take(pivots, a + k0))
                i1 = _over(one, _take(pivots, a + k0 + 1))
                i2 = _over(one, _take(pivots, a + k0 + 2))
                i3 = _over(one, _take(pivots, a + k0 + 3))
                for i in range(k1, m):
                    l0, l1 = _scaled(i0, front, p0 + i), _scaled(i1, front, p1 + i)
                    l2, l3 = _scaled(i2, front, p2 + i), _scaled(i3, front, p3 + i)
                    for j in range(i, m):
                        to = i * m + j
                        x = _without(_take(front, to), l0, front, p0 + j)
                        x = _without(x, l1, front, p1 + j)
                        x = _without(x, l2, front, p2 + j)
                        _put(front, to, _without(x, l3, front, p3 + j))
        if u > 0:
            for i in range(width, m):
                for j in range(i, m):
                    _copy(waiting, top + j - i, front, i * m + j)
                top += m - i
            behind[high] = s
            high += 1
