"""Change of velocity over an implicit step, with forces linearised in it.

Each stiff term is f_end = f - (r k + c) g . dv along its wrench direction g, with r the displacement at the end of the
step per change of velocity. With forces acting for a time h this gives one symmetric positive definite 6 x 6 system,
which is solved for the end forces first (`pftwin.dynamics.integrators.end_of_step`), without contacts that would pull
at the end. See docs/physics.md.
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
FEW = 4  # up to this many bilateral terms, a system with one row per term is smaller than the 6 x 6 one


class Span(NamedTuple):
    """Time for which forces act, and displacement per change of velocity."""

    impulse: Scalar  # impulse per end force [s]
    displacement_gain: Scalar  # displacement at the end of the step per change of velocity [s]


def change_of_velocity(system: System, inertial: Wrench, loads: list[Load], span: Span) -> list[Scalar]:
    """Change of linear (world axes) and angular velocity (patella axes) from inertial forces and predicted loads."""
    step = span.impulse
    right = six(inertial.force, inertial.moment)
    for load in loads:
        for wrench in (load.wrench, None if load.drag is None else load.drag.wrench()):
            if wrench is not None:
                right = [a + b for a, b in zip(right, six(wrench.force, wrench.moment), strict=True)]
    right = [step * a for a in right]
    diagonal = _diagonal(system, loads, span)
    terms = [term for load in loads for term in load.stiff]
    bilateral = [t for t in terms if not t.unilateral]
    beds = [load.bed for load in loads if load.bed is not None]
    if beds or any(jnp.ndim(t.force) for t in terms) or len(bilateral) > FEW:
        mass: Lower = [[jnp.zeros_like(step)] * i + [d] for i, d in enumerate(diagonal)]
        for bed in beds:
            more = step * bed.slope(span.displacement_gain)
            mass = [[a + more[i, j] for j, a in enumerate(row)] for i, row in enumerate(mass)]
            right = [a + step * bed.force[i] for i, a in enumerate(right)]
        for term in bilateral:
            mass, right = _with_term(mass, right, term, span)
        bilateral = []
    else:
        mass = diagonal  # type: ignore[assignment]
    constraints = [
        ConstraintRow(six(t.direction, t.moment), step * t.force, _weight(t, span), t.unilateral)
        for t in (*bilateral, *(t for t in terms if t.unilateral))
    ]
    return end_of_step(mass, constraints, right)[0]


def _weight(term: StiffTerm, span: Span) -> Scalar:
    return span.impulse * (span.displacement_gain * term.stiffness + term.damping)


def load_at_end(load: Load, dv: list[Scalar], displacement_gain: Scalar) -> Load:
    """The load at the end of the step, with its linearised forces at the change of velocity dv."""
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
    """Mass and moments of inertia, plus the contributions of drags and of the rotation of forces.

    A force f that rotates with the body acts as a spring transverse to its direction: about f / SPAN against
    displacement, and f LEVER against rotation, times h r. An estimate is enough: it keeps large steps stable, and does
    not affect the order of the step. Contacts that would pull at the predicted pose are omitted, since they could make
    the mass negative.
    """
    terms = [term for load in loads for term in load.stiff]
    forces = [jnp.sum(jnp.where(t.force > 0, t.force, 0.0)) for t in terms]
    forces += [load.bed.size for load in loads if load.bed is not None]
    total = sum(forces, start=jnp.zeros_like(span.impulse))
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
