r"""The linearly implicit step: one force evaluation, every stiff direction of every effect treated implicitly.

Forces are evaluated where the step would end at the present velocity, with the guided bodies at the step's end; so the
lag of a slow, guided motion is of second order. From there each stiff term, a force f(s, s') along the wrench
direction g, is linearised in the change of velocity dv,

    f_end = f - (h k + c) g . dv,

which makes one symmetric positive definite 6 x 6 system (one Newton iteration of backward Euler),

    (M + sum_i w_i g_i g_i^T) dv = h (f_rest + sum_i g_i f_i),      w_i = h (h k_i + c_i),

solved for the end forces first (`pftwin.dynamics.end_of_step`), without those contacts that would end the step with a
pull. No iteration beyond that, any number of terms, unconditionally stable along the g_i; order one.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp

from pftwin.dynamics.end_of_step import Push, end_of_step
from pftwin.dynamics.ledger import Ledger
from pftwin.dynamics.solve import Lower, add_outer
from pftwin.dynamics.state import Guide, State, System, advance, gyroscopic
from pftwin.effects.base import Load, StiffTerm
from pftwin.spatial import Scalar, Vec3, Wrench

ORDER = 1
SPAN = 0.07  # typical length of a line of force [m]
LEVER = 0.02  # typical arm of a force on the patella [m]
FEW = 4  # two-sided terms up to which a system of one row per term is smaller than one of six
GUIDED_AT = 1.0  # where in the step the guided bodies are looked at: its end


def linear_implicit(
    system: System, state: State, guide: Guide, step: Scalar, ledger: Ledger | None = None
) -> tuple[State, Ledger | None]:
    """The state one step later, and the energy ledger where one is kept."""
    with jax.named_scope("loads"):
        ahead = advance(state, state.velocity, state.spin, step, state.memories).patella()
        loads, memories = system.loads(guide.instant(ahead, step, step), state.memories)
    with jax.named_scope("implicit_solve"):
        dv = _change_of_velocity(system, state, loads, step)
    after = advance(state, state.velocity + Vec3(*dv[:3]), state.spin + Vec3(*dv[3:]), step, memories)
    if ledger is not None:
        ends = [_load_at_end(load, dv, step) for load in loads]
        ledger = ledger.entered(state, after, ends, [t.force for load in ends for t in load.stiff], 1.0, step)
    return after, ledger


def _change_of_velocity(system: System, state: State, loads: list[Load], step: Scalar) -> list[Scalar]:
    """Six components: world axes, then patella axes."""
    rest = gyroscopic(system.inertia, state.spin)
    right = [jnp.zeros_like(step)] * 3 + [rest.x, rest.y, rest.z]
    for load in loads:
        for wrench in (load.wrench, None if load.drag is None else load.drag.wrench()):
            if wrench is not None:
                right = [a + b for a, b in zip(right, _components(wrench), strict=True)]
    right = [step * a for a in right]
    diagonal = _diagonal(system, loads, step)
    terms = [term for load in loads for term in load.stiff]
    two_sided = [t for t in terms if not t.unilateral]
    beds = [load.bed for load in loads if load.bed is not None]
    if beds or any(jnp.ndim(t.force) for t in terms) or len(two_sided) > FEW:
        mass: Lower = [[jnp.zeros_like(step)] * i + [d] for i, d in enumerate(diagonal)]
        for bed in beds:
            more = step * bed.slope(step)
            mass = [[a + more[i, j] for j, a in enumerate(row)] for i, row in enumerate(mass)]
            right = [a + step * bed.force[i] for i, a in enumerate(right)]
        for term in two_sided:
            mass, right = _with_term(mass, right, term, step)
        two_sided = []
    else:
        mass = diagonal  # type: ignore[assignment]
    pushes = [
        Push(_components(Wrench(t.direction, t.moment)), step * t.force, _weight(t, step), t.unilateral)
        for t in (*two_sided, *(t for t in terms if t.unilateral))
    ]
    return end_of_step(mass, pushes, right)[0]


def _components(w: Wrench) -> list[Scalar]:
    return [w.force.x, w.force.y, w.force.z, w.moment.x, w.moment.y, w.moment.z]


def _weight(term: StiffTerm, step: Scalar) -> Scalar:
    return step * (step * term.stiffness + term.damping)


def _load_at_end(load: Load, dv: list[Scalar], step: Scalar) -> Load:
    """The load as it is at the end of the step, with the forces that the solve has reckoned with."""
    load = load._replace(stiff=tuple(_at_end(term, dv, step) for term in load.stiff))
    if load.bed is None:
        return load
    force = load.bed.force - load.bed.slope(step) @ jnp.stack(dv)
    elastic = load.bed.elastic - step * load.bed.stiffness @ jnp.stack(dv)
    return load._replace(bed=eqx.tree_at(lambda b: (b.force, b.elastic), load.bed, (force, elastic)))


def _at_end(term: StiffTerm, dv: list[Scalar], step: Scalar) -> StiffTerm:
    """See `_load_at_end`."""
    change = term.direction.dot(Vec3(*dv[:3])) + term.moment.dot(Vec3(*dv[3:]))
    elastic = term.elastic - step * term.stiffness * change
    force = term.force - (step * term.stiffness + term.damping) * change
    if term.unilateral:
        force = jnp.maximum(force, 0.0)
    return eqx.tree_at(lambda t: (t.force, t.elastic), term, (force, elastic))


def _diagonal(system: System, loads: list[Load], step: Scalar) -> list[Scalar]:
    """Mass and moments of inertia, the drags' share, and h^2 times what the forces' turning amounts to.

    A force f that turns with the body is a spring across its own direction: about f / SPAN against displacement,
    f LEVER against rotation. Only its size matters here: the step stays of the same order whatever is added, and large
    steps stay stable. A contact that would pull at the predicted pose counts for nothing: a negative share would make
    the body lighter than it is, or its mass negative.
    """
    terms = [term for load in loads for term in load.stiff]
    pushes = [jnp.sum(jnp.where(t.force > 0, t.force, 0.0)) for t in terms]
    pushes += [load.bed.size for load in loads if load.bed is not None]
    total = sum(pushes, start=jnp.zeros_like(step))
    across = system.mass + (step * step / SPAN) * total
    about = (step * step * LEVER) * total
    for load in loads:
        if load.drag is not None:
            across = across + step * load.drag.translational
            about = about + step * load.drag.rotational
    i = system.inertia
    return [across, across, across, i.x + about, i.y + about, i.z + about]


def _with_term(mass: Lower, right: list[Scalar], term: StiffTerm, step: Scalar) -> tuple[Lower, list[Scalar]]:
    """Adds w g g^T and the impulse along g; a group is summed over its leading axis."""
    g = _components(Wrench(term.direction, term.moment))
    impulse = step * term.force
    add = [jnp.sum(impulse * a) if jnp.ndim(impulse) else impulse * a for a in g]
    return add_outer(mass, g, _weight(term, step)), [a + b for a, b in zip(right, add, strict=True)]
