"""The load on a patella at rest, and how it changes from pose to pose.

Forces and moments, displacements and angles are put on one scale by a lever: a moment counts as moment / lever [N], an
angle as angle * lever [m].
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.dynamics.solve import Lower, add_outer
from pftwin.dynamics.state import Guide, System
from pftwin.effects.base import Instant, Patella
from pftwin.spatial import Pose, Quaternion, Scalar, Vec3, Wrench

LEVER = 0.02  # turns moments into forces and angles into lengths: about the patella's half width [m]


def still(guide: Guide, pose: Pose) -> Instant:
    """The patella at rest at a pose."""
    return guide.instant(Patella.at_rest(pose.position, pose.orientation), 0.0)


def moved(pose: Pose, d: list[Scalar]) -> Pose:
    """The pose displaced by d: metres in the world, and rotation about the body's axes as angle * lever."""
    turn = Quaternion.from_rotation_vector((1 / LEVER) * Vec3(*d[3:]))
    return Pose(pose.position + Vec3(*d[:3]), (pose.orientation * turn).normalised())


def components(w: Wrench) -> list[Scalar]:
    """Force, and moment / lever [N]."""
    f, m = w.force, w.moment
    return [f.x, f.y, f.z, m.x / LEVER, m.y / LEVER, m.z / LEVER]


def residual(system: System, guide: Guide, pose: Pose, memories: tuple[Any, ...]) -> list[Scalar]:
    """Components of all loads together; 0 in an equilibrium."""
    loads, _ = system.loads(still(guide, pose), memories)
    return components(sum((load.total() for load in loads), start=Wrench.zero()))


class Surroundings(NamedTuple):
    """What one pose and its twelve neighbours tell."""

    memories: tuple[Any, ...]
    table: Array  # (13, 6) static loads: here, a little ahead along each axis, a little back
    convex: Lower  # the stiff terms' own stiffness, positive semidefinite

    def residual(self) -> list[Scalar]:
        """Components of the load here."""
        return [self.table[0, i] for i in range(6)]

    def tangent(self) -> Array:
        """(6, 6): what the load loses per displacement [N/m].

        Not symmetric where forces have no potential, as those of meshes' contours have none.
        """
        return ((self.table[7:] - self.table[1:7]) / (2 * difference(self.table.dtype))).T


def look_around(system: System, guide: Guide, pose: Pose, memories: tuple[Any, ...]) -> Surroundings:
    """Loads at a pose and at its twelve neighbours, all at once, so that effects are compiled once."""
    dtype = pose.position.x.dtype
    small = difference(dtype)
    zero = jnp.zeros((), dtype)

    def evaluate(displacement: Array) -> tuple[Array, Any]:
        loads, later = system.loads(still(guide, moved(pose, [displacement[i] for i in range(6)])), memories)
        r = components(sum((load.total() for load in loads), start=Wrench.zero()))
        own = [term for load in loads for term in load.stiff], [load.bed for load in loads if load.bed is not None]
        return jnp.stack(r), (later, own)

    steps = small * jnp.eye(6, dtype=dtype)
    here = jnp.zeros((1, 6), dtype)
    table, rest = jax.vmap(evaluate)(jnp.concatenate([here, steps, -steps]))
    later, (terms, beds) = jax.tree.map(lambda a: a[0], rest)
    convex: Lower = [[zero] * (i + 1) for i in range(6)]
    for term in terms:
        convex = add_outer(convex, components(Wrench(term.direction, term.moment)), term.stiffness)
    for bed in beds:
        scale = jnp.asarray([1.0] * 3 + [1 / LEVER] * 3, dtype)
        own = scale[:, None] * bed.stiffness * scale[None, :]
        convex = [[a + own[i, j] for j, a in enumerate(row)] for i, row in enumerate(convex)]
    return Surroundings(later, table, convex)


def difference(dtype: Any) -> float:
    """The step of the central differences [m]."""
    return 1e-9 if dtype == jnp.float64 else 2e-6
