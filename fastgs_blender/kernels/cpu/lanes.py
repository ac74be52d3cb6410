# SPDX-License-Identifier: GPL-3.0-or-later
"""Eight Gaussians at once: a number type of kernels that holds one float64 for each.

Functions that are written for one Gaussian take lanes too, as long as they choose by where() instead of if.  array[n, ...] reads what the
Gaussians n have, where n is picked().  LLVM makes vectors of what the processor has; no instruction is named.
"""
from __future__ import annotations

import math
import operator
from functools import reduce

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, lower_cast, models, overload, register_model
from numba.np.arrayobj import make_array

from .jit import inline

LANES = 8
FUSE = ("contract", "nsz")
DOUBLES, INTS, BITS = (ir.VectorType(kind, LANES) for kind in (ir.DoubleType(), ir.IntType(64), ir.IntType(1)))
LOG2E = math.log2(math.e)
EXP2 = [math.log(2) ** k / math.factorial(k) for k in range(7, -1, -1)]
"""Of 2^x for |x| <= 1/2, from the highest power on: 7e-9 relative."""
LOG2 = [2 * LOG2E / k for k in (9, 7, 5, 3, 1)]
"""Of log2((1 + s) / (1 - s)) / s for |s| <= 0.172, by powers of s^2: 1e-9."""
WHOLE = 1.5 * 2.0**52
"""Added to a number below 2^51, it leaves it rounded in the low bits."""


class Kind(types.Type):
    """A type with a value for each of eight Gaussians: numbers, Gaussians, or whether something holds."""

    def unify(self, typingctx, other):
        """Numbers that some way leaves the same for all Gaussians become lanes."""
        return self if self is NUMBERS and isinstance(other, (types.Float, types.Integer)) else None


class Numbers(Kind):
    """float64."""


class Picked(Kind):
    """Places along an array's first axis."""


class Mask(Kind):
    """Whether something holds."""


NUMBERS, PICKED, MASK = Numbers("lanes.numbers"), Picked("lanes.picked"), Mask("lanes.mask")


def _modelled(kind, vector):
    @register_model(kind)
    class Model(models.PrimitiveModel):
        def __init__(self, manager, given):
            super().__init__(manager, given, vector)


for _kind, _vector in ((Numbers, DOUBLES), (Picked, INTS), (Mask, BITS)):
    _modelled(_kind, _vector)


def _constant(number):
    return ir.Constant(DOUBLES, [float(number)] * LANES)


def _spread(b, one, vector=DOUBLES):
    """The same value in every lane."""
    first = b.insert_element(ir.Constant(vector, ir.Undefined), one, ir.Constant(ir.IntType(32), 0))
    return b.shuffle_vector(first, first, ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES))


@lower_cast(types.Float, Numbers)
@lower_cast(types.Integer, Numbers)
@lower_cast(types.IntegerLiteral, Numbers)
def _cast(context, builder, given, kind, value):
    return _spread(builder, context.cast(builder, value, given, types.float64))


def _operator(function, result, build, *kinds):
    """Let a function take lanes, and numbers beside them; build(builder, *vectors) gives the result's vector."""
    @infer_global(function)
    class Template(AbstractTemplate):
        def generic(self, args, kws):
            fits = all(arg is kind or (kind is NUMBERS and isinstance(arg, (types.Float, types.Integer))) for arg, kind in zip(args, kinds))
            if len(args) == len(kinds) and fits and any(arg is kind for arg, kind in zip(args, kinds)):
                return signature(result, *kinds)
            return None

    @lower_builtin(function, *(type(kind) for kind in kinds))
    def lower(context, builder, given, args):
        return build(builder, *args)


def _call(name):
    """A function of LLVM that works on vectors."""
    def build(b, *vectors):
        kind = ir.FunctionType(DOUBLES, [DOUBLES] * len(vectors))
        return b.call(cgutils.get_or_insert_function(b.module, kind, f"llvm.{name}.v{LANES}f64"), vectors)
    return build


