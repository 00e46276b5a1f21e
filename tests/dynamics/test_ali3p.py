"""The paper's formulation: its constraints, projections and multipliers, and the same motion as the reduced one's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import (
    MASS,
    OPTIMISED,
    RADIUS,
    G,
    J,
    contact,
    gravity,
    knee,
    march,
    order_of,
    record,
    settled,
    state_at,
    still_guide,
    still_guide_at,
    system,
    tendon,
)
from scipy.spatial.transform import Rotation
from toy_mesh_scenes import CONTOURS
from toy_scene_files import load

from pftwin.dynamics.ali3p import newton as ali3p_newton
from pftwin.dynamics.ali3p.bodies import driven_targets
from pftwin.dynamics.ali3p.natural_coordinates import (
    LENGTH,
    constraints,
    jacobian,
    rates_wanted,
    second_rates_wanted,
)
from pftwin.dynamics.ali3p.step import ALI3P
from pftwin.dynamics.frame_states import frame_states
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.integrators import Newmark
from pftwin.dynamics.observe import observe
from pftwin.dynamics.state import Guide
from pftwin.dynamics.status import Status
from pftwin.files.mocap.poses import PoseSeries
from pftwin.model.effects.contact_law import Flores
from pftwin.model.effects.viscoelastic_tendon import ViscoelasticTendon
from pftwin.model.motion import KneeMotion
from pftwin.model.scene import Scene

FRAMES = 11


@eqx.filter_jit
def moved(scene: Scene, start, substeps, integrator: Integrator = ALI3P()):
    """States at the frames, and what they show."""
    path = frame_states(scene, integrator=integrator, substeps=substeps, start=start)
    return path.states, observe(scene, path)


def carried_knee() -> Scene:
    """The small knee on a femur that swings, turns and accelerates, up to 2 g and 15 rad/s^2."""
    scene = knee(FRAMES)
    t = scene.motion.times
    turn = Rotation.from_rotvec(np.stack([0.05 * np.sin(9 * t), 0.2 * (np.cos(9 * t) - 1), 0.1 * t], -1))
    place = np.stack([0.05 * np.sin(9 * t), 0.02 * t, 0.2 * (1 - np.cos(9 * t))], -1)
    tibia = turn * Rotation.from_matrix(np.asarray(scene.motion.frames(t)[1].rotation.array()))
    femur = PoseSeries(t, place, turn.as_quat(scalar_first=True))
    series = PoseSeries(t, place + turn.apply([0.0, 0.001, 0.0]), tibia.as_quat(scalar_first=True))
    return replace(scene, motion=KneeMotion.from_poses(femur, series))


SCENES = {"fixed": lambda: knee(FRAMES), "moving": carried_knee}


@pytest.fixture(scope="module", params=[pytest.param(kind, marks=pytest.mark.slow) for kind in ("fixed", "moving")])
def held(request):
    """A scene whose femur is fixed, or moves, and its equilibrium."""
    scene = SCENES[request.param]()
    return scene, settled(scene)


@pytest.fixture(scope="module")
def fixed():
    scene = knee(FRAMES)
    return scene, settled(scene)


@pytest.fixture(scope="module")
def states(held):
    return moved(*held, J(10))[0]


@pytest.fixture(scope="module")
def followed(held):
    """What guided bodies are to follow at the frames."""
    motion = held[0].motion

    def at(time):
        return driven_targets(lambda part: Guide.sample(motion, time + (part - 1) * 1e-3), J(1e-3))

    return jax.jit(jax.vmap(at))(J(motion.times))


def test_constraints_hold(held, states, followed):
    """Not those of the step alone: the recorded frames, and lengths and angles, are what they have to be."""
    motion, q = held[0].motion, np.asarray(states.solver_state.place)
    assert np.abs(jax.vmap(constraints)(states.solver_state.place, followed)).max() < 1e-15
    assert 0 < float(states.solver_state.drift.max()) < 1e-15
    axes = q[..., 3:].reshape(*q.shape[:2], 3, 3) / LENGTH
    np.testing.assert_allclose(axes @ np.swapaxes(axes, 2, 3), np.broadcast_to(np.eye(3), axes.shape), atol=1e-13)
    femur, tibia = motion.frames(motion.times)
    for row, frame in enumerate([tibia] if femur is None else [tibia, femur], start=1):
        np.testing.assert_allclose(q[:, row, :3], frame.origin.array(), atol=1e-14)
        np.testing.assert_allclose(np.swapaxes(axes[:, row], 1, 2), frame.rotation.array(), atol=1e-13)
    np.testing.assert_allclose(states.orientation.rotation().array(), np.swapaxes(axes[:, 0], 1, 2), atol=1e-13)
    assert np.ptp(q[:, 1], axis=0).max() > 3e-4  # it moves


def test_velocities_and_accelerations_are_projected(states, followed):
    """To rounding, after the first step: that starts from what is not known of the guided bodies."""
    now = states.solver_state
    j = jax.vmap(jacobian)(now.place, followed)
    rate = jnp.einsum("tnki,tni->tnk", j, now.rate) - jax.vmap(rates_wanted)(now.place, followed)
    second = jax.vmap(second_rates_wanted)(now.place, now.rate, followed)
    second_rate = jnp.einsum("tnki,tni->tnk", j, now.second_rate) - second
    assert np.abs(rate).max() < 1e-13 * np.abs(now.rate).max()
    assert np.abs(second_rate[1:]).max() < 1e-12 * np.abs(now.second_rate).max()


@pytest.mark.slow
def test_the_same_motion_as_in_independent_coordinates(held):
    """Differences from `newmark` shrink with the square of the step."""
    counts = (5, 10, 20, 40)
    one, two = (np.stack([moved(*held, J(n), i)[0].position.array() for n in counts]) for i in (ALI3P(), Newmark()))
    apart = 1e3 * np.abs(one - two).max((1, 2))
    assert apart[1] < 1e-3  # mm, at 1 ms
    assert apart[1] < 0.5 * 1e3 * np.abs(two[1] - two[3]).max()  # less than what both are off by
    assert order_of(apart).mean() == pytest.approx(2, abs=0.25)


def test_multipliers_are_what_drives_the_guided_bodies(held):
    """Force and moment on the tibia: its inertia, less what the patellar tendon pulls it with."""
    scene, start = held
    path, seen = moved(scene, start, J(40))
    i, (mass, inertia) = 5, (float(scene.patella.mass), np.asarray(scene.patella.inertia.array()))
    place, frames = np.asarray(path.solver_state.place), scene.motion.frames
    h, t = 1e-5, scene.motion.times[i]
    before, tibia, after = (frames(t + k * h)[1] for k in (-1, 0, 1))
    turn = np.asarray(tibia.rotation.array())
    rate = (np.asarray(after.velocity.array()) - np.asarray(before.velocity.array())) / (2 * h)
    turning = (np.asarray(after.angular_velocity.array()) - np.asarray(before.angular_velocity.array())) / (2 * h)
    spin, turning = turn.T @ np.asarray(tibia.angular_velocity.array()), turn.T @ turning

    tendon_ = scene.effects[2]
    arm = turn @ np.asarray(tendon_.origin.array())
    insertion = tendon_.insertion.array() - scene.patella.center_of_mass.array()
    end = place[i, 0, :3] + (place[i, 0, 3:].reshape(3, 3).T / LENGTH) @ np.asarray(insertion)
    line = end - place[i, 1, :3] - arm
    pull = float(seen.effects["patellar_tendon"]["tension"][i]) * line / np.linalg.norm(line)

    multipliers = np.asarray(path.solver_state.multipliers)[i, 1]
    force, moment = -multipliers[6:9], -LENGTH * multipliers[9:]
    inertial = inertia * turning + np.cross(spin, inertia * spin)
    np.testing.assert_allclose(force, mass * rate - pull, atol=1e-3 * np.linalg.norm(pull))
    expected = inertial - turn.T @ np.cross(arm, pull)
    np.testing.assert_allclose(moment, expected, atol=1e-3 * np.linalg.norm(expected))
    assert np.linalg.norm(pull) > 1


def test_driving_forces_and_weight_make_the_momentum_of_all(states):
    """With a femur that moves; every reaction has its counterpart."""
    now = states.solver_state
    if now.place.shape[1] < 3:
        pytest.skip("the world takes what acts on a fixed femur")
    force = -np.asarray(now.multipliers)[1:, :, 6:9].sum(1) + [0, 0, -MASS * G]
    rate = MASS * np.asarray(now.second_rate)[1:, :, :3].sum(1)
    np.testing.assert_allclose(force, rate, atol=2e-2 * np.abs(rate).max())
    assert np.abs(rate).max() > 1


def test_a_free_top_keeps_energy_and_angular_momentum():
    """To second order: the constraints' forces do no work; and there are no gyroscopic forces to get wrong."""
    inertia = np.array([2e-5, 5e-5, 6e-5])
    top = system(inertia=inertia)
    start = state_at(top, (0, 0, 0), spin=(0.3, 12.0, 0.2))

    def conserved(state):
        spin = np.asarray(state.spin.array())
        momentum = np.asarray(state.orientation.rotation().array()) @ (inertia * spin)
        return 0.5 * np.sum(inertia * spin**2), momentum

    e0, l0 = conserved(start)
    drift = [conserved(march(top, start, 0.6, n, ALI3P())) for n in (300, 600, 1200)]
    energy = [abs(e - e0) / e0 for e, _ in drift]
    momentum = [np.linalg.norm(turning - l0) / np.linalg.norm(l0) for _, turning in drift]
    assert momentum[-1] < 1e-6
    assert order_of(momentum) == pytest.approx(2, abs=0.2)
    assert energy[-1] < 1e-9  # of third order
    assert order_of(energy).min() > 2.5


