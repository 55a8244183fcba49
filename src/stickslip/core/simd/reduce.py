"""Sum the contact loads on each body with eight-wide vector operations, which compilers do not generate here."""

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

WIDTH = 8  # numbers in a row of loads: three of a force, three of a torque, two zeros
# the code of a row of loads that a body adds up is ROW times its number, plus flags. IS_I: the body is i of that pair,
# so that the force keeps its sign; IS_FIRST: this is the first row of the body
IS_FIRST, IS_I, ROW = 1, 2, 64  # a row has 64 bytes, so that the code without flags is its offset

PREFETCH_DISTANCE = 16  # rows

_INT64, _INT8, _INT32 = ir.IntType(64), ir.IntType(8), ir.IntType(32)
_DOUBLES, _INTEGERS = ir.VectorType(ir.DoubleType(), WIDTH), ir.VectorType(_INT64, WIDTH)
_SIGNS = [[-1.0] * 3 + [1.0] * 5, [1.0] * 8]  # of a row if the body is j, and if it is i


def _constant_table(module, name, rows, kind):
    """Constant with four vectors, one for each combination of flags in a code."""
    whole = ir.ArrayType(kind, len(rows))
    made = ir.GlobalVariable(module, whole, module.get_unique_name(name))
    made.initializer, made.global_constant, made.linkage, made.align = ir.Constant(whole, rows), True, "internal", 64
    return made


def _vector_pointer(builder, data, at, kind=_DOUBLES):
    """Pointer to a vector at a byte offset from a pointer."""
    first = builder.bitcast(data, _INT8.as_pointer())
    return builder.bitcast(builder.gep(first, [at]), kind.as_pointer())


def prefetch(builder, pointer, write=False):
    """Prefetch a cache line before it is read or written, to hide the latency of distant memory."""
    near = _INT8.as_pointer()
    fetch = cgutils.get_or_insert_function(
        builder.module, ir.FunctionType(ir.VoidType(), [near] + [_INT32] * 3), "llvm.prefetch.p0i8"
    )
    builder.call(fetch, [builder.bitcast(pointer, near), _INT32(int(write)), _INT32(3), _INT32(1)])  # keep, data


class _Stream:
    """Sums for a range of bodies, one entry of `code` after another."""

    def __init__(self, builder, tables, pointers, first, origin):
        self.signs, self.kept = tables
        self.code, self.load, self.external, self.total = pointers
        self.origin = origin  # byte offset of the row of the first body; all offsets are in bytes
        before = builder.sub(builder.mul(first, _INT64(ROW)), _INT64(ROW))
        self.body = cgutils.alloca_once_value(builder, before)
        self.sums = cgutils.alloca_once_value(builder, ir.Constant(_DOUBLES, [0.0] * WIDTH))

    def _row(self, builder, word):
        """Pointer to the row of loads of an entry."""
        return _vector_pointer(builder, self.load, builder.and_(word, _INT64(-ROW)))

    def _entry(self, builder, entry):
        return builder.zext(builder.load(builder.gep(self.code, [entry])), _INT64)

    def add(self, builder, entry, loaded: bool, far: bool):
        """Add one entry. There is no branch, because it is unpredictable which row is the first of a body."""
        word = self._entry(builder, entry)
        if far:
            prefetch(builder, self._row(builder, self._entry(builder, builder.add(entry, _INT64(PREFETCH_DISTANCE)))))
        marks = builder.shl(builder.and_(word, _INT64(3)), _INT64(6))
        body = builder.add(builder.load(self.body), builder.shl(builder.and_(word, _INT64(1)), _INT64(6)))
        builder.store(body, self.body)
        kept = builder.load(_vector_pointer(builder, self.kept, marks, _INTEGERS), align=64)
        before = builder.and_(builder.bitcast(builder.load(self.sums), _INTEGERS), kept)
        if loaded:
            begin = builder.bitcast(builder.load(_vector_pointer(builder, self.external, body), align=8), _INTEGERS)
            before = builder.or_(before, builder.and_(begin, builder.not_(kept)))
        row = builder.load(self._row(builder, word), align=8)
        signs = builder.load(_vector_pointer(builder, self.signs, marks), align=64)
        # times one or minus one is exact, whether fused with the sum or not
        fused = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(_DOUBLES, [_DOUBLES] * 3), f"llvm.fmuladd.v{WIDTH}f64"
        )
        now = builder.call(fused, [row, signs, builder.bitcast(before, _DOUBLES)])
        builder.store(now, self.sums)
        builder.store(now, _vector_pointer(builder, self.total, builder.sub(body, self.origin)), align=8)


