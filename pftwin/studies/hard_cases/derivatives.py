"""Checks derivatives of runs: finite everywhere, and equal to finite differences where the motion is smooth.

A motion that diverges from its neighbours, as a button of few triangles that rolls from corner to corner, amplifies a
change of 10 nm at its start to micrometres within a tenth of a second: finite differences then fail. Where
quartering the parameters' changes alters the differences, that frame and all later ones are not compared.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pftwin.base.arrays import Floats
from pftwin.studies.hard_cases.programs import PARAMETERS

CHANGE = 1e-5  # of a parameter, in its unit, to either side
FINER = 0.25  # share of it that is tried where differences and derivatives disagree
SHARE = 0.02  # tolerance of a derivative, as a share of its column's largest entry
LEAST = {"float64": 1e-7, "float32": 1e-4}  # [m or quaternion component per unit] smaller differences are not judged
PARTED = 2e-5  # [m or quaternion component] between paths in float32 and float64: thousands of roundings
SHARE_IN_SINGLE = 0.10  # tolerance of float32 derivatives against float64 differences


class Reference(NamedTuple):
    """What derivatives of a run are compared with, in whichever float type they are."""

    differences: Floats  # (n, 7, 4) finite differences of float64
    path: Floats  # (n, 7) poses of float64 that they belong to


def differences(forward: Callable[[Floats], Any], share: float = 1.0) -> Floats:
    """Central differences (..., 7, 4) of poses (..., 7) by changes of the parameters (4,), or by a share of them."""
    change = share * CHANGE * np.eye(len(PARAMETERS))
    ahead, back = (np.stack([forward(p) for p in side]) for side in (change, -change))
    return np.moveaxis((ahead - back) / (2 * share * CHANGE), 0, -1)


def agreeing_differences(coarse: Floats, fine: Floats) -> Floats:
    """Finite differences (n, 7, 4) that agree for two sizes of change: NaN from the first frame where they differ."""
    size = np.maximum.accumulate(np.abs(fine).max(axis=1), axis=0)
    off = np.abs(fine - coarse).max(axis=1)
    unsettled = np.logical_or.accumulate(~(off <= 0.5 * SHARE * size + LEAST["float64"]), axis=0)
    return np.where(unsettled[:, None, :], np.nan, fine)


def known_on(reference: Reference, path: Floats) -> Floats:
    """Finite differences (n, 7, 4) for derivatives on a path (n, 7) of float32: NaN once it has left that of float64.

    From there on rounding has been multiplied a thousandfold, and derivatives are those of another path.
    """
    parted = np.logical_or.accumulate(~(np.abs(path - reference.path).max(axis=1) <= PARTED))
    return np.where(parted[:, None, None], np.nan, reference.differences)


def not_finite(slopes: Floats, until: NDArray[np.bool_]) -> str | None:
    """Whether a derivative (n, 7, 4) is not finite in a frame that counts."""
    bad = ~np.isfinite(slopes).all(axis=1) & until[:, None]
    if not bad.any():
        return None
    frame, column = (int(a[0]) for a in np.nonzero(bad))
    return f"derivative by {PARAMETERS[column]} not finite at frame {frame}"


def disagree(slopes: Floats, reference: Floats, dtype: str) -> str | None:
    """Whether derivatives (..., 7, 4) differ from finite differences where those are not NaN."""
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
