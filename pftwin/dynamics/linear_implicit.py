r"""The linearly implicit step: one force evaluation, every stiff direction of every effect treated implicitly.

Forces are evaluated where the step would end at the present velocity, with the guided bodies at the step's end; so the
lag of a slow, guided motion is of second order. From there each stiff term, a force f(s, s') along the wrench
direction g, is linearised in the change of velocity dv,

    f_end = f - (h k + c) g . dv,

which makes one symmetric positive definite 6 x 6 system (one Newton iteration of backward Euler),

    (M + sum_i w_i g_i g_i^T) dv = h (f_rest + sum_i g_i f_i),      w_i = h (h k_i + c_i).

A contact that would end the step with a pull is taken out and the system solved once more. No iteration beyond that,
any number of terms, unconditionally stable along the g_i; order one.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp

from pftwin.dynamics.ledger import Ledger
from pftwin.dynamics.solve import Lower, add_outer, factor, solve
from pftwin.dynamics.state import Guide, State, System, advance, gyroscopic
from pftwin.effects.base import Load, StiffTerm
from pftwin.spatial import Scalar, Vec3

ORDER = 1
SPAN = 0.07  # typical length of a line of force [m]
LEVER = 0.02  # typical arm of a force on the patella [m]
GUIDED_AT = 1.0  # where in the step the guided bodies are looked at: its end


def linear_implicit(
    system: System, state: State, guide: Guide, step: Scalar, ledger: Ledger | None = None
) -> tuple[State, Ledger | None]:
    """The state one step later, and the energy ledger where one is kept."""
    with jax.named_scope("loads"):
        ahead = advance(state, state.velocity, state.spin, step, state.memories).patella()
        loads, memories = system.loads(guide.instant(ahead, step, step), state.memories)
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
        matrix = _with_turning(matrix, loads, step)
        dv = _solved(matrix, right, step)
        for load in loads:
            for term in load.stiff:
                if term.unilateral:
                    matrix, right = _without_if_pulling(matrix, right, term, dv, step)
        dv = _solved(matrix, right, step)
    after = advance(state, state.velocity + Vec3(*dv[:3]), state.spin + Vec3(*dv[3:]), step, memories)
    if ledger is not None:
        ends = [load._replace(stiff=tuple(_at_end(term, dv, step) for term in load.stiff)) for load in loads]
        ledger = ledger.entered(state, after, ends, [t.force for load in ends for t in load.stiff], 1.0, step)
    return after, ledger


def _solved(matrix: Lower, right: list[Scalar], step: Scalar) -> list[Scalar]:
    """The change of velocity."""
    low, inverse = factor(matrix)
    return solve(low, inverse, [step * r for r in right])


def _without_if_pulling(
    matrix: Lower, right: list[Scalar], term: StiffTerm, dv: list[Scalar], step: Scalar
) -> tuple[Lower, list[Scalar]]:
    """Takes a unilateral term out again if it would end the step with a pull."""
    change = term.direction.dot(Vec3(*dv[:3])) + term.moment.dot(Vec3(*dv[3:]))
    end = term.force - (step * term.stiffness + term.damping) * change
    pulls = jnp.where(end < 0, -1.0, 0.0)
    gone = eqx.tree_at(
        lambda t: (t.force, t.stiffness, t.damping),
        term,
        (pulls * term.force, pulls * term.stiffness, pulls * term.damping),
    )
    return _with_term(matrix, right, gone, step)


def _at_end(term: StiffTerm, dv: list[Scalar], step: Scalar) -> StiffTerm:
    """The term as it is at the end of the step, with the forces that the solve has reckoned with."""
    change = term.direction.dot(Vec3(*dv[:3])) + term.moment.dot(Vec3(*dv[3:]))
    elastic = term.elastic - step * term.stiffness * change
    force = term.force - (step * term.stiffness + term.damping) * change
    if term.unilateral:
        force = jnp.maximum(force, 0.0)
    return eqx.tree_at(lambda t: (t.force, t.elastic), term, (force, elastic))


def _mass_matrix(system: System) -> Lower:
    zero = jnp.zeros_like(system.mass)
    i = system.inertia
    diagonal = [system.mass, system.mass, system.mass, i.x, i.y, i.z]
    return [[zero] * row + [d] for row, d in enumerate(diagonal)]


def _with_turning(matrix: Lower, loads: list[Load], step: Scalar) -> Lower:
    """Adds h^2 times what the forces' turning amounts to: f / span against displacement, f lever against rotation.

    A force f that turns with the body is a spring across its own direction. Only its size matters here: the step stays
    of the same order whatever is added, and large steps stay stable.
    """
    total = sum((jnp.sum(term.force) for load in loads for term in load.stiff), start=jnp.zeros_like(step))
    across, about = (step * step / SPAN) * total, (step * step * LEVER) * total
    return [[*row[:-1], row[-1] + (across if i < 3 else about)] for i, row in enumerate(matrix)]


def _with_term(matrix: Lower, right: list[Scalar], term: StiffTerm, step: Scalar) -> tuple[Lower, list[Scalar]]:
    """Adds w g g^T and g f; a group is summed over its leading axis."""
    d, m = term.direction, term.moment
    g = [d.x, d.y, d.z, m.x, m.y, m.z]
    weight = step * (step * term.stiffness + term.damping)
    add = [jnp.sum(term.force * a) if jnp.ndim(term.force) else term.force * a for a in g]
    return add_outer(matrix, g, weight), _add(right, add)


def _add(a: list[Scalar], b: list[Scalar]) -> list[Scalar]:
    return [x + y for x, y in zip(a, b, strict=True)]
