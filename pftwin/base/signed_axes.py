"""The axes of a frame by name: "+x", "-z"; without a sign it is a plus."""

from __future__ import annotations

Direction = tuple[float, float, float]

AXES: dict[str, Direction] = {
    "+x": (1.0, 0.0, 0.0),
    "-x": (-1.0, 0.0, 0.0),
    "+y": (0.0, 1.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "+z": (0.0, 0.0, 1.0),
    "-z": (0.0, 0.0, -1.0),
}


def axis_named(text: str) -> Direction | None:
    """The unit vector of "x", "+x" or "-X"; None for any other text."""
    name = text.strip().lower()
    return AXES.get(name if name.startswith(("+", "-")) else f"+{name}")
