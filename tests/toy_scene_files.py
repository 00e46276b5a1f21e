"""A small knee written as a laboratory's files: a fixed femur, a swinging tibia, two springs and a button."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pftwin.base.errors import InputError
from pftwin.files.mocap import MarkerTrajectories, PoseSeries, Table, write_trc
from pftwin.files.scene_file import load_scene
from pftwin.geometry.mesh.mesh import SurfaceMesh, save_mesh
from pftwin.geometry.patch.implant import rig_implant
from pftwin.model.scene import Scene

CLUSTERS = {
    "femur": {"F1": (0.20, 0.05, 0.03), "F2": (0.25, -0.04, 0.05), "F3": (0.15, 0.01, 0.08)},
    "tibia": {"T1": (-0.15, 0.05, 0.04), "T2": (-0.2, -0.04, 0.05), "T3": (-0.25, 0.02, 0.08)},
    "patella": {"P1": (0.02, 0.015, 0.03), "P2": (-0.02, 0.01, 0.03), "P3": (0.0, -0.02, 0.04)},
}
START = ((-0.005, 0.001, 0.05), (1.0, 0.0, 0.0, 0.0))
SCENE = """limits = { most_start_shift_mm = 20, most_start_turn_deg = 30 }  # its start is a guess
schema = 1
name = "toy"

[motion]
poses = "poses.csv"

[tibia]
body = "tibia"

[patella]
mass_kg = 0.12
inertia_kg_m2 = [3e-5, 3e-5, 4e-5]
center_of_mass_mm = [1, 0, 4]
start = { fixed = { position_m = [-0.005, 0.001, 0.05] } }

[gravity]
acceleration_m_per_s2 = [0, 0, -9.81]

[[tendon]]
name = "quadriceps"
body = "femur"
stiffness_N_per_m = 156
slack_length_mm = 143.2
damping_time_s = 0.01
insertion_mm = [20, 0, -8]
origin_m = [0.22, 0.012, 0.035]

[[tendon]]
name = "patellar_tendon"
body = "tibia"
stiffness_N_per_m = 629
slack_length_m = 0.0714
damping_N_s_per_m = 6.29
insertion_m = [-0.02, 0.0, -0.008]
origin_m = [-0.07, 0.01, 0.045]

[contact]
radius_mm = 22
law = { type = "flores", contact_stiffness = 2e8, restitution = 0.6 }

[contact.surface]
mesh = "femur.stl"
units = "m"
degree = "P5"
chart = "plane"
region = { axis_origin_m = [0, 0, 0], axis_radius_mm = 24.8, angles_deg = [-75, 30], half_width_mm = 20 }
"""


def tibia_poses(frames: int = 41, rate: float = 100.0) -> PoseSeries:
    """A tibia that swings by 10 deg about 45 deg of flexion, in the femur's frame."""
    t = np.arange(frames) / rate
    flexion = np.radians(45 + 10 * np.sin(2 * np.pi * t / 0.8))
    q = Rotation.from_rotvec(np.outer(-flexion, [0, 1, 0])).as_quat(scalar_first=True)
    return PoseSeries(t, np.zeros((frames, 3)), q)


def fixed_poses(like: PoseSeries, position: tuple[float, ...], quaternion: tuple[float, ...]) -> PoseSeries:
    """A pose that does not change, at the same times."""
    n = like.times.size
    return PoseSeries(like.times, np.tile(position, (n, 1)), np.tile(quaternion, (n, 1)))


def write_poses(path: Path, bodies: dict[str, PoseSeries]) -> None:
    """As a table of poses."""
    names, columns = [], []
    for body, poses in bodies.items():
        names += [f"{body}_p{k}" for k in "xyz"] + [f"{body}_q{k}" for k in "wxyz"]
        columns += [poses.positions, poses.quaternions]
    units = {n: "m" if n[-2] == "p" else "1" for n in names}
    times = next(iter(bodies.values())).times
    table = Table(times, tuple(names), np.concatenate(columns, axis=1), units)
    lines = [",".join(["time_s", *(f"{n}_m" if units[n] == "m" else n for n in names)])]
    lines += [",".join(f"{v:.12g}" for v in (t, *row)) for t, row in zip(table.times, table.values, strict=True)]
    path.write_text("\n".join(lines) + "\n")


