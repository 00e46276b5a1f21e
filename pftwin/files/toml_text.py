"""Writes TOML from templates, with formatters for numbers and strings."""

from __future__ import annotations

import json
from typing import Any

import numpy as np


def render_toml(package: str, template: str, **values: Any) -> str:
    """Renders a template in a package's folder, with the functions below as filters number, list, numbers and text."""
    from jinja2 import Environment, PackageLoader

    environment = Environment(loader=PackageLoader(package, ""), keep_trailing_newline=True, autoescape=False)
    environment.filters |= {"number": toml_number, "list": toml_list, "numbers": toml_array, "text": toml_string}
    return environment.get_template(template).render(**values)


def toml_number(value: Any, scale: float = 1.0) -> str:
    """Formats a number, times a scale, with twelve digits."""
    return f"{scale * float(value):.12g}"


def toml_list(values: Any, scale: float = 1.0) -> str:
    """Formats a list of numbers, times a scale, with twelve digits."""
    return "[" + ", ".join(toml_number(v, scale) for v in values) + "]"


def toml_array(values: Any) -> str:
    """Formats a number or nested lists of numbers with twelve digits."""
    return toml_number(values) if np.ndim(values) == 0 else "[" + ", ".join(toml_array(v) for v in values) + "]"


def toml_string(words: str) -> str:
    """Formats a string with escapes, since the words may come from an untrusted file."""
    return json.dumps("".join(c if c.isprintable() else " " for c in words), ensure_ascii=False)
