"""Symplectic (semi-implicit) Euler: forces at the start of the step, positions with the new velocity; order one.

Explicit: stable while the step is short against every vibration (about 0.3 ms for a contact of 2e8 N/m^1.5). A mass m
on a spring k with a damper c stays bounded while h^2 k + 2 h c < 4 m (Schur and Cohn's conditions on the step's
matrix). Beyond that a contact does not blow up, since it cannot pull: it chatters, its energy stays small, and changes
of a parameter grow by powers of ten within a frame. So the step itself tells.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient

from pftwin.base.spatial import Scalar, Vec3
from pftwin.dynamics.integrator import Books, Carry, Integrator, with_carried
from pftwin.dynamics.state import Guide, GuideAt, State, System, advance, gyroscopic
from pftwin.model.effects.base import Load

LIMIT = 4.0  # of (h^2 k + 2 h c) / m


class EulerStep(NamedTuple):
    """What symplectic Euler carries: what its last step tells."""

    residual: Scalar  # by how much the step is beyond the limit of stability, as a share of it; else 0


@dataclass(frozen=True)
class SymplecticEuler(Integrator):
    """Explicit, of order one: see above."""

    name: ClassVar[str] = "symplectic_euler"
    order: ClassVar[int] = 1

    def begin(self, system: System, state: State, guide: Guide, step: Scalar) -> State:
        """The state with what the integrator tells: nothing yet."""
        return with_carried(state, EulerStep(jnp.zeros_like(state.position.x)))

    def advance(self, system: System, state: State, guide_at: GuideAt, step: Scalar, ledger: Books = None) -> Carry:
        """See `Integrator`."""
        with jax.named_scope("loads"):
            loads, memories = system.loads(guide_at(0.0).instant(state.patella(), step), state.memories)
        velocity, spin = state.velocity, state.spin
        moment = gyroscopic(system.inertia, spin)
        for load in loads:
            w = load.total()
            velocity = velocity + (step / system.mass) * w.force
            moment = moment + w.moment
        i = system.inertia
        spin = spin + step * Vec3(moment.x / i.x, moment.y / i.y, moment.z / i.z)
        after = advance(state, velocity, spin, step, memories)
        beyond = jnp.maximum(_stiffest(system, loads, step) / LIMIT - 1, 0.0)
        after = with_carried(after, EulerStep(beyond))
        if ledger is not None:
            ends, _ = system.loads(guide_at(1.0).instant(after.patella(), 0.0), memories)
            ledger = ledger.entered(state, after, ends, step)
        return after, ledger


def _stiffest(system: System, loads: list[Load], step: Scalar) -> Scalar:
    """No more than the largest eigenvalue of A = M^-1/2 sum (h^2 k + 2 h c) g g^T M^-1/2, which is that of one term
    alone, and of any that push the same way: |A|^2 / tr A, in Frobenius' norm."""
    terms = stop_gradient([t for load in loads for t in load.stiff])  # what is only told is not differentiated
    mass, i, step = stop_gradient((system.mass, system.inertia, step))
    masses = [mass] * 3 + [i.x, i.y, i.z]
    square = [[jnp.zeros_like(step)] * 6 for _ in range(6)]
    for term in terms:
        weight = jnp.maximum(step * (step * term.stiffness + 2 * term.damping), 0.0)
        rows = [getattr(v, axis) for v in (term.direction, term.moment) for axis in "xyz"]
        for a in range(6):
            for b in range(a + 1):
                square[a][b] = square[a][b] + jnp.sum(weight * rows[a] * rows[b])
    scaled = [[square[a][b] ** 2 / (masses[a] * masses[b]) for b in range(a + 1)] for a in range(6)]
    trace = sum((square[a][a] / masses[a] for a in range(1, 6)), start=square[0][0] / masses[0])
    whole = sum((2.0 if a != b else 1.0) * scaled[a][b] for a in range(6) for b in range(a + 1))
    return jnp.where(trace > 0, whole / jnp.where(trace > 0, trace, 1.0), 0.0)
