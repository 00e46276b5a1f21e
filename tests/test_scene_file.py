"""Scene files: what they build, and what they say about mistakes."""

from __future__ import annotations

import json
from pathlib import Path

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from toy_scene_files import (
    CLUSTERS,
    DM_SCENE,
    SCENE,
    START,
    markers_of,
    tibia_poses,
    write_poses,
    write_toy,
)

from pftwin.dynamics.trajectory import first_guide
from pftwin.effects.base import Patella
from pftwin.effects.contact_law import Flores, Hertz, HuntCrossley
from pftwin.effects.tendon import Tendon
from pftwin.errors import InputError
from pftwin.mocap import PoseSeries, write_trc
from pftwin.motion import SegmentMotion
from pftwin.scene import Scene
from pftwin.scene_file import load_scene, load_scene_file
from pftwin.scene_file.host_pose import HostPose
from pftwin.scene_file.section import Section
from pftwin.spatial import Vec3
from pftwin.surfaces.implant import rig_implant
from pftwin.surfaces.mesh import SurfaceMesh, save_mesh

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


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("toy")
    write_toy(folder)
    return folder


def load(folder: Path, text: str, name: str = "variant.toml") -> Scene:
    file = folder / name
    file.write_text(text)
    return load_scene(file)


def changed(old: str, new: str, text: str = LIGHT) -> str:
    assert old in text
    return text.replace(old, new, 1)


def refused(folder: Path, text: str) -> str:
    with pytest.raises(InputError) as caught:
        load(folder, text, "bad.toml")
    message = str(caught.value)
    assert message.startswith(str(folder / "bad.toml"))
    return message.replace(f"{folder}/", "")


def same(a: object, b: object, **tolerance: float) -> None:
    assert jax.tree.structure(a) == jax.tree.structure(b)
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        np.testing.assert_allclose(np.asarray(x), np.asarray(y), **({"atol": 1e-9, "rtol": 1e-9} | tolerance))


def same_motion(a: SegmentMotion, b: SegmentMotion) -> None:
    """Frames rather than coefficients: third derivatives magnify the last digit of a file."""
    times = np.linspace(a.knots[0], a.knots[-1], 57)
    one, other = a.frames(times), b.frames(times)
    same((one.origin, one.rotation), (other.origin, other.rotation), atol=1e-7)
    same((one.velocity, one.angular_velocity), (other.velocity, other.angular_velocity), atol=1e-5)


def test_the_toy_scene_holds_what_its_file_says(toy: Path) -> None:
    loaded = load_scene_file(toy / "scene.toml")
    scene = loaded.scene
    assert [e.name for e in scene.effects] == ["gravity", "quadriceps", "patellar_tendon", "contact"]
    assert scene.name == "toy"
    assert loaded.measured is None
    quadriceps, tendon = scene.effect("quadriceps"), scene.effect("patellar_tendon")
    assert isinstance(quadriceps, Tendon)
    assert isinstance(tendon, Tendon)
    assert float(quadriceps.stiffness) == 156
    assert float(quadriceps.slack_length) == pytest.approx(0.1432)
    assert float(quadriceps.damping) == pytest.approx(1.56)
    assert float(tendon.damping) == 6.29
    assert (quadriceps.body, tendon.body) == ("femur", "tibia")
    np.testing.assert_allclose(quadriceps.insertion.array(), [0.02, 0, -0.008])
    np.testing.assert_allclose(scene.patella.center_of_mass.array(), [0.001, 0, 0.004])
    assert scene.contact is not None
    assert scene.contact.surface.degree == 5
    assert isinstance(scene.contact.law, Flores)
    assert scene.motion.n_frames == 41
    assert scene.motion.femur is None
    np.testing.assert_allclose(scene.start.position.array(), START[0])
    assert any("R^2 99." in note for note in loaded.notes)


def test_the_polynomial_can_be_asked_for_by_the_caller(toy: Path) -> None:
    scene = load_scene(toy / "scene.toml", contact="P2")
    assert scene.contact is not None
    assert scene.contact.surface.degree == 2
    (toy / "light.toml").write_text(LIGHT)
    with pytest.raises(InputError, match=r"P4 was asked for, and this surface is not fitted to a mesh"):
        load_scene(toy / "light.toml", contact="P4")


def test_markers_give_the_motion_that_poses_give(toy: Path) -> None:
    by_poses = load(toy, LIGHT)
    clusters = {
        body: "{ " + ", ".join(f"{n} = {[1e3 * v for v in p]}" for n, p in places.items()) + " }"
        for body, places in CLUSTERS.items()
    }
    text = changed('poses = "poses.csv"', 'markers = "walk.trc"')
    text = changed('body = "tibia"', f"cluster_mm = {clusters['tibia']}", text)
    text = changed("fixed = { position_m = [-0.005, 0.001, 0.05] }", f"cluster_mm = {clusters['patella']}", text)
    by_markers = load(toy, text)
    assert by_markers.motion.femur is None
    same_motion(by_markers.motion.tibia, by_poses.motion.tibia)
    same(by_markers.start, by_poses.start, atol=1e-7)


