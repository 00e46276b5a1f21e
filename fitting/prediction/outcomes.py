"""What a treatment is judged by: outcome measures of a simulated motion, one number each, alike for one run and many.

They are written in JAX, so they can be mapped over variants and, where they are smooth, differentiated. Dislocation is
as `pftwin.results.tracking` has it: the button's centre farther than a threshold from the bottom of its groove.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from fitting.prediction.course import Course, center_of_pressure, dislocated
from pftwin.base.errors import InputError
from pftwin.base.spatial import Scalar, Vec3
from pftwin.dynamics.status import Status
from pftwin.results.result import Result
from pftwin.results.tracking import DISLOCATED


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
    "peak_contact_force": Measure("N", "largest normal contact force (running median of five frames, as all forces)"),
    "mean_contact_force": Measure("N", "mean normal contact force"),
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
    """The outcomes in `MEASURES`, SI. Pure; NaN, all of them, where a frame is not finite.

    Forces and their centre are taken as running medians over five frames, since at long steps contact rattles in single
    frames where it slides. On the rig's case 1 the largest force is 20.7 N at 1 ms, with medians or without; at 2.5 ms
    22.0 N without and 21.2 N with them; at 5 ms 31.6 N and 25.9 N, single frames being off by up to 90 %.

    Times, flexions and the number of dislocations jump as amounts change; the others change continuously while the
    patella tracks.
    """
    finite = jnp.all((at.status & int(Status.NOT_FINITE)) == 0)
    found = {**_dislocation(at, threshold), **_motion(at, threshold), **_load(at), **_path(at)}
    return {name: jnp.where(finite, found[name], jnp.nan) for name in MEASURES}


def _dislocation(at: Course, threshold: float) -> dict[str, Scalar]:
    out = dislocated(at.offset, threshold)
    before = jnp.concatenate([jnp.zeros(1, bool), out[:-1]])
    began, ended = out & ~before, ~out & before
    ever, back = jnp.any(out), jnp.any(ended)
    first, again = jnp.argmax(began), jnp.argmax(ended)
    return {
        "dislocations": jnp.sum(began).astype(float),
        "dislocation_time": jnp.where(ever, at.time[first], jnp.nan),
        "dislocation_flexion": jnp.where(ever, at.flexion[first], jnp.nan),
        "dislocation_side": jnp.where(ever, jnp.where(at.offset[first] > 0, 1.0, -1.0), 0.0),
        "dislocated_share": jnp.mean(out.astype(float)),
        "re_engagement_time": jnp.where(back, at.time[again], jnp.nan),
        "re_engagement_flexion": jnp.where(back, at.flexion[again], jnp.nan),
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
    medial, lateral = (running_median(f) for f in at.force)
    total = medial + lateral
    whole = jnp.sum(total)
    share = jnp.where(whole > 0, jnp.sum(medial) / jnp.where(whole > 0, whole, 1.0), jnp.nan)
    less = jnp.minimum(medial, lateral) / jnp.where(total > 0, total, 1.0)
    return {
        "peak_contact_force": jnp.max(total),
        "mean_contact_force": jnp.mean(total),
        "medial_share": share,
        "lateral_share": 1 - share,
        "least_medial_force": jnp.min(medial),
        "least_lateral_force": jnp.min(lateral),
        "stability_margin": jnp.min(less),
        "one_facet_share": jnp.mean(((total > 0) & (less <= 0)).astype(float)),
    }


def running_median(values: Array) -> Array:
    """Over five neighbouring frames, (n,); the first and the last frame are repeated beyond the ends.

    By comparisons: a sort of so few costs ten times as much. NaN spreads to the neighbours.
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


@eqx.filter_jit
def _measured(at: Course, threshold: float) -> Any:
    return measure(at, threshold)


def outcomes(result: Result, threshold: float = DISLOCATED) -> dict[str, float]:
    """The outcomes of one run by name, SI; see `MEASURES`.

    Args:
        result: of `pftwin.simulate`, of a scene with a button and a trochlea.
        threshold: distance from the groove's bottom beyond which the button counts as dislocated [m].

    Raises:
        InputError: a result without contact.
    """
    if result.contact is None or result.groove is None:
        raise InputError("no contact between a button and a trochlea", where=result.scene_name)
    report = result.effects[result.contact]
    forces, points = ((_floats(report[f"{x}_medial"]), _floats(report[f"{x}_lateral"])) for x in ("force", "point"))
    knee, offset, tilt, shift = map(_floats, (result.knee.flexion, result.groove[1], result.angles.tilt, result.shift))
    at = Course(_floats(result.times), knee, offset, tilt, shift, forces, points, jnp.asarray(result.flags))
    found = _measured(at, threshold)
    return {name: float(found[name]) for name in MEASURES}


def _floats(values: Any) -> Array:
    return jnp.asarray(values, dtype=float)
