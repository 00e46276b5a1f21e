"""Slopes of a taut line's length by differences, for tests of every obstacle."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

STEP = 1e-7  # [m]


def slopes(length: Callable[[Any, Any], np.ndarray], start: Any, end: Any) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """For the start, then the end: lengths (6,) after moves along the axes and back, and the negative slopes (3,).

    A length shortens as an end goes along the line, whatever the line touches: the slopes are the direction there.
    """
    moves = STEP * np.concatenate([np.eye(3), -np.eye(3)])
    for which in range(2):
        ends = [np.broadcast_to(p, (6, 3)) + (moves if k == which else 0) for k, p in enumerate((start, end))]
        lengths = length(*ends)
        yield lengths, (lengths[3:] - lengths[:3]) / (2 * STEP)