def test_a_moving_femur_is_recorded_like_a_tibia(toy: Path) -> None:
    tibia = tibia_poses()
    t = tibia.times
    femur = PoseSeries(
        t,
        np.outer(np.sin(t), [0.1, 0, 0.02]),
        Rotation.from_rotvec(np.outer(t, [0.1, 0.2, 0])).as_quat(scalar_first=True),
    )
    write_trc(toy / "moving.trc", markers_of({"femur": femur, "tibia": tibia}))
    write_poses(toy / "moving.csv", {"femur": femur, "tibia": tibia})
    by_poses = load(toy, changed('"poses.csv"', '"moving.csv"') + '\n[femur]\nbody = "femur"\n')
    text = changed('poses = "poses.csv"', 'markers = "moving.trc"')
    text = changed('body = "tibia"', 'three_points = { markers = ["T1", "T2", "T3"] }', text)
    text += "\n[femur]\ncluster_m = " + json.dumps(CLUSTERS["femur"]).replace('":', '" =') + "\n"
    by_markers = load(toy, text)
    assert by_markers.motion.femur is not None
    assert by_poses.motion.femur is not None
    same_motion(by_markers.motion.femur, by_poses.motion.femur)
    first = by_markers.motion.tibia.frames(0.2)
    t1, t2, t3 = (np.asarray(CLUSTERS["tibia"][n]) for n in ("T1", "T2", "T3"))
    axis = (t2 - t1) / np.linalg.norm(t2 - t1)
    true = by_poses.motion.tibia.frames(0.2)
    np.testing.assert_allclose(first.origin.array(), true.point(Vec3.from_array(t1)).array(), atol=1e-8)
    np.testing.assert_allclose(first.rotation.ex.array(), true.direction(Vec3.from_array(axis)).array(), atol=1e-7)
    assert abs(float(first.rotation.ez.dot(true.direction(Vec3.from_array(t3 - t1))))) < 1e-8


def test_a_fixed_femur_anywhere_in_the_world_gives_the_scene_in_its_own_frame(toy: Path) -> None:
    position, quaternion = [0.3, -0.2, 0.9], Rotation.from_rotvec([0.4, 1.1, -0.3]).as_quat(scalar_first=True)
    x = HostPose.of(position, quaternion)
    tibia = tibia_poses()
    in_world = PoseSeries.from_matrices(tibia.times, x.apply(tibia.positions), x.matrix @ tibia.matrices())
    start = x @ HostPose.of(*START)
    patella = PoseSeries.from_matrices(tibia.times, np.tile(start.position, (41, 1)), np.tile(start.matrix, (41, 1, 1)))
    write_poses(toy / "world.csv", {"tibia": in_world, "patella": patella})
    text = changed('"poses.csv"', '"world.csv"')
    text = changed("fixed = { position_m = [-0.005, 0.001, 0.05] }", 'body = "patella"', text)
    text = changed("[0, 0, -9.81]", str((x.matrix @ [0, 0, -9.81]).tolist()), text)
    text += f"\n[femur]\nfixed = {{ position_m = {position}, quaternion_wxyz = {quaternion.tolist()} }}\n"
    ground = '\n[[tendon]]\nname = "string"\nbody = "ground"\nstiffness_N_per_m = 10\nslack_length_m = 0.1\n'
    ground += "insertion_m = [0, 0, 0]\norigin_m = {}\n"
    there = load(toy, text + ground.format(x.apply([0.1, 0.2, 0.3]).tolist()))
    here = load(toy, LIGHT + ground.format([0.1, 0.2, 0.3]))
    same_motion(there.motion.tibia, here.motion.tibia)
    same((there.effects, there.patella, there.start), (here.effects, here.patella, here.start))


def test_a_start_can_be_given_in_the_femur(toy: Path) -> None:
    femur = "\n[femur]\nfixed = { position_m = [0.3, 0.1, 0.2], quaternion_wxyz = [0.6, 0.8, 0, 0] }\n"
    start = 'start = { relative_to = "femur", fixed'
    scene = load(toy, changed("start = { fixed", start, LIGHT + femur))
    np.testing.assert_allclose(scene.start.position.array(), START[0], atol=1e-12)


