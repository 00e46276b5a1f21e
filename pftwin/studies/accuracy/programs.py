"""The compiled functions whose times are taken: one run with all results, many variants, and derivatives."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from pftwin.dynamics.batch.batched import batched
from pftwin.dynamics.equilibrium import Solution
from pftwin.dynamics.frame_states import frame_states
from pftwin.dynamics.integrators import integrator_from_text
from pftwin.dynamics.observe import Observation, observe, tracked_center
from pftwin.model.scene import Scene

VARIANTS = 64
SPREAD = 0.02  # of the variants' mass, to either side
COLUMNS = 4  # parameters that derivatives are taken by, at most
FITTED = (".stiffness", ".slack_length")


class Programs(NamedTuple):
    """Functions of (scene's arrays, start, number of steps), not compiled yet; the number is traced."""

    arrays: Any
    one: Callable[..., Any]  # with all results
    path: Callable[..., Any]  # with the tracked point's path alone, as the following two
    many: Callable[..., Any]
    columns: Callable[..., Any]
    n_columns: int


def programs(scene: Scene, integrator: str) -> Programs:
    """Those of a scene and an integrator."""
    chosen = integrator_from_text(integrator)
    arrays, fixed = eqx.partition(scene.unnamed(), eqx.is_array)

    def run(a: Any, start: Solution, substeps: Array) -> Observation:
        whole = eqx.combine(a, fixed)
        return observe(whole, frame_states(whole, integrator=chosen, substeps=substeps, start=start))

    def tracked(whole: Scene, start: Solution, substeps: Array) -> Array:
        states = frame_states(whole, integrator=chosen, substeps=substeps, start=start).states
        return tracked_center(whole, states).array()

    def path(a: Any, start: Solution, substeps: Array) -> Array:
        return tracked(eqx.combine(a, fixed), start, substeps)

    def variants(a: Any, start: Solution, substeps: Array) -> Array:
        whole = eqx.combine(a, fixed)
        factors = jnp.asarray(np.linspace(1 - SPREAD, 1 + SPREAD, VARIANTS), dtype=float)

        def one(factor: Array) -> Array:
            return tracked(eqx.tree_at(lambda s: s.patella.mass, whole, whole.patella.mass * factor), start, substeps)

        return batched(one)(factors)

    numbers = _parameters(scene)

    def derivatives(a: Any, start: Solution, substeps: Array) -> Array:
        leaves, structure = jax.tree.flatten(eqx.combine(a, fixed))

        def by(factors: Array) -> Array:
            own = list(leaves)
            for k, number in enumerate(numbers):
                own[number] = own[number] * factors[k]
            return tracked(jax.tree.unflatten(structure, own), start, substeps)

        return jax.jacfwd(by)(jnp.ones(len(numbers)))

    return Programs(arrays, run, path, variants, derivatives, len(numbers))


def _parameters(scene: Scene) -> list[int]:
    """Leaves of the scene: stiffness and slack length of the first tendons; of a scene without any the mass."""
    leaves = jax.tree_util.tree_leaves_with_path(scene)
    names = [str(path[-1]) for path, _ in leaves]
    found = [i for i, (_, leaf) in enumerate(leaves) if names[i] in FITTED and jnp.ndim(leaf) == 0]
    return found[:COLUMNS] or [names.index(".mass")]
