"""Symplectic (semi-implicit) Euler: forces at the start of the step, positions from the new velocity; order one.

As an explicit method it is stable only for steps that are short compared with every vibration (about 0.3 ms for a
contact of 2e8 N/m^1.5). A mass m on a spring k with a damper c stays bounded for h^2 k + 2 h c < 4 m (Schur-Cohn
conditions on the matrix of a step). Beyond that a contact does not blow up, since it cannot pull: it chatters with
little energy, while changes of a parameter grow by powers of ten within a frame. So every step checks the limit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient

from pftwin.base.spatial import Scalar, Vec3
from pftwin.dynamics.integrator import Books, Carry, Integrator, with_solver_state
from pftwin.dynamics.state import Guide, GuideAt, State, System, advance, gyroscopic
from pftwin.model.effects.base import Load

LIMIT = 4.0  # stability limit of (h^2 k + 2 h c) / m


class EulerStep(NamedTuple):
    """What symplectic Euler carries: the diagnostics of its last step."""

    residual: Scalar  # relative excess over the stability limit, else 0


@dataclass(frozen=True)
class SymplecticEuler(Integrator):
    """Symplectic Euler, explicit and of first order: see the module `pftwin.dynamics.integrators.symplectic_euler`."""

    name: ClassVar[str] = "symplectic_euler"
    order: ClassVar[int] = 1

    def begin(self, system: System, state: State, guide: Guide, step: Scalar) -> State:
        """See `Integrator`: zero residual."""
        return with_solver_state(state, EulerStep(jnp.zeros_like(state.position.x)))

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
        after = with_solver_state(after, EulerStep(beyond))
        if ledger is not None:
            ends, _ = system.loads(guide_at(1.0).instant(after.patella(), 0.0), memories)
            ledger = ledger.after_step(state, after, ends, step)
        return after, ledger


def _stiffest(system: System, loads: list[Load], step: Scalar) -> Scalar:
    """Lower bound |A|^2 / tr A (Frobenius norm) of the largest eigenvalue of A = M^-1/2 sum (h^2 k + 2 h c) g g^T
    M^-1/2; exact for one term, or terms with the same direction."""
    terms = stop_gradient([t for load in loads for t in load.stiff])  # a diagnostic needs no derivatives
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
