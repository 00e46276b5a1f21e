r"""Implicit Newmark and generalised-alpha methods on the group of rigid motions.

With a the algorithmic accelerations, A those from the forces, and d the displacement of the step (translation in world
axes, rotation in patella axes),

    d = h v + h^2 ((1/2 - beta) a + beta a_end),            q_end = q exp(d)
    v_end = v + h ((1 - gamma) a + gamma a_end)
    (1 - alpha_m) a_end + alpha_m a = (1 - alpha_f) A_end + alpha_f A,      M A_end = F(q_end, v_end, t_end)

is solved for v_end by a Newton iteration whose tangent consists of the derivatives of the stiff terms
(`implicit_solve`): nothing is differentiated, and a scene compiles as fast as two evaluations of its forces.
gamma = 1/2, beta = 1/4 and no alphas is the average acceleration method, of order two and without damping. Source:
Newmark 1959, J Eng Mech Div 85:67; Chung & Hulbert 1993, J Appl Mech 60:371; on groups: Bruels & Cardona 2010, J Comput
Nonlinear Dyn 5:031002.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from pftwin.base.errors import InputError
from pftwin.base.spatial import Scalar, Twist, Vec3, Wrench
from pftwin.dynamics.integrator import Books, Carry, Integrator, with_solver_state
from pftwin.dynamics.integrators.implicit_solve import Span, change_of_velocity
from pftwin.dynamics.solve import changed_by, six, solution_changes, tangent_of
from pftwin.dynamics.state import Guide, GuideAt, State, System, acceleration, displaced_state, gyroscopic
from pftwin.dynamics.static_load import LEVER
from pftwin.model.effects.base import Load

MOST_ITERATIONS = 20
# Largest last change of the velocity of a converged step [m/s]. The iteration converges linearly: with 1e-9, finite
# differences of runs with respect to a contact's stiffness had an error of 3 %; 1e-11 takes 5 % more time.
SETTLED = {"float64": 1e-11, "float32": 1e-4}


class NewmarkStep(NamedTuple):
    """What Newmark's method carries from step to step."""

    algorithmic: Twist  # a
    actual: Twist  # A
    residual: Scalar  # last change of the velocity if the iteration has not converged, else 0 [m/s]


class Weights(NamedTuple):
    """Parameters of the method."""

    gamma: float
    beta: float
    alpha_m: float
    alpha_f: float


class _Step(NamedTuple):
    """Inputs of a step."""

    system: System
    state: State
    guide: Guide  # at the end
    length: Scalar  # h

    def end(self, velocity: Twist, w: Weights) -> tuple[State, Twist, Twist]:
        """The end state for an end velocity, its algorithmic acceleration, and the one required from the forces."""
        last, h = self.state.solver_state, self.length
        start = Twist(self.state.velocity, self.state.spin)
        a = velocity.plus(-1.0, start).plus(-h * (1 - w.gamma), last.algorithmic).times(1 / (w.gamma * h))
        displacement = start.times(h).plus(h * h * (0.5 - w.beta), last.algorithmic).plus(h * h * w.beta, a)
        needed = a
        if w.alpha_m or w.alpha_f:
            mixed = a.times(1 - w.alpha_m).plus(w.alpha_m, last.algorithmic).plus(-w.alpha_f, last.actual)
            needed = mixed.times(1 / (1 - w.alpha_f))
        return displaced_state(self.state, displacement, velocity), a, needed

    def unbalanced(self, velocity: Twist, w: Weights) -> tuple[Wrench, list[Load], tuple[Any, ...]]:
        """Inertial forces for an end velocity, the loads there, and the memories after them."""
        after, _, needed = self.end(velocity, w)
        loads, memories = self.system.loads(self.guide.instant(after.patella(), self.length), after.memories)
        i, about = self.system.inertia, needed.angular
        turning = Vec3(i.x * about.x, i.y * about.y, i.z * about.z)
        inertial = Wrench(-self.system.mass * needed.linear, gyroscopic(i, after.spin) - turning)
        return inertial, loads, memories


