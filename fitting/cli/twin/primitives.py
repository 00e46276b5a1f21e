"""JAX primitives as WebAssembly instructions on single numbers, or as rearrangements of arrays."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from fitting.cli.twin.wasm import F64, I32, MATH, Code, Operand, type_of

Params = dict[str, Any]
# Opcodes of (float64, int32); comparisons give an int32.
_SAME = {
    "add": (b"\xa0", b"\x6a"), "sub": (b"\xa1", b"\x6b"), "mul": (b"\xa2", b"\x6c"), "div": (b"\xa3", b"\x6d"),
    "min": (b"\xa4", b""), "max": (b"\xa5", b""), "and": (b"", b"\x71"), "or": (b"", b"\x72"), "xor": (b"", b"\x73"),
    "sqrt": (b"\x9f", b""), "floor": (b"\x9c", b""), "ceil": (b"\x9b", b""),
}  # fmt: skip
_COMPARED = {
    "eq": (b"\x61", b"\x46"), "ne": (b"\x62", b"\x47"), "lt": (b"\x63", b"\x48"), "gt": (b"\x64", b"\x4a"),
    "le": (b"\x65", b"\x4c"), "ge": (b"\x66", b"\x4e"),
}  # fmt: skip
_SELECT, _EQZ, _FROM_INT, _TO_INT = b"\x1b", b"\x45", b"\xb7", b"\xfc\x02"
_UNCHANGED = ("stop_gradient", "copy", "copy_p", "optimization_barrier", "reduce_precision")


def _same(name: str) -> Callable[..., Operand]:
    def write(code: Code, _: Params, *x: Operand) -> Operand:
        kind = type_of(x[0])
        if name == "mul" and 1.0 in x and kind == F64:  # exact, like the next case
            return x[0] if x[1] == 1.0 else x[1]
        if name == "sub" and type(x[1]) is float and x[1] == 0.0 and not np.signbit(x[1]):
            return x[0]
        opcode = _SAME[name][kind == I32]
        if not opcode:
            wanted = _COMPARED["lt" if name == "min" else "gt"][1]
            return code.op(_SELECT, kind, *x, code.op(wanted, I32, *x))
        return code.op(opcode, kind, *x)

    return write


def _compared(name: str) -> Callable[..., Operand]:
    return lambda code, _, a, b: code.op(_COMPARED[name][type_of(a) == I32], I32, a, b)


def _from_math(name: str) -> Callable[..., Operand]:
    number = list(MATH).index(name)
    return lambda code, _, *x: code.op(bytes([0x10, number]), F64, *x)


def _power(code: Code, params: Params, x: Operand) -> Operand:
    n, found, square = abs(params["y"]), None, x
    while n:
        if n & 1:
            found = square if found is None else code.op(b"\xa2", F64, found, square)
        n >>= 1
        square = code.op(b"\xa2", F64, square, square) if n else square
    found = 1.0 if found is None else found
    return code.op(b"\xa3", F64, 1.0, found) if params["y"] < 0 else found


def _select(code: Code, _: Params, which: Operand, *cases: Operand) -> Operand:
    return code.op(_SELECT, type_of(cases[0]), cases[1], cases[0], which)


def _negative(code: Code, _: Params, x: Operand) -> Operand:
    return code.op(b"\x9a", F64, x) if type_of(x) == F64 else code.op(b"\x6b", I32, 0, x)


def _absolute(code: Code, _: Params, x: Operand) -> Operand:
    if type_of(x) == F64:
        return code.op(b"\x99", F64, x)
    return code.op(_SELECT, I32, x, code.op(b"\x6b", I32, 0, x), code.op(b"\x4a", I32, x, 0))


def _sign(code: Code, _: Params, x: Operand) -> Operand:
    one = code.op(b"\xa6", F64, 1.0, x)
    return code.op(_SELECT, F64, one, x, code.op(b"\x64", I32, code.op(b"\x99", F64, x), 0.0))


def _converted(code: Code, params: Params, x: Operand) -> Operand:
    to, own = params["new_dtype"], type_of(x)
    if to == np.bool_:
        return code.op(_COMPARED["ne"][own == I32], I32, x, 0.0 if own == F64 else 0)
    if (kind := kind_of(to)) == own:
        return x
    return code.op(_FROM_INT, F64, x) if kind == F64 else code.op(_TO_INT, I32, x)


def _not(code: Code, params: Params, x: Operand) -> Operand:
    return code.op(_EQZ, I32, x) if params["dtype"] == np.bool_ else code.op(b"\x73", I32, x, -1)


def _clamped(code: Code, _: Params, low: Operand, x: Operand, high: Operand) -> Operand:
    return ELEMENTWISE["min"](code, {}, ELEMENTWISE["max"](code, {}, x, low), high)


ELEMENTWISE: dict[str, Callable[..., Operand]] = {
    **{name: _same(name) for name in _SAME},
    **{name: _compared(name) for name in _COMPARED},
    **{name: _from_math(name) for name in MATH},
    **dict.fromkeys(_UNCHANGED, lambda code, _, x: x),
    "integer_pow": _power,
    "square": lambda code, _, x: code.op(b"\xa2", F64, x, x),
    "rsqrt": lambda code, _, x: code.op(b"\xa3", F64, 1.0, code.op(b"\x9f", F64, x)),
    "is_finite": lambda code, _, x: code.op(b"\x61", I32, code.op(b"\xa1", F64, x, x), 0.0),
    "select_n": _select,
    "neg": _negative,
    "abs": _absolute,
    "sign": _sign,
    "convert_element_type": _converted,
    "not": _not,
    "clamp": _clamped,
}
REDUCED = {
    "reduce_sum": "add", "reduce_prod": "mul", "reduce_max": "max", "reduce_min": "min", "reduce_or": "or",
    "reduce_and": "and",
}  # fmt: skip
RUNNING = {"cumsum": "add", "cumprod": "mul", "cummax": "max", "cummin": "min"}


def kind_of(dtype: Any) -> int | None:
    """WebAssembly type for numbers of a numpy type; None if it is not supported."""
    kinds = {"float64": F64, "int64": I32, "int32": I32, "bool": I32}
    return kinds.get(str(np.dtype(dtype)))


def _broadcast(params: Params, x: np.ndarray) -> np.ndarray:
    shape = [1] * len(params["shape"])
    for size, axis in zip(x.shape, params["broadcast_dimensions"], strict=True):
        shape[axis] = size
    return np.broadcast_to(x.reshape(shape), params["shape"])


def _sliced(params: Params, x: np.ndarray) -> np.ndarray:
    steps = params["strides"] or (1,) * x.ndim
    return x[tuple(map(slice, params["start_indices"], params["limit_indices"], steps))]


# Primitives that rearrange the entries of one array.
MOVED: dict[str, Callable[[Params, np.ndarray], np.ndarray]] = {
    "reshape": lambda params, x: x.reshape(params["new_sizes"]),
    "squeeze": lambda params, x: x.squeeze(tuple(params["dimensions"])),
    "expand_dims": lambda params, x: np.expand_dims(x, tuple(params["dimensions"])),
    "transpose": lambda params, x: x.transpose(params["permutation"]),
    "rev": lambda params, x: np.flip(x, tuple(params["dimensions"])),
    "broadcast_in_dim": _broadcast,
    "slice": _sliced,
}
# Primitives that join several arrays.
JOINED: dict[str, Callable[[Params, list[np.ndarray]], np.ndarray]] = {
    "concatenate": lambda params, x: np.concatenate(x, params["dimension"]),
    "stack": lambda params, x: np.stack(x, params["axis"]),
}
# Numpy functions for primitives of constant arrays.
FOLDED: dict[str, Callable[..., Any]] = {
    "add": np.add, "sub": np.subtract, "mul": np.multiply, "neg": np.negative, "convert_element_type": np.asarray,
    "stop_gradient": np.asarray, "lt": np.less, "max": np.maximum, "min": np.minimum,
}  # fmt: skip
