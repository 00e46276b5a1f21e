"""Motion of the bones of an OpenSim model: from a file of coordinates or poses, or a synthetic flexion."""

from __future__ import annotations

import os
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.text_files import shortened_list
from pftwin.files.interchange.osim_joints import Tree
from pftwin.files.interchange.osim_knee import OsimKnee
from pftwin.files.mocap.pose_files import holds_matrices, read_poses
from pftwin.files.mocap.poses import PoseSeries, quaternion_product
from pftwin.files.mocap.sto import read_sto
from pftwin.files.mocap.tables import unknown_name

RATE = 100.0  # frames per second of a synthetic flexion
FASTEST = np.radians(45.0)  # its largest angular speed [rad/s]
FARTHEST = np.radians(90.0)  # its largest angle, if the model's range is larger [rad]
GROUND_AS_MODEL = (
    "gravity, and whatever is attached to the ground, are as in the model's: check that this recording is too"
)
_TRIED = 1001  # number of knee angles that are tried for the patella's start
_MOVED = 1e-4  # smallest displacement by which a coordinate counts as moving the patella [m]


class Motion(NamedTuple):
    """Motion of femur, tibia and patella in ground; only the patella's first frame is used, unless it is measured."""

    times: Floats  # (n,) [s]
    poses: dict[str, PoseSeries]  # by body
    said: str  # description
    measured: bool = False  # whether the patella's poses are measurements
    values: dict[str, Floats] | None = None  # coordinates by name, (n,) [rad] or [m]; None for recorded poses
    synthetic: bool = False  # whether it was generated here, not read from a file


def motion_of(
    knee: OsimKnee, path: str | os.PathLike[str] | None, rate: float | None = None, bend: str | None = None
) -> Motion:
    """Reads the motion from a file of coordinates or of poses as matrices; without a file, flexes the knee.

    If a file of poses lacks the patella, it has the model's default pose in the femur. The options are those of
    `import_osim`. Raises InputError as `read_poses`, `read_sto` and `poses`, for no poses of femur or tibia, none of
    the model's coordinates, no coordinate for the flexion, and a rate for a file without poses.
    """
    if path is not None and holds_matrices(path):
        return _measured(knee, path, rate)
    if rate is not None:
        raise InputError("a rate without a file of poses", where="rate", expected="times in seconds, and no rate")
    tree = knee.model.tree
    times, values, said = _flexed_through_range(tree, knee.tibia, bend) if path is None else _recorded(tree, path)
    found = poses(tree, [knee.femur, knee.tibia, knee.patella], times, values)
    return Motion(times, found, said, values=values, synthetic=path is None)


def _flexed_through_range(tree: Tree, tibia: str, name: str | None) -> tuple[Floats, dict[str, Floats], str]:
    """Flexion from the default to the end of the range: times (n,), coordinates by name, and a description.

    The time course is a polynomial of fifth degree that starts and ends at rest.
    """
    joint = tree.joints[tree_joint(tree, tibia)]
    joint.check()
    coordinates = tree.coordinates()
    turning = [c for c in joint.coordinates if c.rotational]
    if name is not None and name not in coordinates:
        known = ", ".join(c.name for c in joint.coordinates)
        raise InputError(f"no coordinate {name!r}", where="--bend", expected=f"such as {known}")
    if name is not None and not coordinates[name].rotational:
        known = ", ".join(c.name for c in turning)
        raise InputError(f"{name!r} is no rotation", where="--bend", expected=f"one, such as {known}")
    if name is None and not turning:
        raise InputError(f"nothing turns {tibia!r}", where="--bend", expected="a joint with a rotation")
    chosen = turning[0] if name is None else coordinates[name]
    start = chosen.default
    low, high = (v if np.isfinite(v) else s * np.inf for v, s in ((chosen.low, -1), (chosen.high, 1)))
    far = high if high - start >= start - low else low
    end = float(np.clip(far, start - FARTHEST, start + FARTHEST))
    share = np.arange(1 + int(np.ceil(RATE * 1.875 * abs(end - start) / FASTEST)))
    share = share / max(share[-1], 1)
    values = start + (end - start) * share**3 * (10 - 15 * share + 6 * share**2)
    said = f"{chosen.name} from {np.degrees(start):.3g} to {np.degrees(end):.3g} deg in {(share.size - 1) / RATE:.2f} s"
    return np.arange(share.size) / RATE, {chosen.name: values}, f"{said}, all other coordinates at their defaults"


