"""A simulated motion as outcome measures look at it: where the button is in its groove, and what presses where."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.errors import InputError
from pftwin.base.rotations import patellar_angles
from pftwin.base.spatial import Quaternion, Vec3
from pftwin.dynamics.observe import Observation, ObservedFrame
from pftwin.dynamics.trajectory import knee_angles
from pftwin.geometry.patch.closest import Surface
from pftwin.model.scene import Scene
from pftwin.results.tracking import DISLOCATED, RE_ENGAGED, groove_line


def groove_surface(scene: Scene) -> Surface:
    """The surface that tells where a scene's groove is.

    Raises:
        InputError: a scene without contact between button and trochlea, or with meshes alone.
    """
    if scene.surface is None:
        found = "no contact between a button and a trochlea"
        if scene.contact is not None:
            found = f"the meshes of {scene.contact.name!r} do not tell where the groove is"
        raise InputError(
            found,
            where=scene.name or "outcomes",
            expected="a contact with a smooth surface, or a stand-in for one: outcomes count from its groove",
        )
    return scene.surface


class Groove(NamedTuple):
    """The bottom of a trochlea's groove in chart coordinates: v over u [m]."""

    u: Array
    v: Array

    @staticmethod
    def of(scene: Scene) -> Groove:
        """Of a scene; on the host. A surface without a groove counts from its middle.

        Raises:
            InputError: a scene without contact between button and trochlea.
        """
        surface = groove_surface(scene)
        line = groove_line(surface)
        if line is None:
            middle = float(getattr(surface, "center", (0.0, 0.0))[1])
            return Groove(jnp.asarray([-1.0, 1.0]), jnp.asarray([middle, middle]))
        return Groove(jnp.asarray(line.u, dtype=float), jnp.asarray(line.v, dtype=float))


class Course(NamedTuple):
    """A motion as outcomes look at it: arrays over n recorded frames."""

    time: Array  # [s]
    flexion: Array  # of the knee [rad]
    offset: Array  # of the button's centre from the groove's bottom, lateral positive [m]
    tilt: Array  # of the patella, lateral positive [rad]
    shift: Array  # of the button's centre in the femur, lateral positive [m]
    force: tuple[Array, Array]  # on the medial and the lateral facet [N]
    point: tuple[Array, Array]  # (n, 3) of contact on each, femur frame [m]; NaN where nothing touches
    status: Array  # bits of `pftwin.Status`


class CourseFrame(NamedTuple):
    """What a course is made of, of a frame or of all (leading axis n)."""

    center: Vec3  # of the button, femur frame [m]
    orientation: Quaternion  # of the patella in the femur
    force: tuple[Array, Array]  # on the medial and the lateral facet [N]
    point: tuple[Array, Array]  # (3,) or (n, 3) of contact on each, femur frame [m]; NaN where nothing touches

    @staticmethod
    def of(scene: Scene, seen: ObservedFrame | Observation) -> CourseFrame:
        """Of what is seen of a scene with contact."""
        contact = scene.contact
        assert contact is not None
        report = seen.effects[contact.name]
        force, point = ((report[f"{what}_medial"], report[f"{what}_lateral"]) for what in ("force", "point"))
        return CourseFrame(seen.center, seen.patella.orientation, force, point)


def course(scene: Scene, seen: Observation, groove: Groove) -> Course:
    """What outcomes need of an observed motion. Pure."""
    return course_of(scene, CourseFrame.of(scene, seen), seen.status, groove)


def course_of(scene: Scene, seen: CourseFrame, status: Array, groove: Groove) -> Course:
    """What outcomes need of glimpses of all frames, and their status (n,). Pure."""
    motion, chart = scene.motion, groove_surface(scene).chart
    u, v = chart.foot(chart.to_frame(seen.center))
    return Course(
        motion.frame_times(),
        knee_flexion(scene),
        v - jnp.interp(u, groove.u, groove.v),
        patellar_angles(seen.orientation).tilt,
        seen.center.y,
        seen.force,
        seen.point,
        status,
    )


def knee_flexion(scene: Scene) -> Array:
    """Of the tibia in the femur at the recorded frames, (n,) [rad]."""
    return knee_angles(scene).flexion


def dislocated(offset: Array, threshold: float = DISLOCATED) -> Array:
    """Frame by frame, whether the button has left its groove, (n,); as `pftwin.results.tracking.follow`, NaN
    included.
    """

    def look(out: Array, far: Array) -> tuple[Array, Array]:
        out = jnp.where(out, ~(far < RE_ENGAGED * threshold), far > threshold)
        return out, out

    return jax.lax.scan(look, jnp.zeros_like(offset[0], dtype=bool), jnp.abs(offset))[1]


def center_of_pressure(at: Course) -> Array:
    """(n, 3) in the femur frame [m]; NaN where nothing touches."""
    (medial, lateral), total = at.force, at.force[0] + at.force[1]
    loaded = total > 0
    weights = (f / jnp.where(loaded, total, 1.0) for f in (medial, lateral))
    parts = [jnp.where((w > 0)[:, None], w[:, None] * p, 0.0) for w, p in zip(weights, at.point, strict=True)]
    return jnp.where(loaded[:, None], parts[0] + parts[1], jnp.nan)
