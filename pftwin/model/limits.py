"""Limits on the parameters and motion of a plausible knee, and the check of a scene against them.

Limits apply to scenes from scene files (`pftwin.load_scene`), imported models included. A scene that is built in
Python may be any body on any surface, and has no limits unless `scene.with_limits()` adds them. The default limits are
wide enough for instrumented rigs, implants and children. Each can be set by name: `[limits]` in a scene file,
`pftwin --allow NAME=VALUE`, `load_scene(path, limits={...})` or `scene.with_limits(NAME=VALUE)`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.leaves import host_array
from pftwin.base.quantities import declarations
from pftwin.base.rotations import tibiofemoral_angles
from pftwin.base.spatial import Quaternion, Rotation, Vec3
from pftwin.model.effects.base import Instant, Patella
from pftwin.model.motion import Frame
from pftwin.model.motion_on_host import first_pose, tibia_orientation

if TYPE_CHECKING:
    from pftwin.model.effects.line_elements import ElasticLine, LineElement
    from pftwin.model.scene import Scene

_PROXIMAL = np.array([1.0, 0.0, 0.0])
_UPWARD = 0.5  # proximal fraction of an upward pull: a retinaculum's is less, a quadriceps' more
_UNITS = {"rad_per_s": "rad/s", "m_per_s": "m/s", "m_per_s2": "m/s^2", "share": "times the distance", "lines": ""}
_ROUNDED = 0.02  # relative excess over the triangle inequality that rounded moments of inertia may have


@dataclasses.dataclass(frozen=True)
class Limits:
    """Limits for a plausible knee, `least_...` and `most_...`, in the units at the end of their names."""

    least_mass_kg: float = 0.001
    most_mass_kg: float = 1.0  # a patella weighs 0.03 to 0.1; the rig's carrier 0.12
    least_gyration_mm: float = 1.0  # radius of gyration: square root of moment of inertia over mass
    most_gyration_mm: float = 100.0
    least_button_radius_mm: float = 2.0
    most_button_radius_mm: float = 100.0
    least_lines: float = 1.0  # number of lines of force; without any, nothing holds the patella
    least_upward_lines: float = 1.0  # lines that pull it proximally, like a quadriceps; required only for motions
    most_line_mm: float = 1000.0  # distance from insertion to origin at the start
    least_slack_share: float = 0.05  # ratio of slack length to the length of the line at the start
    most_slack_share: float = 1.5
    most_depth_in_wrap_mm: float = 0.0  # of a line's end inside its obstacle at the start; frames stay INVALID
    most_force_N: float = 20_000.0  # of a line at the start, and of any force parameter  # noqa: N815
    most_acceleration_m_per_s2: float = 100.0  # of gravity
    least_flexion_deg: float = -40.0  # of the knee, in any frame
    most_flexion_deg: float = 175.0
    most_adduction_deg: float = 45.0  # to either side
    most_rotation_deg: float = 75.0  # to either side
    most_angular_speed_rad_per_s: float = 50.0  # of the tibia in the femur between frames; a fast kick has 30
    most_knee_speed_m_per_s: float = 0.25  # of the tibia along the femur, at the knee: faster poses are errors
    most_marker_residual_mm: float = 5.0  # root mean square over a cluster in one frame
    most_marker_residual_ratio: float = 10.0  # to the median of the other clusters, where it exceeds 1 mm
    most_center_deviation_mm: float = 5.0  # standard deviation of a joint centre that is determined from the motion
    most_start_shift_mm: float = 10.0  # from the recorded start to the equilibrium
    most_start_turn_deg: float = 15.0

    @staticmethod
    def of(given: Mapping[str, Any]) -> Limits:
        """The default limits with those in `given` replaced, by name.

        Raises:
            InputError: there is no such limit, or a value is not a number.
        """
        known = [f.name for f in dataclasses.fields(Limits)]
        for name, value in given.items():
            if name not in known:
                raise InputError(f"no limit {name!r}", expected=f"one of: {', '.join(known)}")
            if isinstance(value, bool) or not isinstance(value, int | float) or np.isnan(value):
                raise InputError(f"found {value!r}", where=name, expected="a number")
        return Limits(**{name: float(value) for name, value in given.items()})

    def of_treated(self) -> Limits:
        """Limits for a treated knee, which need not rest where the untreated one was recorded."""
        return dataclasses.replace(self, most_start_shift_mm=np.inf, most_start_turn_deg=np.inf)


def beyond(name: str, limit: float, found: str, value: float, where: str | None = None) -> InputError:
    """The error for a `value` beyond the limit `name`, in the limit's unit; `found` describes the value."""
    sense, way = ("at least", -1) if name.startswith("least") else ("at most", 1)
    enough = f"{name}={float(f'{value + way * 0.01 * abs(value):.3g}'):g}"
    return InputError(
        found,
        where=where,
        expected=f"{sense} {limit:g} {_unit(name)}".rstrip() + f", which is wide enough for knees ({name})",
        remedy=f"check values and units; if intended: pftwin --allow {enough}, or {enough} in the file's [limits]",
    )