def _recorded(tree: Tree, path: str | os.PathLike[str]) -> tuple[Floats, dict[str, Floats], str]:
    """Reads coordinates of a .mot or .sto file in SI units; columns are names or paths (".../knee_angle_r/value")."""
    known = tree.coordinates()
    names = {label: label.removesuffix("/value").split("/")[-1] for label in read_sto(path, rotational=()).names}
    angles = [label for label, n in names.items() if n in known and known[n].rotational]
    table = read_sto(path, rotational=angles)
    found = {n: table.column(label) for label, n in names.items() if n in known}
    if not found:
        wanted = ", ".join(list(known)[:6])
        raise InputError("none of the model's coordinates", where=path, expected=f"such as {wanted}")
    said = f"{len(found)} coordinates from {os.fspath(path)}, all others at their defaults"
    return table.times, found, said + _not_used([label for label, name in names.items() if name not in known])


def _measured(knee: OsimKnee, path: str | os.PathLike[str], rate: float | None) -> Motion:
    held = read_poses(path, rate=rate)
    if missing := [body for body in (knee.femur, knee.tibia) if body not in held]:
        raise unknown_name("body", missing[0], held, where=path)
    selected = {body: held[body] for body in (knee.femur, knee.tibia, knee.patella) if body in held}
    said = f"poses of {', '.join(selected)} from {os.fspath(path)}"
    femur = selected[knee.femur]
    if measured := knee.patella in held:
        said += "; the patella's are what was measured"
    else:
        rest = poses(knee.model.tree, [knee.femur, knee.patella], np.zeros(1), {})
        there = rest[knee.patella].relative_to(rest[knee.femur])
        places = femur.positions + femur.matrices() @ there.positions[0]
        turns = quaternion_product(femur.quaternions, there.quaternions)
        selected[knee.patella] = PoseSeries(femur.times, places, turns)
        said += f"; {knee.patella} starts where the model has it in {knee.femur}"
    said += _not_used([body for body in held if body not in selected])
    return Motion(femur.times, selected, f"{said}; {GROUND_AS_MODEL}", measured)


def _not_used(names: list[str]) -> str:
    """Names what the file also has."""
    return f"; not used: {shortened_list(names)}" if names else ""


def resting_patella(knee: OsimKnee, tibia: PoseSeries) -> tuple[tuple[Floats, Floats], str]:
    """The model's pose of the patella in the femur, position [m] and quaternion, and a description.

    This is the default pose, unless the coordinate that flexes the knee also moves the patella: then it is the pose at
    the value for which the model's tibia is rotated most nearly as in the first recorded frame.
    """
    tree = knee.model.tree
    bending = [c for c in tree.joints[tree_joint(tree, knee.tibia)].coordinates if c.rotational]
    angles, given = np.zeros(1), {}
    if bending:
        low, high = np.clip((bending[0].low, bending[0].high), -np.pi, np.pi)
        angles = np.concatenate([[bending[0].default], np.linspace(low, high, _TRIED)])
        given = {bending[0].name: angles}
    tried = np.arange(angles.size, dtype=np.float64)
    found = poses(tree, [knee.femur, knee.tibia, knee.patella], tried, given)
    shin, button = (found[body].relative_to(found[knee.femur]) for body in (knee.tibia, knee.patella))
    index, said = 0, "by default"
    if (np.ptp(button.positions, axis=0) > _MOVED).any():
        turns = Rotation.from_quat(shin.quaternions, scalar_first=True).inv()
        first = Rotation.from_quat(tibia.quaternions[0], scalar_first=True)
        off = np.asarray((turns * first).magnitude())
        index = 1 + int(np.argmin(off[1:]))
        said = f"at {bending[0].name} = {np.degrees(angles[index]):.1f} deg"
    turn = Rotation.from_quat(button.quaternions[index], scalar_first=True).as_quat(scalar_first=True, canonical=True)
    said = f"{knee.patella} starts where the model has it in {knee.femur} {said}"
    return (button.positions[index], turn), said


def poses(tree: Tree, bodies: list[str], times: Floats, given: dict[str, Floats]) -> dict[str, PoseSeries]:
    """Poses of bodies in ground; raises InputError for unknown joints and functions that overflow."""
    values = tree.values(given, times.size)
    out = {}
    for body in bodies:
        with np.errstate(over="ignore", invalid="ignore"):
            pose = tree.pose(body, values, times.size)
        if not np.isfinite(pose).all():
            expected = "functions and coordinates of this joint, and of those that carry it, of a human size"
            raise InputError(f"the pose of {body!r} is not finite", where=tree.joints[body].where, expected=expected)
        out[body] = PoseSeries.from_matrices(times, pose[:, :3, 3], pose[:, :3, :3], source=body)
    return out


def tree_joint(tree: Tree, body: str) -> str:
    """The body whose joint moves this one: itself, or the body it is welded to."""
    return body if tree.joints[body].kind != "WeldJoint" else tree.welded(body)[0]
