"""Valid files made invalid: bytes flipped, parts cut, doubled or moved, numbers and fields replaced."""

from __future__ import annotations

import json
import random
import re
from typing import Any

NUMBER = re.compile(rb"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
NUMBERS = (
    b"nan", b"inf", b"-inf", b"1e308", b"-1e308", b"1e999", b"0", b"-1", b"1e-320", b"4294967295",
    b"9223372036854775808",
    b"1_0", b"0x10", b"", b"text", b"1,5", b"9" * 5000, b"-0.0", b"true", b"[]", b'"text"', b"1e18", b"0.5",
)  # fmt: skip
INTEGERS = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF)
VALUES: tuple[Any, ...] = (
    None, True, -1, 0, 1e308, float("nan"), float("inf"), 10**30, "", "text", "\x00", "x" * 5000, [], {}, [[]], [None],
    [float("nan")], {"array": [1], "shape": [2], "dtype": "f8"}, {"array": [], "shape": [10**12], "dtype": "f8"},
    {"array": ["a"], "shape": [1], "dtype": "O"},
)  # fmt: skip


def mutated(content: bytes, source: random.Random) -> bytes:
    """One to four changes."""
    for _ in range(source.choice((1, 1, 1, 2, 4))):
        content = source.choice(_CHANGES)(content, source)
    return content


def _place(content: bytes, source: random.Random) -> tuple[int, int]:
    """The begin and the end of a part; headers are met as often as all the rest."""
    most = len(content) if source.random() < 0.5 else min(len(content), 1024)
    begin = source.randrange(most + 1)
    return begin, min(len(content), begin + int(10 ** source.uniform(0, 4)))


def _flipped(content: bytes, source: random.Random) -> bytes:
    changed = bytearray(content)
    for _ in range(source.choice((1, 2, 8, 64)) if content else 0):
        changed[min(_place(content, source)[0], len(content) - 1)] = source.choice((source.randrange(256), 0, 255))
    return bytes(changed)


def _truncated(content: bytes, source: random.Random) -> bytes:
    return content[: source.randrange(len(content) + 1)]


def _cut(content: bytes, source: random.Random) -> bytes:
    begin, end = _place(content, source)
    return content[:begin] + content[end:]


def _doubled(content: bytes, source: random.Random) -> bytes:
    begin, end = _place(content, source)
    return content[:begin] + content[begin:end] * source.choice((2, 2, 3, 50)) + content[end:]


def _moved(content: bytes, source: random.Random) -> bytes:
    begin, end = _place(content, source)
    rest = content[:begin] + content[end:]
    to = source.randrange(len(rest) + 1)
    return rest[:to] + content[begin:end] + rest[to:]


def _number(content: bytes, source: random.Random) -> bytes:
    """A number as text, replaced."""
    found = list(NUMBER.finditer(content, _place(content, source)[0]))[:50]
    if not found:
        return content
    match = source.choice(found)
    return content[: match.start()] + source.choice(NUMBERS) + content[match.end() :]


def _integer(content: bytes, source: random.Random) -> bytes:
    """Bytes that may be a count or an offset of a binary header, replaced."""
    at, size = _place(content, source)[0], source.choice((1, 2, 4, 8))
    number = source.choice(INTEGERS) % 256**size
    return content[:at] + number.to_bytes(size, source.choice(("little", "big"))) + content[at + size :]


def _line(content: bytes, source: random.Random) -> bytes:
    """A line left out, emptied, doubled or put elsewhere."""
    lines = content.split(b"\n")
    at = source.randrange(min(len(lines), 60) if source.random() < 0.7 else len(lines))
    line = lines.pop(at)
    for put in source.choice(((), (b"",), (line, line), (line[: len(line) // 2],), (line + b"\t1",))):
        lines.insert(at, put)
    return b"\n".join(lines)


def _word(content: bytes, source: random.Random) -> bytes:
    """A word replaced by another one of the file."""
    words = list(re.finditer(rb"[A-Za-z_]\w*", content[:20000]))
    if not words:
        return content
    one, other = source.choice(words), source.choice(words)
    return content[: one.start()] + source.choice((other[0], b"", b"\xff\xfe", b"../x", b"\x00")) + content[one.end() :]


def _field(content: bytes, source: random.Random) -> bytes:
    """A field of a JSON file left out, or of another type."""
    try:
        data = json.loads(content)
    except (ValueError, RecursionError):
        return content
    places = list(_fields(data))
    if not places:
        return content
    holder, key = source.choice(places)
    if source.random() < 0.3:
        del holder[key]
    else:
        holder[key] = source.choice(VALUES)
    return json.dumps(data).encode()


def _fields(data: Any) -> Any:
    keys = list(data) if isinstance(data, dict) else range(min(len(data), 20)) if isinstance(data, list) else ()
    for key in keys:
        yield data, key
        yield from _fields(data[key])


_CHANGES = (
    _flipped, _truncated, _cut, _doubled, _moved, _number, _number, _integer, _line, _word, _field, _field,
)  # fmt: skip
