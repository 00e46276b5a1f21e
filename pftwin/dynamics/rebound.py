r"""What an integrator's steps leave of a contact's restitution: a free patella thrown against a plate.

The law F = k d^p (1 + x dd/dt) alone leaves, of an approach at v, the speed u of

    x v - ln(1 + x v) = -x u - ln(1 - x u),

whatever mass, k and p are: m s ds / (1 + x s) = -k d^p dd has its variables apart, and the way in is as deep as the way
out. Steps that are not short against the impact give another speed: it then lasts a step or two, in which their own
damping is all that acts. What they give is found by letting the integrator itself make them.
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

PHASES = 16  # places within a step at which the plate is reached
LASTS = 10.0  # impacts: how long is waited for the rebound
MOST_OFF = 0.05  # share of the approach's speed by which steps may miss the law's rebound before it is remarked


class Plate(Effect):
    """A plate at z = 0 under a point at the centre of mass."""

    law: ContactLaw

    def remember(self, now: Instant) -> Any:
        """No contact has begun yet."""
        return self.law.no_contact_yet(now.patella.position.x, 1)

    def load(self, now: Instant, memory: Any) -> tuple[Load, Any]:
        """The law's force upwards."""
        zero = jnp.zeros_like(now.patella.position.z)
        up, no_moment = Vec3(zero, zero, zero + 1), Vec3(zero, zero, zero)
        depth, rate = -now.patella.position.z, -now.patella.velocity.z
        return load_of([force_along(self.law, now, depth, rate, up, no_moment, (memory or (None,))[0], 1.0)])


def rebound_of_law(law: ContactLaw, speed: float) -> float:
    """The share of an approach's speed [m/s] that the law returns: see above."""
    x = law.damping_factor(jnp.asarray(speed))
    y = 0.0 if x is None else float(x) * speed
    if y < 1e-6:  # nothing is lost
        return 1.0
    spent = y - np.log1p(y)
    # Of a strongly damped approach the way out is the terminal speed, 1 - z far below rounding.
    most = 1 - 1e-15
    return (most if -most - np.log1p(-most) < spent else brentq(lambda z: -z - np.log1p(-z) - spent, 0, most)) / y


def impact_time(law: ContactLaw, mass: float, speed: float) -> float:
    """How long the undamped impact lasts, nearly [s]: three times its depth over its speed (2.94 for p = 3/2)."""
    p = float(law.hertz_exponent)
    return 3 * ((p + 1) * mass * speed**2 / (2 * float(law.contact_stiffness))) ** (1 / (p + 1)) / speed


def rebound_in_steps(law: ContactLaw, mass: float, speed: float, step: float, integrator: Integrator) -> np.ndarray:
    """The share of an approach's speed [m/s] that an integrator's steps [s] leave to a mass [kg] after the impact.

    (PHASES,), by where the plate lies in a step.
    """
    count = int(np.ceil(LASTS * impact_time(law, mass, speed) / step)) + 2 * PHASES
    law = jax.tree.map(lambda a: jnp.asarray(a, dtype=float) if eqx.is_array(a) else a, law)
    ended = _thrown(
        Plate(law, name="plate"), *(jnp.asarray(float(a)) for a in (mass, speed, step)), integrator, jnp.asarray(count)
    )
    return np.maximum(np.asarray(ended), 0.0) / speed


@Program
def _thrown(plate: Plate, mass: Scalar, speed: Scalar, step: Scalar, integrator: Integrator, count: Array) -> Array:
    """Velocities away from the plate at the end."""
    zero = jnp.zeros_like(mass)
    still = Guide(None, Frame.world(), zero)
    system = System(mass, Vec3(mass, mass, mass), (plate,))

    def thrown(phase: Scalar) -> Scalar:
        pose = Pose(Vec3(zero, zero, speed * step * phase), Quaternion(zero + 1, zero, zero, zero))
        memory = plate.remember(still.instant(Patella.at_rest(pose.position, pose.orientation), 0.0))
        state = eqx.tree_at(lambda s: s.velocity.z, system.at_rest(pose, (memory,)), -speed)
        state = integrator.begin(system, state, still, step)

        def further(_: Scalar, now: State) -> State:
            return integrator.advance(system, now, lambda _: still, step, None)[0]

        return jax.lax.fori_loop(0, count, further, state).velocity.z

    return jax.vmap(thrown)((jnp.arange(PHASES, dtype=float) + 0.5) / PHASES)


@dataclass(frozen=True)
class Impact:
    """The hardest approach of a run, and what a contact of a free patella returns of it."""

    speed: float  # [m/s]
    slow: float  # below this speed the law's restitution does not act [m/s]
    law: float  # share of the speed that the law returns
    steps: float  # and that the run's steps return, on average over where in a step the contact begins
    step: float  # [s]

    @property
    def unresolved(self) -> bool:
        """Whether the steps are too long for the law's restitution, where that acts."""
        return self.speed > self.slow and abs(self.law - self.steps) > MOST_OFF

    def describe(self) -> str:
        """In a sentence."""
        if self.speed <= self.slow:
            return f"contacts close at {self.speed:.2g} m/s at most, too slow for it to act (below {self.slow:.2g} m/s)"
        return (
            f"contacts close at up to {self.speed:.2g} m/s, of which the law returns {self.law:.2f} and steps of"
            f" {1e3 * self.step:g} ms {self.steps:.2f}"
        )


def impact_of(scene: Scene, integrator: Integrator, step: float, approach: float) -> Impact | None:
    """What an integrator's steps [s] make of the hardest approach of a run [m/s]: see `Ledger.approach`.

    None where a scene has no contact with a law, where nothing approached, and without inertia.
    """
    contact = scene.contact
    law = None if contact is None else contact.normal_law()
    if law is None or not integrator.inertia or not (np.isfinite(approach) and approach > 0):
        return None
    slow, due = law.slow_approach(), rebound_of_law(law, approach)
    left = due
    if approach > slow:
        left = float(rebound_in_steps(law, float(scene.patella.mass), approach, step, integrator).mean())
    return Impact(approach, slow, due, left, step)
