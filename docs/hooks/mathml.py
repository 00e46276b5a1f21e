"""Fenced blocks of ```math become MathML, which browsers set by themselves: no script, no font is fetched."""

from __future__ import annotations

from typing import Any

from latex2mathml.converter import convert


def on_config(config: Any) -> Any:
    """Tells the extension for fences about the language "math"."""
    settings = config.mdx_configs.setdefault("pymdownx.superfences", {})
    settings.setdefault("custom_fences", []).append({"name": "math", "class": "math", "format": _display})
    return config


def _display(source: str, *_: Any, **__: Any) -> str:
    return f'<div class="equation">{convert(source.strip(), display="block")}</div>'
