r"""Motion without inertia: at the end of every step the forces of all effects balance, rates and all.

With d the displacement over a step, d_last that over the one before it and h the step,

    F(q exp(d), v, t_end) = 0,      v = (d - s d_last) / ((1 - s) h)

is solved for d by Newton's iteration, started from d_last (continuation). s = 1/3 makes v the backward difference of
second order (BDF2); the first step, and the first after a snap, has s = 0. Guided bodies move with their own
velocities: dashpots, friction and viscoelastic tendons act as they do in the dynamics; only mass and moments of inertia
are left out. In a scene without forces that go by speed this is one static equilibrium per step, exact at any step.

An equilibrium can end: in a fold its tangent loses positive definiteness, and the patella snaps over a facet, out of
its groove or back into it. Where no equilibrium is found nearby, or one that is not stable at rest, the patella goes on
from where the motion has led it in a damped dynamic burst (`pftwin.dynamics.relaxation`), under guided bodies that
stand still, until it comes to rest; and the state counts one snap more. So inertia decides nothing: it lands where it
lands without swing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.spatial import Scalar, Twist
from pftwin.dynamics.integrator import Integrator, with_carried
from pftwin.dynamics.ledger import Ledger
from pftwin.dynamics.quasi_static.branch import Branch, displacement_of
from pftwin.dynamics.quasi_static.solution import carried_along, over_a_snap, solved
from pftwin.dynamics.state import Guide, GuideAt, State, System


class QuasiStaticStep(NamedTuple):
    """What a motion without inertia carries from step to step."""

    displacement: Twist  # d_last
    share: Scalar  # s of the next step
    remainder: Array  # (6, 6) of the last tangent [N/m]: see `quasi_static_newton`
    snaps: Scalar  # since the start
    residual: Scalar  # what is left of the balance where it is not met [N]


@dataclass(frozen=True)
class QuasiStatic(Integrator):
    """Motion without inertia: see above."""

    name: ClassVar[str] = "quasi_static"
    order: ClassVar[int] = 2
    inertia: ClassVar[bool] = False

    def begin(self, system: System, state: State, guide: Guide, step: Scalar) -> State:
        """The state without a past; it goes on with the velocity that it has."""
        zero = jnp.zeros_like(state.position.x)
        displacement = Twist(state.velocity, state.spin).times(step)
        return with_carried(state, QuasiStaticStep(displacement, zero, jnp.zeros((6, 6), zero.dtype), zero, zero))

    def advance(
        self, system: System, state: State, guide_at: GuideAt, step: Scalar, ledger: Ledger | None = None
    ) -> tuple[State, Ledger | None]:
        """See `Integrator`."""
        branch = Branch(system, state, guide_at(1.0), step, jnp.ones_like(step))
        found = solved(branch)
        landed = found.landed(branch)
        after = landed.after(found.d)
        loads, memories = system.loads(landed.instant(found.d), landed.origin.memories)
        snapped = found.snapped > 0
        displacement = jax.tree.map(
            lambda a, b: jnp.where(snapped, a, b), carried_along(branch, after), displacement_of(found.d)
        )
        share = jnp.where(snapped, 0.0, jnp.full_like(step, 1 / 3))
        remainder = jax.lax.stop_gradient(found.remainder)
        carried = QuasiStaticStep(displacement, share, remainder, state.carried.snaps + found.snapped, found.residual)
        after = eqx.tree_at(lambda s: (s.memories, s.carried), after, (memories, carried))
        if ledger is None:
            return after, None
        followed = ledger.entered(state, after, loads, step)
        return after, jax.tree.map(lambda a, b: jnp.where(snapped, a, b), over_a_snap(ledger, branch, loads), followed)
