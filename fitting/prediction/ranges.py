"""Amounts as people write them: one, a list, or from ... to ... in steps."""

from __future__ import annotations

import math

from pftwin.base.errors import InputError
from pftwin.base.written_amounts import amounts_in, listed, units_beside

_MOST_VALUES = 1_000_000


def values(text: str, where: str, unit: str = "") -> list[float]:
    """Numbers from "0:20:1" (the end included), "0,5,10" or "7"; with a unit also "0:2:0.5 cm", "0 mm:2 cm:5 mm".

    InputError, which names the option or field, for anything else, and for units where `unit` is empty.
    """
    parts = amounts_in(text.split(":"), unit) if ":" in text else listed(text, unit, where)
    if not parts or (":" in text and len(parts) not in (2, 3)):
        expected = f"FROM:TO:STEP, or values such as 0,5,10{units_in_words(unit)}"
        raise InputError(f"found {text!r}", where=where, expected=expected)
    if ":" not in text:
        return parts
    first, last = parts[:2]
    step = parts[2] if len(parts) == 3 else 1.0  # of that unit
    if step == 0 or (last - first) * step < 0:
        raise InputError(f"found {text!r}", where=where, expected="a step that leads from the first to the last value")
    span = (last - first) / step
    if not span < _MOST_VALUES:
        raise InputError(f"{span:.3g} values", where=where, expected=f"at most {_MOST_VALUES}")
    return [first + i * step for i in range(math.floor(span + 1e-9) + 1)]


def units_in_words(unit: str) -> str:
    """For messages: the units that amounts in this one may have, behind what else is expected."""
    return f", in {unit} or with a unit: {', '.join(units_beside(unit))}" if unit else ""