@pytest.mark.slow
def test_memories_of_effects_come_along(fixed):
    """A viscoelastic tendon and contacts that remember how fast they began: as with `newmark`."""
    scene, _ = fixed
    t = scene.effects[2]
    slow = ViscoelasticTendon(
        t.stiffness, 2 * t.stiffness, J(0.04), t.slack_length, t.insertion, t.origin, t.body, name=t.name
    )
    scene = scene.with_effect(slow)
    start = settled(scene)
    one, two = (moved(scene, start, J(10), i) for i in (ALI3P(), Newmark()))
    assert 1e3 * np.abs(one[0].position.array() - two[0].position.array()).max() < 2e-4
    stretch = one[1].effects[t.name]["dashpot_stretch"]
    np.testing.assert_allclose(stretch, two[1].effects[t.name]["dashpot_stretch"], atol=1e-7)
    assert np.ptp(stretch) > 1e-4

    falling = system(gravity(), contact(Flores(J(2e8), J(0.6))))
    thrown = state_at(falling, (0, 0, RADIUS + 1e-4), (0, 0, -0.2))
    ends = [march(falling, thrown, 3e-3, 600, i) for i in (ALI3P(), Newmark())]
    rebound = [float(e.velocity.z) for e in ends]
    assert rebound[0] == pytest.approx(rebound[1], rel=1e-6)
    assert rebound[0] > 0.1


