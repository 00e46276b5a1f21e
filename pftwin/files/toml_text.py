"""TOML that a program writes: templates, and how numbers and words stand in them."""

from __future__ import annotations

import json
from typing import Any

import numpy as np


def render_toml(package: str, template: str, **values: Any) -> str:
    """The text of a template in a package's folder, with `number`, `list`, `numbers`, `text` as below for filters."""
    from jinja2 import Environment, PackageLoader

    environment = Environment(loader=PackageLoader(package, ""), keep_trailing_newline=True, autoescape=False)
    environment.filters |= {"number": toml_number, "list": toml_list, "numbers": toml_array, "text": toml_string}
    return environment.get_template(template).render(**values)


def toml_number(value: Any, scale: float = 1.0) -> str:
    """A number, times a scale, to twelve digits."""
    return f"{scale * float(value):.12g}"


def toml_list(values: Any, scale: float = 1.0) -> str:
    """A list of any numbers, likewise."""
    return "[" + ", ".join(toml_number(v, scale) for v in values) + "]"


def toml_array(values: Any) -> str:
    """A number, or a list of numbers or of such lists, likewise."""
    return toml_number(values) if np.ndim(values) == 0 else "[" + ", ".join(toml_array(v) for v in values) + "]"


def toml_string(words: str) -> str:
    """A string; the words may come from a stranger's file."""
    return json.dumps("".join(c if c.isprintable() else " " for c in words), ensure_ascii=False)