for _function, _name in ((operator.add, "fadd"), (operator.iadd, "fadd"), (operator.sub, "fsub"), (operator.isub, "fsub"),
                         (operator.mul, "fmul"), (operator.imul, "fmul"), (operator.truediv, "fdiv")):
    _operator(_function, NUMBERS, lambda b, x, y, name=_name: getattr(b, name)(x, y, flags=FUSE), NUMBERS, NUMBERS)
for _function, _sign in ((operator.gt, ">"), (operator.ge, ">="), (operator.lt, "<"), (operator.le, "<=")):
    _operator(_function, MASK, lambda b, x, y, sign=_sign: b.fcmp_ordered(sign, x, y), NUMBERS, NUMBERS)
_operator(operator.ne, MASK, lambda b, x, y: b.fcmp_unordered("!=", x, y), NUMBERS, NUMBERS)
_operator(operator.neg, NUMBERS, lambda b, x: b.fneg(x), NUMBERS)
for _function, _sign in ((min, "<"), (max, ">")):
    for _count in (2, 3):
        _operator(_function, NUMBERS, lambda b, *vectors, sign=_sign: reduce(
            lambda x, y: b.select(b.fcmp_ordered(sign, y, x), y, x), vectors), *[NUMBERS] * _count)
_operator(abs, NUMBERS, _call("fabs"), NUMBERS)
_operator(math.sqrt, NUMBERS, _call("sqrt"), NUMBERS)
for _function, _name in ((operator.and_, "and_"), (operator.iand, "and_"), (operator.or_, "or_")):
    _operator(_function, MASK, lambda b, x, y, name=_name: getattr(b, name)(x, y), MASK, MASK)


def _sum(b, x, factors):
    """The polynomial with these factors, the highest power's first."""
    return reduce(lambda total, factor: b.fadd(b.fmul(total, x, flags=FUSE), factor, flags=FUSE), map(_constant, factors))


@intrinsic
def _exp(context, x):
    def build(context, b, given, args):
        x = b.fmul(args[0], _constant(LOG2E))
        for sign, bound in (("<", -1000.0), (">", 1000.0)):  # what is no number stays so
            x = b.select(b.fcmp_ordered(sign, x, _constant(bound)), _constant(bound), x)
        shifted = b.fadd(x, _constant(WHOLE))
        power = b.shl(b.add(b.bitcast(shifted, INTS), ir.Constant(INTS, [1023] * LANES)), ir.Constant(INTS, [52] * LANES))
        return b.fmul(_sum(b, b.fsub(x, b.fsub(shifted, _constant(WHOLE))), EXP2), b.bitcast(power, DOUBLES))
    return NUMBERS(x), build


@intrinsic
def _log2(context, x):
    def build(context, b, given, args):
        bits = b.bitcast(args[0], INTS)
        # the mantissa from the root of 1/2 on
        from_root = b.sub(bits, ir.Constant(INTS, [0x3FE6A09E667F3BCD] * LANES))
        whole = b.and_(from_root, ir.Constant(INTS, [-(1 << 52)] * LANES))
        mantissa = b.bitcast(b.sub(bits, whole), DOUBLES)
        # the exponent as a number: its bits in the mantissa of 2^52 + 2^51
        high = b.lshr(b.add(whole, ir.Constant(INTS, [1 << 62] * LANES)), ir.Constant(INTS, [52] * LANES))
        power = b.fsub(b.bitcast(b.or_(high, ir.Constant(INTS, [0x4330000000000000] * LANES)), DOUBLES), _constant(2.0**52 + 1024.0))
        s = b.fdiv(b.fsub(mantissa, _constant(1.0)), b.fadd(mantissa, _constant(1.0)))
        return b.fadd(b.fmul(_sum(b, b.fmul(s, s), LOG2), s, flags=FUSE), power, flags=FUSE)
    return NUMBERS(x), build


def exp(x):
    """exp in float32 (enough for what comes from float32), as float64."""
    return np.float64(math.exp(np.float32(x)))


@overload(exp)
def _exp_of(x):
    return (lambda x: _exp(x)) if x is NUMBERS else exp  # noqa: PLW0108 (intrinsics are no functions)


def log2(x):
    """log2 of a positive number in float32, as float64."""
    return np.float64(math.log2(np.float32(x)))