def test_a_left_knee_is_the_mirror_image_of_a_right_one(toy: Path) -> None:
    flip = np.array([1.0, -1.0, 1.0])
    tibia = tibia_poses()
    q = Rotation.from_rotvec(np.array([0.1, 0.2, -0.1])) * Rotation.from_quat(tibia.quaternions, scalar_first=True)
    right = PoseSeries(tibia.times, np.tile([0.0, 0.003, 0.0], (41, 1)), q.as_quat(scalar_first=True))
    left = PoseSeries.from_matrices(right.times, right.positions * flip, flip[:, None] * right.matrices() * flip)
    write_poses(toy / "right.csv", {"tibia": right})
    write_poses(toy / "left.csv", {"tibia": left})
    mesh = rig_implant().mesh(deviation=0.1e-3)
    save_mesh(SurfaceMesh(mesh.vertices * flip, mesh.faces[:, ::-1]), toy / "left.stl")
    light, full = (t.replace('"poses.csv"', '"right.csv"') for t in (LIGHT, SCENE))
    pairs = [
        ('"right.csv"', '"left.csv"'),
        ("schema = 1", 'schema = 1\nside = "left"'),
        ("[-0.005, 0.001, 0.05]", "[-0.005, -0.001, 0.05]"),
        ("[0.22, 0.012, 0.035]", "[0.22, -0.012, 0.035]"),
        ("[-0.07, 0.01, 0.045]", "[-0.07, -0.01, 0.045]"),
    ]
    patch = [
        ("[0, 0.001, 0.02]", "[0, -0.001, 0.02]"),
        ("[0.9962, 0.05, -0.0705, 0]", "[0.9962, -0.05, -0.0705, 0]"),
        ("[0, 0.002]", "[0, -0.002]"),
        ("0.0005, 0.0002, 0.003]", "-0.0005, -0.0002, 0.003]"),
    ]
    for text, swaps, tolerance in ((light, patch, 1e-8), (full, [('"femur.stl"', '"left.stl"')], 1e-8)):
        mirrored = text
        for old, new in (*pairs, *swaps):
            mirrored = changed(old, new, mirrored)
        same(load(toy, mirrored), load(toy, text), atol=tolerance)


def test_a_patch_by_its_coefficients_is_that_patch(toy: Path) -> None:
    contact = load(toy, LIGHT).contact
    assert contact is not None
    a, b = 0.5, -0.25
    u, v = 0.024 * a, 0.002 + 0.02 * b
    height = 0.004 + 0.001 * a - 0.009 * a * a + 0.0005 * b + 0.0002 * a * b + 0.003 * b * b
    assert float(contact.surface.height(np.asarray(u), np.asarray(v))) == pytest.approx(height, abs=1e-12)


@pytest.mark.parametrize(
    ("law", "kind"),
    [
        ('{ type = "hertz", contact_stiffness = 2e8, hertz_exponent = 1 }', Hertz),
        ('{ type = "hunt_crossley", contact_stiffness = 2e8, dissipation_s_per_m = 0.3 }', HuntCrossley),
    ],
)
def test_contact_laws(toy: Path, law: str, kind: type) -> None:
    contact = load(toy, changed('{ type = "flores", contact_stiffness = 2e8, restitution = 0.6 }', law)).contact
    assert contact is not None
    assert type(contact.law) is kind


def test_the_rigs_smooth_implant_can_be_the_surface(toy: Path) -> None:
    text = SCENE[: SCENE.index("[contact.surface]")] + '[contact.surface]\nimplant = "rig"\n'
    contact = load(toy, text).contact
    assert contact is not None
    same(contact.surface, rig_implant())


GROUP = """
[[tendon]]
name = "retinaculum"
body = "femur"
stiffness_N_per_m = [100, 200]
slack_length_m = 0.05
insertion_m = [[0, 0.01, 0], [0, -0.01, 0]]
origin_mm = [[10, 50, 20], [10, -50, 20]]
"""


def test_lists_make_a_group(toy: Path) -> None:
    group = load(toy, LIGHT + GROUP).effect("retinaculum")
    assert isinstance(group, Tendon)
    np.testing.assert_allclose(group.stiffness, [100, 200])
    np.testing.assert_allclose(group.slack_length, [0.05, 0.05])
    np.testing.assert_allclose(group.damping, [0, 0])
    np.testing.assert_allclose(group.origin.y, [0.05, -0.05])


STRANDS = '\n[[strands]]\nname = "ligament"\nbody = "tibia"\ntoe_strain = 0.06\ndamping_time_s = 0.003\n'


