"""Load on a patella at rest, and its tangent stiffness.

A lever gives forces and moments, displacements and angles the same units: a moment counts as moment / lever [N], an
angle as angle * lever [m].
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.spatial import Pose, Quaternion, Scalar, Vec3, Wrench
from pftwin.dynamics.solve import Lower, add_outer
from pftwin.dynamics.state import Guide, System
from pftwin.model.effects.base import AggregateStiffness, Drag, Instant, Patella, StiffTerm

LEVER = 0.02  # converts moments to forces and angles to lengths: about half the patella's width [m]


def patella_at_rest(guide: Guide, pose: Pose) -> Instant:
    """The instant with the patella at rest at a pose of its centre of mass."""
    return guide.instant(Patella.at_rest(pose.position, pose.orientation), 0.0)


def displaced_pose(pose: Pose, d: list[Scalar]) -> Pose:
    """The pose displaced by d: translation in world axes [m], rotation about the body's axes as angle * lever [m]."""
    turn = Quaternion.from_rotation_vector((1 / LEVER) * Vec3(*d[3:]))
    return Pose(pose.position + Vec3(*d[:3]), (pose.orientation * turn).normalised())


def components(w: Wrench) -> list[Scalar]:
    """Components of a wrench: force, and moment / lever [N]."""
    f, m = w.force, w.moment
    return [f.x, f.y, f.z, m.x / LEVER, m.y / LEVER, m.z / LEVER]


def residual(system: System, guide: Guide, pose: Pose, memories: tuple[Any, ...]) -> list[Scalar]:
    """Components of the total load [N]; 0 in an equilibrium."""
    loads, _ = system.loads(patella_at_rest(guide, pose), memories)
    return components(sum((load.total() for load in loads), start=Wrench.zero()))


class Surroundings(NamedTuple):
    """Loads at a pose and at its twelve neighbours, for central differences."""

    memories: tuple[Any, ...]
    table: Array  # (13, 6) loads: at the pose, and displaced forwards and backwards along each axis
    terms: list[StiffTerm]  # at the pose
    beds: list[AggregateStiffness]
    drags: list[Drag]

    def residual(self) -> list[Scalar]:
        """Components of the load at the pose [N]."""
        return [self.table[0, i] for i in range(6)]

    def tangent(self) -> Array:
        """(6, 6) tangent stiffness: decrease of the load per displacement [N/m].

        It is not symmetric where forces have no potential, e.g. for mesh contact by contours.
        """
        return ((self.table[7:] - self.table[1:7]) / (2 * difference(self.table.dtype))).T

    def convex(self) -> list[list[Scalar]]:
        """(6, 6) stiffness of the stiff terms and foundations alone, positive semidefinite [N/m]."""
        return self._summed([t.stiffness for t in self.terms], [b.stiffness for b in self.beds])

    def viscosity(self) -> list[list[Scalar]]:
        """(6, 6) damping: decrease of the load per velocity [N s/m] from stiff terms, foundations and drags."""
        rows = self._summed([t.damping for t in self.terms], [b.damping_time * b.stiffness for b in self.beds])
        for drag in self.drags:
            each = [drag.translational] * 3 + [drag.rotational / LEVER**2] * 3
            rows = [[a + each[i] if i == j else a for j, a in enumerate(row)] for i, row in enumerate(rows)]
        return rows

    def _summed(self, weights: list[Scalar], beds: list[Array]) -> list[list[Scalar]]:
        zero = jnp.zeros((), self.table.dtype)
        low: Lower = [[zero] * (i + 1) for i in range(6)]
        for term, weight in zip(self.terms, weights, strict=True):
            low = add_outer(low, components(Wrench(term.direction, term.moment)), weight)
        scale = jnp.asarray([1.0] * 3 + [1 / LEVER] * 3, self.table.dtype)
        for own in beds:
            scaled = scale[:, None] * own * scale[None, :]
            low = [[a + scaled[i, j] for j, a in enumerate(row)] for i, row in enumerate(low)]
        return [[low[max(i, j)][min(i, j)] for j in range(6)] for i in range(6)]


def look_around(
    system: System,
    instant_at: Callable[[list[Scalar]], Instant],
    memories: tuple[Any, ...],
    like: Scalar,
    *,
    neighbours: bool = True,
) -> Surroundings:
    """Evaluates loads at a pose and at its twelve neighbours in one batch, so that effects are compiled once.

    The evaluation is the body of a loop that runs once, since XLA stores results of a loop instead of recomputing them
    at every use.

    Args:
        system, memories: the effects, and their memories.
        instant_at: the instant for a displacement of the pose [m, angles * lever].
        like: a traced scalar of the desired float type; its value does not matter.
        neighbours: whether to evaluate the neighbours, which the tangent needs.
    """
    dtype = like.dtype
    small = difference(dtype) * jnp.eye(6, dtype=dtype)
    here = jnp.zeros((1, 6), dtype)
    places = jnp.concatenate([here, small, -small]) if neighbours else here

    def evaluate(*displacement: Scalar) -> tuple[list[Scalar], Any]:
        loads, later = system.loads(instant_at(list(displacement)), memories)
        r = components(sum((load.total() for load in loads), start=Wrench.zero()))
        terms = [term for load in loads for term in load.stiff]
        beds = [load.bed for load in loads if load.bed is not None]
        return r, (later, terms, beds, [load.drag for load in loads if load.drag is not None])

    def once(_: Any) -> tuple[Scalar, Any]:
        r, rest = jax.vmap(evaluate)(*places.T)
        return jnp.array(False), (r, jax.tree.map(lambda a: a[0], rest))

    kinds = jax.eval_shape(lambda: once(None)[1])
    always = (like > -jnp.inf) | ~(like > 0)  # true, but XLA must not be able to prove it and remove the loop
    zero = jnp.where(always, 0.0, 0.0)  # batched where `like` is, which saves `vmap` from tracing the loop again
    nothing = jax.tree.map(lambda a: jnp.broadcast_to(zero.astype(a.dtype), a.shape), kinds)
    r, (later, terms, beds, drags) = jax.lax.while_loop(lambda now: now[0], once, (always, nothing))[1]
    return Surroundings(later, jnp.stack(r, axis=1), terms, beds, drags)


def difference(dtype: Any) -> float:
    """Step of the central differences [m]."""
    return 1e-9 if dtype == jnp.float64 else 2e-6
