"""Contact points and forces of a result, as points and vectors in the femur's frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from pftwin.results.viewer.recorded import Recorded

FACETS = ("medial", "lateral")
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ContactArrow:
    """A contact, or the sum of several, at the frames shown (n)."""

    contact: str  # the effect
    name: str  # "contact, medial"
    points: Floats  # (n, 3) where it acts [m]; NaN where it bears nothing
    forces: Floats | None  # (n, 3) on the patella [N]; None where only the point is known
    touches: bool = True  # whether the points are such where surfaces touch, and not a middle of several

    @property
    def present(self) -> NDArray[np.bool_]:
        """Frames in which it bears a load (n,)."""
        there = np.isfinite(self.points).all(axis=1)
        if self.forces is not None:
            there &= self.forces.any(axis=1)
        return np.asarray(there)


def pushes(result: Recorded) -> list[ContactArrow]:
    """The contacts of a result.

    A sphere is pushed towards its centre, so the (normal) force on each facet has a direction. Of other contacts the
    file holds the facets' sizes alone: their force is the sum, at the points' middle weighted by the sizes.
    """
    contacts = [str(n).removesuffix("_force_medial") for n in result.data.data_vars if str(n).endswith("_force_medial")]
    return [push for name in contacts for push in _of(result, name)]


def _of(result: Recorded, contact: str) -> list[ContactArrow]:
    words = contact.replace("_", " ")
    names = [f"{words}, {facet}" for facet in FACETS]
    points, sizes = ([result.series(f"{contact}_{kind}_{facet}") for facet in FACETS] for kind in ("point", "force"))
    facets = [(p, s) for p, s in zip(points, sizes, strict=True) if p is not None and s is not None]
    center = result.series("sphere_center")
    if len(facets) == len(FACETS) and center is not None and "button_radius" in result.geometry:
        directed = [_towards(center, p, s) for p, s in facets]
        return [ContactArrow(contact, n, p, f) for n, (p, _), f in zip(names, facets, directed, strict=True)]
    components = [result.series(f"{contact}_force_{axis}") for axis in "xyz"]
    total = np.stack([c for c in components if c is not None], axis=-1)
    if total.shape[-1] != 3:
        return []
    pressed = result.series(f"{contact}_center_of_pressure")
    if pressed is not None:
        return [ContactArrow(contact, words, pressed, total)]
    if len(facets) < len(FACETS):
        return []
    borne = [np.where((s > 0)[:, None], p, np.nan) for p, s in facets]
    touching = [ContactArrow(contact, n, p, None) for n, p in zip(names, borne, strict=True)]
    return [*touching, ContactArrow(contact, words, _middle(facets), total, touches=False)]


def _towards(center: Floats, points: Floats, sizes: Floats) -> Floats:
    """Forces (n, 3) of sizes (n,) from points towards the centre (n, 3)."""
    away = center - points
    return (sizes / np.linalg.norm(away, axis=1))[:, None] * away


def _middle(facets: list[tuple[Floats, Floats]]) -> Floats:
    """Of points weighted by sizes (n, 3); NaN where all sizes are zero."""
    weights = np.stack([s for _, s in facets], axis=1)
    whole = weights.sum(axis=1, keepdims=True)
    shares = np.divide(weights, whole, out=np.full_like(weights, np.nan), where=whole > 0)
    places = np.stack([p for p, _ in facets], axis=1)
    return np.where(shares[..., None] == 0, 0.0, shares[..., None] * places).sum(axis=1)
