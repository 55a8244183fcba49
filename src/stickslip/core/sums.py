"""Sums of contacts' loads for each body, in vectors of eight numbers: what the compiler does not find by itself."""

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

WIDTH = 8  # numbers in a row of loads: three of a force, three of a torque, two that stay zero
# a row of loads that a body adds up is written as ROW times its number, plus: the body is i of that pair, so that the
# force is not turned round; it is the body's first row
IS_FIRST, IS_I, ROW = 1, 2, 4

_WHOLE, _LANE = ir.IntType(64), ir.IntType(32)
_NUMBERS, _BITS = ir.VectorType(ir.DoubleType(), WIDTH), ir.VectorType(_WHOLE, WIDTH)


def _in_all_lanes(builder, value):
    """A vector of bits, each lane `value`."""
    none = ir.Constant(_BITS, ir.Undefined)
    first = builder.insert_element(none, value, _LANE(0))
    return builder.shuffle_vector(first, none, ir.Constant(ir.VectorType(_LANE, WIDTH), [0] * WIDTH))


def _row(builder, data, number):
    """Pointer to a row of eight numbers."""
    return builder.bitcast(builder.gep(data, [builder.mul(number, _WHOLE(WIDTH))]), _NUMBERS.as_pointer())


@intrinsic
def summed_rows(typingctx, code, first, last, load, external, own, total):
    """Add up rows for each body: `total` gets a row for each entry of `code[first:last]` that is a first one.

    A sum begins with the row of `external` for the body, counted from `own`; with one row only, with that one.

    There is no branch in the loop: how many contacts the next grain has cannot be foreseen, and a loop for each grain
    takes twice as long in large packings. Sums are sequential, so that their order is that of `code`.

    Parameters
    ----------
    code : (…,) uint32; first, last, own : int64; load : (L, 8); external : (B, 8) or (1, 8); total : (…, 8), contiguous
    """

    def generated(context, builder, signature, args):
        arrays = [context.make_array(signature.args[k])(context, builder, args[k]) for k in (0, 3, 4, 6)]
        code, load, external, total = (array.data for array in arrays)
        rows = cgutils.unpack_tuple(builder, arrays[2].shape)[0]
        stride = builder.zext(builder.icmp_signed(">", rows, _WHOLE(1)), _WHOLE)
        one, turned = _WHOLE(1), ir.Constant(_BITS, [-(2**63)] * 3 + [0] * (WIDTH - 3))
        sums = cgutils.alloca_once_value(builder, ir.Constant(_NUMBERS, [0.0] * WIDTH))
        body = cgutils.alloca_once_value(builder, _WHOLE(-1))
        with cgutils.for_range_slice(builder, args[1], args[2], one, intp=_WHOLE) as (entry, _):
            word = builder.zext(builder.load(builder.gep(code, [entry])), _WHOLE)
            is_first, is_i = builder.and_(word, one), builder.and_(builder.lshr(word, one), one)
            number = builder.add(builder.load(body), is_first)
            builder.store(number, body)
            # bits, not conditions: those would become branches
            row = builder.bitcast(builder.load(_row(builder, load, builder.lshr(word, _WHOLE(2))), align=8), _BITS)
            row = builder.xor(row, builder.and_(_in_all_lanes(builder, builder.sub(is_i, one)), turned))
            before = builder.bitcast(builder.load(sums), _BITS)
            at = builder.mul(stride, builder.add(args[5], number))
            begin = builder.bitcast(builder.load(_row(builder, external, at), align=8), _BITS)
            go_on = _in_all_lanes(builder, builder.sub(is_first, one))
            before = builder.or_(builder.and_(before, go_on), builder.and_(begin, builder.not_(go_on)))
            now = builder.fadd(builder.bitcast(before, _NUMBERS), builder.bitcast(row, _NUMBERS))
            builder.store(now, sums)
            builder.store(now, _row(builder, total, number), align=8)
        return context.get_dummy_value()

    return types.none(code, types.int64, types.int64, load, external, types.int64, total), generated
