"""Pure functions that compute one variant of a batch, its equilibrium and motion, for mapping over all variants."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.errors import InputError
from pftwin.base.quantities import bounded_leaves
from pftwin.base.rotations import patellar_angles
from pftwin.base.spatial import Pose, Scalar, Vec3
from pftwin.dynamics.equilibrium import Solution
from pftwin.dynamics.equilibrium_report import start_offset
from pftwin.dynamics.error_estimate import Course, ErrorEstimate, error_of
from pftwin.dynamics.frame_states import frame_states, relaxed_start, starting_equilibrium
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.observe import Observation, observe, observe_during_run
from pftwin.dynamics.relaxation import THROWN
from pftwin.dynamics.status import FLAGS
from pftwin.model.scene import Scene

Found = TypeVar("Found")
Outcome = Callable[[Scene, Observation], dict[str, Array]]


class Task(NamedTuple):
    """What all variants share. Functions, names and flags determine the program; arrays do not."""

    scene: Scene
    change: Callable[[Scene, Any], Scene]
    substeps: Array
    integrator: Integrator
    energy: bool
    courses: bool
    outcome: Outcome | None
    estimate: bool = False  # whether to estimate the error of the steps from a second run


def member_equilibrium(task: Task, row: Any) -> Solution:
    """Equilibrium of a variant, by descent from its start pose."""
    return starting_equilibrium(task.change(task.scene, row))


def settled_after_relaxing(task: Task, row: Any) -> Solution:
    """Equilibrium of a variant from the end of a damped relaxation, if close; the fallback as in `pftwin.simulate`."""
    scene = task.change(task.scene, row)
    pose = relaxed_start(scene)
    near = (pose.position - scene.start.position).norm() < THROWN
    return starting_equilibrium(scene, jax.tree.map(lambda a, b: jnp.where(near, a, b), pose, scene.start))


def member_motion(task: Task, row: Any, start: Solution) -> dict[str, Any]:
    """Motion of a variant from its equilibrium, as a dictionary of results for `batch_dataset`."""
    scene = task.change(task.scene, row)
    options: Any = {"integrator": task.integrator, "start": start, "ledger": task.energy}

    # The number of substeps is traced, so that one program serves all steps.
    def run(substeps: Array) -> tuple[_Recorded, Array, Observation | None]:
        if task.outcome is None:
            select = partial(_Recorded.of, scene)
            return *observe_during_run(scene, select, substeps=substeps, **options)[:2], None
        whole = observe(scene, frame_states(scene, substeps=substeps, **options))  # an outcome may use all of it
        return _Recorded.of(scene, whole), whole.status, whole

    largest: dict[str, Array] = {}
    if task.estimate:
        (observables, status, whole), error = run_with_error(
            run, lambda found: found[0].course(), task.substeps, task.integrator.order
        )
        status = status | error.flags.astype(status.dtype)
        largest = {f"estimated_error_{name}": value for name, value in error.largest.items()}
    else:
        observables, status, whole = run(task.substeps)
    own = {} if task.outcome is None or whole is None else task.outcome(scene, whole)
    if not isinstance(own, dict):
        kind = type(own).__name__
        raise InputError(f"gives {kind}", where="outcome", expected="a dictionary of numbers or arrays")
    moved, turned = start_offset(scene, start)
    return {
        "sensible": scene_is_valid(scene),
        "status_frames": frames_with_flags(status),
        "equilibrium_residual": start.residual,
        "start_shift": moved,
        "start_turn": turned,
        "summary": {**observables.summary(), **largest},
        "own": own,
        "courses": observables.courses(status) if task.courses else {},
    }


def run_with_error(
    run: Callable[[Array], Found], course: Callable[[Found], Course], substeps: Array, order: float
) -> tuple[Found, ErrorEstimate]:
    """A run with the estimated error of its steps, from a second run with twice the step, or half for a single substep.

    `run` takes the number of steps between two frames and is compiled once; `course` extracts what is compared.
    """
    others = jnp.where(substeps > 1, substeps // 2, 2)
    both = jax.lax.map(run, jnp.stack([substeps, others]))
    found, other = (jax.tree.map(lambda a, i=i: a[i], both) for i in (0, 1))
    ratio = substeps.astype(float) / others.astype(float)
    return found, error_of(course(found), course(other), order, ratio, jnp)


def frames_with_flags(status: Array) -> Array:
    """Number of frames with each of `pftwin.dynamics.status.FLAGS`, (flags,), from their status (n,)."""
    return jnp.stack([jnp.sum((status & int(flag)) != 0) for flag in FLAGS])


class _Recorded(NamedTuple):
    """The stored observables of a frame, or of all frames (leading axis n)."""

    patella: Pose
    center: Vec3
    force: Scalar | None  # contact force; None without a contact [N]
    components: tuple[Scalar, ...]  # contact force: x, y, z; magnitudes on the medial and the lateral facet [N]

    @staticmethod
    def of(scene: Scene, observation: Observation) -> _Recorded:
        """Selects them from an observation."""
        contact, nothing = scene.contact, jnp.zeros_like(observation.center.x)
        report = {} if contact is None else observation.effects[contact.name]
        components = (report.get(f"force_{part}", nothing) for part in ("x", "y", "z", "medial", "lateral"))
        return _Recorded(observation.patella, observation.center, report.get("force"), tuple(components))

    def course(self) -> Course:
        """Path and forces for an error estimate."""
        force = jnp.stack(self.components[:3], axis=-1)
        return Course(self.center.array(), self.patella.orientation.array(), force, *self.components[3:])

    def summary(self) -> dict[str, Scalar]:
        """Summary of the whole motion; names as in `batch_dataset.SUMMARY`."""
        angles = patellar_angles(self.patella.orientation)
        found = {
            "mean_tilt": jnp.mean(angles.tilt),
            "largest_tilt": jnp.max(angles.tilt),
            "mean_shift": jnp.mean(self.center.y),
            "largest_shift": jnp.max(self.center.y),
            "last_proximal": self.center.x[-1],
            "last_lateral": self.center.y[-1],
            "last_anterior": self.center.z[-1],
        }
        if self.force is not None:
            found |= {"largest_contact_force": jnp.max(self.force), "mean_contact_force": jnp.mean(self.force)}
        return found

    def courses(self, status: Array) -> dict[str, Array]:
        """Time courses; names as in `batch_dataset.COURSES`."""
        return {
            "sphere_center": self.center.array(),
            "patella_position": self.patella.position.array(),
            "patella_quaternion": self.patella.orientation.array(),
            "frame_status": status,
        }


def scene_is_valid(scene: Scene) -> Array:
    """Whether a traced scene has finite parameters within their bounds, as `pftwin.model.scene.check` requires."""
    leaves, structure = jax.tree.flatten(scene)
    good = [jnp.all(jnp.isfinite(a)) for a in leaves if eqx.is_inexact_array(a)]
    for quantity, which in bounded_leaves(structure):
        good += [jnp.all(quantity.holds(jnp.asarray(leaves[i]))) for i in which]
    return jnp.stack(good).all()