@pytest.mark.slow
def test_on_meshes(toy: Path):
    """Contours of coarse triangles: as with `newmark`, and every step is solved."""
    scene = load(toy, CONTOURS)
    scene = replace(scene, motion=replace(scene.motion, n_frames=6))
    start = settled(scene)
    (one, seen), (two, _) = (moved(scene, start, J(10), i) for i in (ALI3P(), Newmark()))
    assert not np.asarray(seen.status).any()
    assert float(one.solver_state.drift.max()) < 1e-15
    assert 1e3 * np.abs(one.position.array() - two.position.array()).max() < 2e-4
    assert np.asarray(seen.effects["mesh_contact"]["force"]).min() > 1


def thrown_heights(theta, integrator: Integrator = ALI3P()):
    """A button thrown on a plate, held by a tendon [mm]; by the contact's stiffness, the tendon's, and the start."""
    held_back = tendon(20 * (1 + theta[1]), 0.05, 0.5), contact(Flores(1e6 * (1 + theta[0]), J(0.8)))
    falling = system(gravity(), *held_back)
    start = state_at(falling, (1e-3, 0, RADIUS + 1e-3), (0, 0, -0.2))
    start = eqx.tree_at(lambda s: s.position.z, start, start.position.z + 1e-3 * theta[2])
    return 1e3 * record(falling, start, J(5e-4), 60, integrator)[0].position.z


