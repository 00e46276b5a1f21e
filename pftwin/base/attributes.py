"""Attributes of a variable in a dataset, by the names of the CF conventions."""

from __future__ import annotations


def about(unit: str, long_name: str) -> dict[str, str]:
    """Its unit, "1" for a pure number, and what it is in words."""
    return {"units": unit, "long_name": long_name}
