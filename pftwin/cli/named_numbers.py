"""Options such as `--noise position=2e-4`: numbers by name."""

from __future__ import annotations

from collections.abc import Sequence

from pftwin.base.errors import InputError


def numbers_by_name(
    given: Sequence[str] | None, option: str, expected: str, counts: Sequence[int] = (1,)
) -> dict[str, tuple[float, ...]]:
    """Numbers by name, from "name=number" or "name=number:number".

    Args:
        given: what the user wrote, each time that the option is there.
        option: its name, for messages.
        expected: what is, for messages, such as 'such as "position=2e-4"'.
        counts: how many numbers a name may have.

    Raises:
        InputError: anything else; the same name twice.
    """
    found: dict[str, tuple[float, ...]] = {}
    for text in given or []:
        name, _, value = (part.strip() for part in text.rpartition("="))
        numbers = numbers_between_colons(value)
        if not name or len(numbers) not in counts:
            raise InputError(f"found {text!r}", where=option, expected=f"{expected}, each once")
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