class Found(NamedTuple):
    """A value of a scene, and the names of the limits that apply to it."""

    what: str
    value: float  # in the limits' unit
    least: str = ""
    most: str = ""


def check_limits(scene: Scene, limits: Limits) -> None:
    """Checks that a scene is a plausible knee.

    Raises:
        InputError: a value exceeds its limit, or no rigid body can have these principal moments of inertia.
    """
    inertia = host_array(scene.patella.inertia)
    if inertia.max() > (inertia.sum() - inertia.max()) * (1 + _ROUNDED):
        raise InputError(
            f"found principal moments of {', '.join(f'{v:.3g}' for v in inertia)} kg m^2",
            where=f"{scene.name}: patella.inertia",
            expected="none larger than the sum of the other two, as for every rigid body",
            remedy="check the moments, their order and units",
        )
    for found in (*_of_body(scene), *_of_effects(scene), *_of_motion(scene)):
        for name, broken in ((found.least, np.less), (found.most, np.greater)):
            if name and broken(found.value, limit := getattr(limits, name)):
                words = f"{found.what} is {found.value:.4g} {_unit(name)}".rstrip()
                raise beyond(name, limit, words, found.value, scene.name)


def upward_lines(scene: Scene) -> int:
    """Number of lines that pull along the proximal axis of the patella or the femur in the start pose."""
    femur = first_pose(scene.motion, "femur")
    axes = [_turned(_start_axes(scene), _PROXIMAL), _PROXIMAL if femur is None else femur[1][:, 0]]
    count = 0
    for effect in scene.effects:
        line = effect.line_element()
        if line is not None and line.line_ends[1] != "tibia":
            way = _at_start(scene, line)
            along = np.max(way @ np.transpose(axes), axis=-1) > _UPWARD * np.linalg.norm(way, axis=-1)
            count += int(np.count_nonzero(along & line.pulls()))
    return count


def not_pulled(scene: Scene) -> tuple[str, ...]:
    """A message if nothing pulls the patella upward in a scene with limits, as tracking requires; else empty."""
    limits = scene.limits
    if limits is None or (found := upward_lines(scene)) >= limits.least_upward_lines:
        return ()
    least = f"at least {limits.least_upward_lines:g}: least_upward_lines"
    return (f"lines of force that pull the patella upward: {found} ({least})",)


def _unit(name: str) -> str:
    """Unit of a limit, from the end of its name."""
    return next((unit for ending, unit in _UNITS.items() if name.endswith(ending)), name.rpartition("_")[2])


def _of_body(scene: Scene) -> Iterator[Found]:
    mass, inertia = float(scene.patella.mass), host_array(scene.patella.inertia)
    yield Found("the patella's mass", mass, "least_mass_kg", "most_mass_kg")
    for radius in 1e3 * np.sqrt(np.sort(inertia)[[0, -1]] / mass):
        what = "the patella's radius of gyration (square root of moment of inertia over mass)"
        yield Found(what, float(radius), "least_gyration_mm", "most_gyration_mm")


def _of_effects(scene: Scene) -> Iterator[Found]:
    lines = [line for e in scene.effects if (line := e.line_element()) is not None]
    yield Found("the number of lines of force (tendons, ligaments, muscles)", len(lines), "least_lines")
    now = _at_rest(scene)
    for line in lines:
        yield from _of_line(scene, line, now)
    for effect in scene.effects:
        contact = effect.contact_role()
        if contact is not None:
            radius = 1e3 * float(np.max(np.asarray(contact.button_radius(), np.float64)))
            yield Found(
                f"the button's radius ({effect.name})", radius, "least_button_radius_mm", "most_button_radius_mm"
            )
        for path, leaf, declared in declarations(effect):
            most = {"N": "most_force_N", "m/s^2": "most_acceleration_m_per_s2"}.get(
                "" if declared is None else declared.unit
            )
            if most is not None:
                largest = float(np.max(np.abs(np.asarray(leaf, dtype=float)), initial=0.0))
                yield Found(f"{'.'.join((effect.name, *path))}", largest, most=most)


