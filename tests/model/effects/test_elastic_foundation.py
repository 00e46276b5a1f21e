"""A ball on a plate, both meshes: force, potential, stiffness, a rest, and what is reported."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from height_meshes import plate
from scenes import J, gravity, look, march, state_at, system, vec

from pftwin.base.spatial import Quaternion
from pftwin.geometry.contact.depth_sides import pressed_surface, pressing_surface
from pftwin.geometry.contact.depths import depths
from pftwin.geometry.mesh.icosphere import icosphere
from pftwin.model.effects.elastic_foundation import ElasticFoundation
from pftwin.model.effects.foundation_law import LinearFoundation, checked_layer

RADIUS = 0.02
SOFT = checked_layer(46.3e6, 0.46, 5e-3)


@pytest.fixture(scope="module")
def effect() -> ElasticFoundation:
    mesh = plate(8)
    side = (mesh.vertices[mesh.faces].mean(axis=1)[:, 0] > 0).astype(int)
    femur = pressed_surface(mesh, labels=side)
    ball, law = pressing_surface(icosphere(RADIUS, 40)), LinearFoundation(SOFT, SOFT)
    return ElasticFoundation(femur, ball, law, vec(0, 0, 0), J(0.0))


@eqx.filter_jit
def seen(effect, now):
    return effect.load(now, None)[0], effect.observe(now, None)


def at_depth(d, **rest):
    return look((0, 0, RADIUS - d), orientation=Quaternion.from_rotation_vector(vec(0.3, 0.2, -0.1)), **rest)


@pytest.mark.parametrize("d", [5e-4, 2e-3, 4.9e-3])
def test_a_ball_on_a_plate_bears_what_the_displaced_volume_says(effect, d):
    """Sums over the sphere's area, not its projection, would be d / 3R more: 0.8, 3.4 and 8.9 %."""
    load, report = seen(effect, at_depth(d))
    k = float(1 / effect.law.compliance())
    force = np.asarray(load.total().force.array())
    inscribed = 4e-6 / d  # the triangles of the mesh lie up to 4 um within the ball
    assert force[2] == pytest.approx(k * np.pi * d**2 * (RADIUS - d / 3), rel=2 * inscribed)
    assert float(load.energy) == pytest.approx(k * np.pi * d**3 * (RADIUS / 3 - d / 12), rel=3 * inscribed)
    assert np.abs(force[:2]).max() < 2e-3 * force[2]
    assert np.abs(np.asarray(load.total().moment.array())).max() < 1e-3 * force[2] * RADIUS
    area = np.pi * d * (2 * RADIUS - d)
    assert float(report["area"]) == pytest.approx(area, rel=0.02 if d < 1e-3 else 5e-3)
    assert float(report["max_pressure"]) == pytest.approx(k * d, rel=0.03)
    assert float(report["mean_pressure"]) == pytest.approx(force[2] / area, rel=0.02 if d < 1e-3 else 5e-3)
    np.testing.assert_allclose(report["center_of_pressure"][:2], 0, atol=5e-5)
    assert float(report["force_medial"] + report["force_lateral"]) == pytest.approx(force[2], rel=1e-3)
    assert float(report["too_deep"]) == 0


def test_a_ball_that_slides_across_the_facets_border_leaves_one_as_it_comes_onto_the_other(effect):
    """Each triangle passes from facet to facet as its width crosses the border, not at once as its middle does."""
    d, step = 5e-4, 1e-6
    wide = np.sqrt(d * (2 * RADIUS - d))  # of the contact
    at = np.linspace(-wide, wide, 4001)
    half = np.sqrt(wide**2 - at**2)  # of the contact's chords along the border
    depth = np.sqrt(np.maximum(RADIUS**2 - at**2 - (np.linspace(-1, 1, 201)[:, None] * half) ** 2, 0)) - (RADIUS - d)
    strips = 2 * half * np.trapezoid(depth, axis=0) / 200
    beyond = np.cumsum(strips) / strips.sum()  # share of the force at less than `at` from the middle
    steepest = strips.max() / (strips.sum() * (at[1] - at[0]))
    orientation = Quaternion.from_rotation_vector(vec(0.3, 0.2, -0.1))
    places = np.array([-2.2e-3, -4e-4, 9e-4])[:, None] + step * np.arange(80)
    reports = [seen(effect, look((x, 0, RADIUS - d), orientation=orientation))[1] for x in places.ravel()]
    medial, lateral = (
        np.array([r[f"force_{f}"] for r in reports]).reshape(places.shape) for f in ("medial", "lateral")
    )
    share = lateral / (medial + lateral)
    np.testing.assert_allclose(share, np.interp(places, at, beyond), atol=2e-3)
    assert np.abs(np.diff(share)).max() < 1.5 * steepest * step


