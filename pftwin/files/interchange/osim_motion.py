"""How the bones of an OpenSim model move: by a file of coordinates, or bent evenly through a range."""

from __future__ import annotations

import os
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.rotations import continuous_signs
from pftwin.files.interchange.osim_joints import Coordinate, Tree
from pftwin.files.interchange.osim_knee import OsimKnee
from pftwin.files.mocap.pose_files import holds_matrices, read_poses
from pftwin.files.mocap.poses import PoseSeries, quaternion_product
from pftwin.files.mocap.sto import read_sto
from pftwin.files.mocap.tables import unknown_name

RATE = 100.0  # frames per second of a motion that is made
FASTEST = np.radians(45.0)  # of it [rad/s]
FARTHEST = np.radians(90.0)  # of it, where the model's range goes further
GROUND_AS_MODEL = (
    "gravity, and whatever is attached to the ground, are as in the model's: check that this recording is too"
)
_TRIED = 1001  # angles of the knee at which the patella is looked for
_MOVED = 1e-4  # the patella is moved by what moves it by more [m]


class Motion(NamedTuple):
    """How femur, tibia and patella move in ground; of the patella only the first frame counts, unless measured."""

    times: Floats  # (n,)
    poses: dict[str, tuple[Floats, Floats]]  # positions (n, 3) [m] and quaternions (n, 4), scalar first, by body
    said: str
    measured: bool = False  # whether the patella's are measurements
    values: dict[str, Floats] | None = None  # of coordinates by name (n,) [rad] or [m]; None: of recorded poses


def motion_of(
    tree: Tree, knee: OsimKnee, path: str | os.PathLike[str] | None, rate: float | None = None, bend: str | None = None
) -> Motion:
    """By a file of coordinates, or of poses as matrices; or bent through its range, where there is none.

    A patella that a file of poses does not have stands in the femur's frame where the model has it by default.

    Args:
        tree: the model's.
        knee: its bodies.
        path: of the file.
        rate: frames per second, where the times of a file of poses count frames.
        bend: the coordinate to bend by; None: the first rotation of the tibia's joint.

    Raises:
        InputError: as `read_poses`, `recorded`, `flexed_through_range` and `poses`; poses of no femur or tibia; a rate
            of a file without poses.
    """
    if path is not None and holds_matrices(path):
        return _measured(tree, knee, path, rate)
    if rate is not None:
        raise InputError("a rate without a file of poses", where="rate", expected="times in seconds, and no rate")
    found = flexed_through_range(tree, knee, bend) if path is None else recorded(tree, path)
    times, values, said = found
    return Motion(times, poses(tree, [knee.femur, knee.tibia, knee.patella], times, values), said, values=values)


def flexed_through_range(tree: Tree, knee: OsimKnee, name: str | None = None) -> tuple[Floats, dict[str, Floats], str]:
    """The knee bent from its default to the end of its range: times (n,), coordinates by name, and a description.

    Smoothly (a polynomial of fifth degree), so that it starts and ends at rest.

    Args:
        tree: the model's.
        knee: its bodies.
        name: of the coordinate; None: the first rotation of the tibia's joint.

    Raises:
        InputError: no such coordinate, or none that turns the tibia.
    """
    joint = tree.joints[tree_joint(tree, knee.tibia)]
    joint.check()
    own = joint.coordinates
    turning = [c for c in own if c.rotational]
    if name is not None and name not in tree.coordinates():
        known = ", ".join(c.name for c in own)
        raise InputError(f"no coordinate {name!r}", where="--bend", expected=f"such as {known}")
    if name is None and not turning:
        raise InputError(f"nothing turns {knee.tibia!r}", where="--bend", expected="a joint with a rotation")
    chosen = turning[0] if name is None else tree.coordinates()[name]
    start, end = chosen.default, _end(chosen)
    share = np.arange(1 + int(np.ceil(RATE * 1.875 * abs(end - start) / FASTEST)))
    share = share / max(share[-1], 1)
    values = start + (end - start) * share**3 * (10 - 15 * share + 6 * share**2)
    said = f"{chosen.name} from {np.degrees(start):.3g} to {np.degrees(end):.3g} deg in {(share.size - 1) / RATE:.2f} s"
    return np.arange(share.size) / RATE, {chosen.name: values}, f"{said}, all other coordinates at their defaults"


def recorded(tree: Tree, path: str | os.PathLike[str]) -> tuple[Floats, dict[str, Floats], str]:
    """Coordinates of a .mot or .sto file, by name or by path ("/jointset/knee_r/knee_angle_r/value"), in SI units.

    Raises:
        InputError: what `read_sto` refuses; none of the model's coordinates.
    """
    known = tree.coordinates()
    names = {label: _short(label) for label in read_sto(path, rotational=()).names}
    angles = [label for label, n in names.items() if n in known and known[n].rotational]
    table = read_sto(path, rotational=angles)
    found = {n: table.column(label) for label, n in names.items() if n in known}
    if not found:
        wanted = ", ".join(list(known)[:6])
        raise InputError("none of the model's coordinates", where=path, expected=f"such as {wanted}")
    return table.times, found, f"{len(found)} coordinates from {os.fspath(path)}, all others at their defaults"


