"""Derivatives of layers by modulus, thickness and the mesh's placement: on triangles and on a table of depths."""

from __future__ import annotations

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from height_meshes import grid
from pressed_button import DOME, disc, pressed
from scenes import J, look, march, state_at, vec

from pftwin.base.spatial import Quaternion
from pftwin.dynamics.frame_states import frame_states, starting_equilibrium
from pftwin.dynamics.state import System
from pftwin.geometry.contact.depth_sides import pressed_surface
from pftwin.geometry.contact.distance_grid import distance_grid
from pftwin.model.effects.foundation_law import LogarithmicFoundation
from pftwin.model.number_place import NumberPlace
from pftwin.model.scene import Scene

SADDLE = grid(lambda x, y: 6.0 * y * y - 3.0 * x * x, 13, (0.015, 0.015))  # 288 triangles
LAYERS = [("law", side, number) for side in ("femur", "button") for number in ("modulus", "thickness")]
PLACES = [NumberPlace("contact", path, None, "value") for path in (*LAYERS, *(("placement", k) for k in "xyz"))]
TILT = Quaternion.from_rotation_vector(vec(0.05, -0.03, 0.4))
SIDES = {"triangles": pressed_surface, "table": lambda mesh: distance_grid(mesh, 1.5e-3)}


def knee(side: str) -> Scene:
    """The pressed button on a saddle, its layers unlike each other and logarithmic.

    The button lies off the lines along which the saddle's triangles, and its own, are mirror images: there the nearest
    triangle changes, and differences between both sides are no derivative.
    """
    scene = pressed(disc(1 / DOME), n_frames=4)
    effect = scene.effect("contact")
    law = eqx.tree_at(lambda w: (w.femur.modulus, w.button.thickness), effect.law, (J(5e6), J(2e-3)))
    effect = eqx.tree_at(lambda e: e.placement, effect, vec(0.3e-3, 0.7e-3, 0.1e-3))
    made = SIDES[side](SADDLE), LogarithmicFoundation(law.femur, law.button)
    return scene.with_effect(eqx.tree_at(lambda e: (e.femur, e.law), effect, made))


def changed(scene: Scene, by: jax.Array) -> Scene:
    """Moduli and thicknesses by such shares, placement by so many millimetres."""
    for place, change in zip(PLACES, by, strict=True):
        old = place.read(scene)
        scene = place.written(scene, old + change * (1e-3 if place.is_coordinate(scene) else old))
    return scene


@pytest.fixture(params=SIDES)
def side(request) -> str:
    return request.param


def slopes_of(f: Callable[..., jax.Array]) -> Callable[..., tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Values of f(change, *rest), slopes with respect to the changes, and their central differences of a step."""

    def twice(*given: jax.Array) -> tuple[jax.Array, jax.Array]:
        found = f(*given)
        return found, found

    both = jax.jit(jax.jacfwd(twice, has_aux=True))  # one program for slopes and values

    def differentiated(step: float, *rest: jax.Array) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        slopes, value = both(jnp.zeros(len(PLACES)), *rest)
        ahead, behind = ([both(J(s * e), *rest)[1] for e in np.eye(len(PLACES))] for s in (step, -step))
        return np.asarray(value), np.asarray(slopes), (np.stack(ahead) - np.stack(behind)).T / (2 * step)

    return differentiated


def test_gradients_of_forces_with_and_without_contact(side):
    scene = knee(side)

    def force(by, depth):
        now = look((0.002, -0.003, -depth), orientation=TILT)
        return changed(scene, by).effect("contact").load(now, None)[0].bed.force

    differentiated = slopes_of(force)
    value, slopes, differences = differentiated(1e-5, J(3e-4))
    assert value[2] > 10
    assert (np.linalg.norm(slopes[:3], axis=0) > 0.1).all()
    for rows in (slice(0, 3), slice(3, 6)):  # forces and moments
        np.testing.assert_allclose(slopes[rows], differences[rows], rtol=1e-5, atol=1e-5 * np.abs(slopes[rows]).max())
    value, slopes, _ = differentiated(1e-5, J(-2e-3))
    np.testing.assert_array_equal(value, 0)
    np.testing.assert_array_equal(slopes, 0)


def test_a_batch_in_a_loop_has_the_values_and_slopes_of_its_members(side):
    """Six members, as many as a force has components, so that exchanged axes would not show in shapes."""
    contact = knee(side).effect("contact")

    def force(depth):
        return contact.load(look((0.002, -0.003, -depth), orientation=TILT), None)[0].bed.force

    def differentiated(function):
        return jax.jit(lambda d: jax.jvp(function, (d,), (jnp.ones_like(d),)))

    def all_in_loop(depths):
        found = jax.lax.scan(lambda _, n: (jax.vmap(force)(depths), None), jnp.zeros((6, 6)), jnp.arange(1))
        return found[0]

    depths = J(np.linspace(1e-4, 6e-4, 6))
    together = differentiated(all_in_loop)(depths)
    alone = list(map(differentiated(force), depths))
    assert np.asarray(together[0])[:, 2].min() > 1
    for both, each in zip(together, zip(*alone, strict=True), strict=True):
        np.testing.assert_allclose(both, np.stack(each), rtol=1e-12, atol=1e-9)


def check(slopes: np.ndarray, differences: np.ndarray) -> None:
    """Each number's column counts: to a thousandth of its own largest slope."""
    size = np.abs(slopes).max(axis=0)
    assert (size > 1e-4).all()
    assert (np.abs(slopes - differences) < 1e-3 * size).all(), np.abs(slopes - differences).max(axis=0) / size


@pytest.mark.parametrize("side", ["triangles", pytest.param("table", marks=pytest.mark.slow)])
def test_gradients_of_a_hundredth_of_a_second_from_contact_and_without(side):
    """With small steps: damping makes a force jump where a triangle comes into contact, from one step to the next."""
    scene = knee(side)

    def end(by, height):
        sys = System.of(changed(scene, by))
        start = state_at(sys, (0.0, 0.0, 0.004), orientation=TILT)
        state = march(sys, eqx.tree_at(lambda s: s.position.z, start, height + 0.004), 0.01, 20)
        return 1e3 * jnp.concatenate([state.position.array(), state.velocity.array()])

    differentiated = slopes_of(end)
    for height in (-2e-4, 1e-4):
        check(*differentiated(1e-6, J(height))[1:])


@pytest.mark.slow
def test_the_end_of_a_run_from_equilibrium(side):
    scene = knee(side)

    def end(by):
        made = changed(scene, by)
        state = frame_states(made, substeps=10, start=starting_equilibrium(made)).states
        return jnp.concatenate([1e3 * state.position.array()[-1], 1e2 * state.orientation.array()[-1]])

    check(*slopes_of(end)(1e-5)[1:])
