"""Parsing of user input in options and files: amounts ("16 mm"), named numbers ("position=2e-4") and axes ("-x").

An amount is a number followed by its unit. An axis without a sign is positive."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence

from pftwin.base.errors import InputError

Direction = tuple[float, float, float]

AXES: dict[str, Direction] = {
    "+x": (1.0, 0.0, 0.0),
    "-x": (-1.0, 0.0, 0.0),
    "+y": (0.0, 1.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "+z": (0.0, 0.0, 1.0),
    "-z": (0.0, 0.0, -1.0),
}
UNITS = {  # by SI unit: the accepted units with their sizes in it
    "m": {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "um": 1e-6},
    "rad": {"deg": math.pi / 180, "rad": 1.0},
    "N": {"N": 1.0, "mN": 1e-3},
    "s": {"s": 1.0, "ms": 1e-3},
    "1": {"": 1.0, "%": 0.01},
}
_WRITTEN = re.compile(r"\s*([-+.\deE]+)\s*([^\W\d_]*|%)\s*")
_DECIMAL_COMMA = re.compile(r"\s*([-+]?\d+),(\d+)\s*([^\W\d_]+|%)\s*")
_MOST_VALUES = 1_000_000
_SMALL = str.maketrans("µμ", "uu")  # micro sign, Greek letter


def number_and_unit(text: str) -> tuple[float, str] | None:
    """Splits an amount into number and unit ("" if none); None if it is not a finite number and an optional unit."""
    match = _WRITTEN.fullmatch(text)
    try:
        number = float(match[1]) if match else math.nan
    except ValueError:
        number = math.nan
    return (number, match[2].translate(_SMALL)) if match and math.isfinite(number) else None


def units_beside(unit: str) -> dict[str, float]:
    """Accepted units for an amount in `unit`, with their sizes in it; empty if `unit` is not in `UNITS`."""
    kind = next((sizes for sizes in UNITS.values() if unit in sizes), {})
    return {name: size / kind[unit] for name, size in kind.items() if name}


def amounts_in(parts: list[str], unit: str) -> list[float]:
    """Parses amounts; those without a unit have the last unit that is given.

    Args:
        parts: amounts such as "0", "2 cm", "0.4".
        unit: unit of the result, and of the parts if none has a unit; empty if units are not allowed.

    Returns:
        The numbers; an empty list if a part is not a finite number or has an incompatible unit.
    """
    found = [number_and_unit(part) for part in parts]
    last = next((pair[1] for pair in reversed(found) if pair and pair[1]), "")
    sizes = {"": 1.0, **(units_beside(unit) if unit else {})}
    written = [(number, own or last) for number, own in (pair or (math.nan, "?") for pair in found)]
    return [number * sizes[own] for number, own in written] if all(own in sizes for _, own in written) else []


def listed(text: str, unit: str, where: str) -> list[float]:
    """Parses comma-separated amounts such as "0,5,10 mm"; see `amounts_in`.

    Raises:
        InputError: the text is like "1,5 cm", which may be one number with a decimal comma.
    """
    if found := _DECIMAL_COMMA.fullmatch(text):
        whole, rest, own = found.groups()
        expected = f"a decimal point, {whole}.{rest} {own}, or two amounts with a unit each, {whole} {own},{rest} {own}"
        raise InputError(f"found {text!r}", where=where, expected=expected)
    return amounts_in(text.split(","), unit)


def amount(text: str, unit: str, where: str, *, least: float = -math.inf, most: float = math.inf) -> float:
    """Parses one amount such as "16 mm", or "16" for a number in `unit`.

    Args:
        text: the amount.
        unit: unit of the result.
        where: the option or field, for messages.
        least, most: bounds of the result, in `unit`.

    Raises:
        InputError: the text is not an amount in a compatible unit, or it is out of bounds.
    """
    found = amounts_in([text], unit)
    if not found or not least <= found[0] <= most:
        low = f"at least {least:g}" if least > -math.inf else ""
        high = f"at most {most:g}" if most < math.inf else ""
        bounds = " and ".join(part for part in (low, high) if part)
        expected = f"a number{units_in_words(unit)}"
        raise InputError(f"found {text!r}", where=where, expected=f"{expected}; {bounds}" if bounds else expected)
    return found[0]


def several_amounts(text: str, where: str, unit: str = "") -> list[float]:
    """Parses "0:20:1" (end included), "0,5,10" or "7"; with a unit also "0:2:0.5 cm", "0 mm:2 cm:5 mm".

    Raises InputError, which names the option or field, for other texts, and for units if `unit` is empty.
    """
    parts = amounts_in(text.split(":"), unit) if ":" in text else listed(text, unit, where)
    if not parts or (":" in text and len(parts) not in (2, 3)):
        expected = f"FROM:TO:STEP, or values such as 0,5,10{units_in_words(unit)}"
        raise InputError(f"found {text!r}", where=where, expected=expected)
    if ":" not in text:
        return parts
    first, last = parts[:2]
    step = parts[2] if len(parts) == 3 else 1.0  # in `unit`
    if step == 0 or (last - first) * step < 0:
        raise InputError(f"found {text!r}", where=where, expected="a step that leads from the first to the last value")
    span = (last - first) / step
    if not span < _MOST_VALUES:
        raise InputError(f"{span:.3g} values", where=where, expected=f"at most {_MOST_VALUES}")
    return [first + i * step for i in range(math.floor(span + 1e-9) + 1)]


def units_in_words(unit: str) -> str:
    """Accepted units of an amount in `unit`, as the end of an error message."""
    others = units_beside(unit)
    more = f" or with a unit: {', '.join(others)}" if others else ""
    return f", in {unit}{more}" if unit else ""


def numbers_by_name(
    given: Sequence[str] | None,
    option: str,
    expected: str,
    counts: Sequence[int] = (1,),
    unit: Callable[[str], str] = lambda name: "",
) -> dict[str, tuple[float, ...]]:
    """Parses "name=number" or "name=number:number", with units if the name has one: "name=0.2 mm".

    Args:
        given: values of the option, one for each time it is given.
        option: its name, for messages.
        expected: description of valid values for messages, e.g. 'such as "position=2e-4"'.
        counts: allowed numbers of values per name.
        unit: returns the unit of a name's numbers; empty if they have none.

    Raises:
        InputError: a value has another form, or a name occurs twice.
    """
    found: dict[str, tuple[float, ...]] = {}
    for text in given or []:
        name, _, value = (part.strip() for part in text.rpartition("="))
        own = unit(name) if name else ""
        numbers = numbers_between_colons(value) or tuple(amounts_in(value.split(":"), own))
        if not name or len(numbers) not in counts:
            raise InputError(f"found {text!r}", where=option, expected=f"{expected}, each once{units_in_words(own)}")
        if name in found:
            raise InputError(f"{name!r} is given twice", where=option, expected=f"{expected}, each once")
        found[name] = numbers
    return found


def numbers_between_colons(text: str) -> tuple[float, ...]:
    """Parses "0:20"; empty if a part is not a number."""
    try:
        return tuple(float(part) for part in text.split(":"))
    except ValueError:
        return ()


def axis_named(text: str) -> Direction | None:
    """Unit vector of "x", "+x" or "-X"; None for any other text."""
    name = text.strip().lower()
    return AXES.get(name if name.startswith(("+", "-")) else f"+{name}")
