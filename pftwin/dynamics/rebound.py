r"""Restitution of a contact as an integrator resolves it, from a simulated impact of a free patella on a plate.

With the exact law F = k d^p (1 + x dd/dt), an approach at speed v rebounds at the speed u given by

    x v - ln(1 + x v) = -x u - ln(1 - x u),

for any mass, k and p: m s ds / (1 + x s) = -k d^p dd is separable, and compression and rebound cover the same depth.
Steps that are not short compared with the impact give a different speed: the impact then lasts a step or two, and only
the numerical damping acts. Running the integrator on the impact gives that speed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.optimize import brentq

from pftwin.base.program_cache import Program
from pftwin.base.spatial import Pose, Quaternion, Scalar, Vec3
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.state import Guide, State, System
from pftwin.model.effects.base import Effect, Instant, Load, Patella
from pftwin.model.effects.contact import force_along, load_of
from pftwin.model.effects.contact_law import ContactLaw
from pftwin.model.motion import Frame
from pftwin.model.scene import Scene

PHASES = 16  # number of different phases of the impact within a step
LASTS = 10.0  # duration of the simulation, in impact times
MOST_OFF = 0.05  # accepted error of the rebound's speed, as a fraction of the approach speed


class Plate(Effect):
    """A plate at z = 0 under a point at the centre of mass."""

    law: ContactLaw

    def remember(self, now: Instant) -> Any:
        """Initial memory: no contact has begun."""
        return self.law.no_contact_yet(now.patella.position.x, 1)

    def load(self, now: Instant, memory: Any) -> tuple[Load, Any]:
        """See `Effect`: the law's force along +z."""
        zero = jnp.zeros_like(now.patella.position.z)
        up, no_moment = Vec3(zero, zero, zero + 1), Vec3(zero, zero, zero)
        depth, rate = -now.patella.position.z, -now.patella.velocity.z
        return load_of([force_along(self.law, now, depth, rate, up, no_moment, (memory or (None,))[0], 1.0)])


def rebound_of_law(law: ContactLaw, speed: float) -> float:
    """Coefficient of restitution of the law at an approach speed [m/s]: see the module."""
    x = law.damping_factor(jnp.asarray(speed))
    y = 0.0 if x is None else float(x) * speed
    if y < 1e-6:  # no loss
        return 1.0
    spent = y - np.log1p(y)
    # After a strongly damped approach the rebound has the terminal speed, with 1 - z far below rounding.
    most = 1 - 1e-15
    return (most if -most - np.log1p(-most) < spent else brentq(lambda z: -z - np.log1p(-z) - spent, 0, most)) / y


def impact_time(law: ContactLaw, mass: float, speed: float) -> float:
    """Approximate duration of the undamped impact [s]: three times depth over speed (exactly 2.94 for p = 3/2)."""
    p = float(law.hertz_exponent)
    return 3 * ((p + 1) * mass * speed**2 / (2 * float(law.contact_stiffness))) ** (1 / (p + 1)) / speed


def rebound_in_steps(law: ContactLaw, mass: float, speed: float, step: float, integrator: Integrator) -> np.ndarray:
    """Coefficients of restitution (PHASES,) with an integrator, one per phase of the impact within a step.

    The arguments are the law, the mass [kg], the approach speed [m/s], the step [s] and the integrator.
    """
    count = int(np.ceil(LASTS * impact_time(law, mass, speed) / step)) + 2 * PHASES
    law = jax.tree.map(lambda a: jnp.asarray(a, dtype=float) if eqx.is_array(a) else a, law)
    ended = _rebounds(
        Plate(law, name="plate"), *(jnp.asarray(float(a)) for a in (mass, speed, step)), integrator, jnp.asarray(count)
    )
    return np.maximum(np.asarray(ended), 0.0) / speed


@Program
def _rebounds(plate: Plate, mass: Scalar, speed: Scalar, step: Scalar, integrator: Integrator, count: Array) -> Array:
    """Final velocities away from the plate, (PHASES,) [m/s]."""
    zero = jnp.zeros_like(mass)
    still = Guide(None, Frame.world(), zero)
    system = System(mass, Vec3(mass, mass, mass), (plate,))

    def rebound(phase: Scalar) -> Scalar:
        pose = Pose(Vec3(zero, zero, speed * step * phase), Quaternion(zero + 1, zero, zero, zero))
        memory = plate.remember(still.instant(Patella.at_rest(pose.position, pose.orientation), 0.0))
        state = eqx.tree_at(lambda s: s.velocity.z, system.at_rest(pose, (memory,)), -speed)
        state = integrator.begin(system, state, still, step)

        def further(_: Scalar, now: State) -> State:
            return integrator.advance(system, now, lambda _: still, step, None)[0]

        return jax.lax.fori_loop(0, count, further, state).velocity.z

    return jax.vmap(rebound)((jnp.arange(PHASES, dtype=float) + 0.5) / PHASES)


@dataclass(frozen=True)
class Impact:
    """The fastest approach of a run, and restitution at that speed for a free patella."""

    speed: float  # approach speed [m/s]
    slow: float  # speed below which the law's restitution does not matter [m/s]
    law: float  # coefficient of restitution of the law
    steps: float  # coefficient of restitution with the run's steps, averaged over the phase of the impact in a step
    step: float  # [s]

    @property
    def unresolved(self) -> bool:
        """Whether the steps are too long for the law's restitution, if that matters."""
        return self.speed > self.slow and abs(self.law - self.steps) > MOST_OFF

    def describe(self) -> str:
        """Description in one sentence."""
        if self.speed <= self.slow:
            return f"contacts close at {self.speed:.2g} m/s at most, too slow for it to act (below {self.slow:.2g} m/s)"
        return (
            f"contacts close at up to {self.speed:.2g} m/s, of which the law returns {self.law:.2f} and steps of"
            f" {1e3 * self.step:g} ms {self.steps:.2f}"
        )


def impact_of(scene: Scene, integrator: Integrator, step: float, approach: float) -> Impact | None:
    """Restitution with an integrator's step [s] at the fastest approach of a run [m/s]: see `Ledger.approach`.

    None if the scene has no contact with a normal law, if there was no approach, or without inertia.
    """
    contact = scene.contact
    law = None if contact is None else contact.normal_law()
    if law is None or not integrator.inertia or not (np.isfinite(approach) and approach > 0):
        return None
    slow, exact = law.slow_approach(), rebound_of_law(law, approach)
    in_steps = exact
    if approach > slow:
        in_steps = float(rebound_in_steps(law, float(scene.patella.mass), approach, step, integrator).mean())
    return Impact(approach, slow, exact, in_steps, step)
