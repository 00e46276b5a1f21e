"""Plan of the accuracy study (contact models, integrators, float types, steps) and the functions to time."""

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
from pftwin.dynamics.integrator_text import integrator_from_text
from pftwin.dynamics.observe import Observation, observe, tracked_center
from pftwin.model.scene import Scene

VARIANTS = 64
SPREAD = 0.02  # relative range of the variants' mass, to either side
COLUMNS = 4  # largest number of parameters for derivatives
FITTED = (".stiffness", ".slack_length")


class Programs(NamedTuple):
    """Uncompiled functions of (arrays of the scene, start, number of steps per frame); the number is traced."""

    arrays: Any  # of the scene
    one: Callable[..., Any]  # one run with all observations
    path: Callable[..., Any]  # one run; like the next two, it returns only the tracked point's path
    many: Callable[..., Any]  # a batch of variants
    columns: Callable[..., Any]  # derivatives


def programs(scene: Scene, integrator: str) -> Programs:
    """Returns the functions to time for a scene and an integrator."""
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
    """Indices of the leaves to differentiate by: stiffness and slack length of the first tendons, or else the mass."""
    leaves = jax.tree_util.tree_leaves_with_path(scene)
    names = [str(path[-1]) for path, _ in leaves]
    found = [i for i, (_, leaf) in enumerate(leaves) if names[i] in FITTED and jnp.ndim(leaf) == 0]
    return found[:COLUMNS] or [names.index(".mass")]


SUBSTEPS = (1, 2, 5, 10, 20, 50)  # steps per frame of 10 ms: 10 to 0.2 ms
SHORT = (10, 20, 50, 100, 200)  # explicit steps are unstable in contact above 0.4 ms
ADAPTIVE = (1, 2, 10)  # the solver chooses its own steps within these intervals
REFERENCE = 256  # substeps of the converged run
ON_MESHES = (1, 2, 5, 10, 20)  # down to 0.5 ms: with shorter steps, the error of the meshes' facets dominates
REFERENCE_ON_MESHES = 100
CYLINDER = "-cylinder"  # suffix of the name of a patch over a cylinder instead of a plane
SMOOTH = ("P2", "P4", "P5", "P5-cylinder", "P8", "spline")
MESHES = ("CM", "FM", "volume")
COMMON = ("linear_implicit", "linear_implicit_bdf2", "newmark", "quasi_static")
FURTHER = ("symplectic_euler", "diffrax:Tsit5")
PAPERS = "ali3p"  # about a hundred times slower than the others: measured only on P5 and the coarse mesh
LONG = (1, 2, 5, 10)  # its steps per frame, including 1 ms as in the paper
FLOATS = ("float64", "float32")


class MeasuredProgram(NamedTuple):
    """One program to measure, at several steps."""

    contact: str
    integrator: str
    dtype: str
    batch: bool  # whether a batch of variants is measured too
    gradient: bool  # whether derivatives are measured too

    @property
    def substeps(self) -> tuple[int, ...]:
        """Numbers of steps per frame to measure."""
        name = self.integrator
        if name.startswith("diffrax"):
            return ADAPTIVE
        steps = ON_MESHES if self.contact in MESHES else SUBSTEPS
        return {"symplectic_euler": SHORT, PAPERS: LONG}.get(name, steps)


def chosen(contacts: Sequence[str], integrators: Sequence[str], floats: Sequence[str]) -> list[MeasuredProgram]:
    """Returns all combinations, with batches and derivatives; InputError for an unknown integrator or float type."""
    for name in integrators:
        integrator_from_text(name)
    for name in floats:
        if name not in FLOATS:
            raise InputError(f"no float type {name!r}", where="--dtype", expected=f"one of: {', '.join(FLOATS)}")
    return [MeasuredProgram(c, i, d, True, True) for c in contacts for i in integrators for d in floats]


def full_table() -> list[MeasuredProgram]:
    """Returns the plan of the complete table.

    Single precision only on P5; batches and derivatives for every integrator on P5, else for the first two of `COMMON`.
    """
    stepping, found = COMMON[:2], []
    for contact in (*SMOOTH, *MESHES):
        smooth, chief = contact in SMOOTH, contact == "P5"
        # `quasi_static` rejects contours, whose forces jump between facets, and takes minutes with "volume".
        for integrator in (*COMMON, *FURTHER) if smooth else COMMON[:3]:
            more = smooth and (chief or integrator in stepping)
            found.append(MeasuredProgram(contact, integrator, "float64", more, more))
        if chief:
            found += [MeasuredProgram(contact, name, "float32", name in stepping, False) for name in COMMON]
        if contact in ("P5", "CM"):
            found.append(MeasuredProgram(contact, PAPERS, "float64", False, False))
    return found