def _at_start(scene: Scene, line: LineElement) -> Floats:
    """Vectors from insertion to origin at the start, (..., 3), world axes [m]."""
    inserted, body = line.line_ends
    here = host_array(scene.start.position) + _turned(_start_axes(scene), host_array(inserted))
    there = host_array(line.origin_at(float(scene.motion.times[0])))
    if body != "ground" and (pose := first_pose(scene.motion, body)) is not None:
        there = pose[0] + there @ pose[1].T
    return np.atleast_2d(there - here)


def _at_rest(scene: Scene) -> Instant:
    """The first frame with all bodies at rest; of numpy's numbers, since a check precedes every simulation."""
    still = _vector(np.zeros(3))

    def frame(body: str) -> Frame:
        pose = first_pose(scene.motion, body)
        origin, axes = (np.zeros(3), np.eye(3)) if pose is None else pose
        return Frame(_vector(origin), Rotation(*map(_vector, axes.T)), still, still)

    patella = Patella(_vector(host_array(scene.start.position)), _start_axes(scene), still, still)
    return Instant(patella, frame("femur"), frame("tibia"), float(scene.motion.times[0]), 0.0)


def _vector(values: Any) -> Vec3:
    """A `Vec3` of numpy's numbers, from an array (3,)."""
    return Vec3(*values)


def _start_axes(scene: Scene) -> Rotation:
    """Axes of the patella in the start pose; by numpy."""
    return Quaternion(*host_array(scene.start.orientation)).rotation()


def _of_line(scene: Scene, line: LineElement, now: Instant) -> Iterator[Found]:
    """Values of the line of a group that comes closest to each limit; `now` is the first frame at rest."""
    length = np.linalg.norm(_at_start(scene, line), axis=-1)
    yield Found(
        f"the distance of {line.name} from insertion to origin at the start", 1e3 * length.max(), most="most_line_mm"
    )
    if line.wrap is not None:
        depth = 1e3 * float(np.max(np.asarray(line.depth_in_wrap(now), dtype=float)))
        what = f"the depth of an end of {line.name} within what it wraps over at the start, where it runs straight,"
        yield Found(what, depth, most="most_depth_in_wrap_mm")
    if line.elastic:
        yield from _of_spring(cast("ElasticLine", line), now, length)


def _of_spring(line: ElasticLine, now: Instant, length: Floats) -> Iterator[Found]:
    """Values of the springs of a line or group whose ends are `length` apart [m]."""
    if line.wrap is not None:  # length of the path around the obstacle
        length = np.atleast_1d(np.asarray(line.line(now).length, dtype=float))
    share = np.ravel(np.asarray(line.slack_length, dtype=float) / np.maximum(length, 1e-9))
    what = f"the slack length of {line.name}"
    yield Found(what, float(share.max()), most="most_slack_share")
    yield Found(what, float(share.min()), least="least_slack_share")
    load, _ = line.load(now, line.guess(now))
    pull = max((float(np.max(np.asarray(term.force, dtype=float))) for term in load.stiff), default=0.0)
    yield Found(f"the pull of {line.name} at the start", pull, most="most_force_N")


def _of_motion(scene: Scene) -> Iterator[Found]:
    q = tibia_orientation(scene.motion)
    angles = tibiofemoral_angles(q)
    flexion, adduction, rotation = (np.degrees(a) for a in angles)
    rows = host_array(q)
    cosine = np.minimum(np.abs(np.einsum("ij,ij->i", rows[1:], rows[:-1])), 1.0)
    speed = 2 * np.arccos(cosine) / np.diff(scene.motion.times)
    fastest = int(np.argmax(speed))
    when = f"the knee's angular speed after {scene.motion.times[fastest]:.3f} s"
    yield Found(when, float(speed[fastest]), most="most_angular_speed_rad_per_s")
    for what, values, least, most in (
        ("flexion", flexion, "least_flexion_deg", "most_flexion_deg"),
        ("adduction", np.abs(adduction), "", "most_adduction_deg"),
        ("internal or external rotation", np.abs(rotation), "", "most_rotation_deg"),
    ):
        for kind, limit, i in (("least", least, np.argmin(values)), ("most", most, np.argmax(values))):
            when = f"{scene.motion.times[i]:.3f} s (axes, side, or clusters of the other side?)"
            yield Found(f"the knee's {what} at {when}", float(values[i]), **{kind: limit})


def _turned(rotation: Rotation, points: Floats) -> Floats:
    return points @ host_array(rotation).T
