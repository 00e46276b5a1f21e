"""Paths of muscles over a motion: lengths against OpenSim, and which piece pulls at the patella."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from knee_models import FEMUR, FEMUR_AT, PATELLA, START, TIBIA, body, coordinate, function, model, point
from opensim_process import ask
from scipy.spatial.transform import Rotation

from pftwin.base.errors import InputError
from pftwin.files.interchange.osim_document import read_osim
from pftwin.files.interchange.osim_knee import find_knee
from pftwin.files.interchange.osim_model import read_model
from pftwin.files.interchange.osim_motion import Motion, poses
from pftwin.files.interchange.osim_muscle_path import MovingBodies, path_over_motion
from pftwin.files.mocap import PoseSeries

LENGTHS = """
import json, sys
import opensim as osim

osim.Logger.setLevelString("Off")
model = osim.Model(sys.argv[1])
state = model.initSystem()
found = []
for row in json.loads(sys.argv[2]):
    for name, value in row.items():
        model.getCoordinateSet().get(name).setValue(state, value, False)
    model.assemble(state)
    model.realizePosition(state)
    found.append([model.getMuscles().get(name).getLength(state) for name in json.loads(sys.argv[3])])
print(json.dumps(found))
"""
SHANK, HIP = "/bodyset/shank_r", "/bodyset/pelvis"
FLEX = "/jointset/knee_r/knee_flex_r"
PELVIS = (  # carried by the femur, at a joint with one coordinate
    '<PinJoint name="hip_joint"><socket_parent_frame>/bodyset/femur_r</socket_parent_frame>'
    "<socket_child_frame>/bodyset/pelvis</socket_child_frame><coordinates>"
    + coordinate("hip", 0.0, -2, 2)
    + "</coordinates></PinJoint>"
)
END = (PATELLA, (-0.008, 0.02, 0.0))


def conditional(name: str, frame: str, place: tuple[float, ...], low: float, high: float) -> str:
    inside = point(name, frame, place).replace("PathPoint", "ConditionalPathPoint")
    more = f"<socket_coordinate>{FLEX}</socket_coordinate><range>{low} {high}</range>"
    return inside.replace("</ConditionalPathPoint>", more + "</ConditionalPathPoint>")


def moving(name: str, frame: str) -> str:
    """A point that moves along x and z with the knee, x along a spline, and not along y."""
    axes = {
        "x": function("SimmSpline", "-0.5 0 0.5 0.9 1.2", "0.03 0.04 0.02 0.05 0.06"),
        "y": function("Constant", 0.05),
        "z": function("LinearFunction", 0.02, -0.01),
    }
    held = "".join(f"<{k}_location>{f}</{k}_location>" for k, f in axes.items())
    sockets = "".join(f"<socket_{k}_coordinate>{FLEX}</socket_{k}_coordinate>" for k in axes)
    frame = f"<socket_parent_frame>{frame}</socket_parent_frame>"
    return f'<MovingPathPoint name="{name}">{frame}{sockets}{held}</MovingPathPoint>'


def muscle(name: str, *points: str) -> str:
    return (
        f'<Millard2012EquilibriumMuscle name="{name}"><GeometryPath name="geometrypath"><PathPointSet><objects>'
        f"{''.join(points)}</objects></PathPointSet></GeometryPath></Millard2012EquilibriumMuscle>"
    )


MUSCLES = {
    "plain": (point("a", FEMUR, (0.035, 0.22, 0.012)), point("b", FEMUR, (0.04, 0.12, 0.01)), point("c", *END)),
    "pelvis": (point("a", HIP, (0.05, 0.3, 0.02)), point("b", *END), point("c", PATELLA, (0.01, -0.01, 0.0))),
    "shank": (point("a", *END), point("b", SHANK, (0.03, -0.02, 0.0)), point("c", TIBIA, (0.0, -0.2, 0.0))),
    "sometimes": (
        point("a", FEMUR, (0.035, 0.22, 0.012)),
        conditional("b", FEMUR, (0.06, 0.1, 0.01), 0.5, 2.0),
        point("c", *END),
    ),
    "moving": (point("a", FEMUR, (0.035, 0.22, 0.012)), moving("b", FEMUR), point("c", *END)),
}
ROWS = [
    {"knee_flex_r": k, "hip": h, "pf_flex_r": 0.3 + 0.7 * k, "pf_ty_r": -0.02 * k, "knee_rot_r": 0.1 * k}
    for k, h in ((-0.1, 0.0), (0.0, 0.3), (0.45, -0.4), (0.55, 0.2), (0.8, 0.0), (1.3, -0.2))
]


def written(folder: Path) -> Path:
    muscles = "".join(muscle(name, *points) for name, points in MUSCLES.items())
    text = model(forces=muscles, joints=PELVIS, meshes=False)
    path = folder / "paths.osim"
    path.write_text(text.replace("</objects></BodySet>", body("pelvis", 1.0) + "</objects></BodySet>"))
    return path


class Knee:
    """The model, its knee in the rows above, and the paths."""

    def __init__(self, folder: Path, rows: list[dict[str, float]] = ROWS) -> None:
        root = read_osim(written(folder))
        found = read_model(root)
        self.knee = find_knee(found)
        times = 0.1 * np.arange(len(rows))
        values = {name: np.array([row[name] for row in rows]) for name in rows[0]}
        placed = poses(found.tree, [self.knee.femur, self.knee.tibia, self.knee.patella], times, values)
        self.motion = Motion(times, placed, "", values=values)
        self.elements = {m.name: m for m in root.all("Millard2012EquilibriumMuscle")}

    def path(self, name: str, motion: Motion | None = None):
        bodies = MovingBodies(self.knee, motion or self.motion)
        return path_over_motion(self.elements[name], bodies)


@pytest.fixture(scope="module")
def knee(tmp_path_factory) -> Knee:
    return Knee(tmp_path_factory.mktemp("paths"))


def test_lengths_are_opensims(knee, tmp_path):
    """Of points on bodies beyond the knee, of those that are there at times, and of those that move."""
    lengths = np.array(ask(LENGTHS, written(tmp_path), json.dumps(ROWS), json.dumps([*MUSCLES])))
    for name, expected in zip(MUSCLES, lengths.T, strict=True):
        np.testing.assert_allclose(knee.path(name).lengths, expected, atol=1e-9, err_msg=name)


def test_the_last_piece_is_what_pulls(knee):
    for name, place in (("plain", (0.04, 0.12, 0.01)), ("shank", (0.03, -0.07, 0.0))):  # the shank: 50 mm below
        path = knee.path(name)
        np.testing.assert_allclose(path.insertion, END[1])
        np.testing.assert_allclose(path.origin, np.tile(place, (len(ROWS), 1)), atol=1e-12)
    assert [knee.path(name).body for name in MUSCLES] == ["femur", "femur", "tibia", "femur", "femur"]


def test_a_point_of_another_body_moves_in_the_femur_as_the_model_says(knee):
    """A pin joint turns it about z."""
    turns = Rotation.from_rotvec([[0, 0, row["hip"]] for row in ROWS])
    np.testing.assert_allclose(knee.path("pelvis").origin, turns.apply((0.05, 0.3, 0.02)), atol=1e-12)


def test_points_that_come_and_go_or_move_are_where_they_are_at_each_frame(knee):
    there = np.array([row["knee_flex_r"] >= 0.5 for row in ROWS])
    expected = np.where(there[:, None], (0.06, 0.1, 0.01), (0.035, 0.22, 0.012))
    np.testing.assert_allclose(knee.path("sometimes").origin, expected, atol=1e-12)
    flex = np.array([row["knee_flex_r"] for row in ROWS])
    origin = knee.path("moving").origin
    np.testing.assert_allclose(origin[:, 1], 0.05, atol=1e-12)
    np.testing.assert_allclose(origin[:, 2], 0.02 * flex - 0.01, atol=1e-12)
    np.testing.assert_allclose(origin[flex == 0, 0], 0.04, atol=1e-12)


def test_measured_poses_move_what_hangs_on_them(knee):
    """Everything turned and moved in ground is as long; a shank goes with the tibia, a pelvis with the femur."""
    turn, shift = Rotation.from_rotvec([0.4, -0.9, 1.3]), np.array([1.0, 2.0, -3.0])

    def moved(poses):
        turned = turn * Rotation.from_quat(poses.quaternions, scalar_first=True)
        return PoseSeries(poses.times, turn.apply(poses.positions) + shift, turned.as_quat(scalar_first=True))

    still = [dict(row, hip=0.0) for row in ROWS]
    values = {name: np.array([row[name] for row in still]) for name in still[0]}
    known = {body: moved(poses) for body, poses in knee.motion.poses.items()}
    measured = Motion(knee.motion.times, known, "", measured=True)
    for name in ("plain", "pelvis", "shank"):
        expected = knee.path(name, knee.motion._replace(values=values))
        found = knee.path(name, measured)
        np.testing.assert_allclose(found.lengths, expected.lengths, atol=1e-9)
        np.testing.assert_allclose(found.origin, expected.origin, atol=1e-9)
    for name in ("sometimes", "moving"):
        with pytest.raises(InputError, match="goes by the coordinate 'knee_flex_r', which poses do not tell"):
            knee.path(name, measured)


def changed(folder: Path, points: tuple[str, ...]) -> Knee:
    """The knee with the plain muscle's points replaced."""
    path = written(folder)
    path.write_text(path.read_text().replace(muscle("plain", *MUSCLES["plain"]), muscle("plain", *points)))
    made = Knee.__new__(Knee)
    root = read_osim(path)
    made.knee = find_knee(read_model(root))
    values = {"knee_flex_r": np.array([0.0, 1.0])}
    bodies = [made.knee.femur, made.knee.tibia, made.knee.patella]
    times = np.array([0.0, 1.0])
    made.motion = Motion(times, poses(made.knee.model.tree, bodies, times, values), "", values=values)
    made.elements = {m.name: m for m in root.all("Millard2012EquilibriumMuscle")}
    return made


