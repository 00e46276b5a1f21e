"""Amounts as people write them: one, a list, or from ... to ... in steps."""

from __future__ import annotations

import math

from pftwin.base.errors import InputError

_MOST_VALUES = 1_000_000


def values(text: str, where: str) -> list[float]:
    """Numbers from "0:20:1" (the end included), "0,5,10" or "7".

    Args:
        text: as written.
        where: the option or field, for messages.

    Raises:
        InputError: anything else.
    """
    parts = numbers(text.split(":" if ":" in text else ","))
    if not parts or (":" in text and len(parts) not in (2, 3)):
        raise InputError(f"found {text!r}", where=where, expected="FROM:TO:STEP, or values such as 0,5,10")
    if ":" not in text:
        return parts
    first, last = parts[:2]
    step = parts[2] if len(parts) == 3 else 1.0
    if step == 0 or (last - first) * step < 0:
        raise InputError(f"found {text!r}", where=where, expected="a step that leads from the first to the last value")
    span = (last - first) / step
    if not span < _MOST_VALUES:
        raise InputError(f"{span:.3g} values", where=where, expected=f"at most {_MOST_VALUES}")
    return [first + i * step for i in range(math.floor(span + 1e-9) + 1)]


def numbers(parts: list[str]) -> list[float]:
    """An empty list if any is not a finite number."""
    try:
        found = [float(p) for p in parts]
    except ValueError:
        return []
    return found if all(map(math.isfinite, found)) else []