def _measured(tree: Tree, knee: OsimKnee, path: str | os.PathLike[str], rate: float | None) -> Motion:
    held = read_poses(path, rate=rate)
    if missing := [body for body in (knee.femur, knee.tibia) if body not in held]:
        raise unknown_name("body", missing[0], held, where=path)
    seen = {body: held[body] for body in (knee.femur, knee.tibia, knee.patella) if body in held}
    said = f"poses of {', '.join(seen)} from {os.fspath(path)}"
    if measured := knee.patella in held:
        said += "; the patella's are what was measured"
    else:
        rest = poses(tree, [knee.femur, knee.patella], np.zeros(1), {})
        still, patella = (PoseSeries(np.zeros(1), *rest[body]) for body in (knee.femur, knee.patella))
        there, femur = patella.relative_to(still), seen[knee.femur]
        places = femur.positions + femur.matrices() @ there.positions[0]
        turns = quaternion_product(femur.quaternions, there.quaternions)
        seen[knee.patella] = PoseSeries(femur.times, places, turns)
        said += f"; {knee.patella} starts where the model has it in {knee.femur}"
    said += f"; {GROUND_AS_MODEL}"
    return Motion(
        seen[knee.femur].times, {body: (p.positions, p.quaternions) for body, p in seen.items()}, said, measured
    )


def resting_patella(tree: Tree, knee: OsimKnee, tibia: PoseSeries) -> tuple[Floats, str]:
    """Where the model has the patella in the femur (4, 4) for a tibia as in the first frame, and a description.

    That is its default, unless the coordinate that bends the knee moves the patella too: then at the value for which
    the model turns the tibia most nearly as it was recorded.

    Args:
        tree: the model's.
        knee: its bodies.
        tibia: in the femur.

    Raises:
        InputError: as `poses`.
    """
    bending = [c for c in tree.joints[tree_joint(tree, knee.tibia)].coordinates if c.rotational]
    angles, given = np.zeros(1), {}
    if bending:
        low, high = np.clip((bending[0].low, bending[0].high), -np.pi, np.pi)
        angles = np.concatenate([[bending[0].default], np.linspace(low, high, _TRIED)])
        given = {bending[0].name: angles}
    tried = np.arange(angles.size, dtype=np.float64)
    found = poses(tree, [knee.femur, knee.tibia, knee.patella], tried, given)
    series = {body: PoseSeries(tried, *pair) for body, pair in found.items()}
    shin, button = (series[body].relative_to(series[knee.femur]) for body in (knee.tibia, knee.patella))
    index, said = 0, f"{knee.patella} starts where the model has it in {knee.femur} by default"
    if (np.ptp(button.positions, axis=0) > _MOVED).any():
        turns = Rotation.from_quat(shin.quaternions, scalar_first=True).inv()
        first = Rotation.from_quat(tibia.quaternions[0], scalar_first=True)
        off = np.asarray((turns * first).magnitude())
        index = 1 + int(np.argmin(off[1:]))
        angle = f"{bending[0].name} = {np.degrees(angles[index]):.1f} deg"
        said = f"{knee.patella} starts where the model has it in {knee.femur} at {angle}"
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = button.matrices()[index], button.positions[index]
    return pose, said


def poses(tree: Tree, bodies: list[str], times: Floats, given: dict[str, Floats]) -> dict[str, tuple[Floats, Floats]]:
    """Positions (n, 3) [m] and quaternions (n, 4), scalar first, of bodies in ground.

    Raises:
        InputError: joints on the way that are not known; functions that overflow.
    """
    values = tree.values(given, times.size)
    out = {}
    for body in bodies:
        with np.errstate(over="ignore", invalid="ignore"):
            pose = tree.pose(body, values, times.size)
        if not np.isfinite(pose).all():
            raise InputError(
                f"the pose of {body!r} is not finite",
                where=tree.joints[body].where,
                expected="functions and coordinates of this joint, and of those that carry it, of a human size",
            )
        turn = Rotation.from_matrix(pose[:, :3, :3]).as_quat(scalar_first=True)
        out[body] = pose[:, :3, 3], continuous_signs(turn)
    return out


def tree_joint(tree: Tree, body: str) -> str:
    """The body by whose joint this one moves: itself, or what it is welded to."""
    return body if tree.joints[body].kind != "WeldJoint" else tree.welded(body)[0]


def _end(coordinate: Coordinate) -> float:
    """The farther end of the range, at most `FARTHEST` away."""
    low, high = (v if np.isfinite(v) else s * np.inf for v, s in ((coordinate.low, -1), (coordinate.high, 1)))
    start = coordinate.default
    far = high if high - start >= start - low else low
    return float(np.clip(far, start - FARTHEST, start + FARTHEST))


def _short(label: str) -> str:
    parts = label.removesuffix("/value").split("/")
    return parts[-1]
