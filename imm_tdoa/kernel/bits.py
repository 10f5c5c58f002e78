"""Powers of two, taken from the numbers of a vector and made into such: a matter of their bits."""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba.extending import intrinsic

from imm_tdoa.kernel.compiling import SWITCHED_OFF
from imm_tdoa.kernel.vectors import Vector, splat

ROOT_HALF, FRACTION = 0x3FE6A09E667F3BCD, 52  # the bits of sqrt(1/2); how many are the fraction
WHOLE = 1.5 * 2.0**52  # a number of this size has its last bit before the point


@intrinsic
def _exponent(typing: Any, value: Any) -> Any:
    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        bits, number = _bits(builder, args[0], value.width)
        k = builder.ashr(builder.sub(bits, number(ROOT_HALF)), number(FRACTION))
        whole = splat(builder, ir.Constant(ir.DoubleType(), WHOLE), value.width)
        shifted = builder.add(k, builder.bitcast(whole, bits.type))
        return builder.fsub(builder.bitcast(shifted, whole.type), whole)

    return value(value), code


@intrinsic
def _mantissa(typing: Any, value: Any) -> Any:
    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        bits, number = _bits(builder, args[0], value.width)
        k = builder.ashr(builder.sub(bits, number(ROOT_HALF)), number(FRACTION))
        one = builder.sub(bits, builder.shl(k, number(FRACTION)))
        return builder.bitcast(one, args[0].type)

    return value(value), code


@intrinsic
def _power_of_two(typing: Any, value: Any) -> Any:
    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        biased = splat(builder, ir.Constant(ir.DoubleType(), WHOLE + 1023.0), value.width)
        bits, number = _bits(builder, builder.fadd(args[0], biased), value.width)
        return builder.bitcast(builder.shl(bits, number(FRACTION)), args[0].type)

    return value(value), code


def _bits(builder: Any, vector: Any, width: int) -> Any:
    """The bits of a vector's numbers as integers, and what makes a vector of one integer."""
    kind = ir.VectorType(ir.IntType(64), width)
    return builder.bitcast(vector, kind), lambda whole: ir.Constant(kind, [whole] * width)


if SWITCHED_OFF:

    def exponent(x: Vector) -> Vector:
        """Return the whole number k for which x = 2^k m, m between sqrt(1/2) and sqrt(2)."""
        return ((x.view(np.int64) - ROOT_HALF) >> FRACTION).astype(float)

    def mantissa(x: Vector) -> Vector:
        """Return that m."""
        return np.ldexp(x, -exponent(x).astype(int))

    def power_of_two(k: Vector) -> Vector:
        """Return 2^k for whole numbers k that make it a normal number."""
        return np.ldexp(1.0, k.astype(int))

else:
    exponent, mantissa = _exponent, _mantissa  # type: ignore[assignment]
    power_of_two = _power_of_two  # type: ignore[assignment]
