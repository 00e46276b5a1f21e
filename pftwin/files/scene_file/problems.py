"""Formats validation errors: one message that lists all problems with file, line and field."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, TypeVar

from pydantic import ValidationError

from pftwin.base.errors import InputError
from pftwin.files.scene_file.document import MISSING, Document
from pftwin.files.scene_file.section import Section, ValidationRecords

Table = TypeVar("Table", bound=Section)
Found = tuple[str, str | None, str | None]  # problem, expected, remedy


def validated(document: Document, model: type[Table]) -> tuple[Table, Document]:
    """Validates a file; returns its model, and the document with the values that validation has put into lists.

    Raises one InputError that lists all problems.
    """
    reading = ValidationRecords()
    try:
        table = model.model_validate(document.data, context=reading)
    except ValidationError as error:
        raise _scene_error(error, replace(document, wrapped=tuple(reading.wrapped)), reading) from None
    return table, replace(document, wrapped=tuple(reading.wrapped))


def _scene_error(error: ValidationError, document: Document, reading: ValidationRecords) -> InputError:
    found: list[InputError] = []
    located = [(detail, *document.locate(detail["loc"])) for detail in error.errors()]
    misspelt = {
        (id(parent), close)
        for detail, place, parent, _ in located
        if detail["type"] == "extra_forbidden"
        for close in _nearest(str(place[-1]), reading.models.get(id(parent)))
    }
    for detail, place, parent, value in located:
        if detail["type"] == "missing" and (id(parent), place[-1]) in misspelt:
            continue  # one message per mistake
        model = reading.models.get(id(parent))
        problem, expected, remedy = _message(detail, value, place[-1] if place else "", model)
        found.append(InputError(problem, where=document.describe(place), expected=expected, remedy=remedy))
    if len(found) == 1:
        return found[0]
    prefix = f"{document.path}, "
    listed = "\n".join(f"  {str(one).removeprefix(prefix)}" for one in found)
    return InputError(f"{len(found)} problems:\n{listed}", where=document.path)


def _message(detail: Mapping[str, Any], value: Any, name: str | int, model: type[Section] | None) -> Found:
    context = detail.get("ctx", {})
    kind = detail["type"]
    if kind == "scene":
        return context["found"], context["expected"], context["remedy"]
    if kind == "missing":
        return "is missing", _meaning(name, model), None
    if kind == "extra_forbidden":
        return _unknown(str(name), model)
    if kind.startswith("union_tag"):
        key = str(context.get("discriminator", "")).strip("'")
        found = f"{key} is {context['tag']!r}" if "tag" in context else f"{key} is missing"
        return found, _meaning(name, model), None
    words = _EXPECTED.get(kind)
    expected = words(context) if words else detail["msg"].lower()
    meaning = _meaning(name, model)
    return f"found {_shown(value)}", f"{expected} ({meaning})" if meaning else expected, None


def _meaning(name: str | int, model: type[Section] | None) -> str | None:
    """Description of a field, by its name in metres or millimetres."""
    if model is None or not isinstance(name, str):
        return None
    fields = {f.alias or key: f for key, f in model.model_fields.items()}
    known = fields.get(name) or fields.get(name.removesuffix("m"))
    return known.description if known else None


def _unknown(name: str, model: type[Section] | None) -> Found:
    if close := _nearest(name, model):
        return "unknown field", "did you mean " + " or ".join(close) + "?", None
    return "unknown field", "one of " + ", ".join(_known(model)), None


def _known(model: type[Section] | None) -> list[str]:
    return [f.alias or key for key, f in model.model_fields.items()] if model else []


def _nearest(name: str, model: type[Section] | None) -> list[str]:
    """Up to two known fields with similar names."""
    known = _known(model)
    by_lower = {key.lower(): key for key in [*known, *(f"{key}m" for key in known if key.endswith("_m"))]}
    return [by_lower[c] for c in difflib.get_close_matches(name.lower(), list(by_lower), n=2, cutoff=0.6)]


def _shown(value: Any) -> str:
    if value is MISSING:
        return "nothing"
    if isinstance(value, dict):
        return "a table"
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _count(context: Mapping[str, Any]) -> str:
    low, high = context.get("min_length"), context.get("max_length")
    return "at least one value" if low == 1 else f"{low if high is None else high} values"


_EXPECTED: dict[str, Callable[[Mapping[str, Any]], str]] = {
    "greater_than": lambda c: "a positive number" if c["gt"] == 0 else f"a number above {c['gt']:g}",
    "greater_than_equal": lambda c: (
        "zero or a positive number" if c["ge"] == 0 else f"a number of at least {c['ge']:g}"
    ),
    "less_than": lambda c: f"a number below {c['lt']:g}",
    "less_than_equal": lambda c: f"a number of at most {c['le']:g}",
    "finite_number": lambda c: "a finite number",
    "float_type": lambda c: "a number",
    "int_type": lambda c: "a whole number",
    "bool_type": lambda c: "true or false",
    "string_type": lambda c: "text in quotes",
    "string_too_short": lambda c: "some text",
    "string_pattern_mismatch": lambda c: "a name of letters, digits and _, beginning with a letter",
    "list_type": lambda c: "a list in square brackets",
    "dict_type": lambda c: "a table",
    "model_type": lambda c: "a table of fields",
    "too_short": _count,
    "too_long": _count,
    "literal_error": lambda c: f"one of {c['expected']}",
}
