"""Motion without inertia: dashpots in closed form, folds where energy alone puts them, dynamics of ever less mass."""

from __future__ import annotations

from typing import NamedTuple

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
    contact,
    gravity,
    knee,
    march,
    patch_of,
    settled,
    state_at,
    system,
    tendon,
)

from pftwin.base.errors import InputError
from pftwin.base.spatial import Pose, Quaternion, Vec3
from pftwin.dynamics.frame_states import frame_states, starting_equilibrium
from pftwin.dynamics.integrators import Newmark
from pftwin.dynamics.observe import observe
from pftwin.dynamics.quasi_static import newton as quasi_static_newton
from pftwin.dynamics.quasi_static.step import QuasiStatic
from pftwin.dynamics.status import Status
from pftwin.files.mocap.poses import PoseSeries
from pftwin.geometry.patch.polynomial import exponents
from pftwin.model.effects.contact_law import Hertz
from pftwin.model.motion import KneeMotion
from pftwin.model.scene import PatellaBody, Scene

J = jnp.asarray


@eqx.filter_jit
def path(scene, start, substeps=1, integrator=QuasiStatic(), ledger=False):
    found = frame_states(scene, integrator=integrator, substeps=substeps, start=start, ledger=ledger)
    return found, observe(scene, found)


def places(found) -> np.ndarray:
    """Centre of mass at the frames [mm]."""
    return 1e3 * np.asarray(found[0].states.position.array())


def test_a_dashpot_gives_way_with_the_second_order():
    """A spring with a dashpot in line, nothing else: x = x0 exp(-k t / c), whatever the mass."""
    k, c, x0, t = 200.0, 20.0, 0.004, 0.35
    sprung = system(gravity(), tendon(k, 0.05, c))
    rest = 0.1 - 0.05 - MASS * G / k
    start = state_at(sprung, (0, 0, rest + x0))
    exact = x0 * np.exp(-k * t / c)
    errors = [
        abs(float(march(sprung, start, t, n, QuasiStatic()).position.z) - rest - exact) for n in (20, 40, 80, 160)
    ]
    assert np.log2(errors[-2] / errors[-1]) == pytest.approx(QuasiStatic().order, abs=0.2)
    assert errors[-1] < 1e-4 * x0


@pytest.fixture(scope="module")
def held():
    scene = knee(16)
    return scene, settled(scene)


@pytest.mark.slow
def test_dynamics_come_to_it_with_the_mass(held):
    """What inertia changes goes with the mass that has it; weight is the effect of gravity's own."""
    scene, start = held
    still, apart = places(path(scene, start, J(40))), []
    for share in (1.0, 0.5, 0.25):
        body = scene.patella
        light = eqx.tree_at(
            lambda s: (s.patella.mass, s.patella.inertia), scene, (share * body.mass, share * body.inertia)
        )
        moving = places(path(light, start, J(160), Newmark()))
        apart.append(np.sqrt(np.mean((still - moving) ** 2)))
    assert 1e-3 < apart[0] < 0.05 * np.ptp(still, axis=0).max()
    assert apart[0] / apart[1] == pytest.approx(2, rel=0.25)
    assert apart[1] / apart[2] == pytest.approx(2, rel=0.25)


def test_speed_of_a_motion(held):
    """The same poses at other times, and the velocities that belong to them."""
    motion = held[0].motion
    slow = motion.at_speed(0.25)
    assert slow.times == pytest.approx(motion.start_time + 4 * (motion.times - motion.start_time))
    fast, there = (m.tibia.frames(J(m.times[7] + 0.3 * m.frame_interval)) for m in (motion, slow))
    np.testing.assert_allclose(there.rotation.array(), fast.rotation.array(), atol=1e-14)
    np.testing.assert_allclose(4 * there.angular_velocity.array(), fast.angular_velocity.array(), atol=1e-12)
    with pytest.raises(InputError, match="positive number"):
        motion.at_speed(0.0)


