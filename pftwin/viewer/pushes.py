"""Contact points and forces of a result, as points and vectors in the femur's frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from pftwin.viewer.recorded import Recorded

FACETS = ("medial", "lateral")
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Push:
    """One contact at the frames shown (n); NaN where it bears nothing."""

    contact: str  # the effect
    name: str  # "contact, medial"
    points: Floats  # (n, 3) where it acts [m]
    forces: Floats  # (n, 3) on the patella [N]

    @property
    def present(self) -> NDArray[np.bool_]:
        """Frames in which it bears a load (n,)."""
        return np.isfinite(self.points).all(axis=1) & (np.linalg.norm(self.forces, axis=1) > 0)


def pushes(result: Recorded) -> list[Push]:
    """The contacts of a result.

    A sphere is pushed towards its centre, so the (normal) force on each facet has a direction. Of other contacts the
    file holds the facets' sizes alone: they are drawn as one force, where facets share in it by their size.
    """
    contacts = [str(n).removesuffix("_force_medial") for n in result.data.data_vars if str(n).endswith("_force_medial")]
    return [push for name in contacts for push in _of(result, name)]


def _of(result: Recorded, contact: str) -> list[Push]:
    words = contact.replace("_", " ")
    points = [result.series(f"{contact}_point_{facet}") for facet in FACETS]
    sizes = [result.series(f"{contact}_force_{facet}") for facet in FACETS]
    center = result.series("sphere_center")
    if "button_radius" in result.geometry and center is not None and all(p is not None for p in points):
        found = []
        for facet, point, size in zip(FACETS, points, sizes, strict=True):
            assert point is not None
            assert size is not None
            away = center - point
            direction = away / np.linalg.norm(away, axis=1, keepdims=True)
            found.append(Push(contact, f"{words}, {facet}", point, size[:, None] * direction))
        return found
    total = [result.series(f"{contact}_force_{axis}") for axis in "xyz"]
    if any(t is None for t in total):
        return []
    force = np.stack([t for t in total if t is not None], axis=1)
    pressed = result.series(f"{contact}_center_of_pressure")
    if pressed is None:
        if any(p is None for p in points):
            return []
        shares = np.stack([s for s in sizes if s is not None], axis=1)
        places = np.stack([p for p in points if p is not None], axis=1)
        some = shares.sum(axis=1, keepdims=True) > 0
        weights = np.divide(shares, shares.sum(axis=1, keepdims=True), out=np.full_like(shares, np.nan), where=some)
        pressed = np.where(weights[..., None] > 0, weights[..., None] * places, 0.0).sum(axis=1)
        pressed[~some[:, 0]] = np.nan
    return [Push(contact, words, pressed, force)]
