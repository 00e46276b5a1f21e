"""A second of the rig's case 1 on the spline: beside the exact implant and P5, in batches, and its derivatives."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pftwin import rig
from pftwin.base.leaves import number
from pftwin.dynamics.frame_states import frame_states
from pftwin.geometry.patch.implant import rig_implant
from tests.benchmarks.problem import started_nearby, variants, with_springs

FRAMES, SUBSTEPS = 101, 10


def cut(scene):
    """The first second, from its own equilibrium."""
    return started_nearby(eqx.tree_at(lambda s: s.motion, scene, replace(scene.motion, n_frames=FRAMES))).unnamed()


@eqx.filter_jit
def path_of(scene):
    """(frames, 3) of the patella's centre of mass [m]."""
    return frame_states(scene, substeps=SUBSTEPS).states.position.array()


def with_coefficients(scene, coefficients):
    moved = eqx.tree_at(lambda e: e.surface.coefficients, scene.contact, coefficients)
    return scene.with_effect(moved)


@pytest.fixture(scope="module")
def scene():
    return cut(rig.case(1, "spline"))


@pytest.fixture(scope="module")
def path(scene):
    return np.asarray(path_of(scene))


def distance(one, other) -> float:
    return float(np.linalg.norm(one - other, axis=1).mean())


@pytest.mark.slow
def test_it_moves_as_on_the_exact_implant_and_nearer_to_that_than_p5(scene, path):
    surface = jax.tree.map(lambda a: number(a) if isinstance(a, float) else a, rig_implant())
    exact = np.asarray(path_of(scene.with_effect(eqx.tree_at(lambda e: e.surface, scene.contact, surface))))
    p5 = np.asarray(path_of(cut(rig.case(1, "P5"))))
    assert distance(path, exact) < 0.02e-3
    assert distance(path, exact) < 0.2 * distance(p5, exact)
    assert distance(path, p5) < 1e-3


@pytest.mark.slow
def test_a_batch_is_its_members(scene, path):
    factors = jnp.concatenate([jnp.ones((1, 4)), variants(3)])
    together = np.asarray(eqx.filter_jit(jax.vmap(lambda f: path_of(with_springs(scene, f))))(factors))
    np.testing.assert_allclose(together[0], path, atol=1e-9)
    np.testing.assert_allclose(together[2], path_of(with_springs(scene, factors[2])), atol=1e-9)


@pytest.mark.slow
def test_a_batch_of_surfaces_is_its_members(scene, path):
    c = scene.contact.surface.coefficients
    some = jnp.stack([c, c + 1e-4])
    together = np.asarray(eqx.filter_jit(jax.vmap(lambda c: path_of(with_coefficients(scene, c))))(some))
    np.testing.assert_allclose(together[0], path, atol=1e-9)
    np.testing.assert_allclose(together[1], path_of(with_coefficients(scene, some[1])), atol=1e-9)


@pytest.mark.slow
def test_derivatives_of_the_path_by_the_coefficients(scene):
    """Reverse and forward against a central difference, along a change of the whole surface."""
    c = scene.contact.surface.coefficients
    direction = number(np.random.default_rng(2).normal(size=c.shape))

    def scalar(c):
        return jnp.mean(path_of(with_coefficients(scene, c)) ** 2)

    reverse = float(jnp.vdot(eqx.filter_jit(jax.grad(scalar))(c), direction))
    forward = float(eqx.filter_jit(lambda c, d: jax.jvp(scalar, (c,), (d,))[1])(c, direction))
    value, h = eqx.filter_jit(scalar), 1e-7
    difference = float(value(c + h * direction) - value(c - h * direction)) / (2 * h)
    assert forward == pytest.approx(reverse, rel=1e-6)
    assert reverse == pytest.approx(difference, rel=1e-3)