@pytest.mark.slow
def test_derivatives_without_contact_in_contact_and_after_lift_off_and_a_batch():
    """Forward is reverse is central differences; a batch is its members one by one."""
    zero, h = jnp.zeros(3), 1e-6
    one = jnp.eye(3)
    both = jax.jit(jax.vmap(lambda theta, d: jax.jvp(thrown_heights, (theta,), (d,))))
    paths, slopes = both(jnp.concatenate([h * one, -h * one, 0 * one, 0.1 * one]), jnp.tile(one, (4, 1)))
    heights, forward = np.asarray(paths[6]) - 1e3 * RADIUS, np.asarray(slopes[6:9])
    difference = np.asarray(paths[:3] - paths[3:6]) / (2 * h)
    touching = np.flatnonzero(heights < 0)
    phases = {"apart": slice(0, touching[0]), "touching": touching, "after": slice(touching[-1] + 1, None)}
    assert heights[phases["after"]].size > 5
    for phase, rows in phases.items():
        size = np.abs(difference[:, rows]).max(1)
        np.testing.assert_array_less(np.abs(forward - difference)[:, rows].max(1), 1e-5 * size + 1e-8)
        assert (size[1:] > 0).all(), phase
        assert (size[0] < 1e-8) == (phase == "apart")
    weights = J(np.random.default_rng(1).normal(size=len(heights)))
    alone = jax.jit(jax.value_and_grad(lambda theta: weights @ thrown_heights(theta)))
    np.testing.assert_allclose(alone(zero)[1], forward @ np.asarray(weights), rtol=1e-8)
    for path, theta in zip(paths[9:], 0.1 * one, strict=True):
        assert weights @ path == pytest.approx(float(alone(theta)[0]), rel=1e-10)


@pytest.mark.slow
def test_derivatives_by_the_guided_motion(fixed):
    """Of the patella and of the multipliers, by a shift of the tibia that grows and by the tendon's stiffness."""
    scene, start = fixed

    def shown(theta):
        def where(s):
            return [s.motion.tibia.position_coefficients, s.effects[1].stiffness]

        cubics, stiffness = where(scene)
        changed = eqx.tree_at(where, scene, [cubics.at[2, :, 0].add(1e-2 * theta[0]), stiffness * (1 + theta[1])])
        states = frame_states(changed, integrator=ALI3P(), substeps=4, start=start).states
        return jnp.concatenate([1e3 * states.position.array()[-1], states.solver_state.multipliers[-1, 1, 6:9]])

    value = jax.jit(shown, compiler_options=OPTIMISED)
    zero, h = jnp.zeros(2), 1e-5
    forward = jax.jit(jax.vmap(lambda d: jax.jvp(shown, (zero,), (d,))[1]), compiler_options=OPTIMISED)(jnp.eye(2))
    difference = np.stack([(value(h * d) - value(-h * d)) / (2 * h) for d in jnp.eye(2)])
    np.testing.assert_allclose(forward, difference, atol=2e-3 * np.abs(difference).max(1, keepdims=True).max())
    reverse = jax.jit(jax.grad(lambda theta: shown(theta) @ jnp.arange(1.0, 7.0)), compiler_options=OPTIMISED)(zero)
    np.testing.assert_allclose(reverse, np.asarray(forward) @ np.arange(1.0, 7.0), rtol=1e-8)
    assert np.abs(difference).max(1).min() > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("mode", [jax.jacfwd, jax.jacrev])
