"""What can be measured of a motion, and so be compared or planned: names, and columns in an array of all of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pftwin.model.scene import Scene
from pftwin.model.scene_parameters import numbered_elements

POSITION, ORIENTATION = "position", "orientation"


def channels_of(scene: Scene) -> tuple[str, ...]:
    """Everything that could be measured: poses, and the forces of contact, tendons and ligaments."""
    contact = scene.contact
    tensions = [element.name for element in numbered_elements(scene)]
    return (POSITION, ORIENTATION, *([] if contact is None else [contact.name]), *tensions)


def widths(channels: tuple[str, ...]) -> tuple[int, ...]:
    """Columns of each: position 3, orientation 4 (a unit quaternion), forces 1."""
    return tuple({POSITION: 3, ORIENTATION: 4}.get(c, 1) for c in channels)


def columns_of(channels: tuple[str, ...], among: tuple[str, ...]) -> NDArray[np.intp]:
    """Where the columns of some channels stand, side by side, among those of more."""
    ends = np.cumsum(widths(among))
    columns = {c: np.arange(end - n, end) for c, n, end in zip(among, widths(among), ends, strict=True)}
    return np.concatenate([columns[c] for c in channels])
