"""Scene files: what they build."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from toy_scene_files import (
    CLUSTERS,
    DM_SCENE,
    LIGHT,
    SCENE,
    START,
    changed,
    load,
    markers_of,
    refused,
    same,
    tibia_poses,
    write_poses,
    write_toy,
)

import pftwin
from pftwin.base import cache_folder
from pftwin.base.errors import InputError
from pftwin.base.spatial import Vec3
from pftwin.dynamics.frame_states import first_guide
from pftwin.files.mocap import PoseSeries, write_trc
from pftwin.files.scene_file import load_scene, load_scene_file
from pftwin.files.scene_file.section import Section
from pftwin.files.scene_file.side import HostPose
from pftwin.geometry.mesh.mesh import SurfaceMesh, save_mesh
from pftwin.geometry.patch.implant import rig_implant
from pftwin.model.effects.base import Patella
from pftwin.model.effects.contact_law import Flores
from pftwin.model.effects.tendon import Tendon
from pftwin.model.motion import SegmentMotion
from pftwin.model.scene import Scene


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
    with pytest.raises(InputError, match=r"P4 was requested, but this surface is not fitted to a mesh"):
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
    text = changed(
        "limits = {", "limits = { least_flexion_deg = -180, most_adduction_deg = 90, most_rotation_deg = 180,", text
    )
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
    text = changed("limits = {", "limits = { most_adduction_deg = 90, most_rotation_deg = 180,", LIGHT + femur)
    scene = load(toy, changed("start = { fixed", start, text))
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
        scene, image = load(toy, text), load(toy, mirrored)
        assert (scene.left, image.left) == (False, True)
        same(replace(image, left=False), scene, atol=tolerance)


def test_a_knee_from_the_literature_in_its_own_axes(dm_knee: Path, tmp_path: Path) -> None:
    (tmp_path / "dm.toml").write_text(DM_SCENE.replace("FOLDER", str(dm_knee)))
    loaded = load_scene_file(tmp_path / "dm.toml", allow_outside=True)
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
    line = tendon.line(first_guide(scene).instant(_resting(scene), 0.0))  # type: ignore[attr-defined]
    assert float(line.length.min()) > 0.05
    assert float(line.length.max()) < 0.1


def _resting(scene: Scene) -> Patella:
    return Patella.at_rest(scene.start.position, scene.start.orientation)


def test_axes_of_the_wrong_side_are_refused(toy: Path) -> None:
    axes = '\n[axes]\ntibia = ["+x", "-y", "+z"]\n'
    assert "[axes] tibia: ['+x', '-y', '+z'] are the axes of a left knee" in refused(toy, LIGHT + axes)
    assert 'expected: three axes with signs, as in ["+y", "+z", "+x"]' in refused(toy, LIGHT + axes.replace("-y", "x"))


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


def test_a_motion_that_was_made_up_is_said_to_be(toy: Path) -> None:
    assert not load_scene(toy / "scene.toml").synthetic
    scene = load(toy, changed('"poses.csv"', '"poses.csv"\nsynthetic = true'))
    assert scene.synthetic
    assert scene.without("gravity").synthetic
    assert scene.with_effect(scene.effect("gravity")).synthetic
    assert not scene.unnamed().synthetic  # no part of a program


def test_vertices_count_by_the_weights_of_their_part(toy: Path) -> None:
    """A part of overwhelming weight is fitted as if there were nothing else."""
    surface = SCENE[SCENE.index("[contact.surface]") :]
    part = "emphasis = [{ weight = 1e8, angles_deg = [-20, 20], across_mm = [4, 16] }]"
    weighted, even = (load(toy, SCENE.replace(surface, f"{surface}{more}\n")).contact for more in (part, ""))
    assert weighted is not None
    assert even is not None
    true = rig_implant()
    u, v = (
        jnp.asarray(a.ravel()) for a in np.meshgrid(np.linspace(-0.0085, 0.0085, 30), np.linspace(0.0042, 0.0158, 30))
    )
    points = true.chart.point(u, v, true.height(u, v))

    def error(patch: Any) -> float:
        q = patch.chart.coordinates(points)
        return float(jnp.abs(patch.height(q.x, q.y) - q.z).max())

    assert error(weighted.surface) < 0.06e-3 < 3 * error(weighted.surface) < error(even.surface)


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
    from pftwin.files.scene_file.document import _line_numbers

    text = "a = 1\n[[t]]\nx = 1\n[t.sub]\ny = 2\n[[t]]\n  x.z = 3\n[[t.sub.deep]]\nw = 1\n"
    lines = _line_numbers(text.split("\n"), {})
    assert lines["a",] == 1
    assert lines["t", 0] == 2
    assert lines["t", 0, "sub", "y"] == 5
    assert lines["t", 1, "x", "z"] == 7
    assert lines["t", 1, "sub", "deep", 0, "w"] == 9


def test_a_scene_file_is_read_anew_only_where_a_file_has_changed(tmp_path, monkeypatch):
    monkeypatch.setattr(pftwin, "imported_at", np.inf)  # whoever edits the source while this runs
    derived = []
    write = cache_folder.write
    monkeypatch.setattr(cache_folder, "write", lambda kind, key, body: derived.append(key) or write(kind, key, body))
    before = cache_folder.chosen()
    cache_folder.use_cache_folder(tmp_path / "kept")
    try:
        path = write_toy(tmp_path)
        first, again = load_scene_file(path), load_scene_file(path)
        assert len(derived) == 1
        assert jax.tree.structure(first.scene) == jax.tree.structure(again.scene)
        for a, b in zip(jax.tree.leaves(first.scene), jax.tree.leaves(again.scene), strict=True):
            assert np.array_equal(a, b)
        assert (first.notes, first.path) == (again.notes, again.path)
        load_scene_file(path, contact="P2")
        assert len(derived) == 2
        mesh = tmp_path / "femur.stl"
        mesh.write_bytes(mesh.read_bytes()[:-1])
        with pytest.raises(InputError, match="truncated"):
            load_scene_file(path)
    finally:
        cache_folder.use_cache_folder(before)
