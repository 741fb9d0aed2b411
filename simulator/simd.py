"""Short vectors that compiled kernels compute with: one lane per element, one machine register per vector.

A kernel written with these reads as scalar formulas and runs 8 (float32) or 4 (float64) elements at a time on any
processor LLVM knows, which the loop vectoriser does not reach for element loops: it cannot prove that gathered and
scattered arrays do not overlap. With NUMBA_DISABLE_JIT=1 the same functions are plain numpy, lanes along the last axis.

Nodal vectors are stored as records of 4 numbers (x, y, z, unused), so that a record is one load, and one batch of
records is turned into three vectors by transposing in registers.
"""

from __future__ import annotations

import operator

import numpy as np
from llvmlite import ir
from numba.core import cgutils, config, types
from numba.core.datamodel import models, register_default
from numba.core.imputils import lower_builtin
from numba.core.registry import cpu_target
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import type_callable

LANES = {np.dtype(np.float32): 8, np.dtype(np.float64): 4}
_CONTRACT = ("contract",)  # a * b + c may become one fused instruction; NaN and infinity keep their meaning


def load(array: np.ndarray, start: int):
    """Vector of consecutive values of an array, seen flat."""
    return array.reshape(-1)[start : start + LANES[array.dtype]].copy()


def lanes(array: np.ndarray) -> int:
    """Number of lanes of the vectors loaded from `array`."""
    return LANES[array.dtype]


def load_as(like: np.ndarray, array: np.ndarray, start: int):
    """Consecutive values of a flat array as a vector of the type and length that `load` gives for `like`."""
    return array[start : start + LANES[like.dtype]].astype(like.dtype)


def load_along(like: np.ndarray, array: np.ndarray, start: int):
    """As many consecutive values of a flat array as `load` gives for `like`, in the type of `array`."""
    return array[start : start + LANES[like.dtype]].copy()


def load_product_along(like: np.ndarray, array: np.ndarray, a: np.ndarray, b: np.ndarray, start: int):
    """The product of two flat arrays of one type, rounded to that type, as a vector like that of `load_along`."""
    place = slice(start, start + LANES[like.dtype])
    return (a[place] * b[place]).astype(array.dtype)