@overload(log2)
def _log2_of(x):
    return (lambda x: _log2(x)) if x is NUMBERS else log2  # noqa: PLW0108


@intrinsic
def where(context, mask, x, y):
    """x where the mask holds, else y."""
    kind = NUMBERS if mask is MASK else types.float64

    def build(context, b, given, args):
        return b.select(args[0], args[1], args[2])
    return kind(mask, kind, kind), build


@intrinsic
def anywhere(context, mask):
    """Whether the mask holds for any."""
    def build(context, b, given, args):
        if mask is not MASK:
            return args[0]
        return b.icmp_unsigned("!=", b.bitcast(args[0], ir.IntType(LANES)), ir.IntType(LANES)(0))
    return types.boolean(mask), build


@intrinsic
def bits(context, mask):
    """The mask as bits, the first Gaussian's lowest."""
    def build(context, b, given, args):
        return b.zext(b.bitcast(args[0], ir.IntType(LANES)), ir.IntType(64))
    return types.intp(mask), build


@intrinsic
def picked(context, number, first, last):
    """The Gaussians number[first:last], eight at most, as an index of arrays; the last one again where they are fewer."""
    def build(context, b, given, args):
        data, vector = make_array(given.args[0])(context, b, args[0]).data, ir.Constant(INTS, ir.Undefined)
        end = b.sub(args[2], args[2].type(1))
        for lane in range(LANES):
            at = b.add(args[1], args[1].type(lane))
            at = b.select(b.icmp_signed("<", at, end), at, end)
            n = b.load(b.gep(data, [at]))
            vector = b.insert_element(vector, b.sext(n, ir.IntType(64)) if n.type.width < 64 else n, ir.Constant(ir.IntType(32), lane))
        return vector
    return PICKED(number, types.intp, types.intp), build


@intrinsic
def following(context, first, last):
    """The Gaussians first..last, eight at most, as picked() gives them."""
    def build(context, b, given, args):
        ramp = b.add(_spread(b, args[0], INTS), ir.Constant(INTS, list(range(LANES))))
        end = _spread(b, b.sub(args[1], args[1].type(1)), INTS)
        return b.select(b.icmp_signed("<", ramp, end), ramp, end)
    return PICKED(types.intp, types.intp), build


@infer_global(operator.getitem)
class _Gather(AbstractTemplate):
    def generic(self, args, kws):
        array, index = args
        first = index[0] if isinstance(index, types.BaseTuple) and len(index) else index
        if isinstance(array, types.Array) and first is PICKED:
            return signature(MASK if array.dtype is types.boolean else NUMBERS, array, index)
        return None

    def get_impl_key(self, sig):
        return _Gather


@lower_builtin(_Gather, types.Array, types.Any)
def _gather(context, b, given, args):
    kind, index = given.args
    array = make_array(kind)(context, b, args[0])
    strides = cgutils.unpack_tuple(b, array.strides, kind.ndim)
    each, *rest = cgutils.unpack_tuple(b, args[1], len(index)) if isinstance(index, types.BaseTuple) else [args[1]]
    base = b.bitcast(array.data, ir.IntType(8).as_pointer())
    last = len(rest)
    for axis, place in enumerate(rest, 1):
        place = context.cast(b, place, index[axis], types.intp)
        size = ir.Constant(place.type, context.get_abi_sizeof(context.get_data_type(kind.dtype))) if axis == last and kind.layout == "C" \
            else strides[axis]
        base = b.gep(base, [b.mul(place, size)])
    element = context.get_data_type(kind.dtype)
    vector = ir.Constant(ir.VectorType(element, LANES), ir.Undefined)
    for lane in range(LANES):
        number = ir.Constant(ir.IntType(32), lane)
        at = b.gep(base, [b.mul(b.extract_element(each, number), strides[0])])
        vector = b.insert_element(vector, b.load(b.bitcast(at, element.as_pointer())), number)
    if kind.dtype is types.boolean:
        return b.icmp_unsigned("!=", vector, ir.Constant(vector.type, [0] * LANES))
    return b.fpext(vector, DOUBLES) if kind.dtype is types.float32 else vector


def three(array, *place):
    """The first three numbers of array[place].  Of Gaussians in C-contiguous float32 they are read together, in half the time."""
    return tuple(array[place][:3])