def test_strands_from_lists_json_and_csv_are_the_same(toy: Path) -> None:
    inline = "stiffness_N_per_strain = [490, 500]\nslack_length_mm = [75, 76]\n"
    inline += "insertion_m = [[-0.01, 0, 0], [-0.01, 0.002, 0]]\norigin_m = [[-0.07, 0, 0.04], [-0.07, 0.001, 0.04]]\n"
    a = {"points": [["patella", [-0.01, 0, 0]], ["tibia", [-0.07, 0, 0.04]]]}
    b = {"points": [["tibia", [-0.07, 0.001, 0.04]], ["patella", [-0.01, 0.002, 0]]]}
    other = {"points": [["femur", [0, 0, 0]], ["patella", [0, 0, 0]]]}
    sizes = [{"linear_stiffness_N_per_strain": k, "slack_length_m": s} for k, s in ((490, 0.075), (500, 0.076))]
    strands = {"PT1": a | sizes[0], "PT2": b | sizes[1], "MPFL1": other | sizes[0], "XX": a | sizes[0]}
    (toy / "strands.json").write_text(json.dumps(strands))
    header = "name,stiffness_N_per_strain,slack_length_m," + ",".join(
        f"{e}_{k}_m" for e in ("insertion", "origin") for k in "xyz"
    )
    rows = "PT1,490,0.075,-0.01,0,0,-0.07,0,0.04\nPT2,500,0.076,-0.01,0.002,0,-0.07,0.001,0.04\n"
    (toy / "strands.csv").write_text(f"{header}\n{rows}")
    listed = load(toy, LIGHT + STRANDS + inline)
    same(load(toy, LIGHT + STRANDS + 'file = "strands.json"\nselect = ["PT*"]\n'), listed)
    same(load(toy, LIGHT + STRANDS + 'file = "strands.csv"\n'), listed)
    message = refused(toy, LIGHT + STRANDS + 'file = "strands.json"\nselect = ["QT*"]\n')
    assert "[[strands]] number 1 (ligament), file: strands.json: no strand from the patella to the tibia" in message
    message = refused(toy, LIGHT + STRANDS + inline + 'file = "strands.csv"\n')
    assert "both file and stiffness_N_per_strain are given" in message
    (toy / "strands.csv").write_text(f"{header}\n{rows.replace('0.076', 'long')}")
    assert "strands.csv, line 3: a cell is missing or no number" in refused(
        toy, LIGHT + STRANDS + 'file = "strands.csv"\n'
    )
    (toy / "strands.csv").write_text(f"{header}\n{rows.replace('500', '-500')}")
    assert "strand 'PT2': stiffness -500" in refused(toy, LIGHT + STRANDS + 'file = "strands.csv"\n')


TENSION = '\n[[prescribed_tension]]\nname = "muscles"\nbody = "femur"\nfile = "tension.csv"\n'


def test_prescribed_tensions(toy: Path) -> None:
    times = np.arange(11) * 0.04
    header = "time_s,vas_tension_N,vas_via_femur_x_m,vas_via_femur_y_m,vas_via_femur_z_m"
    rows = [f"{t:.4f},{10 + t},{0.2 + t},0,0.05" for t in times]
    (toy / "tension.csv").write_text("\n".join([header, *rows]) + "\n")
    insertion = "insertion_mm = [20, 0, -8]\n"
    muscles = load(toy, LIGHT + TENSION + insertion).effect("muscles")
    tension, origin = muscles.at(0.1)  # type: ignore[attr-defined]
    np.testing.assert_allclose(tension, [10.1])
    np.testing.assert_allclose(origin.x, [0.3])
    np.testing.assert_allclose(muscles.insertion.z, [-0.008])  # type: ignore[attr-defined]
    assert "no column vas_insertion_x_m, and no insertion_m in the scene file" in refused(toy, LIGHT + TENSION)
    (toy / "tension.csv").write_text("\n".join([header, *rows[:-2]]) + "\n")
    assert "tensions for the whole motion, 0 s to 0.4 s" in refused(toy, LIGHT + TENSION + insertion)
    (toy / "tension.csv").write_text("\n".join([header, *rows]).replace("10.04", "-3") + "\n")
    assert "column 'vas_tension': row 2 holds -3" in refused(toy, LIGHT + TENSION + insertion)


MEASURED = """
[measured]
patella = { body = "patella" }
forces = "forces.csv"
contact_force = "contact_N"
tibial_spring_force = "tendon"
"""


def test_measurements_are_in_the_femur_at_the_frames(toy: Path) -> None:
    t = np.arange(81) * 0.005
    rows = [f"{x:.4f},{100 * x + 5},{0.001 * x}" for x in t]
    (toy / "forces.csv").write_text("\n".join(["time_s,contact_N,tendon_kN", *rows]) + "\n")
    femur = "\n[femur]\nfixed = { position_m = [0.1, 0, 0] }\n"
    (toy / "measured.toml").write_text(
        changed("radius_mm = 22", "radius_mm = 22\ncenter_mm = [1, 2, 3]", LIGHT + MEASURED + femur)
    )
    measured = load_scene_file(toy / "measured.toml").measured
    assert measured is not None
    assert measured.times.shape == (41,)
    np.testing.assert_allclose(measured.center[7], np.add(START[0], [0.001 - 0.1, 0.002, 0.003]), atol=1e-12)
    assert measured.contact_force is not None
    assert measured.tibial_spring_force is not None
    np.testing.assert_allclose(measured.contact_force[10], 15, atol=1e-9)
    np.testing.assert_allclose(measured.tibial_spring_force[10], 0.1, atol=1e-9)
    assert measured.femoral_spring_force is None
    (toy / "forces.csv").write_text("\n".join(["time_s,contact_N,tendon_kN", *rows[:40]]) + "\n")
    assert "[measured] forces: forces.csv: forces from 0 s to 0.195 s" in refused(toy, LIGHT + MEASURED)


