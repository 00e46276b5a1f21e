"""Kinds of values in plain words, from the annotations of a scene file's models."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BeforeValidator
from pydantic.fields import FieldInfo

from pftwin.files.scene_file import section, side
from pftwin.files.scene_file.section import Section

_PLAIN: dict[Any, str] = {float: "number", int: "whole number", str: "text", bool: "true or false"}
_CHECKED = {  # validators that narrow a value further
    section._unit_quaternion: "unit quaternion",
    section._polynomial: '"P1" to "P12"',
    section._direction: "direction, 3 numbers",
    side._three_axes: 'axes, as in `["+y", "+z", "+x"]`',
}
_WRAPS = (section.one_number_or_many, section._point_or_points)  # which take one value in place of a list
Link = Callable[[type[Section]], str]


def sections_of(annotation: Any) -> Iterator[type[Section]]:
    """The tables that an annotation names, however deep."""
    if isinstance(annotation, type) and issubclass(annotation, Section):
        yield annotation
    for inner in get_args(annotation):
        yield from sections_of(inner)


def spelled(annotation: Any, metadata: Iterable[Any], link: Link) -> str:
    """Words for what a field takes; tables become links."""
    constraints = list(_flat(metadata))
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return spelled(inner[0], [*inner[1:], *constraints], link)
    for constraint in constraints:
        if words := _CHECKED.get(getattr(constraint, "func", None)):
            return words
    if origin in (Union, UnionType):
        return " or ".join(spelled(a, constraints, link) for a in inner if a is not type(None))
    if origin is Literal:
        return " or ".join(f'`"{a}"`' if isinstance(a, str) else f"`{a}`" for a in inner)
    if origin is list:
        return _list(inner[0], constraints, link)
    if origin is dict:
        return f"table: a name, and {spelled(inner[1], (), link)} for each"
    if isinstance(annotation, type) and issubclass(annotation, Section):
        return f"table {link(annotation)}"
    words = _PLAIN[annotation]
    return words + "".join(_bound(c) for c in constraints)


def _list(item: Any, constraints: list[Any], link: Link) -> str:
    low = next((c.min_length for c in constraints if hasattr(c, "min_length")), None)
    high = next((c.max_length for c in constraints if hasattr(c, "max_length")), None)
    one = spelled(item, (), link)
    if any(isinstance(c, BeforeValidator) and c.func in _WRAPS for c in constraints):
        return f"{one}, or a list"
    many = re.sub(r"^(number|text)\b", r"\1s", one)
    return f"{low} {many}" if low is not None and low == high else f"list of {many}"


def _bound(constraint: Any) -> str:
    signs = (("gt", "above"), ("ge", "at least"), ("lt", "below"), ("le", "at most"))
    return "".join(f", {sign} {getattr(constraint, key):g}" for key, sign in signs if hasattr(constraint, key))


def _flat(metadata: Iterable[Any]) -> Iterator[Any]:
    for one in metadata:
        if isinstance(one, FieldInfo):
            yield from one.metadata
        else:
            yield one
