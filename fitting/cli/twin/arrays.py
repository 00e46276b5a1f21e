"""Arrays of a program that is compiled to WebAssembly, and operations on them.

A value is one of three: a numpy array of constants, known at compile time; an array of objects whose entries are
operands (local variables or constants); a `Stored` in memory.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from fitting.cli.twin.primitives import kind_of
from fitting.cli.twin.wasm import F64, I32, SLOT, Code, Module, Operand, type_of
from pftwin.base.errors import InputError

SMALL = 96  # largest number of entries of an array held in local variables


class Stored(NamedTuple):
    """An array in memory, in row-major order."""

    address: int
    shape: tuple[int, ...]
    dtype: Any


Value = np.ndarray | Stored


def known(value: Value) -> bool:
    """Whether a value is constant, that is, depends on no input."""
    return not isinstance(value, Stored) and value.dtype != object


class Arrays:
    """The memory of a module, and operations on arrays."""

    def __init__(self) -> None:
        self.module = Module()
        self._written: dict[bytes, int] = {}  # addresses of constant data

    def reserve(self, like: Any) -> Stored:
        """Reserves memory for an array of the shape and type of `like`; InputError for an unsupported type."""
        if kind_of(like.dtype) is None:
            expected = "float64, integers and booleans"
            raise InputError(f"numbers of type {like.dtype}", where="twin", expected=expected)
        size = int(np.prod(like.shape))
        return Stored(self.module.reserve(size), tuple(like.shape), np.dtype(like.dtype))

    def elementwise(self, code: Code, write: Callable[..., Operand], params: Any, args: list[Value], out: Any) -> Value:
        """Applies an elementwise operation, written by `write`, to one array or several."""
        if int(np.prod(out.shape)) <= SMALL:
            flat = [np.broadcast_to(self.entries(code, a), out.shape).reshape(-1) for a in args]
            return array([write(code, params, *map(operand, x)) for x in zip(*flat, strict=True)], out.shape)
        made = self.reserve(out)
        sources = [self.single(code, a) if a.shape == () else self.table(code, a) for a in args]
        with code.loop(int(np.prod(out.shape))) as i:
            at = code.op(b"\x6c", I32, i, SLOT)
            x = [code.load(kind_of_table(s), s.address, at) if isinstance(s, Stored) else s for s in sources]
            code.store(write(code, params, *x), made.address, at)
        return made

    def moved(self, code: Code, move: Callable[[Any], Any], args: list[Value], out: Any) -> Value:
        """Rearranges or repeats the entries of an array by `move`, which accepts numpy arrays of any type."""
        if not isinstance(args[0], Stored) and int(np.prod(out.shape)) <= SMALL:
            return move(args[0])
        if args[0].shape == () or int(np.prod(args[0].shape)) == 1:
            single = self.single(code, args[0])
            return self.elementwise(code, lambda c, p, x: x, {}, [array([single], ())], out)
        source, made = self.table(code, args[0]), self.reserve(out)
        if source.shape != () and int(np.prod(source.shape)) == int(np.prod(out.shape)):
            whole = move(np.arange(np.prod(source.shape)).reshape(source.shape)).reshape(-1)
            if (np.diff(whole) == 1).all():
                return Stored(source.address, made.shape, source.dtype)  # order unchanged: no copy needed
        self._copy(code, source, move(np.arange(np.prod(source.shape)).reshape(source.shape)), made, None)
        return self.fetched(code, made)

    def joined(self, code: Code, join: Callable[[Any], Any], args: list[Value], out: Any) -> Value:
        """Joins several arrays into one by `join`, which accepts numpy arrays of any type."""
        if int(np.prod(out.shape)) <= SMALL:
            return join([self.entries(code, a) for a in args])
        made, sizes = self.reserve(out), [int(np.prod(a.shape)) for a in args]
        ends = np.cumsum([0, *sizes])
        places = join([np.arange(n).reshape(a.shape) + e for n, a, e in zip(sizes, args, ends, strict=False)])
        targets = np.argsort(places.reshape(-1))  # position in the result of every entry of every argument
        for a, begin, end in zip(args, ends, ends[1:], strict=False):
            source, to = self.table(code, a), targets[begin:end].reshape(a.shape)
            self._copy(code, source, np.arange(end - begin).reshape(a.shape), made, to)
        return made

    def _copy(self, code: Code, source: Stored, taken: np.ndarray, made: Stored, put: np.ndarray | None) -> None:
        """Copies entries `taken` of a table to positions `put` (None: in order); strides must be constant per axis."""
        put = np.arange(taken.size).reshape(taken.shape) if put is None else put

        def nest(axes: list[int], address: Operand, to: Operand) -> None:
            if not axes:
                code.store(code.load(kind_of_table(source), 0, address), 0, to)
                return
            ahead = [stride(places, axes[0]) * SLOT for places in (taken, put)]
            with code.loop(taken.shape[axes[0]]) as i:
                moved = [
                    code.op(b"\x6a", I32, a, code.op(b"\x6c", I32, i, s))
                    for a, s in zip((address, to), ahead, strict=True)
                ]
                nest(axes[1:], *moved)

        # Full addresses, because strides of reversed arrays are negative, which an instruction's offset cannot be.
        first = source.address + SLOT * int(taken.flat[0]), made.address + SLOT * int(put.flat[0])
        nest([k for k in range(taken.ndim) if taken.shape[k] > 1], *first)

    def reduced(self, code: Code, write: Callable[..., Operand], axes: Any, x: Value, out: Any) -> Value:
        """Reduces an array along axes by the binary operation that `write` writes, for example a sum."""
        if not isinstance(x, Stored) and x.size <= SMALL:
            remaining = [k for k in range(x.ndim) if k not in axes]
            rows = x.transpose(*remaining, *axes).reshape(int(np.prod(out.shape)), -1)
            return array([self._folded(code, write, [operand(a) for a in row]) for row in rows], out.shape)
        source, made = self.table(code, x), self.reserve(out)
        places = np.arange(np.prod(source.shape)).reshape(source.shape)
        remaining = [k for k in range(places.ndim) if k not in axes]
        order = places.transpose(*axes, *remaining).reshape(-1, int(np.prod(out.shape)))
        ahead = [stride(order, k) * SLOT for k in (0, 1)]
        total = code.new(kind_of_table(source))
        with code.loop(order.shape[1]) as i:
            at = code.op(b"\x6c", I32, i, ahead[1])
            code.set(total, code.load(total.type, source.address, at))
            if order.shape[0] > 1:
                with code.loop(order.shape[0] - 1) as j:
                    down = code.op(b"\x6a", I32, at, code.op(b"\x6c", I32, j, ahead[0]))
                    code.set(total, write(code, {}, total, code.load(total.type, source.address + ahead[0], down)))
            code.store(total, made.address, code.op(b"\x6c", I32, i, SLOT))
        return self.fetched(code, made)

    def running(self, code: Code, write: Callable[..., Operand], x: Value, out: Any) -> Value:
        """Cumulative version of `reduced`, for an array with one axis."""
        source, made = self.table(code, x), self.reserve(out)
        total = code.new(kind_of_table(source))
        code.set(total, code.load(total.type, source.address))
        with code.loop(out.shape[0]) as i:
            at = code.op(b"\x6c", I32, i, SLOT)
            first = code.op(b"\x45", I32, i)
            here = code.load(total.type, source.address, at)
            code.set(total, code.op(b"\x1b", total.type, here, write(code, {}, total, here), first))
            code.store(total, made.address, at)
        return self.fetched(code, made)

    def _folded(self, code: Code, write: Callable[..., Operand], row: list[Operand]) -> Operand:
        total = row[0]
        for a in row[1:]:
            total = write(code, {}, total, a)
        return total

    def stored(self, code: Code, value: Value) -> Value:
        """The value in a form that another function can read: constant, or in memory."""
        return value if known(value) else self.table(code, value)

    def fetched(self, code: Code, value: Value) -> Value:
        """Loads a small table into local variables; returns other values unchanged."""
        if not isinstance(value, Stored) or int(np.prod(value.shape)) > SMALL:
            return value
        return self.entries(code, value)

    def entries(self, code: Code, value: Value) -> np.ndarray:
        """The value as an array of numbers or operands."""
        if not isinstance(value, Stored):
            return value
        size = int(np.prod(value.shape))
        return array([code.load(kind_of_table(value), value.address + SLOT * k) for k in range(size)], value.shape)

    def table(self, code: Code, value: Value) -> Stored:
        """The value as a table in memory."""
        if isinstance(value, Stored):
            return value
        if known(value):
            return Stored(self._data(value), value.shape, value.dtype)
        like = jax.ShapeDtypeStruct(value.shape, np.float64 if _any_float(value) else np.int32)
        made = self.reserve(like)
        self.store_all(code, [made], [value])
        return made

    def store_all(self, code: Code, tables: Sequence[Stored], values: Sequence[Value]) -> None:
        """Writes values to tables of the same shapes."""
        for table, value in zip(tables, values, strict=True):
            if table.shape != value.shape:
                raise AssertionError(f"{table.shape} for {value.shape}")
            if isinstance(value, Stored) or value.size > SMALL:
                self._copy(
                    code, self.table(code, value), np.arange(np.prod(value.shape)).reshape(value.shape), table, None
                )
                continue
            for k, x in enumerate(value.reshape(-1)):
                code.store(operand(x), table.address + SLOT * k)

    def single(self, code: Code, value: Value) -> Operand:
        """The first entry of a value."""
        return operand(self.entries(code, value).reshape(-1)[0])

    def _data(self, value: np.ndarray) -> int:
        if kind_of(value.dtype) == F64:
            text = value.astype("<f8").tobytes()
        else:
            text = b"".join(struct.pack("<ii", int(x), 0) for x in value.reshape(-1))
        if text not in self._written:
            self._written[text] = self.module.reserve(value.size)
            self.module.data.append((self._written[text], text))
        return self._written[text]


def operand(x: Any) -> Operand:
    """Converts a numpy number to a Python constant; returns an operand unchanged."""
    if isinstance(x, np.floating):
        return float(x)
    return int(x) if isinstance(x, np.integer | np.bool_) else x


def kind_of_table(table: Stored) -> int:
    """WebAssembly type of a table's numbers."""
    kind = kind_of(table.dtype)
    assert kind is not None
    return kind


def _any_float(value: np.ndarray) -> bool:
    return type_of(operand(value.reshape(-1)[0])) == F64


def array(entries: Sequence[Any], shape: tuple[int, ...]) -> np.ndarray:
    """An array of objects of this shape; a tuple is one object."""
    made = np.empty(len(entries), dtype=object)
    for k, x in enumerate(entries):
        made[k] = x
    return made.reshape(shape)


def stride(places: np.ndarray, axis: int) -> int:
    """Distance of neighbours along an axis, in entries; InputError if it is not constant."""
    if places.shape[axis] < 2:
        return 0
    ahead = np.diff(places, axis=axis)
    if (ahead != ahead.flat[0]).any():
        raise InputError("an array with varying strides", where="twin", expected="slices and transposes")
    return int(ahead.flat[0])
