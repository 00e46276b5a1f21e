"""Writer of WebAssembly modules: functions of instructions in SSA form, and the sections of the binary format.

Format: WebAssembly core specification, version 1 (with saturating conversions). Every entry of an array occupies a slot
of 8 bytes in memory: floats as float64, integers and booleans as int32.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import NamedTuple

SLOT = 8  # bytes of a number in memory
F64, I32 = 0x7C, 0x7F
_PAGE, _EMPTY = 65536, 0x40
_GET, _SET, _CALL, _ADD, _LESS, _IF, _LOOP, _END, _BRANCH, _BRANCH_IF = (
    b"\x20", b"\x21", b"\x10", b"\x6a", b"\x48", b"\x04", b"\x03", b"\x0b", b"\x0c", b"\x0d",
)  # fmt: skip


class Local(NamedTuple):
    """A local variable of a function."""

    type: int
    index: int


Operand = Local | float | int  # a float is a constant of type F64, an int one of I32


def unsigned(n: int) -> bytes:
    """Unsigned LEB128 encoding."""
    out = bytearray()
    while n > 0x7F:
        out.append(n & 0x7F | 0x80)
        n >>= 7
    return bytes([*out, n])


def signed(n: int) -> bytes:
    """Signed LEB128 encoding."""
    out = bytearray()
    while not -64 <= n < 64:
        out.append(n & 0x7F | 0x80)
        n >>= 7
    return bytes([*out, n & 0x7F])


def type_of(operand: Operand) -> int:
    """Type of an operand: F64 or I32."""
    return operand.type if isinstance(operand, Local) else F64 if type(operand) is float else I32


def _pushed(operand: Operand) -> bytes:
    if isinstance(operand, Local):
        return _GET + unsigned(operand.index)
    if type(operand) is float:
        return b"\x44" + struct.pack("<d", operand)
    return b"\x41" + signed(int(operand))


class Code:
    """The body of a function; each instruction's result is a separate local, which equal instructions share."""

    def __init__(self, counted: bool = False) -> None:
        """`counted`: the function has one parameter, the int32 index of the repetition."""
        self.count = Local(I32, 0)
        self.counted, self._types, self._body = counted, [I32] if counted else [], bytearray()
        self._results: dict[bytes, Local] = {}

    def new(self, kind: int) -> Local:
        """Adds a local variable of a type."""
        self._types.append(kind)
        return Local(kind, len(self._types) - 1)

    def set(self, to: Local, value: Operand) -> None:
        """Assigns a value to a local variable."""
        self._body += _pushed(value) + _SET + unsigned(to.index)

    def op(self, code: bytes, kind: int, *operands: Operand) -> Local:
        """Adds an instruction without side effects; returns its result."""
        text = b"".join(map(_pushed, operands)) + code
        if text not in self._results:
            self._results[text] = self._result(text, kind)
        return self._results[text]

    def load(self, kind: int, address: int, at: Operand = 0) -> Local:
        """Loads a number from memory, `at` bytes beyond an address."""
        return self._result(_pushed(at) + (b"\x2b\x03" if kind == F64 else b"\x28\x02") + unsigned(address), kind)

    def store(self, value: Operand, address: int, at: Operand = 0) -> None:
        """Stores a number in memory, `at` bytes beyond an address."""
        code = b"\x39\x03" if type_of(value) == F64 else b"\x36\x02"
        self._body += _pushed(at) + _pushed(value) + code + unsigned(address)

    def call(self, function: int, *operands: Operand) -> None:
        """Calls a function that returns nothing."""
        self._body += b"".join(map(_pushed, operands)) + _CALL + unsigned(function)

    @contextmanager
    def loop(self, times: int) -> Iterator[Local]:
        """Context whose instructions are repeated; yields the counter, from 0."""
        counter, known = self.new(I32), dict(self._results)
        self.set(counter, 0)
        self._body += _LOOP + bytes([_EMPTY])
        yield counter
        self._body += _pushed(counter) + _pushed(1) + _ADD + _SET + unsigned(counter.index)
        self._body += _pushed(counter) + _pushed(times) + _LESS + _BRANCH_IF + b"\x00" + _END
        self._results = known  # results from inside the loop are not valid after it

    def repeat_while(self, condition: int, address: int, body: int) -> None:
        """Calls `condition`, which stores a boolean at an address, and `body` as long as that is true."""
        self._body += _LOOP + bytes([_EMPTY]) + _CALL + unsigned(condition)
        asked = self.load(I32, address)
        self._body += _pushed(asked) + _IF + bytes([_EMPTY]) + _CALL + unsigned(body)
        self._body += _BRANCH + b"\x01" + _END + _END

    def binary(self) -> bytes:
        """The function's entry in the code section: its locals and instructions."""
        own = self._types[int(self.counted) :]
        runs: list[list[int]] = []
        for kind in own:
            if runs and runs[-1][1] == kind:
                runs[-1][0] += 1
            else:
                runs.append([1, kind])
        declared = unsigned(len(runs)) + b"".join(unsigned(n) + bytes([kind]) for n, kind in runs)
        text = declared + self._body + _END
        return unsigned(len(text)) + text

    def _result(self, text: bytes, kind: int) -> Local:
        found = self.new(kind)
        self._body += text + _SET + unsigned(found.index)
        return found