@dataclass(frozen=True)
class Newmark(Integrator):
    """Newmark's method with iteration, optionally generalised-alpha.

    Args:
        gamma, beta: its parameters; by default 1/2 and (gamma + 1/2)^2 / 4.
        rho: instead of both, the spectral radius at infinite frequency of the generalised-alpha method, from 0 (most
            damping) to 1 (none).

    Raises:
        InputError: the method is not unconditionally stable, `rho` is not in [0, 1], or both kinds are given.
    """

    gamma: float | None = None
    beta: float | None = None
    rho: float | None = None
    name: ClassVar[str] = "newmark"

    def __post_init__(self) -> None:
        if self.rho is None:
            w = self.weights
            if not (w.gamma >= 0.5 and 2 * w.beta >= w.gamma):
                raise InputError(
                    f"found gamma = {w.gamma:g}, beta = {w.beta:g}",
                    where="newmark",
                    expected="gamma of at least 1/2 and beta of at least gamma / 2, which is stable at any step",
                )
        elif self.gamma is not None or self.beta is not None:
            raise InputError("found rho together with gamma or beta", where="newmark", expected="one or the other")
        elif not 0 <= self.rho <= 1:
            raise InputError(f"found rho = {self.rho:g}", where="newmark", expected="from 0 (most damping) to 1 (none)")

    @property
    def weights(self) -> Weights:
        """Parameters of the method."""
        if self.rho is not None:
            alpha_m, alpha_f = (2 * self.rho - 1) / (self.rho + 1), self.rho / (self.rho + 1)
            gamma = 0.5 - alpha_m + alpha_f
            return Weights(gamma, 0.25 * (gamma + 0.5) ** 2, alpha_m, alpha_f)
        gamma = 0.5 if self.gamma is None else self.gamma
        return Weights(gamma, 0.25 * (gamma + 0.5) ** 2 if self.beta is None else self.beta, 0.0, 0.0)

    @property
    def order(self) -> int:
        """Order 2, or 1 if gamma is above 1/2 without `rho`."""
        return 2 if self.rho is not None or self.weights.gamma == 0.5 else 1

    def begin(self, system: System, state: State, guide: Guide, step: Scalar) -> State:
        """See `Integrator`: the initial accelerations."""
        loads, _ = system.loads(guide.instant(state.patella(), 0.0), state.memories)
        now = acceleration(system, state.spin, loads)
        return with_solver_state(state, NewmarkStep(now, now, jnp.zeros_like(now.linear.x)))

    def advance(self, system: System, state: State, guide_at: GuideAt, step: Scalar, ledger: Books = None) -> Carry:
        """See `Integrator`."""
        w = self.weights
        given = _Step(system, state, guide_at(1.0), step)
        velocity, residual = _solved(given, w)
        after, algorithmic, _ = given.end(velocity, w)
        loads, memories = system.loads(given.guide.instant(after.patella(), step), after.memories)
        actual = acceleration(system, after.spin, loads)
        after = eqx.tree_at(
            lambda s: (s.memories, s.solver_state), after, (memories, NewmarkStep(algorithmic, actual, residual))
        )
        if ledger is not None:
            ledger = ledger.after_step(state, after, loads, step)
        return after, ledger


@eqx.filter_custom_jvp
def _solved(given: _Step, w: Weights) -> tuple[Twist, Scalar]:
    """Velocity at the end of the step, and its last change if the iteration has not converged, else 0."""
    impulse, settled = w.gamma * (1 - w.alpha_f) / (1 - w.alpha_m), SETTLED[str(given.length.dtype)]
    span = Span(impulse * given.length, (w.beta / w.gamma) * given.length)
    last = given.state.solver_state
    guess = Twist(given.state.velocity, given.state.spin).plus(given.length, last.algorithmic)

    def improve(now: tuple[Twist, Scalar, Scalar]) -> tuple[Twist, Scalar, Scalar]:
        velocity, _, count = now
        inertial, loads, _ = given.unbalanced(velocity, w)
        dv = change_of_velocity(given.system, inertial, loads, span)
        velocity = velocity.plus(1.0, Twist(Vec3(*dv[:3]), Vec3(*dv[3:])))
        size = jnp.sqrt(sum(a * a for a in (*dv[:3], *(LEVER * b for b in dv[3:]))))
        return velocity, size, count + 1

    zero = jnp.zeros_like(given.length)
    velocity, size, _ = jax.lax.while_loop(
        lambda now: (now[1] > settled) & (now[2] < MOST_ITERATIONS),
        improve,
        (guess, zero + jnp.inf, jnp.zeros((), int)),
    )
    return velocity, jnp.where(size > settled, size, 0.0)


@_solved.def_jvp
def _solved_jvp(primals: Any, tangents: Any) -> tuple[Any, Any]:
    """At the solution r(v, p) = 0, so dv = -(dr/dv)^-1 (dr/dp) dp: exact, unlike the iteration's tangent."""
    given, w = primals
    velocity, residual_left = _solved(given, w)

    def residual(x: list[Scalar], given: _Step) -> list[Scalar]:
        inertial, loads, _ = given.unbalanced(Twist(Vec3(*x[:3]), Vec3(*x[3:])), w)
        total = sum((load.total() for load in loads), start=inertial)
        return six(total.force, total.moment)

    x = six(velocity.linear, velocity.angular)
    tangent = tangent_of(lambda x: residual(x, given), x)
    d = solution_changes(tangent, changed_by(lambda p: residual(x, p), given, tangents[0]))
    return (velocity, residual_left), (Twist(Vec3(*d[:3]), Vec3(*d[3:])), jnp.zeros_like(residual_left))
