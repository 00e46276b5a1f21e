"""The change of velocity over an implicit step under forces that are linearised in it.

Each stiff term is f_end = f - (r k + c) g . dv along its wrench direction g, with r the displacement at the step's end
per change of velocity. With forces acting for a time h this gives one symmetric positive definite 6 x 6 system, which
is solved for the end forces first (`pftwin.dynamics.integrators.end_of_step`), leaving out contacts that would end up
pulling. See docs/physics.md.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp

from pftwin.base.spatial import Scalar, Vec3, Wrench
from pftwin.dynamics.integrators.end_of_step import ConstraintRow, end_of_step
from pftwin.dynamics.solve import Lower, add_outer, six
from pftwin.dynamics.state import System
from pftwin.model.effects.base import Load, StiffTerm

SPAN = 0.07  # typical length of a line of force [m]
LEVER = 0.02  # typical arm of a force on the patella [m]
FEW = 4  # up to this many two-sided terms, a system with one row per term is smaller than the 6 x 6 one


class Span(NamedTuple):
    """How long forces act, and the displacement that a change of velocity causes."""

    impulse: Scalar  # an end force's time in the change of velocity [s]
    displacement_gain: Scalar  # displacement at the step's end per change of velocity [s]


def change_of_velocity(system: System, inertial: Wrench, loads: list[Load], span: Span) -> list[Scalar]:
    """Six components, world axes, then patella axes, under inertial forces and the loads at unchanged velocity."""
    step = span.impulse
    right = six(inertial.force, inertial.moment)
    for load in loads:
        for wrench in (load.wrench, None if load.drag is None else load.drag.wrench()):
            if wrench is not None:
                right = [a + b for a, b in zip(right, six(wrench.force, wrench.moment), strict=True)]
    right = [step * a for a in right]
    diagonal = _diagonal(system, loads, span)
    terms = [term for load in loads for term in load.stiff]
    two_sided = [t for t in terms if not t.unilateral]
    beds = [load.bed for load in loads if load.bed is not None]
    if beds or any(jnp.ndim(t.force) for t in terms) or len(two_sided) > FEW:
        mass: Lower = [[jnp.zeros_like(step)] * i + [d] for i, d in enumerate(diagonal)]
        for bed in beds:
            more = step * bed.slope(span.displacement_gain)
            mass = [[a + more[i, j] for j, a in enumerate(row)] for i, row in enumerate(mass)]
            right = [a + step * bed.force[i] for i, a in enumerate(right)]
        for term in two_sided:
            mass, right = _with_term(mass, right, term, span)
        two_sided = []
    else:
        mass = diagonal  # type: ignore[assignment]
    pushes = [
        ConstraintRow(six(t.direction, t.moment), step * t.force, _weight(t, span), t.unilateral)
        for t in (*two_sided, *(t for t in terms if t.unilateral))
    ]
    return end_of_step(mass, pushes, right)[0]


def _weight(term: StiffTerm, span: Span) -> Scalar:
    return span.impulse * (span.displacement_gain * term.stiffness + term.damping)


def load_at_end(load: Load, dv: list[Scalar], displacement_gain: Scalar) -> Load:
    """The load at the end of the step, with the forces that the solve has used."""
    load = load._replace(stiff=tuple(_at_end(term, dv, displacement_gain) for term in load.stiff))
    if load.bed is None:
        return load
    force = load.bed.force - load.bed.slope(displacement_gain) @ jnp.stack(dv)
    elastic = load.bed.elastic - displacement_gain * load.bed.stiffness @ jnp.stack(dv)
    return load._replace(bed=eqx.tree_at(lambda b: (b.force, b.elastic), load.bed, (force, elastic)))


def _at_end(term: StiffTerm, dv: list[Scalar], displacement_gain: Scalar) -> StiffTerm:
    """See `load_at_end`."""
    change = term.direction.dot(Vec3(*dv[:3])) + term.moment.dot(Vec3(*dv[3:]))
    elastic = term.elastic - displacement_gain * term.stiffness * change
    force = term.force - (displacement_gain * term.stiffness + term.damping) * change
    if term.unilateral:
        force, elastic = jnp.maximum(force, 0.0), jnp.maximum(elastic, 0.0)
    return eqx.tree_at(lambda t: (t.force, t.elastic), term, (force, elastic))


def _diagonal(system: System, loads: list[Load], span: Span) -> list[Scalar]:
    """Mass and moments of inertia, the drags' contribution, and that of the turning of forces, times h r.

    A force f that turns with the body acts as a spring across its own direction: about f / SPAN against displacement,
    f LEVER against rotation. Its rough size is enough: the order of the step does not depend on it, and it keeps large
    steps stable. A contact that would pull at the predicted pose is left out, since a negative contribution could make
    the mass negative.
    """
    terms = [term for load in loads for term in load.stiff]
    pushes = [jnp.sum(jnp.where(t.force > 0, t.force, 0.0)) for t in terms]
    pushes += [load.bed.size for load in loads if load.bed is not None]
    total = sum(pushes, start=jnp.zeros_like(span.impulse))
    across = system.mass + (span.impulse * span.displacement_gain / SPAN) * total
    about = (span.impulse * span.displacement_gain * LEVER) * total
    for load in loads:
        if load.drag is not None:
            across = across + span.impulse * load.drag.translational
            about = about + span.impulse * load.drag.rotational
    i = system.inertia
    return [across, across, across, i.x + about, i.y + about, i.z + about]


def _with_term(mass: Lower, right: list[Scalar], term: StiffTerm, span: Span) -> tuple[Lower, list[Scalar]]:
    """Adds w g g^T and the impulse along g; a group is summed over its leading axis."""
    g = six(term.direction, term.moment)
    impulse = span.impulse * term.force
    add = [jnp.sum(impulse * a) if jnp.ndim(impulse) else impulse * a for a in g]
    return add_outer(mass, g, _weight(term, span)), [a + b for a, b in zip(right, add, strict=True)]
