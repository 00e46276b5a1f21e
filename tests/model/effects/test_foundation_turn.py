"""A button's mesh turned in the patella: that of turned vertices, with derivatives by the turn at and off zero."""

from __future__ import annotations

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from height_meshes import grid
from pressed_button import DOME, disc, foundation, pressed
from scenes import J, look, march, state_at, vec
from scipy.spatial.transform import Rotation

from pftwin.base.spatial import Quaternion, Vec3
from pftwin.dynamics.state import System
from pftwin.geometry.contact.depth_sides import pressed_surface
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.model.effects.elastic_foundation import ElasticFoundation
from pftwin.model.number_place import named_arrays
from pftwin.model.scene import Scene

TILT = Quaternion.from_rotation_vector(vec(0.05, -0.03, 0.4))
OFF = (0.04, -0.06, 0.3)  # a turn [rad]


@cache
def scene() -> Scene:
    """The dome on a saddle, off the lines along which its triangles are mirror images."""
    made = pressed(disc(1 / DOME), n_frames=4)
    saddle = pressed_surface(grid(lambda x, y: 6.0 * y * y - 3.0 * x * x, 13, (0.015, 0.015)))
    effect = made.effect("contact")
    effect = eqx.tree_at(lambda e: (e.femur, e.placement), effect, (saddle, vec(0.3e-3, 0.7e-3, 0.1e-3)))
    return made.with_effect(turned(effect, (0.0, 0.0, 0.0)))


def turned(effect: ElasticFoundation, by) -> ElasticFoundation:
    return eqx.tree_at(lambda e: e.turn, effect, Vec3(*(J(x) for x in by)), is_leaf=lambda x: x is None)


def at(depth: float):
    now = look((0.001, -0.002, -depth), velocity=(0.01, 0.02, -0.03), orientation=TILT)
    return eqx.tree_at(lambda n: n.patella.spin, now, vec(0.3, -0.4, 0.2))


def test_it_is_a_mesh_of_turned_vertices():
    """In force, moment, energy, stiffness, damping and all that is reported; and None is a turn by nothing."""
    mesh, turn = disc(1 / DOME), Rotation.from_rotvec(OFF)
    plain = foundation(mesh)
    made = foundation(SurfaceMesh(turn.apply(mesh.vertices), mesh.faces, "turned"))
    place = vec(1e-3, -5e-4, 2e-4)
    plain, made = (eqx.tree_at(lambda e: e.placement, effect, place) for effect in (plain, made))
    seen = eqx.filter_jit(lambda effect, now: (effect.load(now, None)[0], effect.report(now, None)[0]))
    now = at(4e-4)
    for one, two in ((turned(plain, OFF), made), (turned(plain, (0.0, 0.0, 0.0)), plain)):
        (load, report), (expected, shown) = seen(one, now), seen(two, now)
        assert float(load.bed.size) > 5
        assert np.abs(load.bed.force[3:]).min() > 1e-5
        for found, wanted in zip(jax.tree.leaves(load), jax.tree.leaves(expected), strict=True):
            np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-6 * np.abs(wanted).max())
        np.testing.assert_allclose(float(load.dissipation()), float(expected.dissipation()), rtol=1e-5)
        for name, value in shown.items():
            np.testing.assert_allclose(report[name], value, rtol=1e-5, atol=1e-9, err_msg=name)
        np.testing.assert_allclose(one.button_triangles(), two.button_triangles(), atol=1e-9)


@pytest.mark.parametrize("by", [(0.0, 0.0, 0.0), OFF])
def test_derivatives_of_forces_are_those_of_finite_differences(by):
    effect = scene().effect("contact")

    def force(turn: jax.Array) -> jax.Array:
        return turned(effect, turn).load(at(4e-4), None)[0].bed.force

    run = jax.jit(force)
    forward, reverse = (np.asarray(jax.jit(mode(force))(J(np.array(by)))) for mode in (jax.jacfwd, jax.jacrev))
    np.testing.assert_allclose(reverse, forward, rtol=1e-9, atol=1e-9)
    step = 1e-6
    apart = np.stack([(run(J(by + step * e)) - run(J(by - step * e))) / (2 * step) for e in np.eye(3)], axis=1)
    assert (np.linalg.norm(forward[:3], axis=0) > 0.1).all()
    for rows in (slice(0, 3), slice(3, 6)):
        np.testing.assert_allclose(forward[rows], apart[rows], rtol=1e-4, atol=1e-4 * np.abs(apart[rows]).max())


@pytest.mark.slow
def test_a_motions_derivative_by_the_turn():
    made = scene()

    def end(turn: jax.Array) -> jax.Array:
        sys = System.of(made.with_effect(turned(made.effect("contact"), turn)))
        start = state_at(sys, (0.0, 0.0, 0.004), orientation=TILT)
        state = march(sys, eqx.tree_at(lambda s: s.position.z, start, -2e-4 + 0.004), 0.01, 20)
        return 1e3 * jnp.concatenate([state.position.array(), state.velocity.array()])

    here, step = J(np.array([0.02, -0.03, 0.1])), 1e-6
    slopes, run = np.asarray(jax.jit(jax.jacfwd(end))(here)), jax.jit(end)
    apart = np.stack([(run(here + step * e) - run(here - step * e)) / (2 * step) for e in J(np.eye(3))], axis=1)
    size = np.abs(slopes).max(axis=0)
    assert (size > 1e-3).all()
    assert (np.abs(slopes - apart) < 1e-3 * size).all()


def test_it_is_a_parameter_where_it_is_given_and_none_elsewhere():
    given = scene()
    assert float(given.set("contact.turn.x", 0.02).get("contact.turn.x")) == 0.02
    plain = given.with_effect(eqx.tree_at(lambda e: e.turn, given.effect("contact"), None))
    assert "contact.turn.x" in named_arrays(given)
    assert "contact.turn.x" not in named_arrays(plain)
    count = [str(jax.make_jaxpr(lambda z, s=s: _force(s, z))(J(1e-4))).count(" cos ") for s in (plain, given)]
    assert count[0] < count[1]


def _force(scene: Scene, depth) -> jax.Array:
    now = eqx.tree_at(lambda n: n.patella.position.z, at(0.0), -depth)
    return scene.effect("contact").load(now, None)[0].bed.force
