r"""ALI3-P, the formulation of Michaud et al. 2024: index-3 augmented Lagrangian, natural coordinates, projections.

At the end of a step dq/dt and d2q/dt2 follow from q by Newmark's average acceleration method, and q solves

    M d2q/dt2 + J^T (alpha Phi + lambda) = Q,        lambda <- lambda + alpha Phi

by Newton's method with the tangent M + gamma h C + beta h^2 (J^T alpha J + K), where J = dPhi/dq. The constraints
Phi(q, t) = 0 keep bodies rigid and drive guided ones (`natural_coordinates`). Then velocities and accelerations are
projected to dPhi/dt = 0 and d2Phi/dt2 = 0 with the same matrix (`newton`). Source: Michaud et al. 2024, section 2.3.1;
Bayo & Ledesma 1996, Nonlinear Dyn 9:113; Cuadrado et al. 2004, Multibody Syst Dyn 12:1; Dopico et al. 2014, J Comput
Nonlinear Dyn 9:041006.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.errors import InputError
from pftwin.base.spatial import Scalar
from pftwin.dynamics.ali3p.bodies import Bodies, driven_targets, guided_coordinates, masses
from pftwin.dynamics.ali3p.natural_coordinates import (
    Driven,
    as_rigid,
    constraints,
    coordinates,
    jacobian,
    rates,
    rates_wanted,
    second_rates_wanted,
)
from pftwin.dynamics.ali3p.newton import BETA, GAMMA, PENALTY, Predicted, constrained, solved_step
from pftwin.dynamics.integrator import Books, Carry, Integrator, with_solver_state
from pftwin.dynamics.state import Guide, GuideAt, State, System


class ALI3PStep(NamedTuple):
    """What ALI3-P carries from step to step; the n bodies are patella, tibia, and the femur if it moves."""

    place: Array  # q (n, 12) [m]
    rate: Array  # dq/dt, projected
    second_rate: Array  # d2q/dt2, projected
    multipliers: Array  # lambda (n, 12): 6 of rigid constraints, then driving force and moment / LENGTH [N]
    drift: Scalar  # largest violation of a constraint in any step so far [m]
    residual: Scalar  # last change of the velocity if the iteration has not converged, else 0 [m/s]


@dataclass(frozen=True)
class ALI3P(Integrator):
    """The formulation of Michaud et al. 2024. Unsolved steps report a residual, and keep the bodies rigid.

    Args:
        penalty: beta h^2 alpha as a multiple of the patella's mass. It affects only the speed of convergence of the
            multipliers. 0: a default for the float type.

    Raises:
        InputError: the penalty is below 10 and not 0.
    """

    penalty: float = 0.0
    name: ClassVar[str] = "ali3p"
    order: ClassVar[int] = 2

    def __post_init__(self) -> None:
        if self.penalty and not self.penalty >= 10:
            raise InputError(
                f"found penalty = {self.penalty:g}", where="ali3p", expected="at least 10 times the patella's mass"
            )

    def begin(self, system: System, state: State, guide: Guide, step: Scalar) -> State:
        """See `Integrator`: natural coordinates, and accelerations and multipliers that solve the equations of motion.

        The second rate of the guided bodies' prescribed coordinates is unknown here and taken as zero; it does not
        affect the first step.
        """
        place, rate = guided_coordinates(guide)
        axes = state.orientation.rotation()
        place = place.at[0].set(coordinates(state.position, axes))
        rate = rate.at[0].set(rates(state.velocity, axes.apply(state.spin), axes))
        to = Driven(place, rate, jnp.zeros_like(rate))
        forces, _, _ = Bodies(system, state.memories, guide.time, jnp.zeros_like(step)).forces(place, rate)
        metric = jnp.broadcast_to(jnp.diag(masses(system)), (len(place), 12, 12))
        scale, wanted = PENALTY[str(step.dtype)] * system.mass, second_rates_wanted(place, rate, to)
        second_rate, multipliers = constrained(metric, jacobian(place, to), scale, forces, wanted)
        nothing = jnp.zeros_like(state.position.x)
        return with_solver_state(state, ALI3PStep(place, rate, second_rate, multipliers, nothing, nothing))

    def advance(self, system: System, state: State, guide_at: GuideAt, step: Scalar, ledger: Books = None) -> Carry:
        """See `Integrator`."""
        last: ALI3PStep = state.solver_state
        to = driven_targets(guide_at, step)
        factor = self.penalty or PENALTY[str(step.dtype)]
        given = Predicted(
            Bodies(system, state.memories, guide_at(1.0).time, step),
            last.place + step * last.rate + (0.5 - BETA) * step * step * last.second_rate,
            last.rate + (1 - GAMMA) * step * last.second_rate,
            last.second_rate,
            last.multipliers,
            to,
            factor,
        )
        second_rate, multipliers, residual = solved_step(given)
        place, rate = given.motion(second_rate)
        drift = jnp.maximum(last.drift, jnp.abs(constraints(place, to)).max())
        # An unsolved step keeps bodies rigid and their rates unchanged, so that nothing blows up.
        failed, nothing = residual > 0, jnp.zeros_like(place)
        place, rate = jnp.where(failed, as_rigid(place, to), place), jnp.where(failed, last.rate, rate)
        second_rate, multipliers = jnp.where(failed, nothing, second_rate), jnp.where(failed, nothing, multipliers)
        _, loads, memories = given.bodies.forces(place, rate)

        j, metric = jacobian(place, to), given.metric(place, loads)
        scale = given.scale()

        def projected(value: Array, wanted: Array) -> Array:
            # Solves only for the correction, so that rounding errors from the large penalty affect only that.
            missing = wanted - jnp.einsum("nki,ni->nk", j, value)
            return value + constrained(metric, j, scale, jnp.zeros_like(value), missing)[0]

        rate = projected(rate, rates_wanted(place, to))
        second_rate = projected(second_rate, second_rates_wanted(place, rate, to))
        solver_state = ALI3PStep(place, rate, second_rate, multipliers, drift, residual)
        after = given.bodies.state(place, rate, state)
        after = eqx.tree_at(lambda s: (s.memories, s.solver_state), after, (memories, solver_state))
        if ledger is not None:
            ledger = ledger.after_step(state, after, loads, step)
        return after, ledger
