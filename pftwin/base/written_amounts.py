"""What people write in options and files: amounts ("16 mm", "0.5 N"), numbers by name ("position=2e-4"), axes ("-x").

An amount is a number and, behind it, its unit. An axis without a sign has a plus."""

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
UNITS = {  # by SI unit: the units that an amount may have, with their sizes
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
    """The two parts, the unit empty where there is none; None if the text is no finite number with a word behind it."""
    match = _WRITTEN.fullmatch(text)
    try:
        number = float(match[1]) if match else math.nan
    except ValueError:
        number = math.nan
    return (number, match[2].translate(_SMALL)) if match and math.isfinite(number) else None


def units_beside(unit: str) -> dict[str, float]:
    """Units that an amount in this one may be written in, with their sizes in it; none for a unit not in `UNITS`."""
    kind = next((sizes for sizes in UNITS.values() if unit in sizes), {})
    return {name: size / kind[unit] for name, size in kind.items() if name}


def amounts_in(parts: list[str], unit: str) -> list[float]:
    """Numbers in a unit, of which each may have one of its own; the last unit written counts for those without.

    Args:
        parts: such as "0", "2 cm", "0.4".
        unit: of the answer, and of parts where none has a unit; empty where none may have one.

    Returns:
        An empty list if a part is no finite number or has a unit of another kind.
    """
    found = [number_and_unit(part) for part in parts]
    last = next((pair[1] for pair in reversed(found) if pair and pair[1]), "")
    sizes = {"": 1.0, **(units_beside(unit) if unit else {})}
    written = [(number, own or last) for number, own in (pair or (math.nan, "?") for pair in found)]
    return [number * sizes[own] for number, own in written] if all(own in sizes for _, own in written) else []


def listed(text: str, unit: str, where: str) -> list[float]:
    """Numbers in a unit, from "0,5,10 mm"; an empty list as in `amounts_in`.

    Raises:
        InputError: "1,5 cm", which may be meant as one number.
    """
    if found := _DECIMAL_COMMA.fullmatch(text):
        whole, rest, own = found.groups()
        expected = f"a decimal point, {whole}.{rest} {own}, or two amounts with a unit each, {whole} {own},{rest} {own}"
        raise InputError(f"found {text!r}", where=where, expected=expected)
    return amounts_in(text.split(","), unit)


def amount(text: str, unit: str, where: str, *, least: float = -math.inf, most: float = math.inf) -> float:
    """One number in a unit, from "16 mm", or "16" in that unit.

    Args:
        text: as written.
        unit: of the answer.
        where: the option or field, for messages.
        least, most: what it may be, in that unit.

    Raises:
        InputError: anything else.
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
    """Numbers by name, from "name=number" or "name=number:number", with units where the name has one: "name=0.2 mm".

    Args:
        given: what the user wrote, each time that the option is there.
        option: its name, for messages.
        expected: what is, for messages, such as 'such as "position=2e-4"'.
        counts: how many numbers a name may have.
        unit: of a name's numbers; empty for one whose numbers may have none.

    Raises:
        InputError: anything else; the same name twice.
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
    """Numbers from "0:20"; none, if one of them is no number."""
    try:
        return tuple(float(part) for part in text.split(":"))
    except ValueError:
        return ()


def axis_named(text: str) -> Direction | None:
    """The unit vector of "x", "+x" or "-X"; None for any other text."""
    name = text.strip().lower()
    return AXES.get(name if name.startswith(("+", "-")) else f"+{name}")
