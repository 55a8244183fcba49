"""Transposition between rows of bodies and planes of lanes, four at a time, with vector instructions.

Compilers move one number at a time instead, which takes longer than evaluating the contact law.
"""

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic

from .reduce import WIDTH, prefetch

LANES = 64
# offsets of the planes in the scratch memory of a block. It is flat, with offsets known at compile time, so that the
# compiler sees no overlaps: pair vector, relative velocity, Σ R ω, sum of radii; with dashpots predicted velocity and
# Σ R ω
PAIR, MOTION, ROLL, RADII, MOTION_AHEAD, ROLL_AHEAD, SCRATCH = (LANES * k for k in (0, 3, 6, 9, 10, 13, 16))
# columns of a body, in vectors of four numbers: position and radius; velocity and half a time step over mass; spin and
# half a time step over inertia. Then columns of predicted values: velocity; spin
RADIUS, VELOCITY, KICK, SPIN, KICK_T, BODY = 3, 4, 7, 8, 11, 12
VELOCITY_AHEAD, SPIN_AHEAD, BODY_AHEAD = 0, 4, 8

_INT64, _INT32 = ir.IntType(64), ir.IntType(32)
_DOUBLE4 = ir.VectorType(ir.DoubleType(), 4)


def _shuffle(builder, a, b, mask):
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(_INT32, 4), mask))


def _transpose(builder, a, b, c, d):
    """Transpose four rows of four numbers to four planes, or back."""
    low_ab, high_ab = _shuffle(builder, a, b, [0, 4, 2, 6]), _shuffle(builder, a, b, [1, 5, 3, 7])
    low_cd, high_cd = _shuffle(builder, c, d, [0, 4, 2, 6]), _shuffle(builder, c, d, [1, 5, 3, 7])
    return (
        _shuffle(builder, low_ab, low_cd, [0, 1, 4, 5]),
        _shuffle(builder, high_ab, high_cd, [0, 1, 4, 5]),
        _shuffle(builder, low_ab, low_cd, [2, 3, 6, 7]),
        _shuffle(builder, high_ab, high_cd, [2, 3, 6, 7]),
    )


def _vector_pointer(builder, data, at):
    """Pointer to four numbers."""
    return builder.bitcast(builder.gep(data, [at]), _DOUBLE4.as_pointer())


def _load_vector(builder, data, at):
    return builder.load(_vector_pointer(builder, data, at), align=8)


def _data_pointer(context, builder, signature, args, k):
    return context.make_array(signature.args[k])(context, builder, args[k]).data


