r"""How stiff a load is: the longest step at which an explicit method would stay stable with it alone.

With M the mass matrix, K = sum k g g^T and C = sum c g g^T over the load's stiff terms (and its bed's and its drag's),
the fastest oscillation has w^2 = |M^-1/2 K M^-1/2| and damping rate y = |M^-1/2 C M^-1/2|. The semi-implicit
(symplectic) Euler method with damping taken at the step's start,

    v' = v - h (w^2 x + y v),   x' = x + h v',

is stable up to h = 4 / (y + sqrt(y^2 + 4 w^2)). Norms are Frobenius': for one term exact, for a group at most sqrt(6)
above the largest eigenvalue, so the step named is at most that much too short.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.spatial import Scalar, Vec3
from pftwin.dynamics.state import System
from pftwin.model.effects.base import Load, StiffTerm


class Rates(NamedTuple):
    """The fastest motions that a load makes."""

    oscillation: Scalar  # w^2 [1/s^2]
    damping: Scalar  # y [1/s]

    def longest_step(self) -> Scalar:
        """That an explicit method could take; infinite where there is neither spring nor damper [s]."""
        rate = self.damping + jnp.sqrt(jnp.square(self.damping) + 4 * self.oscillation)
        return jnp.where(rate > 0, 4 / jnp.where(rate > 0, rate, 1.0), jnp.inf)


def rates(system: System, loads: list[tuple[float, Load]]) -> Rates:
    """Of a sum of loads with their signs."""
    i = system.inertia
    lighter = 1 / jnp.sqrt(jnp.stack([system.mass, system.mass, system.mass, i.x, i.y, i.z]))
    springs = dampers = jnp.zeros((6, 6), lighter.dtype)
    for sign, load in loads:
        for term in load.stiff:
            springs = springs + sign * _gram(term, term.stiffness)
            dampers = dampers + sign * _gram(term, term.damping)
        if load.bed is not None:
            springs = springs + sign * load.bed.stiffness
            dampers = dampers + sign * load.bed.damping_time * load.bed.stiffness
        if load.drag is not None:
            three = jnp.ones(3, lighter.dtype)
            drag = jnp.concatenate([load.drag.translational * three, load.drag.rotational * three])
            dampers = dampers + sign * jnp.diag(drag)
    scale = lighter[:, None] * lighter[None, :]
    return Rates(*(jnp.sqrt(jnp.sum(jnp.square(scale * a))) for a in (springs, dampers)))


def _gram(term: StiffTerm, weight: Scalar) -> Array:
    """The sum of w g g^T over a term's group."""
    parts = (*_components(term.direction), *_components(term.moment))
    rows = jnp.stack([jnp.ravel(jnp.broadcast_to(a, jnp.shape(weight))) for a in parts])
    return (rows * jnp.ravel(weight)[None, :]) @ rows.T


def _components(v: Vec3) -> tuple[Scalar, Scalar, Scalar]:
    return v.x, v.y, v.z
