"""The programs of a twin in a file: the computations of `pftwin.simulate` for a treated scene, given slider values.

And the data for its page: sliders, frames, flags and groove.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from fitting.cli.live.knobs import KNOBS, Knob, Knobs, neutral
from fitting.cli.twin.emitter import Emitter
from fitting.prediction.untreated import untrusted_start
from pftwin.base.errors import InputError
from pftwin.base.rotations import patellar_angles, tibiofemoral_angles
from pftwin.base.spatial import Pose, Quaternion, Vec3
from pftwin.dynamics.error_estimate import Course, after_halving, error_of
from pftwin.dynamics.frame_states import relaxed_start, start_before_search, starting_equilibrium, substeps_for
from pftwin.dynamics.integrators import BDF2
from pftwin.dynamics.observe import Observation, observe_during_run
from pftwin.dynamics.relaxation import THROWN
from pftwin.dynamics.status import Status
from pftwin.dynamics.tolerance import HALVINGS, UNCONFIRMED
from pftwin.dynamics.trajectory import DEFAULT_STEP
from pftwin.geometry.patch.closest import Surface
from pftwin.model.effects.contact import Contact
from pftwin.model.motion_on_host import tibia_orientation
from pftwin.model.scene import Scene
from pftwin.results.tracking import DISLOCATED, RE_ENGAGED, groove_bottom
from pftwin.results.verdict import IN_ORDER, most_frames

# Treatments in which a scene's parameters are linear, as in the tendons' stiffness; rotations are not.
_KINDS = ("tibial_tuberosity_transfer", "quadriceps_lengthening", "patellar_tendon_length_change")
_CLOSE = 1e-12  # tolerance of linearity, relative and absolute, for rounding
_INTEGRATOR = BDF2()


class Programs(NamedTuple):
    """A WebAssembly module, and the data that a page needs to run it."""

    binary: bytes
    facts: dict[str, Any]


def sliders(knobs: Knobs) -> tuple[Knob, ...]:
    """The live page's sliders that a twin in a file offers: tuberosity and tendons."""
    return tuple(k for k in knobs.usable if _offered(k))


def missing(knobs: Knobs) -> dict[str, str]:
    """By group, the reason why it has no sliders, for the groups that a twin in a file can offer."""
    groups = {k.group for k in KNOBS if _offered(k)}
    return {group: why for group, why in knobs.missing.items() if group in groups}


def _offered(knob: Knob) -> bool:
    return knob.name.endswith(".stiffness") or knob.name.partition(".")[0] in _KINDS


def programs(knobs: Knobs) -> Programs:
    """Compiles the programs of a scene with its sliders.

    Raises InputError for a scene whose programs cannot be compiled, for example contacts on meshes.
    """
    scene, emitter, changed = knobs.scene, Emitter(), _changed(knobs)
    values = jnp.asarray([k.neutral for k in sliders(knobs)], float)
    pose = scene.start
    start = jax.eval_shape(start_before_search, scene.unnamed())
    empty = jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), start)
    n, contact = scene.motion.n_frames, scene.contact

    def settle(values: Array, position: Array, quaternion: Array) -> dict[str, Any]:
        found = starting_equilibrium(changed(values), Pose(Vec3(*position), Quaternion(*quaternion)))
        known = found.rounding <= found.tolerance() if isinstance(found.rounding, float) else found.rounding < 1e-6
        return {"start": jax.tree.leaves(found), "converged": found.converged(), "known": known}

    def relaxed(values: Array) -> dict[str, Array]:
        treated = changed(values)
        found = relaxed_start(treated)
        near = (found.position - treated.start.position).norm() < THROWN
        return {"position": found.position.array(), "quaternion": found.orientation.array(), "near": near}

    def motion(values: Array, leaves: list[Array], substeps: Array) -> dict[str, Array]:
        treated, found = changed(values), jax.tree.unflatten(jax.tree.structure(start), leaves)
        options: Any = {"integrator": _INTEGRATOR, "substeps": substeps, "start": found, "ledger": True}
        frames, status, _ = observe_during_run(treated, partial(_frame_record, contact), **options)
        return {**frames, "status": status}

    three, each = jnp.zeros((n, 3)), jnp.zeros(n)
    course = Course(three, jnp.zeros((n, 4)), three, each, each)
    place = pose.position.array(), pose.orientation.array()
    substeps = substeps_for(scene.motion.frame_interval, DEFAULT_STEP)
    exported = {
        "settle": emitter.program("settle", settle, values, *place),
        "relaxed": emitter.program("relaxed", relaxed, values),
        "motion": emitter.program("motion", motion, values, jax.tree.leaves(empty), jnp.asarray(1)),
        "estimate": emitter.program(
            "estimate", _error_estimate, course, course, [jnp.zeros(n)] * 4, jnp.zeros(()), jnp.asarray(True)
        ),
    }
    start_pose = [np.asarray(a, float).tolist() for a in place]
    rules = {"substeps": substeps + substeps % 2, "halvings": HALVINGS, "unconfirmed": UNCONFIRMED}
    return Programs(emitter.module.binary(), {"programs": exported, "start": start_pose, "rules": rules})


