"""Compiled leapfrog of many vectors at once: q ← q + v, v ← v + B q for a sparse matrix of dense blocks."""

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic

BLOCK = 3  # rows of a block: three displacements, three rotations, or both kinds in two dimensions
LANES = 16  # vectors that are advanced together: one register of AVX-512, two of AVX2, four of NEON
_INT64, _FLOAT = ir.IntType(64), ir.FloatType()
_VECTOR = ir.VectorType(_FLOAT, LANES)


@intrinsic(prefer_literal=True)
def _add_block_row(typingctx, size, row, first, last, indices, blocks, q, v):
    """v[row] += Σ blocks[e] q[indices[e]] over e from first to last, for blocks of a constant size.

    Every number of a block multiplies one register of LANES vectors, and the sums stay in registers.
    """
    width = size.literal_value

    def generated(context, builder, signature, args):
        _, row, first, last, *arrays = args
        kinds = signature.args[4:]
        indices, blocks, q, v = (
            context.make_array(kind)(context, builder, array).data for kind, array in zip(kinds, arrays, strict=True)
        )
        size = _INT64(width)
        q, v = (builder.bitcast(p, _VECTOR.as_pointer()) for p in (q, v))
        fused = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(_VECTOR, [_VECTOR] * 3), f"llvm.fmuladd.v{LANES}f32"
        )
        start = builder.mul(row, size)
        places = [builder.gep(v, [builder.add(start, _INT64(k))]) for k in range(width)]
        sums = [cgutils.alloca_once_value(builder, builder.load(place, align=4)) for place in places]
        with cgutils.for_range_slice(builder, first, last, _INT64(1), intp=_INT64) as (e, _):
            column = builder.mul(builder.zext(builder.load(builder.gep(indices, [e])), _INT64), size)
            entry = builder.mul(e, _INT64(width * width))
            vectors = [builder.load(builder.gep(q, [builder.add(column, _INT64(c))]), align=4) for c in range(width)]
            for k, total in enumerate(sums):
                value = builder.load(total)
                for c, vector in enumerate(vectors):
                    number = builder.load(builder.gep(blocks, [builder.add(entry, _INT64(k * width + c))]))
                    value = builder.call(fused, [_broadcast(builder, number), vector, value])
                builder.store(value, total)
        for place, total in zip(places, sums, strict=True):
            builder.store(builder.load(total), place, align=4)
        return context.get_dummy_value()

    return types.none(size, *[types.int64] * 3, indices, blocks, q, v), generated


def _broadcast(builder, number):
    one = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), number, ir.IntType(32)(0))
    return builder.shuffle_vector(
        one, ir.Constant(_VECTOR, ir.Undefined), ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    )


@njit(cache=True, nogil=True, error_model="numpy")
def leapfrog(indptr, indices, blocks, bucket, signs, q, v, record):
    """Advance q and v in place by len(record) steps, and record signed sums of q.

    Parameters
    ----------
    indptr, indices, blocks : (n/3 + 1,) int64, (m,) uint32, (m, 9) float32; the matrix in blocks of three rows
    bucket, signs : (n,) int64 and float32; the sum to which each row contributes, and its sign
    q, v : (n, LANES) float32, in rows
    record : (steps, buckets, LANES) float32, filled with zeros
    """
    for t in range(len(record)):
        for i in range(len(indptr) - 1):
            _add_block_row(BLOCK, i, indptr[i], indptr[i + 1], indices, blocks, q, v)
        _move(bucket, signs, q, v, record[t])


@njit(cache=True, nogil=True, error_model="numpy")
def _move(bucket, signs, q, v, sums):
    """q ← q + v, and signed sums of q by bucket."""
    for i in range(np.uint64(len(q))):
        k, sign = np.uint64(bucket[i]), signs[i]
        for p in range(LANES):
            q[i, p] += v[i, p]
            sums[k, p] += sign * q[i, p]
