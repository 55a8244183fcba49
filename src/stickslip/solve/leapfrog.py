"""Leapfrog of many vectors at once: q ← q + v, v ← v + B q for a sparse matrix of dense blocks."""

from ..core.library import core

BLOCK = 3  # rows of a block: three displacements, three rotations, or both kinds in two dimensions
LANES = 16  # vectors that are advanced together: one register of AVX-512, two of AVX2, four of NEON


def leapfrog(indptr, indices, blocks, bucket, signs, q, v, record):
    """Advance q and v in place by len(record) steps, and record signed sums of q.

    Parameters
    ----------
    indptr, indices, blocks : (n/3 + 1,) int64, (m,) uint32, (m, 9) float32; the matrix in blocks of three rows
    bucket, signs : (n,) int64 and float32; the sum to which each row contributes, and its sign
    q, v : (n, LANES) float32, in rows
    record : (steps, buckets, LANES) float32, filled with zeros
    """
    steps, buckets, _ = record.shape
    core.leapfrog(len(indptr) - 1, indptr, indices, blocks, bucket, signs, q, v, steps, buckets, record)