@intrinsic
def sum_rows(typingctx, code, start, first, last, far, load, external, total):
    """Sum rows for each body from `first` up to but excluding `last`, and write one row per body to `total`.

    A sum starts with the body's row of `external`, or with zero if that has only one row. Sums are sequential, in the
    order of `code`. The two halves of the bodies are interleaved, because each addition waits for the previous one.

    Parameters
    ----------
    code : (…,) uint32, PREFETCH_DISTANCE longer than needed; start : (B + 1,) uint32, bounds of each body in `code`
    first, last : int64; far : int64, 1 if rows may be outside the caches, so that they are prefetched
    load : (L, 8); external : (B, 8) or (1, 8) zeros; total : (…, 8), contiguous
    """

    def generated(context, builder, signature, args):
        arrays = {k: context.make_array(signature.args[k])(context, builder, args[k]) for k in (0, 1, 5, 6, 7)}
        code, start, load, external, total = (array.data for array in arrays.values())
        rows = cgutils.unpack_tuple(builder, arrays[6].shape)[0]
        first, last = args[2], args[3]
        middle = builder.ashr(builder.add(first, last), _INT64(1))
        kept = [[-1] * WIDTH, [0] * WIDTH] * 2
        tables = (
            _constant_table(
                builder.module, "signs", [ir.Constant(_DOUBLES, _SIGNS[k // IS_I]) for k in range(4)], _DOUBLES
            ),
            _constant_table(builder.module, "kept", [ir.Constant(_INTEGERS, kept[k]) for k in range(4)], _INTEGERS),
        )
        origin = builder.mul(first, _INT64(ROW))

        def bound(body):
            return builder.zext(builder.load(builder.gep(start, [body])), _INT64)

        def sum_all(loaded, far):
            pointers = (code, load, external, total)
            one, two = (_Stream(builder, tables, pointers, body, origin) for body in (first, middle))
            begin, half, end = bound(first), bound(middle), bound(last)
            sizes = builder.sub(half, begin), builder.sub(end, half)
            both = builder.select(builder.icmp_signed("<", *sizes), *sizes)
            with cgutils.for_range_slice(builder, _INT64(0), both, _INT64(1), intp=_INT64) as (k, _):
                one.add(builder, builder.add(begin, k), loaded, far)
                two.add(builder, builder.add(half, k), loaded, far)
            for stream, own, stop in ((one, begin, half), (two, half, end)):
                rest = builder.add(own, both)
                with cgutils.for_range_slice(builder, rest, stop, _INT64(1), intp=_INT64) as (entry, _):
                    stream.add(builder, entry, loaded, far)

        cases = builder.icmp_signed(">", rows, _INT64(1)), builder.icmp_signed("!=", args[4], _INT64(0))
        with builder.if_else(cases[0]) as loads:
            for loaded, branch in zip((True, False), loads, strict=True):
                with branch, builder.if_else(cases[1]) as distances:
                    for far, inner in zip((True, False), distances, strict=True):
                        with inner:
                            sum_all(loaded, far)
        return context.get_dummy_value()

    return types.none(code, start, types.int64, types.int64, types.int64, load, external, total), generated
