"""What is computed of one member: its equilibrium, its motion, and what is kept of it. Pure; mapped over members."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.dynamics.equilibrium import Solution
from pftwin.dynamics.observe import Observation, Status, observe
from pftwin.dynamics.relaxation import THROWN, relax
from pftwin.dynamics.trajectory import first_guide, starting_equilibrium, trajectory
from pftwin.errors import InputError
from pftwin.rotations import patellar_angles
from pftwin.scene import LIMITS, Scene, limited
from pftwin.spatial import Pose, Scalar, Vec3

FLAGS = tuple(flag for flag in Status if flag)
Outcome = Callable[[Scene, Observation], dict[str, Array]]


class Task(NamedTuple):
    """What all members share. Functions, names and switches decide the program; arrays do not."""

    scene: Scene
    change: Callable[[Scene, Any], Scene]
    substeps: Array
    integrator: str
    energy: bool
    courses: bool
    outcome: Outcome | None


def settled(task: Task, row: Any) -> Solution:
    """The equilibrium nearest to the member's own start pose."""
    return starting_equilibrium(task.change(task.scene, row))


def settled_after_relaxing(task: Task, row: Any) -> Solution:
    """As `pftwin.simulate` does it where the search fails: from where damped motion comes to rest, if that is near."""
    scene = task.change(task.scene, row)
    rested = relax(scene.system(), first_guide(scene), scene.center_of_mass_pose())
    pose = Pose(rested.apply(-scene.patella.center_of_mass), rested.orientation)
    near = (pose.position - scene.start.position).norm() < THROWN
    return starting_equilibrium(scene, jax.tree.map(lambda a, b: jnp.where(near, a, b), pose, scene.start))


def moved(task: Task, row: Any, start: Solution) -> dict[str, Any]:
    """The member's motion from an equilibrium, as `batch_dataset` names it."""
    scene = task.change(task.scene, row)
    path = trajectory(
        scene, integrator=task.integrator, substeps=task.substeps, start=start, ledger=task.energy
    )  # a traced number of substeps: smaller steps are the same program
    seen = observe(scene, path)
    own = {} if task.outcome is None else task.outcome(scene, seen)
    if not isinstance(own, dict):
        raise InputError(f"gives {type(own).__name__}", where="outcome", expected="a dictionary of numbers or arrays")
    return {
        "sensible": sensible(scene),
        "status_frames": jnp.stack([jnp.sum((seen.status & int(flag)) != 0) for flag in FLAGS]),
        "equilibrium_residual": start.residual,
        "summary": _summary(scene, seen),
        "own": own,
        "courses": _courses(seen) if task.courses else {},
    }


def _summary(scene: Scene, seen: Observation) -> dict[str, Scalar]:
    angles = patellar_angles(seen.patella.orientation)
    found = {
        "mean_tilt": jnp.mean(angles.tilt),
        "largest_tilt": jnp.max(angles.tilt),
        "mean_shift": jnp.mean(seen.center.y),
        "largest_shift": jnp.max(seen.center.y),
        "last_proximal": seen.center.x[-1],
        "last_lateral": seen.center.y[-1],
        "last_anterior": seen.center.z[-1],
    }
    button = scene.button
    if button is not None:
        force = seen.effects[button.name]["force"]
        found |= {"largest_contact_force": jnp.max(force), "mean_contact_force": jnp.mean(force)}
    return found


def _courses(seen: Observation) -> dict[str, Array]:
    q = seen.patella.orientation
    return {
        "sphere_center": _rows(seen.center),
        "patella_position": _rows(seen.patella.position),
        "patella_quaternion": jnp.stack([q.w, q.x, q.y, q.z], axis=-1),
        "frame_status": seen.status,
    }


def _rows(v: Vec3) -> Array:
    return jnp.stack([v.x, v.y, v.z], axis=-1)


def sensible(scene: Scene) -> Array:
    """What `pftwin.scene.check` asks for, of a scene that is traced."""
    leaves, structure = jax.tree.flatten(scene)
    positive, not_negative, within = limited(structure)
    good = [jnp.all(jnp.isfinite(a)) for a in leaves if eqx.is_inexact_array(a)]
    good += [jnp.all(jnp.asarray(leaves[i]) > 0) for i in positive]
    good += [jnp.all(jnp.asarray(leaves[i]) >= 0) for i in not_negative]
    for i, name in within:
        low, high, _ = LIMITS[name]
        good.append(jnp.all((jnp.asarray(leaves[i]) >= low) & (jnp.asarray(leaves[i]) <= high)))
    return jnp.stack(good).all()
