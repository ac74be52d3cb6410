# SPDX-License-Identifier: GPL-3.0-or-later
"""Vectors of eight float32, or WIDE, for numba kernels: arithmetic, masks, loads and stores as LLVM vector instructions.

LLVM does not vectorise the blending loop of its own accord reliably, so its body is written with vectors here.  They become
AVX on x86, pairs of NEON registers on ARM; no instruction is named.
"""
from __future__ import annotations

from functools import reduce

from llvmlite import binding, ir
from numba.core import types
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

LANES = 8
FLOATS = ir.VectorType(ir.FloatType(), LANES)
INTS = ir.VectorType(ir.IntType(32), LANES)
WIDE = 2 * LANES if binding.get_host_cpu_features().get("avx512f") else LANES
"""Lanes of the widest vectors that the processor has registers for."""
FUSE = ("contract", "nsz")


def floats(lanes: int):
    """LLVM's type of so many float32."""
    return ir.VectorType(ir.FloatType(), lanes)


class Floats:
    """A vector of float32 while code is being generated; + - * work as they look and may fuse."""

    def __init__(self, builder, value):
        self.builder, self.value, self.lanes = builder, value, value.type.count

    def _with(self, other):
        return other.value if isinstance(other, Floats) else constant(self.builder, other, self.lanes).value

    def _bits(self):
        """The bits of each, as whole numbers, and a function that gives such a number for each lane."""
        ints = ir.VectorType(ir.IntType(32), self.lanes)
        return self.builder.bitcast(self.value, ints), lambda number: ir.Constant(ints, [number] * self.lanes)

    def __add__(self, other):
        return Floats(self.builder, self.builder.fadd(self.value, self._with(other), flags=FUSE))

    def __sub__(self, other):
        return Floats(self.builder, self.builder.fsub(self.value, self._with(other), flags=FUSE))

    def __mul__(self, other):
        return Floats(self.builder, self.builder.fmul(self.value, self._with(other), flags=FUSE))

    def __truediv__(self, other):
        return Floats(self.builder, self.builder.fdiv(self.value, self._with(other), flags=FUSE))

    def __gt__(self, other):
        return self.builder.fcmp_ordered(">", self.value, self._with(other))

    def __ge__(self, other):
        return self.builder.fcmp_ordered(">=", self.value, self._with(other))

    def min(self, other):
        """The smaller of each pair."""
        other = self._with(other)
        return Floats(self.builder, self.builder.select(self.builder.fcmp_ordered("<", self.value, other), self.value, other))

    def max(self, other):
        """The larger of each pair."""
        other = self._with(other)
        return Floats(self.builder, self.builder.select(self.builder.fcmp_ordered(">", self.value, other), self.value, other))

    def where(self, mask, other):
        """self where the mask holds, else other."""
        return Floats(self.builder, self.builder.select(mask, self.value, self._with(other)))

    def magnitude(self):
        """|self|, by clearing the sign bit."""
        bits, number = self._bits()
        return Floats(self.builder, self.builder.bitcast(self.builder.and_(bits, number((1 << 31) - 1)), self.value.type))

    def negative_magnitude(self):
        """-|self|, by setting the sign bit."""
        bits, number = self._bits()
        return Floats(self.builder, self.builder.bitcast(self.builder.or_(bits, number(-(1 << 31))), self.value.type))

    def exp2(self):
        """2^self for self <= 0, to 1e-7 relative; below -126 anything.

        The sum with 1.5 * 2^23 rounds to a whole number and leaves it in the low bits; the fraction in [-1/2, 1/2] goes
        through a minimax polynomial; the whole number is added to the exponent's bits.
        """
        b = self.builder
        shifted = self + 12582912.0
        f = self - (shifted - 12582912.0)
        p = constant(b, 0.0013398899, self.lanes)
        for c in (0.0096707680, 0.055503285, 0.24022119, 0.69314718, 1.0):
            p = p * f + c
        whole, number = shifted._bits()
        return Floats(b, b.bitcast(b.add(p._bits()[0], b.shl(whole, number(23))), self.value.type))


def constant(builder, number, lanes: int = LANES) -> Floats:
    """The same number in every lane."""
    return numbers(builder, [number] * lanes)


def numbers(builder, values) -> Floats:
    """A given number for each lane."""
    return Floats(builder, ir.Constant(floats(len(values)), [float(value) for value in values]))


def ramp(builder, lanes: int = LANES) -> Floats:
    """0, 1, 2, ..."""
    return numbers(builder, range(lanes))


def any_of(builder, mask):
    """Whether the mask holds in any lane."""
    bits = ir.IntType(mask.type.count)
    return builder.icmp_unsigned("!=", builder.bitcast(mask, bits), bits(0))


