"""A marker on the patella, whose position is reported and which exerts no force."""

from __future__ import annotations

from typing import Any, ClassVar, Self

import equinox as eqx

from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar, Vec3
from pftwin.model.effects.base import Effect, Instant, Load, Observable


class Marker(Effect):
    """A marker fixed to the patella. It reports its position in the femur frame: x proximal, y lateral, z anterior.

    It allows comparison with single measured markers, where too few are visible to determine a pose.
    """

    point: Vec3 = eqx.field(metadata=quantity("m", frame="patella"))
    observables: ClassVar[dict[str, Observable]] = {
        axis: Observable("m", f"{axis} in the femur frame, {sense}")
        for axis, sense in {"x": "proximal", "y": "lateral", "z": "anterior"}.items()
    }

    def load(self, now: Instant, memory: Any) -> tuple[Load, Any]:
        """See `Effect`: no load."""
        return Load(), memory

    def observe(self, now: Instant, memory: Any) -> dict[str, Scalar]:
        """See `Effect`: position in the femur frame [m]."""
        there = now.femur.to_local(now.patella.position + now.patella.arm(self.point))
        return {"x": there.x, "y": there.y, "z": there.z}

    def recentred(self, center_of_mass: Vec3) -> Self:
        """See `Effect`."""
        return eqx.tree_at(lambda e: e.point, self, self.point - center_of_mass)