def _frame_record(contact: Contact | None, observation: Observation) -> dict[str, Array]:
    """What the page needs of a frame; zeros without a contact, or without a surface that has a groove."""
    report: Mapping[str, Array] = {} if contact is None else observation.effects[contact.name]
    surface: Any = None if contact is None else contact.groove_surface()
    none = jnp.zeros(())
    along = (none, none) if surface is None else surface.chart.foot(surface.chart.to_frame(observation.center))
    turn, angles = observation.patella.orientation, patellar_angles(observation.patella.orientation)
    return {
        "center": observation.center.array(),
        "position": observation.patella.position.array(),
        "quaternion": turn.array(),
        "contact_force": jnp.stack([report.get(f"force_{axis}", none) for axis in "xyz"]),
        "medial": report.get("force_medial", none),
        "lateral": report.get("force_lateral", none),
        "force": report.get("force", none),
        "tilt": angles.tilt,
        "along": jnp.asarray(along[0], float),
        "across": jnp.asarray(along[1], float),
    }


def _error_estimate(here: Course, coarse: Course, before: list[Array], factor: Array, sound: Array) -> dict[str, Any]:
    """Flags by a motion's error, estimated from a coarser one (infinite unless both are `sound`), times `factor` and at
    least `before`; and the errors to expect with half the step."""
    pair = error_of(here, coarse, _INTEGRATOR.order, 2.0, jnp)
    pair = pair.with_errors(*(jnp.where(sound, x, jnp.inf) for x in pair.errors))
    error = pair.with_errors(*(jnp.maximum(factor * x, y) for x, y in zip(pair.errors, before, strict=True)))
    return {"flags": error.flags, "halved": list(after_halving(pair, _INTEGRATOR.order).errors)}


def _changed(knobs: Knobs) -> Any:
    """The treated scene as a traceable function of the sliders' values (knobs,).

    The scene's parameters must be linear in all sliders, which this checks at one further point; InputError if not.
    """
    own = sliders(knobs)
    rest = neutral()

    def leaves(values: Mapping[str, float]) -> tuple[list[Any], Any]:
        return jax.tree.flatten(knobs.scene_with(values).unnamed())

    base, structure = leaves(rest)
    arrays = [jnp.asarray(a) for a in base]  # traced indices work with JAX arrays only
    slopes = []
    for k in own:
        ends = [leaves({**rest, k.name: end})[0] for end in (k.least, k.most)]
        slopes.append([_slope(b, a, k.most - k.least) for a, b in zip(*ends, strict=True)])
    moved = [i for i in range(len(base)) if any(np.any(s[i]) for s in slopes)]
    lines = {i: np.stack([np.asarray(s[i], float) for s in slopes]) for i in moved}
    neutrals = [k.neutral for k in own]

    def at(values: Any, i: int, xp: Any) -> Any:
        steps = [(values[k] - neutrals[k]) * lines[i][k] for k in range(len(own)) if np.any(lines[i][k])]
        return sum(steps, start=xp.asarray(base[i], float))

    trial = {k.name: 0.7 * k.least + 0.3 * k.most for k in own}
    for i, a in enumerate(leaves({**rest, **trial})[0]):
        line = at(list(trial.values()), i, np) if i in lines else base[i]
        if not np.allclose(a, line, rtol=_CLOSE, atol=_CLOSE):
            raise InputError("sliders with a nonlinear effect on the scene", where="twin", expected="linear effects")

    def changed(values: Array) -> Scene:
        return jax.tree.unflatten(structure, [at(values, i, jnp) if i in lines else a for i, a in enumerate(arrays)])

    return changed


def _slope(b: Any, a: Any, span: float) -> Any:
    return (np.asarray(b) - np.asarray(a)) / span if not np.array_equal(a, b) else np.zeros(np.shape(a))


def facts(scene: Scene, knobs: tuple[Knob, ...], missing: dict[str, str]) -> dict[str, Any]:
    """Data of a scene for the page, as values for JSON; `missing` gives reasons for missing sliders, by group.

    `reasons` are why the untreated scene is INVALID; they hold for all values of the sliders.
    """
    motion, contact = scene.motion, scene.contact
    surface = scene.surface
    shown = ("name", "label", "group", "unit", "least", "most", "step", "neutral", "hint")
    return {
        "name": scene.name,
        "synthetic": scene.synthetic,
        "frames": motion.n_frames,
        "times": np.asarray(motion.times, float).tolist(),
        "flexion": np.degrees(np.asarray(tibiofemoral_angles(tibia_orientation(motion)).flexion)).tolist(),
        "knobs": [{name: getattr(k, name) for name in shown} for k in knobs],
        "missing": missing,
        "reasons": list(untrusted_start(scene)),
        "hasContact": contact is not None,
        "groove": None if surface is None else _groove(surface),
        "dislocated": DISLOCATED,
        "reEngaged": RE_ENGAGED,
        "stepTooLong": int(Status.STEP_TOO_LONG),
        "flags": [
            {
                "bit": int(flag),
                "words": flag.describe(),
                "most": most_frames(flag, motion.n_frames),
                "everywhere": flag is Status.START_NOT_IN_EQUILIBRIUM,
            }
            for flag in IN_ORDER
        ],
    }


def _groove(surface: Surface) -> dict[str, list[float]]:
    """Bottom line of the groove in chart coordinates [m]."""
    u, v = groove_bottom(surface)
    return {"u": u.tolist(), "v": v.tolist()}
