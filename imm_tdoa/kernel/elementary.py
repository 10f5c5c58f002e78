"""Exponential and logarithm of all lanes at once, right to about one unit in the last place.

What LLVM calls for them takes the lanes one by one. Here they are sums and products, so they go
through all lanes like any other arithmetic: the argument is reduced to a small interval around
1 (log) or 0 (exp), where a polynomial is as good as the function, and powers of two do the rest.
"""

from __future__ import annotations

import math

from imm_tdoa.kernel.bits import WHOLE, exponent, mantissa, power_of_two
from imm_tdoa.kernel.compiling import compiled
from imm_tdoa.kernel.vectors import Vector, choose

LOG2_E = 1.4426950408889634
LN2_HIGH = 6.93147180369123816490e-01  # its last bits are zero: exact when multiplied by 0 to 2000
LN2_LOW = 1.90821492927058770002e-10  # and the rest
HIGHEST, LOWEST = 710.0, -746.0  # beyond them e^x is infinite, or nothing
LARGEST, SMALLEST = 1.7976931348623157e308, 2.0**-1022  # normal numbers
UP = 2.0**54  # makes any number a normal one


@compiled
def finite(x: Vector) -> Vector:
    """1 where x is finite, elsewhere not a number."""
    return (x - x) + 1.0


@compiled
def exp(x: Vector) -> Vector:
    """e^x = 2^k e^r with whole k and abs(r) <= log(2) / 2.

    The polynomial is the best of its degree for (e^r - 1 - r) / r^2, found by Remez' exchange:
    e^r has a relative error of 1.1e-17.
    """
    x = choose(x - HIGHEST, HIGHEST, x)
    x = choose(LOWEST - x, LOWEST, x)
    k = (x * LOG2_E + WHOLE) - WHOLE
    r = (x - k * LN2_HIGH) - k * LN2_LOW
    p = 2.5000056604513257e-08 * r + 2.7630248336116406e-07
    p = p * r + 2.7557586388429143e-06
    p = p * r + 2.4801493099030417e-05
    p = p * r + 0.00019841269506564
    p = p * r + 0.001388888894362999
    p = p * r + 0.008333333333494468
    p = p * r + 0.04166666666653016
    p = p * r + 0.16666666666666413
    p = p * r + 0.5000000000000011
    p = (p * r * r + r) + 1.0
    half = (0.5 * k + WHOLE) - WHOLE  # 2^k itself need not be a normal number
    return p * power_of_two(half) * power_of_two(k - half)


@compiled
def log(x: Vector) -> Vector:
    """Natural logarithm, of 0 -inf, of less not a number.

    As fdlibm has it (Sun Microsystems 1993, e_log.c): x = 2^k (1 + f), and with s = f / (2 + f)
    log(1 + f) = 2 atanh(s), a series in s^2.
    """
    tiny = SMALLEST - x
    normal = choose(tiny, x * UP, x)
    k = exponent(normal) - choose(tiny, 54.0, 0.0)
    f = mantissa(normal) - 1.0
    s = f / (f + 2.0)
    z = s * s
    R = 0.1479819860511658591 * z + 0.1531383769920937332
    R = R * z + 0.1818357216161805012
    R = R * z + 0.2222219843214978396
    R = R * z + 0.2857142874366239149
    R = R * z + 0.3999999999940941908
    R = (R * z + 0.6666666666666735130) * z
    half_square = 0.5 * f * f
    value = k * LN2_HIGH - ((half_square - (s * (half_square + R) + k * LN2_LOW)) - f)
    value = choose(x - LARGEST, x, value)
    return choose(x, value, choose(-x, math.nan, x - math.inf))