@pytest.mark.slow
def test_the_force_is_minus_the_energys_gradient_and_the_stiffness_its_slope(effect):
    now = at_depth(0.0)

    def load(z):
        return effect.load(eqx.tree_at(lambda n: n.patella.position.z, now, z), None)[0]

    def energy_and_force(z):
        found = load(z)
        return jnp.stack([found.energy, found.total().force.z])

    @jax.jit
    def slopes(z):
        return load(z), jax.jacrev(energy_and_force)(z), jax.jacfwd(energy_and_force)(z)

    found, reverse, forward = slopes(J(RADIUS - 4e-4))
    expected = [-float(found.total().force.z), -float(found.bed.stiffness[2, 2])]
    np.testing.assert_allclose(reverse, expected, rtol=1e-9)
    np.testing.assert_allclose(forward, expected, rtol=1e-9)


@pytest.mark.slow
def test_damping_resists_and_never_pulls(effect):
    damped = eqx.tree_at(lambda e: e.damping_time, effect, J(1e-3))
    still, sinking, leaving = (seen(damped, at_depth(4e-4, velocity=(0, 0, v)))[0] for v in (0.0, -0.05, 10.0))
    assert sinking.total().force.z > still.total().force.z
    assert sinking.dissipation() > 0
    np.testing.assert_allclose(leaving.total().force.array(), 0, atol=1e-12)


@pytest.mark.slow
def test_a_ball_comes_to_rest_under_its_weight(effect):
    light = eqx.tree_at(lambda e: e.damping_time, effect, J(2e-3))
    mass = 0.5
    sys = system(light, gravity(mass), mass=mass)
    rest = march(sys, state_at(sys, (0, 0, RADIUS + 1e-4)), 0.3, 300)
    load, _ = seen(light, look((0, 0, float(rest.position.z)), orientation=rest.orientation))
    assert float(load.total().force.z) == pytest.approx(9.81 * mass, rel=0.02)
    assert abs(float(rest.velocity.z)) < 1e-4


@pytest.mark.slow
def test_the_sums_are_those_of_the_list_of_triangles(effect):
    pose = at_depth(1.5e-3, velocity=(0.01, 0.02, -0.03))
    pose = eqx.tree_at(lambda n: n.patella.spin, pose, vec(0.3, -0.4, 0.5))
    damped = eqx.tree_at(lambda e: (e.damping_time, e.origin), effect, (J(2e-3), vec(0.0, 1e-3, 0.0)))

    @eqx.filter_jit
    def listed(effect, now):
        at = effect.pressed(now)
        found = depths(effect.button, effect.femur, at.position, at.rotation)
        return at, found, effect.law.press(found.depth)

    at, found, answer = listed(damped, pose)
    count = np.asarray(found.listed)
    n, local = (np.asarray(v.array()) for v in (found.normal, found.local))
    turn = np.asarray(at.rotation.array())
    g = np.hstack([n, np.cross(local + np.array([0.0, 1e-3, 0.0]), n @ turn)])
    rate = -g @ np.asarray(at.twist)
    elastic, k = (np.asarray(found.area * a) for a in (answer.pressure, answer.slope))
    force = elastic + 2e-3 * k * rate
    count = count & (force > 0)
    load, _ = seen(damped, pose)
    bed = load.bed
    turning = np.asarray(answer.energy[:, None] * found.tilting.array())[count].sum(axis=0)
    turning = np.array([0, 0, 0, *turning])
    np.testing.assert_allclose(bed.force, force[count] @ g[count] + turning, rtol=1e-10)
    np.testing.assert_allclose(bed.elastic, elastic[count] @ g[count] + turning, rtol=1e-10)
    np.testing.assert_allclose(bed.stiffness, (g[count].T * k[count]) @ g[count], rtol=1e-10)
    assert float(bed.size) == pytest.approx(force[count].sum(), rel=1e-12)
    heat = float(((force - elastic)[count] * rate[count]).sum())
    assert float(load.dissipation()) == pytest.approx(heat, rel=1e-10)


