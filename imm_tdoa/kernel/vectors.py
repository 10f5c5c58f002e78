"""Numbers of several targets at once: the vector type that the kernel computes with.

A *lane* is one target. All that a block of targets needs lies in one array, its memory M, one
vector a row; a matrix is named by where in M it begins: ``get(lanes, M, P + a * n + b)`` is
P[a, b] of every lane, and ``put`` writes it. Vectors add, subtract, multiply and divide lane by
lane, with each other and with plain numbers. So the kernel reads like the textbook's scalar
formulas, and the compiler makes vector instructions of it without having to find out that it
may. How many lanes there are is the length of the tuple ``lanes``, part of its type.

Where Numba's compilation is switched off a vector is a NumPy array, and the same source runs.
"""

from __future__ import annotations

import operator
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

from imm_tdoa.contract import Array
from imm_tdoa.kernel.compiling import SWITCHED_OFF

LANES = (0,) * 16  # as many as give the widest registers enough to do
FOUR, ONE = (0,) * 4, (0,)

Lanes = tuple[int, ...]
Vector = Any  # a vector of the lanes
CONTRACT = ("contract",)  # a * b + c may be one instruction


class VectorType(types.Type):  # type: ignore[misc]
    """Numba's type of a vector of `width` numbers."""

    def __init__(self, width: int) -> None:
        self.width = width
        super().__init__(name=f"Vector({width})")


@register_model(VectorType)
class _VectorModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, dmm: Any, fe_type: VectorType) -> None:
        super().__init__(dmm, fe_type, ir.VectorType(ir.DoubleType(), fe_type.width))


def splat(builder: Any, value: Any, width: int) -> Any:
    vector = ir.Constant(ir.VectorType(ir.DoubleType(), width), ir.Undefined)
    first = builder.insert_element(vector, value, ir.Constant(ir.IntType(32), 0))
    mask = ir.Constant(ir.VectorType(ir.IntType(32), width), [0] * width)
    return builder.shuffle_vector(first, vector, mask)


def _operation(op: Any, instruction: str) -> None:
    """Teach Numba one arithmetic operation of vectors, and of a vector with a number."""

    class Typing(AbstractTemplate):  # type: ignore[misc]
        def generic(self, args: Any, kws: Any) -> Any:
            vectors = [a for a in args if isinstance(a, VectorType)]
            others = [a for a in args if not isinstance(a, VectorType)]
            if not vectors or not all(isinstance(a, types.Number) for a in others):
                return None
            kinds = [a if isinstance(a, VectorType) else types.float64 for a in args]
            return signature(vectors[0], *kinds)

    infer_global(op)(Typing)

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        width = sig.return_type.width
        a, b = (
            value if isinstance(kind, VectorType) else splat(builder, value, width)
            for kind, value in zip(sig.args, args, strict=True)
        )
        return getattr(builder, instruction)(a, b, flags=CONTRACT)

    for kinds in ((VectorType, VectorType), (VectorType, types.Float), (types.Float, VectorType)):
        lower_builtin(op, *kinds)(lower)


for _op, _instruction in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _operation(_op, _instruction)


@infer_global(operator.neg)
class _Negative(AbstractTemplate):  # type: ignore[misc]
    def generic(self, args: Any, kws: Any) -> Any:
        return signature(args[0], *args) if isinstance(args[0], VectorType) else None