_TYPES = (((), ()), ((I32,), ()), ((F64,), (F64,)), ((F64, F64), (F64,)))  # of functions: parameters and results
# Functions of JavaScript's `Math` that modules import, in this order, and their numbers of arguments.
MATH = {
    **dict.fromkeys(
        ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh"), 1
    ),
    **dict.fromkeys(("exp", "expm1", "log", "log1p", "cbrt"), 1),
    **dict.fromkeys(("atan2", "pow"), 2),
}


@dataclass(eq=False)
class Module:
    """Functions, memory and data."""

    functions: list[Code] = field(default_factory=list)
    exported: dict[str, int] = field(default_factory=dict)
    data: list[tuple[int, bytes]] = field(default_factory=list)
    size: int = SLOT  # of the memory that is in use [bytes]; an address is never 0

    def reserve(self, slots: int) -> int:
        """Reserves slots of memory; returns their address."""
        self.size, address = self.size + SLOT * slots, self.size
        return address

    def function(self, code: Code, name: str | None = None) -> int:
        """Adds a function, exported under a name if one is given; returns its index."""
        self.functions.append(code)
        number = len(MATH) + len(self.functions) - 1
        if name is not None:
            self.exported[name] = number
        return number

    def binary(self) -> bytes:
        """The module in the binary format."""
        pages = -(-self.size // _PAGE)
        types = [b"\x60" + _list([bytes([a]) for a in of]) + _list([bytes([a]) for a in to]) for of, to in _TYPES]
        imports = [_name("Math") + _name(name) + b"\x00" + unsigned(1 + count) for name, count in MATH.items()]
        exports = [_name(name) + b"\x00" + unsigned(number) for name, number in self.exported.items()]
        sections = {
            1: _list(types),
            2: _list(imports),
            3: _list([unsigned(int(c.counted)) for c in self.functions]),
            5: _list([b"\x00" + unsigned(pages)]),
            7: _list([*exports, _name("memory") + b"\x02\x00"]),
            10: _list([c.binary() for c in self.functions]),
            11: _list([b"\x00" + _pushed(at) + _END + unsigned(len(b)) + b for at, b in self.data]),
        }
        return b"\0asm\1\0\0\0" + b"".join(bytes([i]) + unsigned(len(s)) + s for i, s in sections.items())


def _list(items: list[bytes]) -> bytes:
    return unsigned(len(items)) + b"".join(items)


def _name(text: str) -> bytes:
    return unsigned(len(text)) + text.encode("ascii")