def test_without_contact_a_foundation_bears_nothing(effect):
    load, report = seen(effect, at_depth(-1e-3))
    np.testing.assert_array_equal(load.total().force.array(), 0)
    assert report["area"] == 0
    assert np.isnan(report["center_of_pressure"]).all()
    assert float(load.energy) == 0
    assert all(np.isfinite(np.asarray(a)).all() for a in jax.tree.leaves(load.bed))


@pytest.mark.slow
def test_slopes_in_a_batch_are_those_of_each_member(effect):
    """From none to many pieces in contact; against differences, by depth and by tilt."""

    @eqx.filter_jit
    def push(effect, depth, tilt):
        turn = Quaternion.from_rotation_vector(vec(0.3, 0.2, -0.1) + tilt * vec(1.0, 0.0, 0.0))
        return effect.load(look((0, 0, RADIUS - depth), orientation=turn), None)[0].bed.force

    depths_of, tilts, step = J([-1e-3, 2e-4, 3e-3]), J([0.0, 0.1, -0.2]), 1e-7
    both = jax.jit(jax.vmap(jax.jacfwd(lambda d, t: push(effect, d, t), argnums=(0, 1))))(depths_of, tilts)
    assert np.abs(both[0][0]).max() == 0
    for k, (d, t) in enumerate(zip(depths_of, tilts, strict=True)):
        alone = jax.jacfwd(lambda d, t: push(effect, d, t), argnums=(0, 1))(d, t)
        for mine, own in zip(both, alone, strict=True):
            np.testing.assert_allclose(mine[k], own, rtol=1e-9, atol=1e-9)
        differences = (push(effect, d + step, t) - push(effect, d - step, t)) / (2 * step)
        np.testing.assert_allclose(both[0][k], differences, rtol=1e-4, atol=1e-4 * (1 + np.abs(differences).max()))


def test_a_mesh_placed_elsewhere_is_one_of_another_origin(effect):
    """But for the point whose path is followed: that stays on the patella."""
    placed = eqx.tree_at(lambda e: e.placement, effect, vec(1e-3, -5e-4, 0.003))
    moved = effect.with_button_moved(vec(1e-3, -5e-4, 0.003))
    now = look((0, 0, RADIUS - 4e-4 - 3e-3))
    (one, report), (two, expected) = seen(placed, now), seen(moved, now)
    assert float(expected["force"]) > 10
    np.testing.assert_allclose(one.total().force.array(), two.total().force.array(), rtol=1e-12)
    np.testing.assert_allclose(one.total().moment.array(), two.total().moment.array(), rtol=1e-12)
    np.testing.assert_allclose(report["point_medial"], expected["point_medial"], rtol=1e-12)
    np.testing.assert_array_equal(placed.tracked_point().array(), effect.tracked_point().array())
    one, two = (np.asarray(e.button_triangles()).reshape(-1, 3) for e in (placed, moved))
    by = np.array([1e-3, -5e-4, 0.003])
    np.testing.assert_allclose(one + np.asarray(placed.tracked_point().array()), two + by, atol=1e-12)


@pytest.mark.slow
def test_an_offset_button_is_the_same_ball(effect):
    there = eqx.tree_at(lambda e: e.origin, effect, vec(0.0, 0.0, 0.003))
    one, _ = seen(there, look((0, 0, RADIUS - 4e-4 - 3e-3)))
    two, _ = seen(effect, look((0, 0, RADIUS - 4e-4)))
    np.testing.assert_allclose(one.total().force.array(), two.total().force.array(), rtol=1e-9, atol=1e-9)
    three, _ = seen(there.recentred(vec(0, 0, 0.003)), look((0, 0, RADIUS - 4e-4)))
    np.testing.assert_allclose(three.total().moment.array(), two.total().moment.array(), atol=1e-12)