def test_a_knee_from_the_literature_in_its_own_axes(dm_knee: Path, tmp_path: Path) -> None:
    (tmp_path / "dm.toml").write_text(DM_SCENE.replace("FOLDER", str(dm_knee)))
    loaded = load_scene_file(tmp_path / "dm.toml")
    scene, measured = loaded.scene, loaded.measured
    assert measured is not None
    assert scene.motion.n_frames == 31
    tendon, retinacula = scene.effect("patellar_tendon"), scene.effect("retinacula")
    assert tendon.stiffness.shape == (30,)  # type: ignore[attr-defined]
    assert retinacula.stiffness.shape == (30,)  # type: ignore[attr-defined]
    assert float(tendon.stiffness.sum()) == pytest.approx(14700)  # type: ignore[attr-defined]
    np.testing.assert_allclose(scene.patella.inertia.array(), [7.594e-5, 7.594e-5, 1.642e-5])
    # The patella lies in front of the trochlea, and is hardly turned against the femur at full extension.
    assert measured.quaternion is not None
    assert scene.contact is not None
    assert float(scene.contact.radius) == pytest.approx(19.05e-3, abs=2e-5)
    assert measured.center[0, 2] > 0.03
    assert abs(measured.quaternion[0, 0]) > 0.97
    assert measured.contact_force is None
    assert measured.tibial_spring_force is not None
    femur, tibia = scene.motion.frames(scene.motion.start_time)
    assert femur is not None
    assert float(femur.to_local(tibia.origin).x) < 0  # the tibia lies distally
    center = femur.to_local(scene.start.apply(scene.tracked_point()))
    np.testing.assert_allclose(center.array(), measured.center[0], atol=1e-5)
    lines = [e.line(first_guide(scene).instant(_resting(scene), 0.0)) for e in (tendon, retinacula)]  # type: ignore[attr-defined]
    assert 0.05 < float(lines[0].length.min()) and float(lines[0].length.max()) < 0.1


def _resting(scene: Scene) -> Patella:
    return Patella.at_rest(scene.start.position, scene.start.orientation)


def test_axes_of_the_wrong_side_are_refused(toy: Path) -> None:
    axes = '\n[axes]\ntibia = ["+x", "-y", "+z"]\n'
    assert "[axes] tibia: ['+x', '-y', '+z'] are the axes of a left knee" in refused(toy, LIGHT + axes)
    assert 'expected: three axes with signs, as in ["+y", "+z", "-x"]' in refused(toy, LIGHT + axes.replace("-y", "x"))


def test_a_scene_in_other_axes_is_the_same_scene(toy: Path) -> None:
    """The tibia's frame named anew: proximal, lateral, anterior are its -z, -x, +y."""
    names = np.array([[0.0, 0, -1], [-1, 0, 0], [0, 1, 0]])  # rows: proximal, lateral, anterior in the new axes
    tibia = tibia_poses()
    turned = PoseSeries.from_matrices(tibia.times, tibia.positions, tibia.matrices() @ names)
    write_poses(toy / "turned.csv", {"tibia": turned})
    text = changed('"poses.csv"', '"turned.csv"', LIGHT) + '\n[axes]\ntibia = ["-z", "-x", "+y"]\n'
    text = changed("[-0.07, 0.01, 0.045]", str((names.T @ [-0.07, 0.01, 0.045]).tolist()), text)
    there, here = load(toy, text), load(toy, LIGHT)
    same_motion(there.motion.tibia, here.motion.tibia)
    same((there.effects, there.patella, there.start), (here.effects, here.patella, here.start))


def test_only_part_of_a_recording(toy: Path) -> None:
    scene = load(toy, changed('"poses.csv"', '"poses.csv"\nstart_time_s = 0.1\nend_time_s = 0.3'))
    assert scene.motion.n_frames == 21
    assert scene.motion.start_time == pytest.approx(0.1)