@pytest.mark.slow
def test_without_dashpots_every_step_is_exact():
    """What forces know of speed is all that a step's length can change: here nothing."""
    scene = knee(16, Hertz(J(2e8)))
    undamped = eqx.tree_at(lambda s: [s.effects[1].damping, s.effects[2].damping], scene, [J(0.0), J(0.0)])
    start = settled(undamped)
    one, ten = (places(path(undamped, start, J(n))) for n in (1, 10))
    np.testing.assert_allclose(one, ten, atol=1e-5)  # 10 nm
    # And it is the equilibrium of every frame, found afresh from a place nearby.
    last = undamped.motion.times.size - 1
    frozen = eqx.tree_at(
        lambda s: (s.motion, s.start),
        undamped,
        (
            still_at(undamped, last),
            Pose(Vec3.from_array(J(1e-3 * one[-1] + [2e-4, -2e-4, 1e-4])), undamped.start.orientation),
        ),
    )
    found = settled(frozen)
    np.testing.assert_allclose(1e3 * np.asarray(found.pose.position.array()), one[-1], atol=1e-5)


def still_at(scene: Scene, frame: int) -> KneeMotion:
    """The guided bodies as they are at a frame, for good."""
    series = scene.motion.tibia
    t = np.asarray(scene.motion.times)
    frames = series.frames(J(t[frame]))
    q = Quaternion.from_rotation(frames.rotation).array()
    n = t.size
    return KneeMotion.from_poses(
        None, PoseSeries(t, np.tile(np.asarray(frames.origin.array()), (n, 1)), np.tile(np.asarray(q), (n, 1)))
    )


# A ridge between two grooves: z = a (s^2 - 1)^2 with s = v / b, and a spring that is led from one side to the other.
A, B, PULL, SLACK, HEIGHT, FRAMES = 2e-3, 24e-3, 60.0, 0.05, -0.06, 61


STEPS = 4  # between two frames: the account of work is of first order in the step


def led(n: int = FRAMES) -> np.ndarray:
    return np.linspace(-0.02, 0.028, n)


def ridge_scene() -> Scene:
    half = 0.05  # coefficients are those of v / half
    powers = {(0, 0): A, (0, 2): -2 * A * (half / B) ** 2, (0, 4): A * (half / B) ** 4}
    patch = patch_of([powers.get((i, j), 0.0) for i, j in exponents(4)], 4, (half, half))
    t = 0.01 * np.arange(FRAMES)
    aside = np.stack([0 * t, led(), 0 * t], 1)
    motion = KneeMotion.from_poses(None, PoseSeries(t, aside, np.tile([1.0, 0, 0, 0], (FRAMES, 1))))
    effects = (
        gravity(),
        tendon(PULL, SLACK, insertion=(0, 0, 0), origin=(0, 0, HEIGHT), body="tibia"),
        contact(Hertz(J(2e8)), patch),
    )
    body = PatellaBody(J(MASS), Vec3(J(3e-5), J(3e-5), J(4e-5)), Vec3(J(0.0), J(0.0), J(0.0)))
    return Scene(body, effects, motion, Pose(Vec3(J(0.0), J(-B), J(RADIUS)), Quaternion.identity()), "ridge")


class Followed(NamedTuple):
    aside: np.ndarray  # of the sphere's centre at every frame [m]
    energy: np.ndarray  # [J]
    ends_after: int  # frame before the groove's own equilibrium ends
    released: float  # [J]


@pytest.fixture(scope="module")
def by_energy() -> Followed:
    """A rigid sphere slides down its energy over a fine grid of touching points: no dynamics, no Newton."""
    v = np.linspace(-0.04, 0.04, 400_001)
    s = v / B
    z, slope = A * (s**2 - 1) ** 2, 4 * A / B * s * (s**2 - 1)
    root = np.sqrt(1 + slope**2)
    across, up = v - RADIUS * slope / root, z + RADIUS / root
    at, aside, energy, jumps = int(np.argmin(abs(v + B))), [], [], []
    for y in led():
        stretch = np.maximum(np.hypot(across - y, up - HEIGHT) - SLACK, 0)
        e = MASS * G * up + 0.5 * PULL * stretch**2
        began = at
        while e[at + 1] < e[at]:
            at += 1
        while e[at - 1] < e[at]:
            at -= 1
        if across[at] - across[began] > 0.01:
            jumps.append((len(aside), e[began] - e[at]))
        aside.append(across[at])
        energy.append(e[at])
    ((ends_after, released),) = jumps
    return Followed(np.array(aside), np.array(energy), ends_after, released)


@pytest.fixture(scope="module")
def over_the_ridge():
    scene = ridge_scene()
    return scene, path(scene, settled(scene), J(STEPS), ledger=True)


