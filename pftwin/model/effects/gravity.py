"""The patella's weight."""

from __future__ import annotations

from typing import Any, ClassVar

import equinox as eqx

from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar, Vec3, Wrench
from pftwin.model.effects.base import Effect, Instant, Load, Observable
from pftwin.model.motion import SegmentMotion


class Gravity(Effect):
    """Uniform gravity: F = m g at the centre of mass, with energy -m g . x relative to the world's origin."""

    mass: Scalar = eqx.field(metadata=quantity("kg", positive=True))  # of the patella
    acceleration: Vec3 = eqx.field(metadata=quantity("m/s^2", frame="world"))
    name: str = eqx.field(static=True, kw_only=True, default="gravity")
    is_weight: ClassVar[bool] = True
    observables: ClassVar[dict[str, Observable]] = {"weight": Observable("N", "weight of the patella")}

    def load(self, now: Instant, memory: Any) -> tuple[Load, Any]:
        """See `Effect`: the weight."""
        weight = self.mass * self.acceleration
        return Load(wrench=Wrench(weight, Vec3.zero()), energy=-weight.dot(now.patella.position)), memory

    def observe(self, now: Instant, memory: Any) -> dict[str, Scalar]:
        """See `Effect`: magnitude of the weight [N]."""
        return {"weight": self.mass * self.acceleration.norm()}

    def in_still_femur(self, femur: SegmentMotion) -> TurningGravity:
        """See `Effect`: gravity with its direction over time in the femur's axes."""
        return TurningGravity(self.mass, self.acceleration, femur=femur, name=self.name)


class TurningGravity(Gravity):
    """Gravity in the axes of a moving femur whose frame is treated as inertial: its direction changes over time."""

    femur: SegmentMotion = eqx.field(kw_only=True)  # recorded motion of the femur in the world

    def load(self, now: Instant, memory: Any) -> tuple[Load, Any]:
        """See `Effect`: the weight."""
        there = self.femur.frames(now.time).rotation.unapply(self.acceleration)
        return Load(wrench=Wrench(self.mass * there, Vec3.zero())), memory
