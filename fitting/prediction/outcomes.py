"""Outcome measures of treatments: scalars computed from a simulated motion.

They are written in JAX, so they can be mapped over variants and, where they are smooth, differentiated. Dislocation is
defined as in `pftwin.results.tracking`: the button's centre is farther than a threshold from the groove's bottom.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.errors import InputError
from pftwin.base.rotations import patellar_angles
from pftwin.base.spatial import Quaternion, Scalar, Vec3
from pftwin.dynamics.batch.member import frames_with_flags
from pftwin.dynamics.error_estimate import Course as ComparedCourse
from pftwin.dynamics.observe import Observation
from pftwin.dynamics.trajectory import knee_angles
from pftwin.geometry.patch.closest import Surface
from pftwin.model.scene import Scene
from pftwin.results.result import Result
from pftwin.results.tracking import DISLOCATED, RE_ENGAGED, groove_bottom
from pftwin.results.verdict import is_invalid


def groove_surface(scene: Scene) -> Surface:
    """The surface that defines a scene's groove.

    Raises:
        InputError: for a scene without contact between button and trochlea, or with meshes alone.
    """
    if scene.surface is None:
        raise _no_groove(scene)
    return scene.surface


def _no_groove(scene: Scene) -> InputError:
    """The error for a scene without a surface that defines a groove."""
    found = "no contact between a button and a trochlea"
    if scene.contact is not None:
        found = f"the meshes of {scene.contact.name!r} do not tell where the groove is"
    expected = "a contact with a smooth surface, or a stand-in for one: outcomes count from its groove"
    return InputError(found, where=scene.name or "outcomes", expected=expected)


class Groove(NamedTuple):
    """The bottom of a trochlea's groove in chart coordinates: v over u [m]."""

    u: Array
    v: Array

    @staticmethod
    def of(scene: Scene) -> Groove:
        """The groove of a scene, on the host; for a surface without one, its middle line.

        Raises:
            InputError: for a scene without contact between button and trochlea.
        """
        return Groove(*(jnp.asarray(x, dtype=float) for x in groove_bottom(groove_surface(scene))))


class Course(NamedTuple):
    """The quantities of a motion from which outcomes are computed: arrays over n recorded frames."""

    time: Array  # [s]
    flexion: Array  # of the knee [rad]
    offset: Array  # of the button's centre from the groove's bottom, lateral positive [m]
    tilt: Array  # of the patella, lateral positive [rad]
    shift: Array  # of the button's centre in the femur, lateral positive [m]
    force: tuple[Array, Array]  # on the medial and the lateral facet [N]
    point: tuple[Array, Array]  # (n, 3) contact point on each facet, femur frame [m]; NaN without contact
    contact_force: Array  # the contact's observable `force` [N]
    status: Array  # bits of `pftwin.Status`


class CourseFrame(NamedTuple):
    """Quantities of one frame or all (leading axis n) from which a `Course` is made; forces and points as there."""

    center: Vec3  # of the button, femur frame [m]
    orientation: Quaternion  # of the patella in the femur
    force: tuple[Array, Array]
    point: tuple[Array, Array]
    contact_force: Array
    total: Vec3  # contact force on the patella, femur frame [N]

    @staticmethod
    def of(scene: Scene, observation: Observation) -> CourseFrame:
        """The frame of one observation of a scene with contact."""
        contact = scene.contact
        assert contact is not None
        report = observation.effects[contact.name]
        force, point = ((report[f"{what}_medial"], report[f"{what}_lateral"]) for what in ("force", "point"))
        total = Vec3(*(report[f"force_{axis}"] for axis in "xyz"))
        return CourseFrame(observation.center, observation.patella.orientation, force, point, report["force"], total)

    def compared(self) -> ComparedCourse:
        """The quantities that the estimate of the time steps' error compares, for all frames."""
        return ComparedCourse(self.center.array(), self.orientation.array(), self.total.array(), *self.force)


def course_of(scene: Scene, frames: CourseFrame, status: Array, groove: Groove) -> Course:
    """The course from observations and status (n,) of all frames. Pure."""
    motion, chart = scene.motion, groove_surface(scene).chart
    u, v = chart.foot(chart.to_frame(frames.center))
    return Course(
        motion.frame_times(),
        knee_angles(scene).flexion,
        v - jnp.interp(u, groove.u, groove.v),
        patellar_angles(frames.orientation).tilt,
        frames.center.y,
        frames.force,
        frames.point,
        frames.contact_force,
        status,
    )


