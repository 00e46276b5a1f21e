"""A contact law at one contact, as the stiff term that an implicit step asks for."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from pftwin.base.spatial import Scalar, Vec3
from pftwin.model.effects.base import Instant, StiffTerm
from pftwin.model.effects.contact_law import ContactLaw


class ContactPush(NamedTuple):
    """What a contact does, and what it remembers."""

    term: StiffTerm
    energy: Scalar  # stored [J]
    approach_speed: Scalar | None  # at the moment the contact began, 0 while apart [m/s]; None: the law forgets


def pushed(
    law: ContactLaw,
    now: Instant,
    indentation: Scalar,
    rate: Scalar,
    direction: Vec3,
    moment: Vec3,
    approach_speed: Scalar | None,
    share: Scalar,
) -> ContactPush:
    """A law's force along a direction.

    Args:
        law: the normal contact law.
        now: the instant; its `lookahead` says how far ahead of a step's start it is.
        indentation, rate: [m], [m/s].
        direction, moment: of a unit force on the patella: world axes, and patella axes about the centre of mass [m].
        approach_speed: what `approach_speed` was at the last look.
        share: of the law's force that this contact bears.
    """
    if approach_speed is not None:
        begun = jnp.where(approach_speed > 0, approach_speed, jnp.maximum(rate, 1e-12))
        approach_speed = jnp.where(indentation > 0, begun, 0.0)
    # Sliding along a curve, a tangent leads off the surface: linearised about the deeper of where the step starts
    # and where it leads, contact does not open and close from step to step.
    # The viscous part is left to the step as well, which sees that the force does not pull.
    if isinstance(now.lookahead, float):
        force = law.force(indentation, rate, approach_speed)
    else:
        deeper = jnp.where(rate < 0, -now.lookahead * rate, 0.0)
        force = law.force(indentation + deeper, jnp.zeros_like(rate), approach_speed)
        back = force.elastic - deeper * force.stiffness
        force = force._replace(total=back + force.damping * rate, elastic=back)
    total, elastic, stiffness, damping, energy = (share * a for a in force)
    term = StiffTerm(direction, moment, total, elastic, stiffness, damping, rate, unilateral=True)
    return ContactPush(term, energy, approach_speed)