@njit(cache=True)
def empty_aligned(rows, width):
    """Uninitialised array (rows, width) aligned to cache lines.

    Access to a vector that spans two lines costs twice as much.
    """
    line = 64 // 8
    flat = np.empty(rows * width + line)
    first = (line - flat.ctypes.data // 8 % line) % line
    return flat[first : first + rows * width].reshape(rows, width)


def _prefetch_of(array, write):
    """Signature and code for prefetching the cache line that holds an element of a contiguous array."""

    def generated(context, builder, signature, args):
        prefetch(builder, builder.gep(_data_pointer(context, builder, signature, args, 0), [args[1]]), write)
        return context.get_dummy_value()

    return types.none(array, types.int64), generated


@intrinsic
def prefetch_for_read(typingctx, array, at):
    """Prefetch, for reading, the cache line that holds element `at` of a contiguous array.

    Results do not depend on it.
    """
    return _prefetch_of(array, False)


@intrinsic
def prefetch_for_write(typingctx, array, at):
    """Prefetch a cache line for writing. Other processors that hold the line release it meanwhile."""
    return _prefetch_of(array, True)


@intrinsic
def use_widest_vectors(typingctx):
    """Let loops of the calling function use the widest available vectors.

    The compiler prefers half that width, assuming narrower code nearby. Results do not depend on it.
    """

    def generated(context, builder, signature, args):
        set.add(builder.function.attributes, '"prefer-vector-width"="512"')  # llvmlite's own `add` rejects this name
        return context.get_dummy_value()

    return types.none(), generated


class _PairRows:
    """Rows of both bodies of four pairs, and the planes to which their combinations are written."""

    def __init__(self, builder, solid, first, at, i, j, scratch):
        self.builder, self.solid, self.at, self.scratch = builder, solid, at, scratch
        slots = [builder.add(builder.add(first, at), _INT64(q)) for q in range(4)]
        self.pairs = [[builder.zext(builder.load(builder.gep(n, [s])), _INT64) for n in (i, j)] for s in slots]

    def of_both(self, data, width, offset):
        """Four values for each of the two bodies of every pair."""
        one = self.builder
        starts = [[one.add(one.mul(n, _INT64(width)), _INT64(offset)) for n in pair] for pair in self.pairs]
        return [[_load_vector(one, data, n) for n in pair] for pair in starts]

    def differences(self, rows):
        """Planes of differences between the bodies."""
        return _transpose(self.builder, *(self.builder.fsub(*row) for row in rows))

    def rotations(self, levers, rows):
        """Planes of the vectors R_i ω_i + R_j ω_j, one for each component."""
        return _transpose(
            self.builder, *(_sum_rotations(self.builder, *both) for both in zip(levers, rows, strict=True))
        )

    def store(self, value, plane):
        """Store one plane."""
        to = _vector_pointer(self.builder, self.scratch, self.builder.add(self.at, _INT64(plane)))
        self.builder.store(value, to, align=8)

    def write(self, planes, plane, in_plane):
        """Store three planes, or in two dimensions only the components given by `in_plane`."""
        for k in in_plane:
            self.store(planes[k], plane + LANES * k)
        with self.builder.if_then(self.solid):
            for k in {0, 1, 2} - set(in_plane):
                self.store(planes[k], plane + LANES * k)


def _loop_by_four(builder):
    return cgutils.for_range_slice(builder, _INT64(0), _INT64(LANES), _INT64(4), intp=_INT64)


@intrinsic
def gather_positions(typingctx, dim, first, i, j, body, scratch):
    """Gather x_i − x_j and R_i + R_j of the pairs of a block into planes of `scratch`.

    Parameters
    ----------
    dim, first : int64, the latter the block's first slot; i, j : (…,) uint32
    body : (B, BODY); scratch : (SCRATCH,); all contiguous
    """

    def generated(context, builder, signature, args):
        i, j, body, scratch = (_data_pointer(context, builder, signature, args, k) for k in range(2, 6))
        solid = builder.icmp_signed("==", args[0], _INT64(3))
        with _loop_by_four(builder) as (at, _):
            rows = _PairRows(builder, solid, args[1], at, i, j, scratch)
            sums = [(mine, _negate_fourth(builder, other)) for mine, other in rows.of_both(body, BODY, 0)]
            planes = rows.differences(sums)
            rows.write(planes[:3], PAIR, (0, 1))
            rows.store(planes[RADIUS], RADII)
        return context.get_dummy_value()

    return types.none(types.int64, types.int64, i, j, body, scratch), generated


@intrinsic
def gather_motion(typingctx, dim, predict, first, i, j, body, ahead, scratch):
    """Gather v_i − v_j, R_i ω_i + R_j ω_j and, with `predict`, their predicted values into planes of `scratch`.

    Parameters
    ----------
    dim, predict, first : int64, the last one the block's first slot; i, j : (…,) uint32
    body : (B, BODY); ahead : (B, BODY_AHEAD), or (0, BODY_AHEAD); scratch : (SCRATCH,); all contiguous
    """

    def generated(context, builder, signature, args):
        i, j, body, ahead, scratch = (_data_pointer(context, builder, signature, args, k) for k in range(3, 8))
        solid = builder.icmp_signed("==", args[0], _INT64(3))
        predicted = builder.icmp_signed("!=", args[1], _INT64(0))
        with _loop_by_four(builder) as (at, _):
            rows = _PairRows(builder, solid, args[2], at, i, j, scratch)
            places, spins = rows.of_both(body, BODY, 0), rows.of_both(body, BODY, SPIN)
            levers = [[_shuffle(builder, row, row, [RADIUS] * 4) for row in pair] for pair in places]
            rows.write(rows.differences(rows.of_both(body, BODY, VELOCITY))[:3], MOTION, (0, 1))
            rows.write(rows.rotations(levers, spins)[:3], ROLL, (2,))
            with builder.if_then(predicted):
                moved = rows.differences(rows.of_both(ahead, BODY_AHEAD, VELOCITY_AHEAD))
                rows.write(moved[:3], MOTION_AHEAD, (0, 1))
                turned = rows.rotations(levers, rows.of_both(ahead, BODY_AHEAD, SPIN_AHEAD))
                rows.write(turned[:3], ROLL_AHEAD, (2,))
        return context.get_dummy_value()

    return types.none(types.int64, types.int64, types.int64, i, j, body, ahead, scratch), generated


def _negate_fourth(builder, row):
    """Negate the fourth number of a row, so that a difference becomes a sum there."""
    bits = ir.VectorType(_INT64, 4)
    sign = ir.Constant(bits, [0, 0, 0, -(2**63)])
    return builder.bitcast(builder.xor(builder.bitcast(row, bits), sign), _DOUBLE4)


def _sum_rotations(builder, levers, spins):
    """Compute R_i ω_i + R_j ω_j, fusing the second product and the sum if the processor supports it."""
    one = ir.FunctionType(_DOUBLE4, [_DOUBLE4] * 3)
    fused = cgutils.get_or_insert_function(builder.module, one, "llvm.fmuladd.v4f64")
    return builder.call(fused, [levers[1], spins[1], builder.fmul(levers[0], spins[0])])


@intrinsic
def scatter_loads(typingctx, place, scratch, load):
    """Scatter six planes of `scratch`, forces and −n × F_t, to rows of `load` starting at `place`.

    Two numbers are zero.

    Parameters
    ----------
    place : int64; scratch : (SCRATCH,); load : (L, 8), contiguous
    """

    def generated(context, builder, signature, args):
        scratch, load = (_data_pointer(context, builder, signature, args, k) for k in (1, 2))
        zeros = ir.Constant(_DOUBLE4, [0.0] * 4)
        with cgutils.for_range_slice(builder, _INT64(0), _INT64(LANES), _INT64(4), intp=_INT64) as (at, _):
            planes = [_load_vector(builder, scratch, builder.add(at, _INT64(LANES * k))) for k in range(6)]
            halves = _transpose(builder, *planes[:4]), _transpose(builder, *planes[4:], zeros, zeros)
            for q in range(4):
                row = builder.mul(builder.add(builder.add(args[0], at), _INT64(q)), _INT64(WIDTH))
                for half, offset in zip(halves, (0, 4), strict=True):
                    builder.store(half[q], _vector_pointer(builder, load, builder.add(row, _INT64(offset))), align=8)
        return context.get_dummy_value()

    return types.none(types.int64, scratch, load), generated
