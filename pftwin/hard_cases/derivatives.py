"""Derivatives of runs: finite everywhere, and those of finite differences where the motion is smooth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pftwin.hard_cases.programs import PARAMETERS

Floats = NDArray[np.float64]

CHANGE = 1e-5  # of a parameter, in its unit, to either side
SHARE = 0.02  # of a column's largest entry that a derivative may be off
LEAST = {"float64": 1e-7, "float32": 1e-4}  # [m or quaternion component per unit] below which nothing is said
SHARE_IN_SINGLE = 0.10  # of float32's from float64's finite differences


def changes() -> Floats:
    """(2, 4, 4): the parameters' changes, ahead and back, a row for each parameter."""
    return CHANGE * np.stack([np.eye(len(PARAMETERS)), -np.eye(len(PARAMETERS))])


def differences(ahead: Floats, back: Floats) -> Floats:
    """Central differences of poses (4, ..., 7), a parameter in each row; the parameters' axis becomes the last."""
    return np.moveaxis((ahead - back) / (2 * CHANGE), 0, -1)


def not_finite(slopes: Floats, until: NDArray[np.bool_]) -> str | None:
    """Whether a derivative (n, 7, 4) is not finite, among the frames that count."""
    bad = ~np.isfinite(slopes).all(axis=1) & until[:, None]
    if not bad.any():
        return None
    frame, column = (int(a[0]) for a in np.nonzero(bad))
    return f"derivative by {PARAMETERS[column]} not finite at frame {frame}"


def disagree(slopes: Floats, reference: Floats, dtype: str) -> str | None:
    """Whether derivatives (..., 7, 4) differ from finite differences."""
    share = SHARE if dtype == "float64" else SHARE_IN_SINGLE
    size = np.abs(reference).reshape(-1, len(PARAMETERS)).max(axis=0)
    off = np.abs(slopes - reference).reshape(-1, len(PARAMETERS)).max(axis=0)
    bad = ~(off <= share * size + LEAST[dtype])
    if not bad.any():
        return None
    k = int(np.argmax(np.where(bad, off / np.maximum(size, 1e-30), 0.0)))
    return f"derivative by {PARAMETERS[k]} off by {100 * off[k] / max(size[k], 1e-30):.2g} % of finite differences"