def test_derivatives_of_a_top_on_a_tendon_are_difference_quotients(mode):
    """By mass and initial spin, of place and spin, and of the multipliers that keep the top rigid."""
    pull = tendon(300.0, 0.05, insertion=(0.004, 0.002, 0.001), origin=(0.0, 0.01, 0.06))

    def ends(theta):
        top = system(pull, mass=MASS * theta[0], inertia=(2e-5, 5e-5, 6e-5))
        state = ALI3P().begin(top, state_at(top, (0, 0, 0), spin=(0.3, 12.0 * theta[1], 0.2)), still_guide(), J(2e-3))

        def one(now, _):
            return ALI3P().advance(top, now, still_guide_at, J(2e-3), None)[0], None

        after = jax.lax.scan(one, state, None, length=5)[0]
        held = after.solver_state.multipliers[0, :6]
        found = jnp.concatenate([1e2 * after.position.array(), after.spin.array(), held])
        return found, found

    at, h = J([1.0, 1.0]), 1e-3
    slopes_and_ends = jax.jit(mode(ends, has_aux=True))  # one program for both: compiling it takes longest
    sides = [[slopes_and_ends(at + s * h * d)[1] for s in (1, -1)] for d in jnp.eye(2)]
    difference = np.stack([(high - low) / (2 * h) for high, low in sides], axis=-1)
    assert np.abs(difference[:3]).max() > 1e-2
    assert np.abs(difference[6:]).max() > 0.1
    derivative, _ = slopes_and_ends(at)
    np.testing.assert_allclose(derivative[:6], difference[:6], rtol=1e-6, atol=1e-6)
    # The search for the multipliers stops at a speed of 1e-9 m/s, which is what a difference quotient sees of them.
    np.testing.assert_allclose(derivative[6:], difference[6:], atol=1e-3)


def test_the_penalty_changes_nothing_but_the_iterations():
    top = system(inertia=(2e-5, 5e-5, 6e-5))
    start = state_at(top, (0, 0, 0), spin=(0.3, 12.0, 0.2))
    usual, soft = (march(top, start, 0.1, 100, i) for i in (ALI3P(), ALI3P(penalty=1e3)))
    np.testing.assert_allclose(soft.spin.array(), usual.spin.array(), rtol=1e-7)
    assert float(soft.solver_state.drift) < 1e-11
    assert float(soft.spin.x) != float(usual.spin.x)


def test_a_step_that_is_not_solved_says_so():
    """A body that turns by five radians in a step: Newton's iteration finds no way, and numbers stay numbers."""
    top = system(inertia=(2e-5, 5e-5, 6e-5))
    states, _ = record(top, state_at(top, (0, 0, 0), spin=(30.0, 90.0, 10.0)), J(5e-2), 40, ALI3P())
    assert np.isfinite(states.orientation.array()).all()
    assert (np.asarray(states.solver_state.residual) > 0).any()


@pytest.mark.slow
def test_a_frame_whose_steps_are_not_solved_has_the_status(fixed, monkeypatch):
    monkeypatch.setattr(ali3p_newton, "MOST_ITERATIONS", 1)
    cut_off = eqx.filter_jit(lambda s, a: observe(s, frame_states(s, integrator=ALI3P(), substeps=1, start=a)))
    seen = cut_off(*fixed)
    assert (np.asarray(seen.status) & int(Status.STEP_TOO_LONG)).any()
    assert np.isfinite(seen.center.array()).all()


@pytest.mark.slow
def test_single_precision_is_close(fixed):
    scene, start = fixed
    double = moved(scene, start, J(10))[0].position.array()
    with jax.enable_x64(False):
        small = jax.tree.map(lambda a: jnp.asarray(a, jnp.float32) if eqx.is_inexact_array(a) else a, (scene, start))
        states, seen = moved(*small, jnp.asarray(10, jnp.int32))
        assert {a.dtype for a in jax.tree.leaves(states) if eqx.is_inexact_array(a)} == {np.dtype(np.float32)}
        assert not np.asarray(seen.status).any()
        assert float(states.solver_state.drift.max()) < 1e-7
        single = np.asarray(states.position.array(), np.float64)
    assert 1e3 * np.abs(single - double).max() < 0.02