def test_paths_that_no_single_line_represents_are_not_read(tmp_path):
    start, end = point("a", FEMUR, (0.035, 0.22, 0.012)), point("c", *END)
    over = (start, end, point("d", TIBIA, (0.04, -0.07, 0.0)))
    leaving = (start, conditional("c", *END, 0.5, 2.0))
    wandering = (start, moving("c", PATELLA))
    for points in (over, leaving, wandering):
        assert changed(tmp_path, points).path("plain") is None


def test_what_is_no_path_is_refused_in_words(tmp_path):
    place = START["pf_tx_r"], START["pf_ty_r"], START["pf_tz_r"]
    assert FEMUR_AT != (0, 0, 0)  # so that ground is not the femur
    collapsed = (point("a", PATELLA, (0.0, 0.0, 0.0)), point("b", FEMUR, place))
    with pytest.raises(InputError, match=r"paths.osim, line \d+, frame 1: the path of 'plain' has no length"):
        changed(tmp_path, collapsed).path("plain")
    lost = (conditional("a", FEMUR, (0.0, 0.2, 0.0), 0, 1).replace(FLEX, "/jointset/knee_r/nothing"), point("c", *END))
    with pytest.raises(InputError, match="no coordinate 'nothing'"):
        changed(tmp_path, lost).path("plain")
    bare = (point("a", FEMUR, (0.0, 0.2, 0.0)).replace("location", "place"), point("c", *END))
    with pytest.raises(InputError, match="has no <location>"):
        changed(tmp_path, bare).path("plain")
