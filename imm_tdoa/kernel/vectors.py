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

import numba
import numpy as np
from llvmlite import ir
from numba.core import cgutils, config, types
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

from imm_tdoa.contract import Array

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


def _splat(builder: Any, value: Any, width: int) -> Any:
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
            value if isinstance(kind, VectorType) else _splat(builder, value, width)
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
        vector = args[3] if whole else _splat(builder, args[3], width)
        builder.store(vector, pointer, align=8)
        return context.get_dummy_value()

    return types.void(lanes, memory, types.intp, kind), code


@intrinsic
def _fill(typing: Any, lanes: Any, value: Any) -> Any:
    width = len(lanes)

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _splat(builder, args[1], width)

    return VectorType(width)(lanes, types.float64), code


def _each(name: str) -> Any:
    """Return the function that applies an LLVM intrinsic lane by lane."""

    @intrinsic
    def apply(typing: Any, value: Any) -> Any:
        width = value.width

        def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            vector = ir.VectorType(ir.DoubleType(), width)
            kind = ir.FunctionType(vector, [vector])
            insert: Any = cgutils.get_or_insert_function
            function = insert(builder.module, kind, f"llvm.{name}.v{width}f64")
            return builder.call(function, args)

        return value(value), code

    return apply


@intrinsic
def _choose(typing: Any, mask: Any, yes: Any, no: Any) -> Any:
    width = mask.width

    def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        zero = ir.Constant(ir.VectorType(ir.DoubleType(), width), [0.0] * width)
        test = builder.fcmp_ordered(">", args[0], zero)
        a, b = (
            v if isinstance(k, VectorType) else _splat(builder, v, width)
            for k, v in zip(sig.args[1:], args[1:], strict=True)
        )
        return builder.select(test, a, b)

    kinds = [k if isinstance(k, VectorType) else types.float64 for k in (yes, no)]
    return VectorType(width)(mask, *kinds), code


def compiled(function: Any) -> Any:
    """Compile a function that makes no arrays: it may leave the counting of references out.

    Counting takes an atomic instruction for each array argument of each call.
    """
    return _jit(function, _nrt=False)


def allocating(function: Any) -> Any:
    """Compile a function that makes arrays."""
    return _jit(function)


def _jit(function: Any, **options: Any) -> Any:
    """Compile `function` when it is first called (`machine` keeps the machine code on disk)."""
    # error_model: a division may give inf, without a branch
    return numba.njit(nogil=True, error_model="numpy", fastmath={"contract"}, **options)(function)


SWITCHED_OFF = bool(getattr(config, "DISABLE_JIT"))  # noqa: B009 - set at run time

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

    sqrt, exp, log = np.sqrt, np.exp, np.log
else:
    get, put, fill, choose = _get, _put, _fill, _choose  # type: ignore[assignment]
    sqrt, exp, log = _each("sqrt"), _each("exp"), _each("log")
