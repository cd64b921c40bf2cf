"""Eight numbers at a time, for loops of compiled functions that must not depend on what a compiler recognises.

A loop is vectorised by LLVM only where it can prove, or check before each run, that no array overlaps another, and its
last elements are done one by one; for runs of 20 to 200 elements both cost as much as the run. `Lanes` are eight
float64 in one value that becomes one AVX-512 register, two AVX registers or four of SSE and NEON. Each operation rounds
as on single numbers (`fused` rounds once, as IEEE 754 has it, on any processor): the same bits everywhere.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import core, extending, types

__all__ = [
    "LANES",
    "add_to",
    "fill",
    "fused",
    "inverse_root",
    "larger",
    "last_lane",
    "last_lanes",
    "load",
    "smaller",
    "store",
    "take_from",
    "together",
    "where_positive",
]

LANES = 8

# Numba has no type hints.
_intrinsic: Any = extending.intrinsic
_lower: Any = extending.lower_builtin
_typer: Any = extending.type_callable
_model: Any = extending.register_model
_declared: Any = core.cgutils.get_or_insert_function

_float = ir.DoubleType()
_vector = ir.VectorType(_float, LANES)
_integers = ir.VectorType(ir.IntType(64), LANES)


class LanesType(types.Type):  # type: ignore[misc]
    """Numba's type of eight float64."""

    def __init__(self) -> None:
        super().__init__(name="Lanes")  # type: ignore[no-untyped-call]


lanes_type: Any = LanesType()


@_model(LanesType)
class _LanesModel(extending.models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _vector)  # type: ignore[no-untyped-call]


def _binary(function: Callable[..., Any], emit: str) -> None:
    @_typer(function)
    def typer(_: Any) -> Any:
        return lambda a, b: lanes_type if isinstance(a, LanesType) and isinstance(b, LanesType) else None

    @_lower(function, lanes_type, lanes_type)
    def lower(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return getattr(builder, emit)(*arguments)


_binary(operator.add, "fadd")
_binary(operator.sub, "fsub")
_binary(operator.mul, "fmul")
_binary(operator.truediv, "fdiv")


def _call(builder: Any, name: str, *arguments: Any) -> Any:
    kind = ir.FunctionType(_vector, [_vector] * len(arguments))
    return builder.call(_declared(builder.module, kind, name), arguments)


def _constant(value: float) -> Any:
    return ir.Constant(_vector, [ir.Constant(_float, value)] * LANES)


def _splat(builder: Any, number: Any, kind: Any) -> Any:
    undefined = ir.Constant(kind, ir.Undefined)
    first = builder.insert_element(undefined, number, ir.IntType(32)(0))
    return builder.shuffle_vector(first, undefined, ir.Constant(ir.VectorType(ir.IntType(32), LANES), None))


def _pointer(context: Any, builder: Any, array_type: Any, array: Any, index: Any) -> Any:
    data = context.make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), _vector.as_pointer())


@_intrinsic
def load(typing: Any, array: Any, index: Any) -> Any:
    """array[index : index + 8] of a contiguous row of float64; the caller sees to it that these exist."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load(_pointer(context, builder, signature.args[0], *arguments), align=8)

    return lanes_type(_row(array), types.intp), emit


@_intrinsic
def store(typing: Any, array: Any, index: Any, value: Any) -> Any:
    """array[index : index + 8] = value."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        builder.store(arguments[2], _pointer(context, builder, signature.args[0], *arguments[:2]), align=8)
        return context.get_dummy_value()

    return types.none(_row(array), types.intp, lanes_type), emit


@_intrinsic
def add_to(typing: Any, array: Any, index: Any, value: Any) -> Any:
    """array[index : index + 8] += value."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place = _pointer(context, builder, signature.args[0], *arguments[:2])
        builder.store(builder.fadd(builder.load(place, align=8), arguments[2]), place, align=8)
        return context.get_dummy_value()

    return types.none(_row(array), types.intp, lanes_type), emit


@_intrinsic
def take_from(typing: Any, array: Any, index: Any, value: Any) -> Any:
    """array[index : index + 8] -= value."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place = _pointer(context, builder, signature.args[0], *arguments[:2])
        builder.store(builder.fsub(builder.load(place, align=8), arguments[2]), place, align=8)
        return context.get_dummy_value()

    return types.none(_row(array), types.intp, lanes_type), emit