MISTAKES = [
    ("schema = 1", "", "bad.toml, schema: is missing; expected: schema = 1"),
    ("schema = 1", "schema = 2", "bad.toml, line 2, schema: found 2"),
    ("schema = 1", "schema = 1\nbananas = 3", "line 3, bananas: unknown field; expected: one of schema, name, side"),
    ("mass_kg", "mas_kg", "line 12, [patella] mas_kg: unknown field; expected: did you mean mass_kg?"),
    ("mass_kg = 0.12\n", "", "line 11, [patella] mass_kg: is missing; expected: mass of the patella [kg]"),
    ("mass_kg = 0.12", "mass_kg = -0.12", "line 12, [patella] mass_kg: found -0.12; expected: a positive number"),
    ("mass_kg = 0.12", "mass_kg = 0", "[patella] mass_kg: found 0; expected: a positive number"),
    ("mass_kg = 0.12", 'mass_kg = "0.12"', "[patella] mass_kg: found '0.12'; expected: a number"),
    ("mass_kg = 0.12", "mass_kg = nan", "[patella] mass_kg: found nan; expected: a finite number"),
    ("[3e-5, 3e-5, 4e-5]", "[3e-5, 3e-5]", "[patella] inertia_kg_m2: found [3e-05, 3e-05]; expected: 3 values"),
    ("[3e-5, 3e-5, 4e-5]", "[3e-5, 0, 4e-5]", "inertia_kg_m2 number 2: found 0; expected: a positive number"),
    ("= 629", "= -629", "line 32, [[tendon]] number 2 (patellar_tendon), stiffness_N_per_m: found -629"),
    ("= 629", "= 0", "stiffness_N_per_m: found 0; expected: a positive number (stiffness K [N/m])"),
    ("length_mm = 143.2", "length_mm = -1", "number 1 (quadriceps), slack_length_mm: found -1; expected: a positive"),
    ("mm = 143.2", "mm = 143.2\nslack_length_m = 0.1", "both slack_length_m and slack_length_mm are given"),
    ("length_mm = 143.2", "lenght_mm = 143.2", "slack_lenght_mm: unknown field; expected: did you mean slack_length_m"),
    ('body = "femur"', 'body = "femurr"', "body: found 'femurr'; expected: one of 'femur', 'tibia' or 'ground'"),
    ("= 156", "= [1, 2, 3]\ndamping_N_s_per_m = [1, 2]", "both damping_N_s_per_m and damping_time_s are given"),
    ("radius_mm = 22\n", "", "[contact]: the sphere has no radius; expected: radius_m and center_m, or button"),
    ("= 156", "= [1, 2, 3]\ntags = 1", "tags: unknown field"),
    ("insertion_mm = [20, 0, -8]", "insertion_mm = [20, 0]", "insertion_mm: found [20, 0]; expected: 3 values"),
    ("[20, 0, -8]", "[[2, 0, 1], [3, 4]]", "insertion_mm number 2: found [3, 4]; expected: 3 values"),
    ('"patellar_tendon"', '"quadriceps"', "two effects are named 'quadriceps'"),
    ('"patellar_tendon"', '"patellar tendon"', "expected: a name of letters, digits and _"),
    (
        "{ position_m",
        "{ quaternion_wxyz = [1, 1, 0, 0], position_m",
        "quaternion_wxyz: found a quaternion of length 1.41",
    ),
    ('"flores"', '"floress"', "[contact] law: type is 'floress'; expected: table: the normal force's law"),
    ('type = "flores", ', "", "[contact] law: type is missing"),
    ("restitution = 0.6", "restitution = 1.6", "law.restitution: found 1.6; expected: a number of at most 1"),
    ("restitution = 0.6", "restituton = 0.6", "law.restituton: unknown field; expected: did you mean restitution?"),
    ("radius_mm = 22", "radius_mm = 0", "[contact] radius_mm: found 0; expected: a positive number"),
    ("coefficients_m = [0.004, ", "coefficients_m = [", "surface.coefficients_m: 5 coefficients; expected: the 6"),
    ('"P2"', '"Q2"', "surface.degree: found 'Q2'; expected: a polynomial"),
    ('type = "plane"', 'type = "cylinder"', "surface.chart: a cylinder chart without radius_m"),
    ('"poses.csv"', '"missing.csv"', "line 6, [motion] poses: missing.csv: no such file"),
    ('"poses.csv"', '"poses.csv"\nend_time_s = 5', "line 7, [motion] end_time_s: found 5; expected: a time within"),
    ('"poses.csv"', '"poses.csv"\nend_time_s = 0.02', "a motion of 3 frames is shorter than its interpolation needs"),
    ('"poses.csv"', '"poses.csv"\nstart_time_s = 1\nend_time_s = 0', "expected: start < end"),
    (
        'body = "tibia"\n',
        'body = "tibea"\n',
        "line 9, [tibia] body: poses.csv: no body called 'tibea'; expected: did you mean",
    ),
    ('[tibia]\nbody = "tibia"', "[tibia]", "[tibia]: nothing says where it is; expected: one of fixed, body"),
    ('[tibia]\nbody = "tibia"', "[tibia]\nfixed = {}", "[tibia] fixed: the tibia is fixed; expected: a recording"),
    ('[tibia]\nbody = "tibia"', "", "bad.toml, tibia: is missing"),
    ("[gravity]", "[gravity", "line 17, column 9: not valid TOML"),
    ("[gravity]", "[gravty]", "line 17, [gravty]: unknown field; expected: did you mean gravity?"),
    ("[0, 0, -9.81]", "9.81", "[gravity] acceleration_m_per_s2: found 9.81; expected: a list in square brackets"),
]