def four(array, *place):
    """The first four."""
    return tuple(array[place][:4])


@overload(three)
def _three_of(array, *place):
    if _lies_together(array, place):
        return lambda array, *place: _together(array, place, 3)
    return lambda array, *place: (array[place + (0,)], array[place + (1,)], array[place + (2,)])


@overload(four)
def _four_of(array, *place):
    if _lies_together(array, place):
        return lambda array, *place: _together(array, place, 4)
    return lambda array, *place: (array[place + (0,)], array[place + (1,)], array[place + (2,)], array[place + (3,)])


def _lies_together(array, place) -> bool:
    return place[0] is PICKED and array.layout == "C" and array.dtype is types.float32


@intrinsic(prefer_literal=True)
def _together(context, array, place, count):
    """Three or four numbers side by side of each Gaussian, as lanes: read as a vector each, which are then transposed."""
    def build(context, b, given, args):
        made, number, quad = make_array(array)(context, b, args[0]), ir.IntType(32), ir.VectorType(ir.FloatType(), 4)
        wanted = ir.VectorType(ir.IntType(1), 4)
        load = cgutils.get_or_insert_function(b.module, ir.FunctionType(quad, [quad.as_pointer(), number, wanted, quad]),
                                              "llvm.masked.load.v4f32.p0")
        each, *rest = cgutils.unpack_tuple(b, args[1], len(place))
        first, *strides = cgutils.unpack_tuple(b, made.strides, array.ndim)
        base, quads = b.bitcast(made.data, ir.IntType(8).as_pointer()), []
        for index, stride in zip(rest, strides):
            base = b.gep(base, [b.mul(index, stride)])
        for lane in range(LANES):
            at = b.bitcast(b.gep(base, [b.mul(b.extract_element(each, number(lane)), first)]), quad.as_pointer())
            quads.append(b.call(load, [at, number(4), ir.Constant(wanted, [i < count.literal_value for i in range(4)]),
                                       ir.Constant(quad, ir.Undefined)]))

        def mixed(x, y, places):
            return b.shuffle_vector(x, y, ir.Constant(ir.VectorType(number, LANES), places))

        far = [mixed(x, y, list(range(8))) for x, y in zip(quads[:4], quads[4:])]  # Gaussians i and i + 4
        turned = []
        for half in ([0, 8, 1, 9, 4, 12, 5, 13], [2, 10, 3, 11, 6, 14, 7, 15]):
            near = mixed(far[0], far[1], half), mixed(far[2], far[3], half)
            turned += [mixed(*near, [i, i + 1, i + 8, i + 9, i + 4, i + 5, i + 12, i + 13]) for i in (0, 2)]
        return context.make_tuple(b, given.return_type, [b.fpext(one, DOUBLES) for one in turned[:count.literal_value]])

    return types.UniTuple(NUMBERS, count.literal_value)(array, place, count), build


@inline
def room(rows):
    """np.empty((rows, LANES)) that begins at a line of the cache: a vector in two pages of memory takes many times as long."""
    block = np.empty((rows + 1) * LANES)
    first = -np.intp(block.ctypes.data) % 64 // 8
    return block[first:first + rows * LANES].reshape(rows, LANES)


@intrinsic
def put(context, rows, row, first, x):
    """Write x to rows[row, first:first + 8], rows a C-contiguous array of float64."""
    def build(context, b, given, args):
        b.store(args[3], _row(context, b, given.args[0], *args[:3]), align=8)
        return context.get_dummy_value()
    return types.void(rows, types.intp, types.intp, NUMBERS), build


@intrinsic
def take(context, rows, row, first):
    """What put() wrote."""
    def build(context, b, given, args):
        return b.load(_row(context, b, given.args[0], *args), align=8)
    return NUMBERS(rows, types.intp, types.intp), build


def _row(context, b, kind, rows, row, first):
    array = make_array(kind)(context, b, rows)
    at = b.add(b.mul(row, cgutils.unpack_tuple(b, array.shape, 2)[1]), first)
    return b.bitcast(b.gep(array.data, [at]), DOUBLES.as_pointer())
