"""Linear viscous damping of the patella's motion relative to a segment."""

from __future__ import annotations

from typing import Any

import equinox as eqx

from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar
from pftwin.model.effects.base import Drag, Effect, Instant, Load
from pftwin.model.motion import SegmentMotion


class LinearDamping(Effect):
    """F = -c_t v, M = -c_r w, with v and w the patella's velocity and angular velocity relative to `body`."""

    translational: Scalar = eqx.field(metadata=quantity("N s/m", at_least=0))  # c_t
    rotational: Scalar = eqx.field(metadata=quantity("N m s/rad", at_least=0))  # c_r
    body: str = eqx.field(static=True, default="femur")
    name: str = eqx.field(static=True, kw_only=True, default="damping")

    def load(self, now: Instant, memory: Any) -> tuple[Load, Any]:
        """See `Effect`: the drag."""
        segment, patella = now.segment(self.body), now.patella
        velocity = segment.relative_velocity(patella.velocity, patella.position)
        spin = segment.relative_spin(patella.spin, patella.rotation)
        return Load(drag=Drag(self.translational, self.rotational, velocity, spin)), memory

    def in_still_femur(self, femur: SegmentMotion) -> LinearDamping | None:
        """See `Effect`; None for damping relative to the ground, which moves in the femur's frame."""
        return None if self.body == "ground" else self