@pytest.mark.parametrize(("old", "new", "message"), MISTAKES, ids=[m[2][:60] for m in MISTAKES])
def test_a_mistake_is_named_with_file_line_and_field(toy: Path, old: str, new: str, message: str) -> None:
    assert message in refused(toy, changed(old, new))


MESH_MISTAKES = [
    ('"femur.stl"', '"femurs.stl"', "[contact] surface.mesh: femurs.stl: no such file"),
    ('"femur.stl"', '"empty.stl"', "[contact] surface.mesh: empty.stl: the file is empty"),
    ('"femur.stl"', '"half.stl"', "surface.mesh: half.stl: a truncated or damaged binary STL"),
    ('"femur.stl"', '"poses.csv"', "surface.mesh: poses.csv: unknown mesh format .csv"),
    ('"femur.stl"', '"nan.stl"', "vertices are not finite"),
    ('"femur.stl"', '"flipped.stl"', "the normals of the foremost vertices point backward"),
    ('"femur.stl"', '"mixed.stl"', "surface.mesh: mixed.stl: "),
    ('units = "m"', 'units = "mm"', "a longest side of 0.064 mm is implausible"),
    ('units = "m"\n', "", "[contact] surface.units: is missing; expected: unit of the mesh's coordinates"),
    ("[-75, 30], half_width_mm = 20", "[-60, 0], half_width_mm = 8", "vertices for the 91 coefficients of P12"),
    ('chart = "plane"', 'chart = "sphere"', "surface.chart: found 'sphere'; expected: one of 'plane' or 'cylinder'"),
    ("[-75, 30]", "[30, -75]", "surface.region: angles_deg is [30.0, -75.0]; expected: the lower limit first"),
    ("axis_radius_mm = 24.8, ", "", "only one of axis_origin_m and axis_radius_m is given"),
    ("region = {", "region = { anterior = [1, 0, 0],", "anterior and proximal are nearly parallel"),
    ("region = {", "region = { anterior = [0, 0, 0],", "region.anterior: found the zero vector"),
]