def spread(like: np.ndarray, array: np.ndarray, values: np.ndarray, record: int):
    """One value per record of 4 numbers, from `record` on, as a vector like that of `load_along`."""
    return np.repeat(values[record : record + LANES[like.dtype] // 4].astype(array.dtype), 4)


def store(array: np.ndarray, start: int, value) -> None:
    """Write a vector to consecutive places of an array, seen flat, rounded to the type of the array."""
    array.reshape(-1)[start : start + len(value)] = value


def zero(array: np.ndarray):
    """Vector of zeros, of the type that `load` gives for `array`."""
    return np.zeros(LANES[array.dtype], array.dtype)


def zero_along(like: np.ndarray, array: np.ndarray):
    """Vector of zeros like that of `load_along`."""
    return np.zeros(LANES[like.dtype], array.dtype)


RUN_ORDER = (0, 2, 4, 6, 1, 3, 5, 7)  # lanes of a run hold its elements in this order, which saves shuffles


def gather(records: np.ndarray, starts: np.ndarray, start: int, run: int):
    """Vectors of the four columns of the records (N, 4) whose numbers times 4 are consecutive in the flat `starts`.

    `run` other than 0 promises that the records of 8 lanes are consecutive, in RUN_ORDER; they are read as they lie.
    """
    rows = records[starts[start : start + LANES[records.dtype]] // 4]
    return rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3]


def scatter(records: np.ndarray, starts: np.ndarray, start: int, x, y, z, w) -> None:
    """Write vectors to the 4 columns of the records that `gather` would read by number."""
    rows = np.stack([x, y, z, np.broadcast_to(w, x.shape)], axis=1)
    records[starts[start : start + LANES[records.dtype]] // 4] = rows


def scatter_add(records: np.ndarray, starts: np.ndarray, start: int, x, y, z, w) -> None:
    """Add vectors to the 4 columns of the records that `gather` would read, lane after lane (repeats add up)."""
    rows = np.stack([x, y, z, np.broadcast_to(w, x.shape)], axis=1)
    np.add.at(records, starts[start : start + LANES[records.dtype]] // 4, rows)


def scatter_add_line(records: np.ndarray, starts: np.ndarray, a: int, b: int, run: int, xa, ya, za, xb, yb, zb) -> None:
    """`scatter_add` of x, y, z at the places of two corners, `a` and `b`.

    `run` other than 0 promises a run at both, those of `b` one record on: each record is then read and written once,
    and copies of some of z are added to the 4th column, which saves a quarter of the shuffles.
    """
    scatter_add(records, starts, a, xa, ya, za, 0 * xa)
    scatter_add(records, starts, b, xb, yb, zb, 0 * xb)


def splat(like, value: float):
    """Vector with `value` in every lane, of the type of `like`."""
    return np.full_like(like, value)


def minimum(a, b):
    """Lane by lane the smaller, and NaN where a is NaN."""
    return np.where(b < a, b, a)


def maximum(a, b):
    """Lane by lane the larger, and NaN where a is NaN."""
    return np.where(b > a, b, a)


def choose(test, a, b):
    """Lane by lane a where `test` is above 0, else b."""
    return np.where(test > 0, a, b)


def square_root(x):
    """Square roots of lanes that are not negative."""
    return np.sqrt(x)


def poison_unless_positive(low, value):
    """`low` lowered to `value` where that is smaller, and to -1 where `value` is NaN."""
    return np.where(value > low, low, np.where(value > 0, value, np.asarray(-1, value.dtype)))


def lowest(vector) -> float:
    """Smallest lane of a vector free of NaN."""
    return vector.min()


def total(vector) -> float:
    """Sum of the lanes, pairwise."""
    while vector.size > 1:
        half = vector.size // 2
        vector = vector[:half] + vector[half:]
    return vector[0]


def inverse_cbrt(x):
    """x^(-1/3) of positive lanes to rounding error, without a call to the mathematics library.

    The exponent of the start value comes from the bits of x; y <- y (1 + r/3 + 2 r^2/9), r = 1 - x y^3, is repeated.
    """
    bits = x.astype(np.float32).view(np.int32).astype(np.float32)
    y = (np.float32(_CBRT_MAGIC) - bits * np.float32(1 / 3)).astype(np.int32).view(np.float32)
    y = _refine(x.astype(np.float32), _refine(x.astype(np.float32), y))
    return y if x.dtype == np.float32 else _refine(x, y.astype(x.dtype))


_CBRT_MAGIC = 1419967116.0  # 4/3 (127 - 0.0450) 2^23, which spreads the start error evenly around 0


def _refine(x, y):
    r = 1 - (x * y) * (y * y)  # in two factors, so that the processor can work on both at once; also below
    third, two_ninths = x.dtype.type(1 / 3), x.dtype.type(2 / 9)
    return y + (y * r) * (third + two_ninths * r)


# ---- compiled forms -------------------------------------------------------------------------------------------------


class Vector(types.Type):
    """Numba type of a vector of `lanes` floats."""

    def __init__(self, dtype, lanes):
        self.dtype, self.lanes = dtype, lanes
        super().__init__(name=f"Vector({dtype}, {lanes})")


@register_default(Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        scalar = ir.FloatType() if fe_type.dtype == types.float32 else ir.DoubleType()
        super().__init__(dmm, fe_type, ir.VectorType(scalar, fe_type.lanes))


def _vector_of(dtype) -> Vector:
    return Vector(dtype, 8 if dtype == types.float32 else 4)


def _register_operators() -> None:
    for op, name in (
        (operator.add, "fadd"),
        (operator.sub, "fsub"),
        (operator.mul, "fmul"),
        (operator.truediv, "fdiv"),
    ):
        _register(op, type(f"Vector_{name}", (_BinaryTemplate,), {"key": op}))
        for left, right in ((Vector, Vector), (Vector, types.Float), (types.Float, Vector)):
            lower_builtin(op, left, right)(_binary(name))
    _register(operator.neg, type("Vector_neg", (_UnaryTemplate,), {"key": operator.neg}))
    lower_builtin(operator.neg, Vector)(lambda context, builder, sig, args: builder.fneg(args[0], flags=_CONTRACT))


def _register(op, template) -> None:
    """Make `template` the first that type inference tries for `op`; as the last of dozens it doubles compile time."""
    infer_global(op)(template)
    context = cpu_target.typing_context
    context.refresh()
    function = context.resolve_value_type(op)
    function.templates = (template, *(other for other in function.templates if other is not template))


class _BinaryTemplate(AbstractTemplate):
    def generic(self, args, kws):
        a, b = args
        if isinstance(a, Vector) and a == b:
            return signature(a, a, a)
        if isinstance(a, Vector) and isinstance(b, types.Number):
            return signature(a, a, a.dtype)
        if isinstance(b, Vector) and isinstance(a, types.Number):
            return signature(b, b.dtype, b)
        return None


class _UnaryTemplate(AbstractTemplate):
    def generic(self, args, kws):
        return signature(args[0], args[0]) if isinstance(args[0], Vector) else None


def _binary(name: str):
    def lower(context, builder, sig, args):
        a, b = (
            value if isinstance(ty, Vector) else _broadcast(builder, value, sig.return_type.lanes)
            for value, ty in zip(args, sig.args, strict=True)
        )
        return getattr(builder, name)(a, b, flags=_CONTRACT)

    return lower


def _broadcast(builder, scalar, lanes: int):
    one = builder.insert_element(ir.Constant(ir.VectorType(scalar.type, lanes), ir.Undefined), scalar, _i32(0))
    return builder.shuffle_vector(one, one, ir.Constant(ir.VectorType(ir.IntType(32), lanes), [0] * lanes))


def _i32(value: int):
    return ir.Constant(ir.IntType(32), value)


def _shuffle(builder, a, b, mask):
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(ir.IntType(32), len(mask)), mask))


def _pointer(context, builder, array_type, array, index, width: int):
    """Pointer to `width` values of a C-contiguous array, seen flat, from `index` on."""
    struct = context.make_array(array_type)(context, builder, array)
    at = builder.gep(struct.data, [index], inbounds=True)
    return builder.bitcast(at, ir.VectorType(context.get_data_type(array_type.dtype), width).as_pointer())


def _load(context, builder, array_type, array, index, width: int):
    at = _pointer(context, builder, array_type, array, index, width)
    value = builder.load(at)
    value.align = array_type.dtype.bitwidth // 8
    return value


def _store(context, builder, array_type, array, index, value) -> None:
    at = _pointer(context, builder, array_type, array, index, value.type.count)
    builder.store(value, at, align=array_type.dtype.bitwidth // 8)


def _as_intp(context, builder, value, ty):
    return context.cast(builder, value, ty, types.intp)


@type_callable(lanes)
def _type_lanes(context):
    return lambda array: types.intp


@lower_builtin(lanes, types.Array)
def _lower_lanes(context, builder, sig, args):
    return ir.Constant(context.get_value_type(types.intp), _vector_of(sig.args[0].dtype).lanes)


@type_callable(load)
def _type_load(context):
    return lambda array, start: _vector_of(array.dtype)


@lower_builtin(load, types.Array, types.Integer)
def _lower_load(context, builder, sig, args):
    start = _as_intp(context, builder, args[1], sig.args[1])
    return _load(context, builder, sig.args[0], args[0], start, sig.return_type.lanes)


@type_callable(load_as)
def _type_load_as(context):
    return lambda like, array, start: _vector_of(like.dtype)


@lower_builtin(load_as, types.Array, types.Array, types.Integer)
def _lower_load_as(context, builder, sig, args):
    start = _as_intp(context, builder, args[2], sig.args[2])
    value = _load(context, builder, sig.args[1], args[1], start, sig.return_type.lanes)
    return _convert(builder, value, context.get_value_type(sig.return_type))


def _convert(builder, value, vector_type):
    if value.type.element == vector_type.element:
        return value
    return (builder.fpext if isinstance(vector_type.element, ir.DoubleType) else builder.fptrunc)(value, vector_type)


def _along(like, array) -> Vector:
    return Vector(array.dtype, _vector_of(like.dtype).lanes)


@type_callable(load_along)
def _type_load_along(context):
    return lambda like, array, start: _along(like, array)


@lower_builtin(load_along, types.Array, types.Array, types.Integer)
def _lower_load_along(context, builder, sig, args):
    start = _as_intp(context, builder, args[2], sig.args[2])
    return _load(context, builder, sig.args[1], args[1], start, sig.return_type.lanes)


@type_callable(load_product_along)
def _type_load_product_along(context):
    return lambda like, array, a, b, start: _along(like, array)


@lower_builtin(load_product_along, types.Array, types.Array, types.Array, types.Array, types.Integer)
def _lower_load_product_along(context, builder, sig, args):
    start = _as_intp(context, builder, args[4], sig.args[4])
    a, b = (_load(context, builder, sig.args[i], args[i], start, sig.return_type.lanes) for i in (2, 3))
    return _convert(builder, builder.fmul(a, b), context.get_value_type(sig.return_type))


@type_callable(spread)
def _type_spread(context):
    return lambda like, array, values, record: _along(like, array)


@lower_builtin(spread, types.Array, types.Array, types.Array, types.Integer)
def _lower_spread(context, builder, sig, args):
    vector, source = sig.return_type, sig.args[2]
    record = _as_intp(context, builder, args[3], sig.args[3])
    data = context.make_array(source)(context, builder, args[2]).data
    filled = ir.Constant(context.get_value_type(vector), ir.Undefined)
    for lane in range(vector.lanes):
        at = builder.gep(data, [builder.add(record, ir.Constant(record.type, lane // 4))], inbounds=True)
        value = context.cast(builder, builder.load(at), source.dtype, vector.dtype)
        filled = builder.insert_element(filled, value, _i32(lane))
    return filled


@type_callable(zero_along)
def _type_zero_along(context):
    return lambda like, array: _along(like, array)


@lower_builtin(zero_along, types.Array, types.Array)
def _lower_zero_along(context, builder, sig, args):
    return ir.Constant(context.get_value_type(sig.return_type), None)


@type_callable(zero)
def _type_zero(context):
    return lambda array: _vector_of(array.dtype)


@lower_builtin(zero, types.Array)
def _lower_zero(context, builder, sig, args):
    return ir.Constant(context.get_value_type(sig.return_type), None)


@type_callable(store)
def _type_store(context):
    return lambda array, start, value: types.void


@lower_builtin(store, types.Array, types.Integer, Vector)
def _lower_store(context, builder, sig, args):
    narrow = ir.VectorType(context.get_data_type(sig.args[0].dtype), sig.args[2].lanes)
    start = _as_intp(context, builder, args[1], sig.args[1])
    _store(context, builder, sig.args[0], args[0], start, _convert(builder, args[2], narrow))
    return context.get_dummy_value()


def _record_starts(context, builder, sig, args, lanes: int):
    """Flat index of the first number of each lane's record."""
    starts_type, start = sig.args[1], _as_intp(context, builder, args[2], sig.args[2])
    data = context.make_array(starts_type)(context, builder, args[1]).data
    places = [builder.add(start, ir.Constant(start.type, lane)) for lane in range(lanes)]
    loaded = [builder.load(builder.gep(data, [place], inbounds=True)) for place in places]
    return [_as_intp(context, builder, at, starts_type.dtype) for at in loaded]


def _groups(lanes: int, pattern):
    """Shuffle mask that repeats a pattern of (which operand, place) in every group of 4 lanes."""
    return [operand * lanes + 4 * group + place for group in range(lanes // 4) for operand, place in pattern]


_LOW_INTERLEAVED = ((0, 0), (1, 0), (0, 1), (1, 1))
_HIGH_INTERLEAVED = ((0, 2), (1, 2), (0, 3), (1, 3))
_LOW_PAIRS = ((0, 0), (0, 1), (1, 0), (1, 1))
_HIGH_PAIRS = ((0, 2), (0, 3), (1, 2), (1, 3))


@type_callable(gather)
def _type_gather(context):
    return lambda records, starts, start, run: types.UniTuple(_vector_of(records.dtype), 4)


@lower_builtin(gather, types.Array, types.Array, types.Integer, types.Integer)
def _lower_gather(context, builder, sig, args):
    lanes = sig.return_type.dtype.lanes

    def by_number():
        starts = _record_starts(context, builder, sig, args, lanes)
        rows = [_load(context, builder, sig.args[0], args[0], at, 4) for at in starts]
        if lanes == 8:
            rows = [_shuffle(builder, rows[i], rows[i + 4], list(range(8))) for i in range(4)]
        return _columns(builder, rows, lanes)

    if lanes != 8:
        return context.make_tuple(builder, sig.return_type, by_number())
    with builder.if_else(_is_run(builder, args[3])) as (as_run, otherwise):
        with as_run:
            first = _first_start(context, builder, sig, args)
            pairs = [builder.add(first, ir.Constant(first.type, 8 * i)) for i in range(4)]
            lain = _columns(builder, [_load(context, builder, sig.args[0], args[0], at, 8) for at in pairs], lanes)
            run_block = builder.block
        with otherwise:
            picked = by_number()
            picked_block = builder.block
    columns = []
    for one, other in zip(lain, picked, strict=True):
        phi = builder.phi(one.type)
        phi.add_incoming(one, run_block)
        phi.add_incoming(other, picked_block)
        columns.append(phi)
    return context.make_tuple(builder, sig.return_type, columns)


def _is_run(builder, run):
    return builder.icmp_signed("!=", run, ir.Constant(run.type, 0))


def _first_start(context, builder, sig, args):
    data = context.make_array(sig.args[1])(context, builder, args[1]).data
    place = _as_intp(context, builder, args[2], sig.args[2])
    return _as_intp(context, builder, builder.load(builder.gep(data, [place], inbounds=True)), sig.args[1].dtype)


def _columns(builder, rows, lanes: int):
    """Transpose 4 vectors of records into the vectors of their columns."""
    low, high = _groups(lanes, _LOW_INTERLEAVED), _groups(lanes, _HIGH_INTERLEAVED)
    lower, upper = _groups(lanes, _LOW_PAIRS), _groups(lanes, _HIGH_PAIRS)
    xy01, zw01 = _shuffle(builder, rows[0], rows[1], low), _shuffle(builder, rows[0], rows[1], high)
    xy23, zw23 = _shuffle(builder, rows[2], rows[3], low), _shuffle(builder, rows[2], rows[3], high)
    return [_shuffle(builder, a, b, mask) for a, b in ((xy01, xy23), (zw01, zw23)) for mask in (lower, upper)]


def _rows_of_three(builder, x, y, z, lanes: int):
    """Transpose 3 vectors of columns into 4 vectors of records, whose 4th numbers are copies of some of z."""
    pairs = [_shuffle(builder, x, y, _groups(lanes, mask)) for mask in (_LOW_INTERLEAVED, _HIGH_INTERLEAVED)]
    picks = [((0, 0), (0, 1), (1, 0), (1, 0)), ((0, 2), (0, 3), (1, 1), (1, 1))]
    picks += [((0, 0), (0, 1), (1, 2), (1, 2)), ((0, 2), (0, 3), (1, 3), (1, 3))]
    return [_shuffle(builder, pairs[row // 2], z, _groups(lanes, picks[row])) for row in range(4)]


def _rows(builder, x, y, z, w, lanes: int):
    """Transpose 4 vectors of columns into 4 vectors of records, the inverse of `_columns`."""
    low, high = _groups(lanes, _LOW_INTERLEAVED), _groups(lanes, _HIGH_INTERLEAVED)
    lower, upper = _groups(lanes, _LOW_PAIRS), _groups(lanes, _HIGH_PAIRS)
    xy01, xy23 = _shuffle(builder, x, y, low), _shuffle(builder, x, y, high)
    zw01, zw23 = _shuffle(builder, z, w, low), _shuffle(builder, z, w, high)
    return [_shuffle(builder, a, b, mask) for a, b in ((xy01, zw01), (xy23, zw23)) for mask in (lower, upper)]


def _add_at(context, builder, records_type, records, at, row) -> None:
    old = _load(context, builder, records_type, records, at, row.type.count)
    _store(context, builder, records_type, records, at, builder.fadd(old, row))


@type_callable(scatter)
def _type_scatter(context):
    return lambda records, starts, start, x, y, z, w: types.void


@lower_builtin(scatter, types.Array, types.Array, types.Integer, Vector, Vector, Vector, Vector)
def _lower_scatter(context, builder, sig, args):
    for at, row in _numbered_rows(context, builder, sig, args):
        _store(context, builder, sig.args[0], args[0], at, row)
    return context.get_dummy_value()


def _numbered_rows(context, builder, sig, args):
    """Where each lane's record starts, and the record."""
    lanes = sig.args[3].lanes
    rows = _rows(builder, *args[3:], lanes)
    if lanes == 8:
        rows = [_shuffle(builder, row, row, list(range(half, half + 4))) for half in (0, 4) for row in rows]
    return zip(_record_starts(context, builder, sig, args, lanes), rows, strict=True)


@type_callable(scatter_add)
def _type_scatter_add(context):
    return lambda records, starts, start, x, y, z, w: types.void


@lower_builtin(scatter_add, types.Array, types.Array, types.Integer, Vector, Vector, Vector, Vector)
def _lower_scatter_add(context, builder, sig, args):
    for at, row in _numbered_rows(context, builder, sig, args):
        _add_at(context, builder, sig.args[0], args[0], at, row)
    return context.get_dummy_value()


@type_callable(scatter_add_line)
def _type_scatter_add_line(context):
    return lambda records, starts, a, b, run, xa, ya, za, xb, yb, zb: types.void


@lower_builtin(scatter_add_line, types.Array, types.Array, types.Integer, types.Integer, types.Integer, *(Vector,) * 6)
def _lower_scatter_add_line(context, builder, sig, args):
    vector = sig.args[5]
    nothing = ir.Constant(context.get_value_type(vector), None)
    types_a = signature(None, *sig.args[:3], vector, vector, vector, vector)
    types_b = signature(None, *sig.args[:2], sig.args[3], vector, vector, vector, vector)
    args_a, args_b = (*args[:3], *args[5:8], nothing), (*args[:2], args[3], *args[8:], nothing)

    def by_number():
        _lower_scatter_add(context, builder, types_a, args_a)
        _lower_scatter_add(context, builder, types_b, args_b)

    if vector.lanes != 8:
        by_number()
        return context.get_dummy_value()
    with builder.if_else(_is_run(builder, args[4])) as (as_run, otherwise):
        with as_run:
            first = _first_start(context, builder, types_a, args_a)
            at_a, at_b = _rows_of_three(builder, *args_a[3:6], 8), _rows_of_three(builder, *args_b[3:6], 8)
            before = nothing
            for i in range(4):
                # Records 2i and 2i + 1 get lanes 2i, 2i + 1 of corner a and lanes 2i - 1, 2i of corner b.
                shifted = _shuffle(builder, before, at_b[i], list(range(4, 12)))
                place = builder.add(first, ir.Constant(first.type, 8 * i))
                _add_at(context, builder, sig.args[0], args[0], place, builder.fadd(at_a[i], shifted))
                before = at_b[i]
            last = _shuffle(builder, before, before, list(range(4, 8)))
            _add_at(context, builder, sig.args[0], args[0], builder.add(first, ir.Constant(first.type, 32)), last)
        with otherwise:
            by_number()
    return context.get_dummy_value()


@type_callable(splat)
def _type_splat(context):
    return lambda like, value: like


@lower_builtin(splat, Vector, types.Number)
def _lower_splat(context, builder, sig, args):
    return _broadcast(builder, context.cast(builder, args[1], sig.args[1], sig.args[0].dtype), sig.args[0].lanes)


@type_callable(minimum)
def _type_minimum(context):
    return lambda a, b: a


@lower_builtin(minimum, Vector, Vector)
def _lower_minimum(context, builder, sig, args):
    a, b = args
    return builder.select(builder.fcmp_ordered("<", b, a), b, a)


@type_callable(maximum)
def _type_maximum(context):
    return lambda a, b: a


@lower_builtin(maximum, Vector, Vector)
def _lower_maximum(context, builder, sig, args):
    a, b = args
    return builder.select(builder.fcmp_ordered(">", b, a), b, a)


@type_callable(choose)
def _type_choose(context):
    return lambda test, a, b: a


@lower_builtin(choose, Vector, Vector, Vector)
def _lower_choose(context, builder, sig, args):
    test, a, b = args
    return builder.select(builder.fcmp_ordered(">", test, ir.Constant(test.type, None)), a, b)


@type_callable(square_root)
def _type_square_root(context):
    return lambda x: x


@lower_builtin(square_root, Vector)
def _lower_square_root(context, builder, sig, args):
    name = f"llvm.sqrt.v{sig.args[0].lanes}f{sig.args[0].dtype.bitwidth}"
    kind = ir.FunctionType(args[0].type, [args[0].type])
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), args)


@type_callable(poison_unless_positive)
def _type_poison(context):
    return lambda low, value: low


@lower_builtin(poison_unless_positive, Vector, Vector)
def _lower_poison(context, builder, sig, args):
    low, value = args
    zero, minus_one = ir.Constant(value.type, None), ir.Constant(value.type, [-1.0] * value.type.count)
    positive = builder.select(builder.fcmp_ordered(">", value, zero), value, minus_one)
    return builder.select(builder.fcmp_ordered(">", value, low), low, positive)


@type_callable(lowest)
def _type_lowest(context):
    return lambda vector: vector.dtype


@lower_builtin(lowest, Vector)
def _lower_lowest(context, builder, sig, args):
    return _fold(builder, args[0], lambda a, b: builder.select(builder.fcmp_ordered("<", b, a), b, a))


@type_callable(total)
def _type_total(context):
    return lambda vector: vector.dtype


@lower_builtin(total, Vector)
def _lower_total(context, builder, sig, args):
    return _fold(builder, args[0], builder.fadd)


def _fold(builder, vector, combine):
    while vector.type.count > 1:
        half = vector.type.count // 2
        lower = _shuffle(builder, vector, vector, list(range(half)))
        upper = _shuffle(builder, vector, vector, list(range(half, 2 * half)))
        vector = combine(lower, upper)
    return builder.extract_element(vector, _i32(0))


@type_callable(inverse_cbrt)
def _type_inverse_cbrt(context):
    return lambda x: x


@lower_builtin(inverse_cbrt, Vector)
def _lower_inverse_cbrt(context, builder, sig, args):
    x, lanes = args[0], sig.args[0].lanes
    singles, ints = ir.VectorType(ir.FloatType(), lanes), ir.VectorType(ir.IntType(32), lanes)
    x32 = x if sig.args[0].dtype == types.float32 else builder.fptrunc(x, singles)
    bits = builder.sitofp(builder.bitcast(x32, ints), singles)
    start = builder.fsub(_all(singles, _CBRT_MAGIC), builder.fmul(bits, _all(singles, np.float32(1 / 3))))
    y = builder.bitcast(builder.fptosi(start, ints), singles)
    for _ in range(2):
        y = _lower_refine(builder, x32, y, np.float32)
    if sig.args[0].dtype == types.float64:
        y = _lower_refine(builder, x, builder.fpext(y, x.type), np.float64)
    return y


def _lower_refine(builder, x, y, real):
    third, two_ninths = _all(x.type, real(1 / 3)), _all(x.type, real(2 / 9))
    product = builder.fmul(builder.fmul(x, y), builder.fmul(y, y), flags=_CONTRACT)
    r = builder.fsub(_all(x.type, 1.0), product, flags=_CONTRACT)
    bracket = builder.fadd(third, builder.fmul(two_ninths, r, flags=_CONTRACT), flags=_CONTRACT)
    return builder.fadd(y, builder.fmul(builder.fmul(y, r), bracket, flags=_CONTRACT), flags=_CONTRACT)


def _all(vector_type, value: float):
    return ir.Constant(vector_type, [float(value)] * vector_type.count)


# ---- threads that meet between the phases of a step -----------------------------------------------------------------


def meet(arrived: np.ndarray, threads: int, round_: int) -> None:
    """Wait until all `threads` have called this for the `round_`-th time from 1; arrived (1,) int64 starts at 0.

    Spins: a step takes microseconds, less than it takes to put a thread to sleep. Memory written before is seen after.
    """


@type_callable(meet)
def _type_meet(context):
    return lambda arrived, threads, round_: types.void


@lower_builtin(meet, types.Array, types.Integer, types.Integer)
def _lower_meet(context, builder, sig, args):
    counter = context.make_array(sig.args[0])(context, builder, args[0]).data
    threads = context.cast(builder, args[1], sig.args[1], types.int64)
    round_ = context.cast(builder, args[2], sig.args[2], types.int64)
    several = builder.icmp_signed(">", threads, ir.Constant(threads.type, 1))
    with builder.if_then(several):
        builder.atomic_rmw("add", counter, ir.Constant(threads.type, 1), "seq_cst")
        everyone = builder.mul(threads, round_)
        spin, done = builder.append_basic_block("spin"), builder.append_basic_block("done")
        builder.branch(spin)
        builder.position_at_end(spin)
        seen = builder.load_atomic(counter, "seq_cst", 8)
        builder.cbranch(builder.icmp_signed("<", seen, everyone), spin, done)
        builder.position_at_end(done)
    return context.get_dummy_value()


if not config.DISABLE_JIT:
    _register_operators()