def dislocated(offset: Array, threshold: float = DISLOCATED) -> Array:
    """Whether the button has left its groove, for each frame (n,); defined as in `find_dislocations`."""

    def look(out: Array, far: Array) -> tuple[Array, Array]:
        out = jnp.where(out, ~(far < RE_ENGAGED * threshold), far > threshold)
        return out, out

    return jax.lax.scan(look, jnp.zeros_like(offset[0], dtype=bool), jnp.abs(offset))[1]


def center_of_pressure(at: Course) -> Array:
    """Centre of pressure (n, 3) in the femur frame [m]; NaN without contact."""
    (medial, lateral), total = at.force, at.force[0] + at.force[1]
    loaded = total > 0
    weights = (f / jnp.where(loaded, total, 1.0) for f in (medial, lateral))
    parts = [jnp.where((w > 0)[:, None], w[:, None] * p, 0.0) for w, p in zip(weights, at.point, strict=True)]
    return jnp.where(loaded[:, None], parts[0] + parts[1], jnp.nan)


class Measure(NamedTuple):
    """Unit and meaning of an outcome."""

    unit: str
    long_name: str


MEASURES = {
    "dislocations": Measure("1", "times that the button left its groove"),
    "dislocation_time": Measure("s", "time of the first dislocation"),
    "dislocation_flexion": Measure("rad", "knee flexion at the first dislocation"),
    "dislocation_side": Measure("1", "side of the first dislocation: 1 lateral, -1 medial, 0 none"),
    "dislocated_share": Measure("1", "share of the motion spent dislocated"),
    "re_engagement_time": Measure("s", "time at which the button came back after the first dislocation"),
    "re_engagement_flexion": Measure("rad", "knee flexion at which it came back"),
    "tracks_at_end": Measure("1", "whether the button is in its groove at the end of the motion"),
    "largest_offset": Measure("m", "largest distance of the button's centre from the groove's bottom"),
    "largest_lateral_offset": Measure("m", "largest lateral distance of the button's centre from the groove's bottom"),
    "dislocation_margin": Measure("m", "how far the button stayed from dislocating; negative where it did"),
    "mean_tilt": Measure("rad", "mean patellar tilt, lateral positive"),
    "largest_tilt": Measure("rad", "largest patellar tilt, lateral positive"),
    "mean_shift": Measure("m", "mean medial-lateral place of the button's centre in the femur, lateral positive"),
    "largest_shift": Measure("m", "most lateral place of the button's centre in the femur"),
    "peak_contact_force": Measure("N", "largest contact force (running median of five frames, as all forces)"),
    "mean_contact_force": Measure("N", "mean contact force"),
    "medial_share": Measure("1", "share of the contact force, summed over the motion, on the medial facet"),
    "lateral_share": Measure("1", "share of the contact force, summed over the motion, on the lateral facet"),
    "least_medial_force": Measure("N", "least force on the medial facet: how far it is from vanishing"),
    "least_lateral_force": Measure("N", "least force on the lateral facet: how far it is from vanishing"),
    "stability_margin": Measure("1", "least share of the contact force on the less loaded facet: 0.5 is centred"),
    "one_facet_share": Measure("1", "share of the motion in which one facet bears everything"),
    "contact_path_length": Measure("m", "length of the path of the centre of pressure on the trochlea"),
    "contact_path_proximal_range": Measure("m", "proximal-distal range of the centre of pressure"),
    "contact_path_lateral_range": Measure("m", "medial-lateral range of the centre of pressure"),
}


def measure(at: Course, threshold: float = DISLOCATED) -> dict[str, Scalar]:
    """Computes the outcomes in `MEASURES`, SI units. Pure; all NaN for a motion that `pftwin.results.verdict` calls
    INVALID.

    Forces and their centre are running medians over five frames, since with long steps the contact rattles in single
    frames while sliding. On the rig's case 1 the largest force is 20.7 N at 1 ms, with medians or without; at 2.5 ms
    22.0 N without and 21.2 N with them; at 5 ms 31.6 N and 25.9 N, with errors of up to 90 % in single frames.

    Times, flexions and the number of dislocations jump as amounts change; the others change continuously while the
    patella tracks.
    """
    invalid = is_invalid(frames_with_flags(at.status), at.status.shape[0])
    found = {**_dislocation(at, threshold), **_motion(at, threshold), **_load(at), **_path(at)}
    return {name: jnp.where(invalid, jnp.nan, found[name]) for name in MEASURES}


