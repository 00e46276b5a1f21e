"""What a result's file keeps of its scene to draw: surfaces, meshes, lines; and the recorded poses on the host."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_scene import HALF_U, HALF_V, small_result, small_scene, vec
from toy_mesh_scenes import SCENES
from toy_scene_files import load

from pftwin.base.leaves import vector
from pftwin.base.spatial import Vec3
from pftwin.files.mocap.poses import PoseSeries
from pftwin.files.result_files import GEOMETRY, load_dataset
from pftwin.geometry.mesh.mesh import load_mesh
from pftwin.model.effects.tendon import StrandGroup
from pftwin.model.effects.tension import PrescribedTension
from pftwin.model.motion import KneeMotion
from pftwin.model.motion_on_host import seen_from_femur, tibia_orientation, tibia_position
from pftwin.results.scene_geometry import geometry


def moving_knee(n: int = 21) -> KneeMotion:
    times, rng = 0.01 * np.arange(n), np.random.default_rng(3)
    poses = []
    for _ in range(2):
        turns = Rotation.from_rotvec(0.3 * np.outer(np.sin(5 * times), rng.normal(size=3)))
        places = np.outer(np.cos(4 * times), rng.normal(size=3))
        poses.append(PoseSeries(times, places, turns.as_quat(scalar_first=True)))
    return KneeMotion.from_poses(*poses)


frames = eqx.filter_jit(lambda motion, t: motion.frames(t))
height_of = eqx.filter_jit(lambda surface, at: surface.height(at.x, at.y))
point_of = eqx.filter_jit(lambda surface, u, v: surface.chart.point(u, v, surface.height(u, v)).array())
coordinates = eqx.filter_jit(lambda surface, points: surface.chart.coordinates(Vec3(*points.T)))


def rows(v: Vec3) -> np.ndarray:
    return np.asarray(v.array())


def test_the_tibia_in_the_femur_is_that_of_the_simulation():
    motion = moving_knee()
    femur, tibia = frames(motion, motion.times)
    assert femur is not None
    np.testing.assert_allclose(tibia_position(motion), rows(femur.to_local(tibia.origin)), atol=1e-12)
    axis = rows(femur.local_direction(tibia.rotation.ey))
    turned = tibia_orientation(motion)
    q = np.stack([turned.w, turned.x, turned.y, turned.z], axis=1)
    np.testing.assert_allclose(Rotation.from_quat(q, scalar_first=True).apply([0.0, 1.0, 0.0]), axis, atol=1e-12)


def test_points_of_the_ground_move_in_a_femur_that_moves():
    motion, point = moving_knee(), np.array([[0.1, 0.2, 0.3], [0.0, -0.1, 0.0]])
    femur, _ = frames(motion, motion.times)
    assert femur is not None
    points = seen_from_femur(motion, point)
    for k, p in enumerate(point):
        there = Vec3(*(jnp.full(motion.n_frames, c) for c in p))
        np.testing.assert_allclose(points[:, k], rows(femur.to_local(there)), atol=1e-12)
    still = small_scene().motion
    assert seen_from_femur(still, point) is point


def test_a_saved_result_holds_what_there_is_to_draw(tmp_path):
    result = small_result()
    result.save(tmp_path / "knee.nc")
    kept = load_dataset(tmp_path / "knee.nc", group=GEOMETRY)
    assert kept.identical(result.geometry())
    data = load_dataset(tmp_path / "knee.nc")
    np.testing.assert_array_equal(data["tibia_position"], result.tibia[0])
    for name in kept.variables:
        assert kept[name].attrs["units"], name
        assert len(kept[name].attrs["long_name"]) > 3, name
    assert float(kept["button_radius"]) == 0.022
    assert kept["patellar_tendon_origin"].attrs["body"] == "tibia"
    np.testing.assert_allclose(kept["patellar_tendon_origin"], [[-0.07, 0.004, 0.045]])
    np.testing.assert_allclose(kept["quadriceps_insertion"], [[0.02, 0, -0.008]])


def test_a_fitted_surface_is_drawn_where_it_is():
    scene, made = small_scene(), geometry(small_scene())
    surface = scene.surface
    assert surface is not None
    at = coordinates(surface, made["surface_vertices"].values.astype(float))
    np.testing.assert_allclose(at.z, height_of(surface, at), atol=1e-8)
    assert np.abs(at.x).max() == pytest.approx(HALF_U)
    assert np.abs(at.y).max() == pytest.approx(HALF_V)
    assert "continuation_vertices" not in made
    corners = made["surface_vertices"].values[made["surface_triangles"].values]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normal @ rows(surface.chart.axes.ez) > 0).all()  # counter-clockwise from outside


def test_a_surface_goes_on_to_where_it_was_touched():
    scene = small_scene()
    surface = scene.surface
    assert surface is not None
    points = np.asarray(point_of(surface, np.array([0.0, HALF_U + 0.005]), np.array([0.0, -HALF_V - 0.01])))
    made = geometry(scene, {"contact": {"point_medial": points, "point_lateral": np.full((2, 3), np.nan)}})
    at = coordinates(surface, made["continuation_vertices"].values.astype(float))
    np.testing.assert_allclose(at.z, height_of(surface, at), atol=1e-8)
    assert np.max(np.asarray(at.x)) > HALF_U + 0.005
    assert np.min(np.asarray(at.y)) < -HALF_V - 0.01
    assert np.min(np.asarray(at.x)) == pytest.approx(-HALF_U)  # nowhere else
    corners = made["continuation_vertices"].values[made["continuation_triangles"].values]
    middle = coordinates(surface, corners.mean(axis=1).astype(float))
    assert ((np.abs(middle.x) > HALF_U) | (np.abs(middle.y) > HALF_V)).all()


def test_groups_and_pulls_from_moving_origins():
    scene = small_scene()
    three, two = jnp.ones(3), jnp.ones(2)
    places = np.stack([np.full(3, 0.01), [0.01, 0.012, 0.014], np.zeros(3)], axis=1)
    strands = StrandGroup(three, three, three, three, vector(places), vector(2 * places), "femur", name="mpfl")
    times = np.array([0.0, 0.1, 0.2])
    moving = Vec3(jnp.asarray(np.outer(times, [1, 1])), jnp.zeros((3, 2)), jnp.zeros((3, 2)))
    pull = PrescribedTension(jnp.ones((3, 2)), moving, Vec3(two, two, two), 0.0, 0.1, "femur", name="vasti")
    made = geometry(scene.with_effect(strands).with_effect(pull))
    np.testing.assert_allclose(made["mpfl_insertion"], places)
    np.testing.assert_allclose(made["mpfl_origin"], 2 * places)
    assert made["vasti_origin"].dims == ("time", "vasti_line", "axis")
    expected = jax.jit(jax.vmap(lambda t: pull.at(t)[1].x[1]))(scene.motion.times)
    np.testing.assert_allclose(made["vasti_origin"][:, 1, 0], expected, atol=1e-12)


def test_lines_to_the_ground_are_seen_from_the_femur():
    scene = small_scene()
    k = scene.index("quadriceps")
    hung = eqx.tree_at(lambda s: s.motion, scene, moving_knee())
    quadriceps = type(scene.effects[k])(
        *(getattr(scene.effects[k], n) for n in ("stiffness", "slack_length", "damping", "insertion")),
        vec(0.2, 0.0, 0.0),
        "ground",
        name="quadriceps",
    )
    made = geometry(hung.with_effect(quadriceps))["quadriceps_origin"]
    assert made.attrs["body"] == "femur"
    np.testing.assert_allclose(made, seen_from_femur(hung.motion, np.array([[0.2, 0.0, 0.0]])))


@pytest.mark.parametrize("method", SCENES)
def test_meshes_of_contacts_come_back_whole(toy, method):
    """Trees hold copies of triangles in their empty places: none of them is drawn."""
    scene = load(toy, SCENES[method])
    made = geometry(scene)
    mesh = load_mesh(toy / "femur.stl", units="m")
    assert made.sizes["femur_triangle"] == len(mesh.faces)
    corners = made["femur_vertices"].values[made["femur_triangles"].values].astype(float)
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    assert areas.sum() == pytest.approx(mesh.area, rel=1e-4)
    directed = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0) / 2
    np.testing.assert_allclose(directed, mesh.area_vectors.sum(axis=0), atol=1e-4 * mesh.area)
    if method in ("contours", "foundation"):
        distance = np.linalg.norm(made["button_vertices"].values, axis=1)
        assert distance == pytest.approx(0.022, rel=1e-3)
    else:
        assert float(made["button_radius"]) == pytest.approx(0.022)