@_intrinsic
def together(typing: Any, before: Any, value: Any, back: Any) -> Any:
    """Eight lanes that end `back` (1 or 2, a literal) lanes before the end of `before` followed by `value`."""
    if not isinstance(back, types.IntegerLiteral):
        raise core.errors.RequireLiteralValue("lanes: `back` is not a literal")  # type: ignore[no-untyped-call]
    first = LANES - back.literal_value
    mask = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [ir.IntType(32)(first + k) for k in range(LANES)])

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.shuffle_vector(arguments[0], arguments[1], mask)

    return lanes_type(lanes_type, lanes_type, back), emit


@_intrinsic
def last_lane(typing: Any, value: Any, back: Any) -> Any:
    """The number in lane 7 - back (0 to 7)."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        lane = builder.sub(ir.IntType(64)(LANES - 1), arguments[1])
        return builder.extract_element(arguments[0], lane)

    return types.float64(lanes_type, types.intp), emit


@_intrinsic
def last_lanes(typing: Any, value: Any, count: Any) -> Any:
    """The value in the last `count` lanes (an int up to 8), 0 in the others."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        value, count = arguments
        ways = ir.Constant(_integers, [ir.Constant(ir.IntType(64), LANES - k) for k in range(LANES)])
        chosen = builder.icmp_signed("<=", ways, _splat(builder, count, _integers))
        return builder.select(chosen, value, _constant(0.0))

    return lanes_type(lanes_type, types.intp), emit


def _row(array: Any) -> Any:
    if not (
        isinstance(array, types.Array) and array.ndim == 1 and array.layout == "C" and array.dtype == types.float64
    ):
        raise core.errors.TypingError(f"lanes: {array} is not a contiguous row of float64")
    return array


@_intrinsic
def fill(typing: Any, value: Any) -> Any:
    """The same number in all eight."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _splat(builder, arguments[0], _vector)

    return lanes_type(types.float64), emit


@_intrinsic
def fused(typing: Any, a: Any, b: Any, c: Any) -> Any:
    """a b + c, rounded once."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _call(builder, "llvm.fma.v8f64", *arguments)

    return lanes_type(lanes_type, lanes_type, lanes_type), emit


def _choice(comparison: str) -> Any:
    """Emits a where it compares so with b, else b."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        a, b = arguments
        return builder.select(builder.fcmp_ordered(comparison, a, b), a, b)

    return emit


@_intrinsic
def smaller(typing: Any, a: Any, b: Any) -> Any:
    """The smaller of each two numbers; b where one is not a number."""
    return lanes_type(lanes_type, lanes_type), _choice("<")


@_intrinsic
def larger(typing: Any, a: Any, b: Any) -> Any:
    """The larger of each two numbers; b where one is not a number."""
    return lanes_type(lanes_type, lanes_type), _choice(">")


@_intrinsic
def where_positive(typing: Any, condition: Any, a: Any, b: Any) -> Any:
    """a in the lanes in which `condition` is above 0, b in the others."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        condition, a, b = arguments
        return builder.select(builder.fcmp_ordered(">", condition, _constant(0.0)), a, b)

    return lanes_type(lanes_type, lanes_type, lanes_type), emit


@_intrinsic
def inverse_root(typing: Any, squared: Any, least: Any) -> Any:
    """1 / sqrt(max(squared, least)) to within 2 units in the last place, for least (float64) above 1e-300.

    Half the exponent, negated, gives a first value within 3.5 % (Lomont 2003, for float64). Each of two iterations of
    fourth order, y + y h (1/2 + 3/8 h + 5/16 h^2) with h = 1 - r y^2 (the binomial series), takes the relative error e
    to 35/8 e^4: 6e-6, then below rounding. Division and root of the processor take about twice as long.
    """

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        r, least = arguments[0], _splat(builder, arguments[1], _vector)
        r = builder.select(builder.fcmp_ordered(">", r, least), r, least)
        shifts = ir.Constant(_integers, [ir.Constant(ir.IntType(64), 1)] * LANES)
        magic = ir.Constant(_integers, [ir.Constant(ir.IntType(64), 0x5FE6EB50C7B537A9)] * LANES)
        y = builder.bitcast(builder.sub(magic, builder.lshr(builder.bitcast(r, _integers), shifts)), _vector)
        minus_r = builder.fneg(r)
        for _ in range(2):
            h = _call(builder, "llvm.fma.v8f64", builder.fmul(minus_r, y), y, _constant(1.0))
            series = _call(builder, "llvm.fma.v8f64", h, _constant(0.3125), _constant(0.375))
            series = _call(builder, "llvm.fma.v8f64", h, series, _constant(0.5))
            y = _call(builder, "llvm.fma.v8f64", builder.fmul(y, h), series, y)
        return y

    return lanes_type(lanes_type, types.float64), emit