def markers_of(bodies: dict[str, PoseSeries]) -> MarkerTrajectories:
    """The clusters' markers on the moving bodies."""
    names, points = [], []
    for body, poses in bodies.items():
        for name, place in CLUSTERS[body].items():
            names.append(name)
            points.append(poses.positions + np.einsum("nij,j->ni", poses.matrices(), np.asarray(place)))
    return MarkerTrajectories(next(iter(bodies.values())).times, tuple(names), np.stack(points, axis=1))


@cache
def _femur() -> SurfaceMesh:
    return rig_implant().mesh(deviation=0.1e-3)


def write_toy(folder: Path, text: str = SCENE) -> Path:
    """All files of the toy scene; returns the scene file."""
    tibia = tibia_poses()
    bodies = {"tibia": tibia, "patella": fixed_poses(tibia, *START)}
    write_poses(folder / "poses.csv", bodies)
    femur = fixed_poses(tibia, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    write_trc(folder / "walk.trc", markers_of({"femur": femur, **bodies}))
    save_mesh(_femur(), folder / "femur.stl")
    scene = folder / "scene.toml"
    scene.write_text(text)
    return scene


DM_SCENE = """
schema = 1
name = "dm_knee"

[axes]  # -x anterior, +y proximal, +z medial
femur = ["+y", "-z", "-x"]
tibia = ["+y", "-z", "-x"]
patella = ["+y", "-z", "-x"]

[motion]
poses = "FOLDER/passive_flexion_poses.csv"
start_time_s = 0.5
end_time_s = 0.8

[femur]
body = "femur"

[tibia]
body = "tibia"

[patella]
mass_kg = 0.449
inertia_kg_m2 = [1.642e-5, 7.594e-5, 7.594e-5]
start = { body = "patella" }

[gravity]
acceleration_m_per_s2 = [0, -9.81, 0]

[[strands]]
name = "patellar_tendon"
body = "tibia"
file = "FOLDER/ligaments.json"
select = ["PT*"]
damping_time_s = 0.003

[[strands]]
name = "retinacula"
body = "femur"
file = "FOLDER/ligaments.json"
damping_time_s = 0.003

[[prescribed_tension]]
name = "quadriceps"
body = "femur"
file = "FOLDER/passive_flexion_quadriceps.csv"

[contact]
button = { mesh = "FOLDER/patellar_button_contact.stl", units = "m" }
law = { type = "hertz", contact_stiffness = 3e8, hertz_exponent = 2 }
surface = { mesh = "FOLDER/femoral_component_contact.stl", units = "m", degree = "P6", chart = "cylinder" }

[measured]
patella = { body = "patella" }
forces = "FOLDER/passive_flexion_tensions.csv"
tibial_spring_force = "patellar_tendon_N"
"""

PATCH = """
[contact.surface]
degree = "P2"
chart = { type = "plane", origin_m = [0, 0.001, 0.02], quaternion_wxyz = [0.9962, 0.05, -0.0705, 0] }
center_m = [0, 0.002]
half_size_mm = [24, 20]
coefficients_m = [0.004, 0.001, -0.009, 0.0005, 0.0002, 0.003]
"""
# The same scene without its mesh: what most of the tests below need, in a tenth of the time.
LIGHT = SCENE[: SCENE.index("[contact.surface]")] + PATCH


def load(folder: Path, text: str, name: str = "variant.toml") -> Scene:
    """The scene of a text, in the folder of the toy's files."""
    file = folder / name
    file.write_text(text)
    return load_scene(file)


def changed(old: str, new: str, text: str = LIGHT) -> str:
    """A text with one thing changed."""
    assert old in text
    return text.replace(old, new, 1)


def refused(folder: Path, text: str) -> str:
    """The message about a text, without the folder's name."""
    with pytest.raises(InputError) as caught:
        load(folder, text, "bad.toml")
    message = str(caught.value)
    assert message.startswith(str(folder / "bad.toml"))
    return message.replace(f"{folder}/", "")


def same(a: object, b: object, **tolerance: float) -> None:
    assert jax.tree.structure(a) == jax.tree.structure(b)
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        np.testing.assert_allclose(np.asarray(x), np.asarray(y), **({"atol": 1e-9, "rtol": 1e-9} | tolerance))
