"""Linear viscous damping of the patella's motion relative to a segment."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp

from pftwin.effects.base import Effect, Ground, Instant, Load, StiffTerm
from pftwin.spatial import Scalar, Vec3


class LinearDamping(Effect):
    """F = -c_t v, M = -c_r w, with v and w the patella's velocity and angular velocity relative to `body`."""

    translational: Scalar  # c_t [N s/m]
    rotational: Scalar  # c_r [N m s/rad]
    body: str = eqx.field(static=True, default="femur")
    name: str = eqx.field(static=True, kw_only=True, default="damping")

    def load(self, now: Instant, memory: Any) -> tuple[Load, Any]:
        """Three damped directions of translation and three of rotation, as two groups."""
        segment, patella = now.segment(self.body), now.patella
        velocity = segment.relative_velocity(patella.velocity, patella.position)
        spin = patella.spin
        if not isinstance(segment, Ground):
            spin = spin - patella.rotation.unapply(segment.angular_velocity)
        return Load(stiff=(_damper(velocity, self.translational, 0), _damper(spin, self.rotational, 1))), memory


def _damper(velocity: Vec3, coefficient: Scalar, which: int) -> StiffTerm:
    """A damper per axis, along force directions (which = 0) or moments (1)."""
    along = velocity.array()
    unit = Vec3.from_array(jnp.eye(3, dtype=along.dtype))
    none = Vec3.from_array(jnp.zeros((3, 3), dtype=along.dtype))
    c = jnp.broadcast_to(jnp.asarray(coefficient, dtype=along.dtype), (3,))
    zero = jnp.zeros_like(c)
    direction, moment = (unit, none) if which == 0 else (none, unit)
    return StiffTerm(direction, moment, -c * along, zero, zero, c, -along)
