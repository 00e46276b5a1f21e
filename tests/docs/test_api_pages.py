"""Every public name of pftwin and of fitting has its place in the reference."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import fitting
import pftwin

PAGES = Path(__file__).resolve().parents[2] / "docs" / "api"


def documented() -> set[str]:
    texts = (page.read_text(encoding="utf-8") for page in PAGES.glob("*.md"))
    return {name for text in texts for name in re.findall(r"^::: ([\w.]+)$", text, re.MULTILINE)}


def where(value: Any) -> str:
    """The module that a public object is defined in, and its name."""
    return f"{value.__module__}.{value.__qualname__}"


@pytest.mark.parametrize("package", [pftwin, fitting])
def test_public_names_are_documented(package: ModuleType) -> None:
    named = documented()
    for name in package.__all__:
        value = getattr(package, name)
        if name == "__version__":
            continue
        if isinstance(value, ModuleType):
            assert any(place == value.__name__ or place.startswith(f"{value.__name__}.") for place in named), name
        else:
            assert {where(value), value.__module__} & named, name


def test_what_the_pages_name_is_there() -> None:
    for place in sorted(documented()):
        module, _, name = place.rpartition(".")
        found = getattr(import_module(module), name, None) or import_module(place)
        assert found.__doc__, place
