"""The plan of measurements: contact models, integrators, float types and steps, and the functions to time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from pftwin.base.errors import InputError
from pftwin.dynamics.batch.batched import batched
from pftwin.dynamics.equilibrium import Solution
from pftwin.dynamics.frame_states import frame_states
from pftwin.dynamics.integrators import integrator_from_text
from pftwin.dynamics.observe import Observation, observe, tracked_center
from pftwin.model.scene import Scene

VARIANTS = 64
SPREAD = 0.02  # range of the variants' mass, to either side
COLUMNS = 4  # most parameters for derivatives
FITTED = (".stiffness", ".slack_length")


class Programs(NamedTuple):
    """Functions of (scene's arrays, start, number of steps), not compiled yet; the number is traced."""

    arrays: Any
    one: Callable[..., Any]  # with all results
    path: Callable[..., Any]  # with the tracked point's path alone, as the following two
    many: Callable[..., Any]
    columns: Callable[..., Any]


def programs(scene: Scene, integrator: str) -> Programs:
    """The functions to time for a scene and an integrator."""
    chosen = integrator_from_text(integrator)
    arrays, fixed = eqx.partition(scene.unnamed(), eqx.is_array)

    def run(whole: Scene, start: Solution, substeps: Array) -> Observation:
        return observe(whole, frame_states(whole, integrator=chosen, substeps=substeps, start=start))

    def tracked(whole: Scene, start: Solution, substeps: Array) -> Array:
        states = frame_states(whole, integrator=chosen, substeps=substeps, start=start).states
        return tracked_center(whole, states).array()

    def variants(whole: Scene, start: Solution, substeps: Array) -> Array:
        factors = jnp.asarray(np.linspace(1 - SPREAD, 1 + SPREAD, VARIANTS), dtype=float)

        def one(factor: Array) -> Array:
            return tracked(eqx.tree_at(lambda s: s.patella.mass, whole, whole.patella.mass * factor), start, substeps)

        return batched(one)(factors)

    numbers = _parameters(scene)

    def derivatives(whole: Scene, start: Solution, substeps: Array) -> Array:
        leaves, structure = jax.tree.flatten(whole)

        def by(factors: Array) -> Array:
            own = list(leaves)
            for k, number in enumerate(numbers):
                own[number] = own[number] * factors[k]
            return tracked(jax.tree.unflatten(structure, own), start, substeps)

        return jax.jacfwd(by)(jnp.ones(len(numbers)))

    def of_arrays(function: Callable[..., Any]) -> Callable[..., Any]:
        return lambda a, *given: function(eqx.combine(a, fixed), *given)

    return Programs(arrays, *map(of_arrays, (run, tracked, variants, derivatives)))


def _parameters(scene: Scene) -> list[int]:
    """Leaves of the scene: stiffness and slack length of the first tendons; of a scene without any the mass."""
    leaves = jax.tree_util.tree_leaves_with_path(scene)
    names = [str(path[-1]) for path, _ in leaves]
    found = [i for i, (_, leaf) in enumerate(leaves) if names[i] in FITTED and jnp.ndim(leaf) == 0]
    return found[:COLUMNS] or [names.index(".mass")]


SUBSTEPS = (1, 2, 5, 10, 20, 50)  # of 10 ms frames: 10 to 0.2 ms
SHORT = (10, 20, 50, 100, 200)  # explicit steps are unstable in contact above 0.4 ms
ADAPTIVE = (1, 2, 10)  # the solver chooses its own steps within these intervals
REFERENCE = 256  # substeps of the converged run
ON_MESHES = (1, 2, 5, 10, 20)  # 0.5 ms: what the meshes' facets cost is more than shorter steps gain
REFERENCE_ON_MESHES = 100
CYLINDER = "-cylinder"  # ending of a patch's name: over a cylinder instead of a plane
SMOOTH = ("P2", "P4", "P5", "P5-cylinder", "P8", "spline")
MESHES = ("CM", "FM", "volume")
COMMON = ("linear_implicit", "linear_implicit_bdf2", "newmark", "quasi_static")
FURTHER = ("symplectic_euler", "diffrax:Tsit5")
PAPERS = "ali3p"  # some hundred times slower than the rest: measured on P5 and the coarse mesh only
LONG = (1, 2, 5, 10)  # its steps, 1 ms as in the paper among them
FLOATS = ("float64", "float32")


class MeasuredProgram(NamedTuple):
    """One program to measure: everything but the step."""

    contact: str
    integrator: str
    dtype: str
    batch: bool  # whether many variants side by side are measured too
    gradient: bool  # and derivatives

    @property
    def substeps(self) -> tuple[int, ...]:
        """Numbers of steps between two frames."""
        name = self.integrator
        if name.startswith("diffrax"):
            return ADAPTIVE
        steps = ON_MESHES if self.contact in MESHES else SUBSTEPS
        return {"symplectic_euler": SHORT, PAPERS: LONG}.get(name, steps)


def chosen(contacts: Sequence[str], integrators: Sequence[str], floats: Sequence[str]) -> list[MeasuredProgram]:
    """All combinations, with batches and derivatives; InputError for an unknown integrator or float type."""
    for name in integrators:
        integrator_from_text(name)
    for name in floats:
        if name not in FLOATS:
            raise InputError(f"no float type {name!r}", where="--dtype", expected=f"one of: {', '.join(FLOATS)}")
    return [MeasuredProgram(c, i, d, True, True) for c in contacts for i in integrators for d in floats]


def full_table() -> list[MeasuredProgram]:
    """The whole table. Single precision on P5; batches and derivatives for the steps that batches are for, and of every
    integrator on P5.
    """
    stepping, found = COMMON[:2], []
    for contact in (*SMOOTH, *MESHES):
        smooth, chief = contact in SMOOTH, contact == "P5"
        # Contours' forces jump from facet to facet: `quasi_static` refuses them. By volume it takes minutes.
        for integrator in (*COMMON, *FURTHER) if smooth else COMMON[:3]:
            more = smooth and (chief or integrator in stepping)
            found.append(MeasuredProgram(contact, integrator, "float64", more, more))
        if chief:
            found += [MeasuredProgram(contact, name, "float32", name in stepping, False) for name in COMMON]
        if contact in ("P5", "CM"):
            found.append(MeasuredProgram(contact, PAPERS, "float64", False, False))
    return found
