"""Checks that derivatives of runs are finite, and equal to finite differences if the motion is smooth.

A chaotic motion, such as a button of few triangles that rolls from corner to corner, amplifies a change of 10 nm at
its start to micrometres within a tenth of a second, and finite differences then fail. If a quarter of the change of
the parameters alters the differences, that frame and all later ones are not compared.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pftwin.base.arrays import Floats
from pftwin.studies.hard_cases.programs import PARAMETERS

CHANGE = 1e-5  # step of a parameter, in its unit, for central differences
FINER = 0.25  # share of that step to use if differences and derivatives disagree
SHARE = 0.02  # tolerance of a derivative, relative to its column's largest entry
LEAST = {"float64": 1e-7, "float32": 1e-4}  # absolute tolerance [m or quaternion component per unit]
PARTED = 2e-5  # [m or quaternion component] between float32 and float64 paths: thousands of rounding errors
SHARE_IN_SINGLE = 0.10  # tolerance of float32 derivatives against float64 differences


class Reference(NamedTuple):
    """The reference for derivatives of a run in either float type."""

    differences: Floats  # (n, 7, 4) finite differences in float64
    path: Floats  # (n, 7) poses of that run in float64


def differences(forward: Callable[[Floats], Any], share: float = 1.0) -> Floats:
    """Returns central differences (..., 7, 4) of poses (..., 7) by the parameters (4,), with step `share * CHANGE`."""
    change = share * CHANGE * np.eye(len(PARAMETERS))
    ahead, back = (np.stack([forward(p) for p in side]) for side in (change, -change))
    return np.moveaxis((ahead - back) / (2 * share * CHANGE), 0, -1)


def agreeing_differences(coarse: Floats, fine: Floats) -> Floats:
    """Returns finite differences (n, 7, 4) that agree for two steps; NaN from the first frame where they differ."""
    size = np.maximum.accumulate(np.abs(fine).max(axis=1), axis=0)
    off = np.abs(fine - coarse).max(axis=1)
    unconverged = np.logical_or.accumulate(~(off <= 0.5 * SHARE * size + LEAST["float64"]), axis=0)
    return np.where(unconverged[:, None, :], np.nan, fine)


def known_on(reference: Reference, path: Floats) -> Floats:
    """Returns the finite differences (n, 7, 4) for a float32 path (n, 7); NaN after it leaves the float64 path.

    From there on, rounding errors have grown a thousandfold, and the derivatives belong to another path.
    """
    parted = np.logical_or.accumulate(~(np.abs(path - reference.path).max(axis=1) <= PARTED))
    return np.where(parted[:, None, None], np.nan, reference.differences)


def not_finite(slopes: Floats, until: NDArray[np.bool_]) -> str | None:
    """Describes the first derivative (n, 7, 4) that is not finite in the frames `until` (n,); None if all are."""
    bad = ~np.isfinite(slopes).all(axis=1) & until[:, None]
    if not bad.any():
        return None
    frame, column = (int(a[0]) for a in np.nonzero(bad))
    return f"derivative by {PARAMETERS[column]} not finite at frame {frame + 1}"


def disagree(slopes: Floats, reference: Floats, dtype: str) -> str | None:
    """Describes the largest disagreement of derivatives (..., 7, 4) with finite differences, ignoring NaN, or None."""
    share = SHARE if dtype == "float64" else SHARE_IN_SINGLE
    rows = reference.reshape(-1, len(PARAMETERS))
    known = np.isfinite(rows)
    if not known.any(axis=0).all():
        return "finite differences settle in no frame"
    size = np.where(known, np.abs(rows), 0.0).max(axis=0)
    off = np.where(known, np.abs(slopes.reshape(rows.shape) - rows), 0.0).max(axis=0)
    bad = ~(off <= share * size + LEAST[dtype])
    if not bad.any():
        return None
    k = int(np.argmax(np.where(bad, off / np.maximum(size, 1e-30), 0.0)))
    return f"derivative by {PARAMETERS[k]} off by {100 * off[k] / max(size[k], 1e-30):.2g} % of finite differences"
