"""Derivatives of whole motions against central differences: apart, at touch, sliding on two facets, past a lift-off."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import (
    MASS,
    RADIUS,
    J,
    contact,
    gravity,
    groove_patch,
    knee,
    run,
    settled,
    starting_as_it_is,
    tendon,
    vec,
)  # fmt: skip

from pftwin.base.spatial import Pose, Quaternion
from pftwin.dynamics.frame_states import FrameStates, frame_states
from pftwin.dynamics.observe import observe
from pftwin.files.mocap.poses import PoseSeries
from pftwin.model.effects.contact_law import Flores
from pftwin.model.motion import KneeMotion
from pftwin.model.scene import PatellaBody, Scene

N_FRAMES, INTERVAL, SUBSTEPS = 61, 2e-3, 10
GROOVE = groove_patch(4)
COEFFICIENTS = len(GROOVE.coefficients)


def bouncing_scene() -> Scene:
    """A button falls beside a groove's floor, bounces, comes to slide on both facets, pulled along by two tendons."""
    effects = (
        gravity(),
        tendon(156, 0.08, 1.5, (0.02, 0, 0), (0.12, 0.004, 0.01), "femur", "quadriceps"),
        tendon(629, 0.08, 6.0, (-0.02, 0, 0), (-0.1, 0.002, 0.01), "tibia", "patellar_tendon"),
        contact(Flores(J(1e6), J(0.8)), GROOVE),
    )
    t = np.arange(N_FRAMES, dtype=np.float64) * INTERVAL
    still = np.tile([1.0, 0, 0, 0], (t.size, 1))
    pulled = np.zeros((t.size, 3))
    pulled[:, 0] = -0.02 * (t / t[-1]) ** 2
    motion = KneeMotion.from_poses(None, PoseSeries(t, pulled, still))
    start = Pose(vec(0, 0.0004, RADIUS + 0.0065), Quaternion.identity())
    return Scene(PatellaBody(J(MASS), vec(3e-5, 3e-5, 4e-5), vec(0.001, 0, 0)), effects, motion, start)


SCENE = bouncing_scene()
START = starting_as_it_is(SCENE)


def with_parameters(theta: jax.Array) -> Scene:
    """K1, L1, K2, L2 (relative) and every patch coefficient [mm] around the scene's own."""

    def where(s):
        a, b = s.effects[1:3]
        return [a.stiffness, a.slack_length, b.stiffness, b.slack_length, s.effects[3].surface.coefficients]

    values = where(SCENE)
    new = [v * (1 + theta[i]) for i, v in enumerate(values[:4])] + [values[4] + 1e-3 * theta[4:-1]]
    return eqx.tree_at(where, SCENE, new)


@eqx.filter_jit
def path_of(theta: jax.Array) -> FrameStates:
    """The motion; the last parameter raises its start [mm]."""
    start = eqx.tree_at(lambda s: s.pose.position.z, START, START.pose.position.z + 1e-3 * theta[-1])
    return frame_states(with_parameters(theta), substeps=SUBSTEPS, start=start)


def positions(theta: jax.Array) -> jax.Array:
    """Path of the centre of mass [mm]."""
    return 1e3 * path_of(theta).states.position.array()


@jax.jit
def batch(thetas: jax.Array, directions: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Paths and their derivatives along directions, of a batch of parameters."""
    return jax.vmap(lambda theta, d: jax.jvp(positions, (theta,), (d,)))(thetas, directions)


N_PARAMETERS = 4 + COEFFICIENTS + 1
EACH = np.eye(N_PARAMETERS)
RANDOM = np.random.default_rng(0).normal(size=(2, N_PARAMETERS)) * (EACH[4:-1].sum(0))
DIRECTIONS = np.vstack([EACH[:4], RANDOM, EACH[-1]])  # four tendon parameters, two ways to bend the patch, the start
TRIPLED = J(np.tile(DIRECTIONS, (3, 1)))


@pytest.fixture(scope="module")
def derivatives():
    """By automatic differentiation and by central differences, (directions, frames, 3)."""
    h, n = 1e-6, len(DIRECTIONS)
    paths, forward = batch(J(np.concatenate([h * DIRECTIONS, -h * DIRECTIONS, 0 * DIRECTIONS])), TRIPLED)
    return np.asarray(forward[2 * n :]), np.asarray((paths[:n] - paths[n : 2 * n]) / (2 * h))


@pytest.fixture(scope="module")
def phases():
    """Which frames lie apart before touch, at touch, on two facets, and after a lift-off."""
    path = path_of(jnp.zeros(N_PARAMETERS))
    seen = eqx.filter_jit(observe)(SCENE, path).effects["contact"]
    medial, lateral = (np.asarray(seen[f"force_{side}"]) > 0 for side in ("medial", "lateral"))
    any_contact = medial | lateral
    first = int(np.flatnonzero(any_contact)[0])
    lifted = np.flatnonzero(~any_contact & (np.arange(N_FRAMES) > first))
    both = np.flatnonzero(medial & lateral)
    return {"apart": np.arange(2, first), "touch": np.arange(first, first + 2), "lift_off": lifted, "two_facets": both}


@pytest.mark.parametrize("phase", ["apart", "touch", "two_facets", "lift_off"])
def test_forward_mode_agrees_with_central_differences(phase, derivatives, phases):
    frames = phases[phase]
    assert len(frames) >= 2
    forward, difference = derivatives
    for k in range(len(DIRECTIONS)):
        size = np.abs(difference[k]).max()
        error = np.abs(forward[k] - difference[k])[frames].max()
        # No derivative passes through the starts of the closest points' Newton steps, and in an impact they are off.
        assert error < (1e-6 if phase == "apart" else 3e-3) * size
        if k not in (4, 5) or phase != "apart":  # a surface that is not touched matters to nothing
            assert np.abs(forward[k][frames]).max() > 1e-7 * size
        else:
            assert np.all(forward[k][frames] == 0)


@pytest.mark.slow
def test_reverse_mode_is_forward_mode(derivatives):
    weights = J(np.random.default_rng(1).normal(size=(N_FRAMES, 3)))
    gradient = jax.jit(jax.grad(lambda theta: jnp.sum(weights * positions(theta))))(jnp.zeros(N_PARAMETERS))
    expected = np.sum(np.asarray(weights) * derivatives[0], axis=(1, 2))
    np.testing.assert_allclose(DIRECTIONS @ np.asarray(gradient), expected, rtol=1e-8)
    assert np.all(np.asarray(gradient) != 0)  # every coefficient of the patch is felt


def test_a_batch_is_its_members_one_by_one():
    several = 0.02 * np.random.default_rng(2).normal(size=TRIPLED.shape)
    for theta, path in zip(several, batch(J(several), TRIPLED)[0], strict=True):
        np.testing.assert_allclose(positions(J(theta)), path, atol=1e-7)


@pytest.mark.slow
def test_single_precision_is_finite_and_close():
    scene = knee()
    start = settled(scene)
    double = 1e3 * np.asarray(run(scene, start)[0].states.position.array())
    with jax.enable_x64(False):
        small = jax.tree.map(lambda a: jnp.asarray(a, jnp.float32) if eqx.is_inexact_array(a) else a, (scene, start))
        states = eqx.filter_jit(lambda scene, start: frame_states(scene, start=start).states)(*small)
        assert {a.dtype for a in jax.tree.leaves(states)} == {np.dtype(np.float32)}
        single = 1e3 * np.asarray(states.position.array(), np.float64)
    assert np.all(np.isfinite(single))
    assert np.abs(single - double).max() < 0.02
