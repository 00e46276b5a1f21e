"""An elastic foundation on a table of depths, against that on the triangles themselves."""

from __future__ import annotations

import equinox as eqx
import numpy as np
import pytest
from height_meshes import grid, plate
from pressed_button import DOME, disc, foundation
from scenes import J, look, vec

from pftwin.base.spatial import Quaternion, Vec3
from pftwin.files.mocap import read_poses
from pftwin.geometry.contact.depth_sides import pressed_surface, pressing_surface
from pftwin.geometry.contact.distance_grid import distance_grid
from pftwin.geometry.mesh.mesh import load_mesh
from pftwin.model.effects.elastic_foundation import ElasticFoundation
from pftwin.model.effects.foundation_law import LogarithmicFoundation, checked_layer


@eqx.filter_jit
def seen(effect, now):
    return effect.load(now, None)[0], effect.observe(now, None)


@pytest.mark.slow
def test_on_a_plate_it_is_the_same():
    """Off the plate's middle, tilted, moving, damped: of a plane the table is exact."""
    exact = foundation(disc(1 / DOME), damping_time=3e-3)
    tabled = eqx.tree_at(lambda e: e.femur, exact, distance_grid(plate(8, 0.02), 1.3e-3))
    turn = Quaternion.from_rotation_vector(vec(0.05, -0.03, 0.4))
    now = look((0.002, -0.003, -3e-4), orientation=turn, velocity=(0.01, 0.02, -0.005))
    now = eqx.tree_at(lambda n: n.patella.spin, now, vec(0.3, -0.2, 0.1))
    (ours, our_report), (theirs, their_report) = (seen(effect, now) for effect in (tabled, exact))
    assert float(their_report["force"]) > 10
    for name in ("force", "elastic", "stiffness"):
        one, other = (np.asarray(getattr(load.bed, name)) for load in (ours, theirs))
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-5 * np.abs(other).max())
    for name in ("area", "max_pressure", "indentation", "force"):
        assert float(our_report[name]) == pytest.approx(float(their_report[name]), rel=1e-4)
    np.testing.assert_allclose(our_report["center_of_pressure"], their_report["center_of_pressure"], atol=1e-7)


@pytest.mark.parametrize("bend", [60.0, -40.0])
def test_on_a_curved_femur_forces_and_moments_are_the_energys_slopes(bend):
    """Deep, beside the middle and tilted: without what changing areas add, the force is off by some 3 %. The table's
    gradients are a thousandth off unit length."""
    saddle = grid(lambda u, v: 0.5 * bend * u**2 - 25.0 * v**2, 61, (0.02, 0.02))
    effect = foundation(disc(0.0), damping_time=0.0)
    effect = eqx.tree_at(lambda e: e.femur, effect, distance_grid(saddle, 1e-3))
    start = Quaternion.from_rotation_vector(vec(0.25, -0.3, 0.4))

    def at(step):
        turn = start * Quaternion.from_rotation_vector(vec(*step[3:]))
        return look((0.003 + step[0], 0.004 + step[1], -1.2e-3 + step[2]), orientation=turn)

    found, slopes = seen(effect, at(np.zeros(6)))[0], []
    for k, h in enumerate(3 * [2e-6] + 3 * [2e-4]):
        ahead, back = (seen(effect, at(s * h * np.eye(6)[k]))[0].energy for s in (1, -1))
        slopes.append(-float(ahead - back) / (2 * h))
    force, moment = np.split(np.asarray(found.bed.force), 2)
    np.testing.assert_allclose(slopes[:3], force, atol=4e-3 * np.linalg.norm(force))
    np.testing.assert_allclose(slopes[3:], moment, atol=4e-3 * np.linalg.norm(moment))
    report = seen(effect, at(np.zeros(6)))[1]
    np.testing.assert_allclose([float(report[f"force_{a}"]) for a in "xyz"], force, rtol=1e-9)


@pytest.fixture(scope="module")
def cartilage(healthy_knee):
    """A living knee's two layers of cartilage: on the triangles, in cubes of 1 mm, and four triangles taken for one."""
    femur, patella = (
        load_mesh(healthy_knee / "geometry" / f"lenhart2015-R-{bone}-cartilage.stl", units="m")
        for bone in ("femur", "patella")
    )
    side = femur.vertices[femur.faces][:, :, 2].mean(axis=1) > 0.002
    layer = checked_layer(5e6, 0.45, 3e-3)
    sides = {
        "exact": (pressed_surface(femur, side), pressing_surface(patella)),
        "tabled": (distance_grid(femur, 1e-3, side), pressing_surface(patella)),
        "together": (distance_grid(femur, 1e-3, side), pressing_surface(patella, 4)),
    }
    law, zero = LogarithmicFoundation(layer, layer), vec(0, 0, 0)
    return {name: ElasticFoundation(*pair, law, zero, J(0.0)) for name, pair in sides.items()}


@pytest.mark.slow
@pytest.mark.parametrize("frame", [20, 30])
def test_a_living_knees_cartilage(healthy_knee, cartilage, frame):
    """The patella where it was measured, and pushed on until it touches."""
    with pytest.warns(match="rows"):
        poses = read_poses(healthy_knee / "passive_body_transformations.sto", rate=30)
    patella = poses["patella_r"].relative_to(poses["femur_distal_r"])
    turn = Quaternion.from_array(J(patella.quaternions[frame]))
    place = Vec3.from_array(J(patella.positions[frame])) - vec(2e-3, 0, 0)  # to the back
    now = look((0, 0, 0), orientation=turn)
    now = eqx.tree_at(lambda n: n.patella.position, now, place)
    (exact, report), *others = (seen(cartilage[name], now) for name in ("exact", "tabled", "together"))
    assert float(report["force"]) > 50
    for load, theirs in others:
        assert float(theirs["force"]) == pytest.approx(float(report["force"]), rel=0.01)
        assert float(theirs["area"]) == pytest.approx(float(report["area"]), rel=0.06)
        for name in ("force", "stiffness"):
            one, other = (np.asarray(getattr(each.bed, name))[:3] for each in (load, exact))
            assert np.linalg.norm(one - other) < 0.02 * np.linalg.norm(other)
        np.testing.assert_allclose(theirs["center_of_pressure"], report["center_of_pressure"], atol=2e-4)
        for facet in ("force_medial", "force_lateral"):
            assert float(theirs[facet]) == pytest.approx(float(report[facet]), abs=0.02 * float(report["force"]))