def largest(builder, floats):
    """The largest of all lanes, as a scalar."""
    lane = [builder.extract_element(floats.value, ir.Constant(ir.IntType(32), i)) for i in range(floats.lanes)]
    return reduce(lambda a, b: builder.select(builder.fcmp_ordered(">", a, b), a, b), lane)


def broadcast(builder, scalar, lanes: int = LANES) -> Floats:
    """A float32 of the running program in every lane."""
    one = builder.insert_element(ir.Constant(floats(lanes), ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0))
    return Floats(builder, builder.shuffle_vector(one, one, ir.Constant(ir.VectorType(ir.IntType(32), lanes), [0] * lanes)))


class Memory:
    """The elements of a C-contiguous float32 array while code is being generated."""

    def __init__(self, context, builder, array_type, array):
        assert array_type.dtype == types.float32 and array_type.layout == "C"
        self.builder, self.data = builder, make_array(array_type)(context, builder, array).data

    def _at(self, index, offset):
        return self.builder.gep(self.data, [self.builder.add(index, ir.Constant(index.type, offset))])

    def floats(self, index, offset, lanes: int = LANES) -> Floats:
        """So many elements from index + offset on."""
        pointer = self.builder.bitcast(self._at(index, offset), floats(lanes).as_pointer())
        return Floats(self.builder, self.builder.load(pointer, align=4))

    def store(self, index, offset, floats):
        """Write all lanes to the elements from index + offset on."""
        pointer = self.builder.bitcast(self._at(index, offset), floats.value.type.as_pointer())
        self.builder.store(floats.value, pointer, align=4)

    def scalar(self, index, offset):
        """One element."""
        return self.builder.load(self._at(index, offset))


class Sum:
    """A sum for each lane, in a register while code is being generated; LLVM sees through the memory behind them."""

    def __init__(self, builder, lanes: int = LANES):
        with builder.goto_entry_block():
            self.pointer = builder.alloca(floats(lanes))
        self.builder = builder
        builder.store(constant(builder, 0.0, lanes).value, self.pointer)

    def add(self, floats):
        """Add to each of them."""
        self.builder.store((Floats(self.builder, self.builder.load(self.pointer)) + floats).value, self.pointer)

    def value(self) -> Floats:
        """Eight sums: wider vectors are folded."""
        b, whole = self.builder, self.builder.load(self.pointer)
        parts = [[ir.Constant(ir.IntType(32), at + lane) for lane in range(LANES)] for at in range(0, whole.type.count, LANES)]
        eights = [Floats(b, b.shuffle_vector(whole, whole, ir.Constant(INTS, part))) for part in parts]
        return reduce(lambda x, y: x + y, eights)


def totals(builder, eight) -> Floats:
    """The sums over the lanes of each of eight vectors, as one vector: pairs are halved and joined three times."""
    number = ir.IntType(32)
    vectors = [v.value for v in eight]
    while len(vectors) > 1:
        even, odd = ([2 * i + part for i in range(LANES)] for part in (0, 1))
        vectors = [builder.fadd(builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(number, LANES), even)),
                                builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(number, LANES), odd)))
                   for a, b in zip(vectors[::2], vectors[1::2])]
    return Floats(builder, vectors[0])


@intrinsic
def prefetch(context, array, index):
    """Ask for the first and the last byte of row `index` of a C-contiguous array to be brought into the cache; never faults.

    Rows of some forty bytes mostly lie in two of the cache's lines; of an array with one axis a row is a number.
    """
    def build(context, b, signature, args):
        made = make_array(signature.args[0])(context, b, args[0])
        stride = b.extract_value(made.strides, 0)
        row = b.gep(b.bitcast(made.data, ir.IntType(8).as_pointer()), [b.mul(args[1], stride)])
        number = ir.IntType(32)
        function = b.module.declare_intrinsic(
            "llvm.prefetch", [row.type], ir.FunctionType(ir.VoidType(), [row.type, number, number, number]))
        for place in (ir.Constant(stride.type, 0), b.sub(stride, ir.Constant(stride.type, 1)))[:signature.args[0].ndim]:
            b.call(function, [b.gep(row, [place]), number(0), number(3), number(1)])
        return context.get_dummy_value()
    return types.void(array, types.intp), build


@intrinsic
def any_from(context, array, index, bound):
    """Whether any of the eight elements from index on, of a C-contiguous float32 array, is at least so large."""
    def build(context, b, signature, args):
        return any_of(b, Memory(context, b, signature.args[0], args[0]).floats(args[1], 0) >= broadcast(b, args[2]))
    return types.boolean(array, types.intp, types.float32), build