def _dislocation(at: Course, threshold: float) -> dict[str, Scalar]:
    out = dislocated(at.offset, threshold)
    before = jnp.concatenate([jnp.zeros(1, bool), out[:-1]])
    began, ended = out & ~before, ~out & before
    ever, back = jnp.any(out), jnp.any(ended)
    lost, regained = jnp.argmax(began), jnp.argmax(ended)
    return {
        "dislocations": jnp.sum(began).astype(float),
        "dislocation_time": jnp.where(ever, at.time[lost], jnp.nan),
        "dislocation_flexion": jnp.where(ever, at.flexion[lost], jnp.nan),
        "dislocation_side": jnp.where(ever, jnp.where(at.offset[lost] > 0, 1.0, -1.0), 0.0),
        "dislocated_share": jnp.mean(out.astype(float)),
        "re_engagement_time": jnp.where(back, at.time[regained], jnp.nan),
        "re_engagement_flexion": jnp.where(back, at.flexion[regained], jnp.nan),
        "tracks_at_end": 1.0 - out[-1].astype(float),
    }


def _motion(at: Course, threshold: float) -> dict[str, Scalar]:
    farthest = jnp.max(jnp.abs(at.offset))
    return {
        "largest_offset": farthest,
        "dislocation_margin": threshold - farthest,
        "largest_lateral_offset": jnp.max(at.offset),
        "mean_tilt": jnp.mean(at.tilt),
        "largest_tilt": jnp.max(at.tilt),
        "mean_shift": jnp.mean(at.shift),
        "largest_shift": jnp.max(at.shift),
    }


def _load(at: Course) -> dict[str, Scalar]:
    medial, lateral, contact = (running_median(f) for f in (*at.force, at.contact_force))
    total = medial + lateral
    whole = jnp.sum(total)
    share = jnp.where(whole > 0, jnp.sum(medial) / jnp.where(whole > 0, whole, 1.0), jnp.nan)
    less = jnp.minimum(medial, lateral) / jnp.where(total > 0, total, 1.0)
    return {
        "peak_contact_force": jnp.max(contact),
        "mean_contact_force": jnp.mean(contact),
        "medial_share": share,
        "lateral_share": 1 - share,
        "least_medial_force": jnp.min(medial),
        "least_lateral_force": jnp.min(lateral),
        "stability_margin": jnp.min(less),
        "one_facet_share": jnp.mean(((total > 0) & (less <= 0)).astype(float)),
    }


def running_median(values: Array) -> Array:
    """Running median over five neighbouring frames, (n,); the first and last values are repeated beyond the ends.

    Computed by comparisons: sorting so few values takes ten times as long. NaN spreads to the neighbours.
    """
    n = values.shape[0]
    padded = jnp.concatenate([values[:1], values[:1], values, values[-1:], values[-1:]])
    a, b, c, d, e = (padded[i : i + n] for i in range(5))
    low = jnp.maximum(jnp.minimum(a, b), jnp.minimum(c, d))
    high = jnp.minimum(jnp.maximum(a, b), jnp.maximum(c, d))
    return jnp.maximum(jnp.minimum(e, low), jnp.minimum(jnp.maximum(e, low), high))


def _path(at: Course) -> dict[str, Scalar]:
    p = Vec3(*(running_median(a) for a in center_of_pressure(at).T))
    touching = ~jnp.isnan(p.x)
    both = touching[1:] & touching[:-1]
    steps = Vec3(*(jnp.where(both, a[1:] - a[:-1], 0.0) for a in (p.x, p.y, p.z)))
    proximal, lateral = (
        jnp.max(jnp.where(touching, a, -jnp.inf)) - jnp.min(jnp.where(touching, a, jnp.inf)) for a in (p.x, p.y)
    )
    some = jnp.any(touching)
    return {
        "contact_path_length": jnp.sum(steps.norm()),
        "contact_path_proximal_range": jnp.where(some, proximal, jnp.nan),
        "contact_path_lateral_range": jnp.where(some, lateral, jnp.nan),
    }


_measured = eqx.filter_jit(measure)


def outcomes(result: Result, threshold: float = DISLOCATED) -> dict[str, float]:
    """Computes the outcomes of one run by name, SI units; see `MEASURES`.

    Args:
        result: result of `pftwin.simulate`, of a scene with a button and a trochlea.
        threshold: distance from the groove's bottom beyond which the button counts as dislocated [m].

    Raises:
        InputError: for a result without contact, or with meshes alone.
    """
    if result.contact is None or result.groove is None:
        raise _no_groove(result.scene)
    report = result.effects[result.contact]
    forces, points = ((_floats(report[f"{x}_medial"]), _floats(report[f"{x}_lateral"])) for x in ("force", "point"))
    knee, offset, tilt, shift = map(_floats, (result.knee.flexion, result.groove[1], result.angles.tilt, result.shift))
    contact, flags = _floats(report["force"]), jnp.asarray(result.flags)
    at = Course(_floats(result.times), knee, offset, tilt, shift, forces, points, contact, flags)
    found = _measured(at, threshold)
    return {name: float(found[name]) for name in MEASURES}


def _floats(values: Any) -> Array:
    return jnp.asarray(values, dtype=float)