@pytest.fixture(scope="module")
def bad_meshes(toy: Path) -> Path:
    data = (toy / "femur.stl").read_bytes()
    (toy / "empty.stl").write_bytes(b"")
    (toy / "half.stl").write_bytes(data[: len(data) // 2 - 7])
    triangles = np.frombuffer(data[84:], dtype=np.uint8).reshape(-1, 50).copy()
    corners = triangles[:, 12:48].copy().view("<f4").reshape(-1, 3, 3)

    def save(name: str, points: np.ndarray) -> None:
        out = triangles.copy()
        out[:, 12:48] = np.ascontiguousarray(points, dtype="<f4").reshape(-1, 9).view(np.uint8)
        (toy / name).write_bytes(data[:84] + out.tobytes())

    save("nan.stl", np.where(np.arange(len(corners))[:, None, None] == 5, np.nan, corners))
    save("flipped.stl", corners[:, ::-1])
    some = np.arange(len(corners)) % 7 == 0
    save("mixed.stl", np.where(some[:, None, None], corners[:, ::-1], corners))
    return toy


@pytest.mark.parametrize(("old", "new", "message"), MESH_MISTAKES, ids=[m[2][:60] for m in MESH_MISTAKES])
def test_a_mesh_that_cannot_be_used_is_named(bad_meshes: Path, old: str, new: str, message: str) -> None:
    text = changed('"P5"', '"P12"', SCENE) if "P12" in message else SCENE
    assert message in refused(bad_meshes, changed(old, new, text))


MARKERS = changed('poses = "poses.csv"', 'markers = "walk.trc"\ncutoff_Hz = 12')
MARKERS = changed(
    'body = "tibia"', "cluster_mm = { T1 = [-150, 50, 40], T2 = [-200, -40, 50], T3 = [-250, 20, 80] }", MARKERS
)
MARKER_MISTAKES = [
    ("cutoff_Hz = 12", "cutoff_Hz = 60", "[motion] cutoff_Hz: cutoff: a cut-off of 60 Hz cannot be had at 100 Hz"),
    ("cutoff_Hz = 12", "cutoff_Hz = 12\nend_time_s = 0.02", "shorter than its interpolation needs"),
    ("cutoff_Hz = 12", "cutoff_Hz = 2", "samples are too few for a filter of 2 Hz"),
    ("walk.trc", "gap.trc", "gaps that cannot be filled: 'T2' frames 5 to 24"),
    ("walk.trc", "poses.csv", "[motion] markers: poses.csv"),
    ("walk.trc", "walk.xyz", "the suffix '.xyz' is not known"),
    ("walk.trc", "binary.trc", "binary.trc: the content is binary, not text"),
    ("walk.trc", "cut.trc", "cut.trc, line"),
    ("walk.trc", "words.trc", "not a number"),
    ("walk.trc", "twice.trc", "repeats the time"),
    ("T3 = [-250, 20, 80]", "T9 = [-250, 20, 80]", "[tibia] cluster_mm: "),
    (", T3 = [-250, 20, 80]", "", "fewer than three markers"),
    ("T3 = [-250, 20, 80]", "T3 = [-250, -130, 60]", "lie on a line"),
]


@pytest.fixture(scope="module")
def bad_markers(toy: Path) -> Path:
    text = (toy / "walk.trc").read_text()
    lines = text.split("\n")
    (toy / "binary.trc").write_bytes(b"\x00\x01\x02" * 100)
    (toy / "cut.trc").write_text(text[:-40])
    (toy / "words.trc").write_text(text.replace(lines[10].split("\t")[5], "high"))
    cells = [line.split("\t") for line in lines]
    column = cells[3].index("T2")
    for row in cells[11:31]:
        row[column : column + 3] = ["", "", ""]
    (toy / "gap.trc").write_text("\n".join("\t".join(row) for row in cells))
    frame, _, *rest = lines[9].split("\t")
    doubled = [*lines[:9], "\t".join([frame, lines[8].split("\t")[1], *rest]), *lines[10:]]
    (toy / "twice.trc").write_text("\n".join(doubled))
    return toy


@pytest.mark.parametrize(("old", "new", "message"), MARKER_MISTAKES, ids=[m[2][:60] for m in MARKER_MISTAKES])
def test_a_recording_that_cannot_be_used_is_named(bad_markers: Path, old: str, new: str, message: str) -> None:
    assert message in refused(bad_markers, changed(old, new, MARKERS))


def test_poses_that_are_none_are_named(toy: Path) -> None:
    text = (toy / "poses.csv").read_text().splitlines()
    cells = [line.split(",") for line in text]
    cells[5][4] = "2.0"
    (toy / "skewed.csv").write_text("\n".join(",".join(c) for c in cells) + "\n")
    assert "skewed.csv, body 'tibia': row 5: a quaternion of length" in refused(
        toy, changed('"poses.csv"', '"skewed.csv"')
    )


def test_every_problem_is_listed_at_once(toy: Path) -> None:
    message = refused(toy, changed("mass_kg = 0.12", "mass_kg = -1", changed("= 629", "= -629")))
    assert message.splitlines() == [
        "bad.toml: 2 problems:",
        "  line 12, [patella] mass_kg: found -1; expected: a positive number (mass of the patella [kg])",
        "  line 32, [[tendon]] number 2 (patellar_tendon), stiffness_N_per_m: found -629; expected: a positive number"
        " (stiffness K [N/m])",
    ]


@pytest.mark.parametrize(
    ("content", "message"),
    [(b"", "the file is empty"), (b"\x00\xff\x01" * 50, "the content is binary, not text"), (None, "no such file")],
)
def test_a_file_that_is_no_scene(tmp_path: Path, content: bytes | None, message: str) -> None:
    file = tmp_path / "scene.toml"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(InputError, match=message):
        load_scene(file)


def test_a_scene_without_effects_is_refused(toy: Path) -> None:
    assert "no effect acts on the patella" in refused(toy, LIGHT[: LIGHT.index("[gravity]")])


def _sections(base: type[Section]) -> list[type[Section]]:
    return [s for sub in base.__subclasses__() for s in (sub, *_sections(sub))]


def test_every_field_is_documented() -> None:
    bare = [
        f"{section.__name__}.{name}"
        for section in _sections(Section)
        for name, field in section.model_fields.items()
        if not field.description and name != "type"
    ]
    assert not bare


def test_the_line_numbers_follow_toml_into_nested_tables() -> None:
    from pftwin.scene_file.document import _line_numbers

    text = "a = 1\n[[t]]\nx = 1\n[t.sub]\ny = 2\n[[t]]\n  x.z = 3\n[[t.sub.deep]]\nw = 1\n"
    lines = _line_numbers(text.split("\n"), {})
    assert lines["a",] == 1
    assert lines["t", 0] == 2
    assert lines["t", 0, "sub", "y"] == 5
    assert lines["t", 1, "x", "z"] == 7
    assert lines["t", 1, "sub", "deep", 0, "w"] == 9
