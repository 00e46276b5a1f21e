r"""The linearly implicit step: one force evaluation, every stiff direction of every effect treated implicitly.

A stiff term pushes with f(s, s') along the wrench direction g. Linearised at the start of the step,

    f_end = f + k h s'_end + c (s'_end - s'),      s'_end - s' = -g . (v_end - v),

so the change of velocity solves one symmetric positive definite 6 x 6 system,

    (M + sum_i w_i g_i g_i^T) dv = h (f_rest + sum_i g_i (f_i + h k_i s'_i)),      w_i = h (h k_i + c_i).

No iteration, any number of terms, unconditionally stable along the g_i; order one. Guided bodies keep, within a step,
the velocity that they have at its middle.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from pftwin.dynamics.ledger import Ledger
from pftwin.dynamics.solve import Lower, add_outer, factor, solve
from pftwin.dynamics.state import Guide, State, System, advance, gyroscopic
from pftwin.effects.base import StiffTerm
from pftwin.spatial import Scalar, Vec3

ORDER = 1


def linear_implicit(
    system: System, state: State, guide: Guide, step: Scalar, ledger: Ledger | None = None
) -> tuple[State, Ledger | None]:
    """The state one step later, and the energy ledger where one is kept."""
    with jax.named_scope("loads"):
        loads, memories = system.loads(guide.instant(state.patella(), step), state.memories)
    with jax.named_scope("implicit_solve"):
        rest = gyroscopic(system.inertia, state.spin)
        right = [jnp.zeros_like(step)] * 3 + [rest.x, rest.y, rest.z]
        matrix = _mass_matrix(system)
        for load in loads:
            if load.wrench is not None:
                w = load.wrench
                right = _add(right, [w.force.x, w.force.y, w.force.z, w.moment.x, w.moment.y, w.moment.z])
            for term in load.stiff:
                matrix, right = _with_term(matrix, right, term, step)
        low, inverse = factor(matrix)
        dv = solve(low, inverse, [step * r for r in right])
    after = advance(state, state.velocity + Vec3(*dv[:3]), state.spin + Vec3(*dv[3:]), step, memories)
    if ledger is not None:
        terms = [term for load in loads for term in load.stiff]
        ledger = ledger.entered(state, after, loads, [_applied(t, dv, step) for t in terms], step)
    return after, ledger


def _applied(term: StiffTerm, dv: list[Scalar], step: Scalar) -> Scalar:
    """The force at the end of the step, with which the solve has reckoned."""
    slower = term.direction.dot(Vec3(*dv[:3])) + term.moment.dot(Vec3(*dv[3:]))
    return term.force + step * term.stiffness * (term.rate - slower) - term.damping * slower


def _mass_matrix(system: System) -> Lower:
    zero = jnp.zeros_like(system.mass)
    i = system.inertia
    diagonal = [system.mass, system.mass, system.mass, i.x, i.y, i.z]
    return [[zero] * row + [d] for row, d in enumerate(diagonal)]


def _with_term(matrix: Lower, right: list[Scalar], term: StiffTerm, step: Scalar) -> tuple[Lower, list[Scalar]]:
    """Adds w g g^T and g (f + h k s'); a group is summed over its leading axis."""
    d, m = term.direction, term.moment
    g = [d.x, d.y, d.z, m.x, m.y, m.z]
    weight = step * (step * term.stiffness + term.damping)
    push = term.force + step * term.stiffness * term.rate
    add = [jnp.sum(push * a) if jnp.ndim(push) else push * a for a in g]
    return add_outer(matrix, g, weight), _add(right, add)


def _add(a: list[Scalar], b: list[Scalar]) -> list[Scalar]:
    return [x + y for x, y in zip(a, b, strict=True)]