@pytest.mark.slow
def test_a_fold_is_found_crossed_and_flagged(over_the_ridge, by_energy):
    """It leaves its groove in the frame in which that has no equilibrium any more, and lands in the other groove."""
    _, (found, seen) = over_the_ridge
    snaps = np.flatnonzero(np.asarray(seen.status) & int(Status.SNAPPED))
    assert snaps.tolist() == [by_energy.ends_after]
    assert not (np.asarray(seen.status) & int(Status.STEP_TOO_LONG)).any()
    aside = np.asarray(found.states.position.y)
    apart = abs(aside - by_energy.aside)  # the contact gives by 0.01 mm, which counts where the groove ends
    assert np.median(apart) < 1e-6
    assert apart.max() < 1e-4
    assert np.ptp(aside[snaps[0] - 1 : snaps[0] + 1]) > 0.01


@pytest.mark.slow
def test_what_a_snap_releases_is_heat(over_the_ridge, by_energy):
    _, (found, seen) = over_the_ridge
    stored = sum(np.asarray(e) for e in seen.potential_energy.values())
    work, heat = np.asarray(found.ledger.work), np.asarray(found.ledger.heat)
    gap = stored - stored[0] - work + heat
    at = by_energy.ends_after
    assert heat[at] - heat[at - 1] == pytest.approx(by_energy.released, rel=0.1)
    assert abs(gap).max() < 0.1 * by_energy.released
    assert heat[at - 1] < 1e-3 * by_energy.released


@pytest.mark.slow
def test_members_of_a_batch_snap_on_their_own(over_the_ridge):
    """One whose spring is too soft to leave its groove does not, and changes nothing for the other."""
    scene, (alone, _) = over_the_ridge
    springs = J([PULL, PULL / 8])

    @eqx.filter_jit
    def both(stiffness):
        def one(k):
            soft = eqx.tree_at(lambda s: s.effects[1].stiffness, scene, k)
            found = frame_states(soft, integrator=QuasiStatic(), substeps=J(STEPS), start=starting_equilibrium(soft))
            return observed(found)

        return jax.vmap(one)(stiffness)

    positions, snaps = both(springs)
    np.testing.assert_allclose(positions[0, :, 1], alone.states.position.y, atol=1e-9)
    assert snaps[:, -1].tolist() == [1, 0]
    assert positions[1, -1, 1] < 0


def observed(found):
    return found.states.position.array(), found.states.solver_state.snaps


@pytest.fixture(scope="module")
def derivatives(over_the_ridge, by_energy):
    """Of where it is before the snap and after it, by the spring's stiffness; and its slope."""
    scene = over_the_ridge[0]
    start, frames = settled(scene), J([by_energy.ends_after - 8, FRAMES - 1])

    def aside(k):
        soft = eqx.tree_at(lambda s: s.effects[1].stiffness, scene, k)
        found = frame_states(soft, integrator=QuasiStatic(), substeps=1, start=start)
        return found.states.position.y[frames]

    return aside, np.asarray(jax.jit(jax.jacfwd(aside))(J(PULL)))


@pytest.mark.slow
def test_derivatives_agree_with_differences(derivatives):
    aside, forward = derivatives
    at, h = jax.jit(aside), 0.05
    differences = (np.asarray(at(J(PULL + h))) - np.asarray(at(J(PULL - h)))) / (2 * h)
    np.testing.assert_allclose(forward, differences, rtol=1e-4)
    assert abs(forward).min() > 1e-6


@pytest.mark.slow
def test_reverse_mode_agrees_with_forward_mode(derivatives):
    """One number after the other, as losses are."""
    aside, forward = derivatives
    weighed = jax.grad(lambda k, weights: weights @ aside(k))
    program = jax.jit(weighed, compiler_options=OPTIMISED)
    backward = [program(J(PULL), weights) for weights in jnp.eye(2)]
    np.testing.assert_allclose(backward, forward, rtol=1e-9)


@pytest.mark.slow
def test_what_is_not_balanced_says_so(held, monkeypatch):
    monkeypatch.setattr(quasi_static_newton, "MOST_ITERATIONS", 1)
    scene, start = held
    seen = eqx.filter_jit(lambda s: observe(s, frame_states(s, integrator=QuasiStatic(), substeps=1, start=start)))
    status = np.asarray(seen(scene).status)
    assert (status & int(Status.STEP_TOO_LONG)).any()
    assert np.isfinite(np.asarray(seen(scene).center.x)).all()