@lower_builtin(operator.neg, VectorType)
def _lower_negative(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.fneg(args[0])


def _pointer(context: Any, builder: Any, kind: Any, memory: Any, index: Any, width: int) -> Any:
    """Where vector number `index` of the memory begins."""
    data = context.make_array(kind)(context, builder, memory).data
    size = context.get_constant(types.intp, 8 * width)
    offset = builder.mul(index, size, flags=("nsw",))
    vector = ir.VectorType(ir.DoubleType(), width)
    return cgutils.pointer_add(builder, data, offset, vector.as_pointer())


@intrinsic
def _get(typing: Any, lanes: Any, memory: Any, index: Any) -> Any:
    width = len(lanes)

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pointer = _pointer(context, builder, memory, args[1], args[2], width)
        return builder.load(pointer, align=8, typ=ir.VectorType(ir.DoubleType(), width))

    return VectorType(width)(lanes, memory, types.intp), code


@intrinsic
def _put(typing: Any, lanes: Any, memory: Any, index: Any, value: Any) -> Any:
    width = len(lanes)
    kind = value if isinstance(value, VectorType) else types.float64

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pointer = _pointer(context, builder, memory, args[1], args[2], width)
        whole = isinstance(kind, VectorType)
        vector = args[3] if whole else splat(builder, args[3], width)
        builder.store(vector, pointer, align=8)
        return context.get_dummy_value()

    return types.void(lanes, memory, types.intp, kind), code


@intrinsic
def _fill(typing: Any, lanes: Any, value: Any) -> Any:
    width = len(lanes)

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return splat(builder, args[1], width)

    return VectorType(width)(lanes, types.float64), code


@intrinsic
def _sqrt(typing: Any, value: Any) -> Any:
    width = value.width

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        vector = ir.VectorType(ir.DoubleType(), width)
        kind = ir.FunctionType(vector, [vector])
        insert: Any = cgutils.get_or_insert_function
        function = insert(builder.module, kind, f"llvm.sqrt.v{width}f64")
        return builder.call(function, args)

    return value(value), code


@intrinsic
def _choose(typing: Any, mask: Any, yes: Any, no: Any) -> Any:
    width = mask.width

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        zero = ir.Constant(ir.VectorType(ir.DoubleType(), width), [0.0] * width)
        test = builder.fcmp_ordered(">", args[0], zero)
        a, b = (
            v if isinstance(k, VectorType) else splat(builder, v, width)
            for k, v in zip(sig.args[1:], args[1:], strict=True)
        )
        return builder.select(test, a, b)

    kinds = [k if isinstance(k, VectorType) else types.float64 for k in (yes, no)]
    return VectorType(width)(mask, *kinds), code


@intrinsic
def _anywhere(typing: Any, mask: Any) -> Any:
    width = mask.width

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        zero = ir.Constant(ir.VectorType(ir.DoubleType(), width), [0.0] * width)
        test = builder.fcmp_ordered(">", args[0], zero)
        bits = builder.bitcast(test, ir.IntType(width))
        return builder.icmp_unsigned("!=", bits, ir.Constant(ir.IntType(width), 0))

    return types.boolean(mask), code


EIGHT = 8  # rows of the memory that `scatter` writes


@intrinsic
def _scatter(
    typing: Any, lanes: Any, memory: Any, row: Any, out: Any, begin: Any, stride: Any, last: Any
) -> Any:
    width = len(lanes)
    index = types.intp

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        kind = ir.VectorType(ir.DoubleType(), width)
        rows = [
            builder.load(
                _pointer(
                    context, builder, memory, args[1],
                    builder.add(args[2], context.get_constant(index, i)), width,
                ),
                align=8, typ=kind,
            )
            for i in range(EIGHT)
        ]  # fmt: skip

        def shuffled(a: Any, b: Any, order: Any) -> Any:
            mask = ir.Constant(ir.VectorType(ir.IntType(32), len(order)), order)
            return builder.shuffle_vector(a, b, mask)

        half = width // 2
        low = [i + side for i in range(half) for side in (0, width)]
        high = [i + side for i in range(half, width) for side in (0, width)]
        for _ in range(3 if width > 1 else 0):  # as one shuffles cards: 8 x L becomes L x 8
            rows = [
                shuffled(rows[i], rows[i + EIGHT // 2], order)
                for i in range(EIGHT // 2)
                for order in (low, high)
            ]
        piece = min(EIGHT, width)
        data = context.make_array(out)(context, builder, args[3]).data
        for k in range(EIGHT * width - piece, -1, -piece):  # the last lane after those left out
            lane = context.get_constant(index, k // EIGHT)
            own = builder.select(builder.icmp_signed("<", lane, args[6]), lane, args[6])
            here = builder.add(builder.mul(own, args[5]), args[4])
            here = builder.add(here, context.get_constant(index, k % EIGHT))
            vector, first = rows[k // width], k % width
            part = shuffled(vector, vector, [*range(first, first + piece)])
            place = builder.bitcast(builder.gep(data, [here]), part.type.as_pointer())
            builder.store(part, place, align=8)
        return context.get_dummy_value()

    return types.void(lanes, memory, index, out, index, index, index), code


if SWITCHED_OFF:

    def get(lanes: Lanes, M: Array, index: int) -> Vector:
        """Return vector number `index` of the memory."""
        return M[index].copy()

    def put(lanes: Lanes, M: Array, index: int, value: Vector) -> None:
        """Write vector number `index` of the memory."""
        M[index] = value

    def fill(lanes: Lanes, value: float) -> Vector:
        """Return the vector of one number."""
        return np.full(len(lanes), value)

    def choose(mask: Vector, yes: Vector, no: Vector) -> Vector:
        """Return `yes` in the lanes where the mask is above zero, else `no`."""
        return np.where(mask > 0.0, yes, no)

    def scatter(
        lanes: Lanes, M: Array, row: int, out: Array, begin: int, stride: int, last: int
    ) -> None:
        """Write EIGHT rows of the memory to `out`, those of one lane side by side.

        Lane i's begin at `begin` + i * `stride`; lanes after the `last` are left out.
        """
        for lane in range(last + 1):
            here = begin + lane * stride
            out[here : here + EIGHT] = M[row : row + EIGHT, lane]

    def anywhere(mask: Vector) -> bool:
        """Whether the mask is above zero in any lane."""
        return bool(np.any(mask > 0.0))

    sqrt = np.sqrt
else:
    get, put, fill, choose = _get, _put, _fill, _choose  # type: ignore[assignment]
    anywhere, scatter = _anywhere, _scatter  # type: ignore[assignment]
    sqrt = _sqrt  # type: ignore[assignment]
