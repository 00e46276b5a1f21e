"""Jinja templates of the HTML pages, which escape all text, and their filters."""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING, Any

from pftwin.base.sheet import Sheet

if TYPE_CHECKING:
    from jinja2 import Template


_MOST_WHOLE = 1e6  # larger numbers are written with an exponent


@cache
def template(name: str) -> Template:
    """Loads a template of fitting/cli/templates, with the filters `number`, `sentence`, `numeric` and `css_text`."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    found = Environment(
        loader=PackageLoader("fitting.cli"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    found.filters |= {"number": number, "sentence": sentence, "numeric": numeric, "css_text": css_text}
    return found.get_template(name)


def number(value: Any, digits: int = 4) -> str:
    """Formats a number for display, with `digits` significant digits; a dash if it is not finite."""
    x = float(value)
    if not math.isfinite(x):
        return "–"
    whole = 10**digits <= abs(x) < _MOST_WHOLE
    return f"{x:{'.0f' if whole else f'.{digits}g'}}".replace("-", "\N{MINUS SIGN}")


def sentence(words: str) -> str:
    """The words with a capital letter and a full stop."""
    return f"{words[:1].upper()}{words[1:]}."


def numeric(sheet: Sheet) -> list[Any]:
    """For each column, the HTML attribute that right-aligns numbers; empty for text and for the first column."""
    from markupsafe import Markup

    def is_number(text: str) -> bool:
        return not text.strip(" –") or text.strip(" +\N{MINUS SIGN}-")[:1].isdigit()

    right = [i > 0 and all(is_number(row[i]) for row in sheet.rows) for i in range(len(sheet.headings))]
    return [Markup(' class="number"') if r else "" for r in right]


def css_text(words: str) -> Any:
    """A CSS string in which all characters but letters, digits and " .,-" are escaped."""
    from markupsafe import Markup

    return Markup('"' + "".join(c if c.isalnum() or c in " .,-" else f"\\{ord(c):x} " for c in words) + '"')
