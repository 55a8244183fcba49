"""Cycle counter for compiled code."""

import platform

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

_INT64 = ir.IntType(64)


@intrinsic
def ticks(typingctx):
    """Read a constant-rate counter of the processor, or return 0 where none is known."""

    def generated(context, builder, signature, args):
        clock, machine = ir.FunctionType(_INT64, []), platform.machine().lower()
        if machine in ("x86_64", "amd64"):
            return builder.call(builder.module.declare_intrinsic("llvm.readcyclecounter", fnty=clock), [])
        if machine in ("arm64", "aarch64"):
            return builder.asm(clock, "mrs $0, cntvct_el0", "=r", [], True)
        return _INT64(0)

    return types.int64(), generated
