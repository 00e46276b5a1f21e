"""A femur that moves: against an independent integration in numpy, and Galileo's and d'Alembert's tests."""

from __future__ import annotations

import equinox as eqx
import numpy as np
import pytest
from scenes import MASS, RADIUS, G, J, contact, flat_patch, gravity, knee, run, settled, starting_as_it_is, tendon, vec
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from pftwin.base.spatial import Pose, Quaternion
from pftwin.files.mocap.poses import PoseSeries
from pftwin.model.effects.contact_law import HuntCrossley
from pftwin.model.effects.damping import LinearDamping
from pftwin.model.motion import KneeMotion
from pftwin.model.scene import PatellaBody, Scene

FRAMES = 41
T = np.arange(FRAMES, dtype=np.float64) * 0.01


def femur_pose(t):
    """Swings, turns and accelerates: up to 25 m/s^2 and 100 rad/s^2."""
    w = 2 * np.pi * 2.0
    position = np.stack([0.05 * np.sin(w * t), 0.02 * np.cos(1.3 * w * t), 0.1 * t + 0.01 * np.sin(2 * w * t)], -1)
    turn = np.stack([0.1 * np.sin(w * t), 0.6 * np.sin(w * t + 0.5), 0.2 * np.cos(w * t)], -1)
    return position, Rotation.from_rotvec(turn)


def tibia_pose(t):
    position, turn = femur_pose(t)
    return position + 0.01 * np.sin(9 * t)[..., None] * np.array([1.0, 0.5, -0.2]), turn


def series(pose, times=T) -> PoseSeries:
    position, turn = pose(times)
    return PoseSeries(times, position, turn.as_quat(scalar_first=True))


# A button whose centre is its centre of mass: it does not turn, so Newton's law for a point is the whole reference.
K_QUADRICEPS, K_PATELLAR, K_CONTACT, DISSIPATION, DRAG = 300.0, 800.0, 1e6, 3.0, 0.8
ON_FEMUR, ON_TIBIA = np.array([0.12, 0.01, 0.0]), np.array([-0.08, -0.01, 0.0])


def button_scene() -> Scene:
    effects = (
        gravity(),
        tendon(K_QUADRICEPS, 0.08, 3.0, origin=ON_FEMUR, body="femur", name="quadriceps"),
        tendon(K_PATELLAR, 0.06, 8.0, origin=ON_TIBIA, body="tibia", name="patellar_tendon"),
        contact(HuntCrossley(J(K_CONTACT), J(DISSIPATION)), flat_patch()),
        LinearDamping(J(DRAG), J(1e-4)),
    )
    motion = KneeMotion.from_poses(series(femur_pose), series(tibia_pose))
    position, turn = femur_pose(np.array(0.0))
    start = Pose(
        vec(*(position + turn.apply([0.0, 0.0, RADIUS]))), Quaternion.from_array(J(turn.as_quat(scalar_first=True)))
    )
    return Scene(PatellaBody(J(MASS), vec(3e-5, 3e-5, 3e-5), vec(0, 0, 0)), effects, motion, start)


def newton(t, y):
    """m a = sum of forces, in the world; the femur's and tibia's velocities by central differences of their poses."""
    x, v = y[:3], y[3:]
    force = MASS * np.array([0, 0, -G])
    h = 1e-6

    def velocity_of(pose, point):
        """Of the body's point that is at `point` now."""
        position, turn = pose(np.array(t))
        local = turn.inv().apply(point - position)
        (p1, r1), (p0, r0) = pose(np.array(t + h)), pose(np.array(t - h))
        return (p1 + r1.apply(local) - p0 - r0.apply(local)) / (2 * h)

    for pose, end, k, slack, c in ((femur_pose, ON_FEMUR, K_QUADRICEPS, 0.08, 3.0),
                                   (tibia_pose, ON_TIBIA, K_PATELLAR, 0.06, 8.0)):  # fmt: skip
        position, turn = pose(np.array(t))
        anchor = position + turn.apply(end)
        length = np.linalg.norm(anchor - x)
        along = (anchor - x) / length
        pull = k * (length - slack) + c * along @ (velocity_of(pose, anchor) - v)
        force = force + along * max(pull, 0) * (length > slack)
    position, turn = femur_pose(np.array(t))
    normal = turn.apply([0.0, 0.0, 1.0])
    depth = RADIUS - normal @ (x - position)
    sliding = v - velocity_of(femur_pose, x)
    push = K_CONTACT * max(depth, 0) ** 1.5 * max(1 - 1.5 * DISSIPATION * normal @ sliding, 0)
    force = force + normal * push - DRAG * sliding
    return np.concatenate([v, force / MASS])


@pytest.fixture(scope="module")
def button_path():
    scene = button_scene()
    return run(scene, starting_as_it_is(scene), 40)[0].states


def test_the_start_moves_with_the_femur(button_path):
    x0 = np.asarray(button_path.position.array())[0]
    h = 1e-6
    (p1, r1), (p0, r0) = femur_pose(np.array(h)), femur_pose(np.array(-h))
    position, turn = femur_pose(np.array(0.0))
    local = turn.inv().apply(x0 - position)
    expected = (p1 + r1.apply(local) - p0 - r0.apply(local)) / (2 * h)
    np.testing.assert_allclose(button_path.velocity.array()[0], expected, atol=2e-3)
    spin = (r1 * r0.inv()).as_rotvec() / (2 * h)
    np.testing.assert_allclose(button_path.orientation.rotate(button_path.spin).array()[0], spin, atol=2e-2)


def test_against_newtons_law_written_out_in_numpy(button_path):
    x, v = (np.asarray(a.array()) for a in (button_path.position, button_path.velocity))
    reference = solve_ivp(newton, (0, T[-1]), [*x[0], *v[0]], t_eval=T, rtol=1e-7, atol=1e-9, method="LSODA").y[:3].T
    assert np.all(np.ptp(reference - femur_pose(T)[0], axis=0) > 0.005)  # it moves by a centimetre on the femur
    rms = 1e3 * np.sqrt(np.mean(np.sum((x - reference) ** 2, 1)))
    assert rms < 0.02  # 0.0174 at 0.25 ms, halved with the step


def moving_knee(velocity, acceleration=(0, 0, 0)) -> Scene:
    """The small knee, all of it carried along."""
    scene = knee()
    t = scene.motion.times
    shift = t[:, None] * np.array(velocity) + 0.5 * t[:, None] ** 2 * np.array(acceleration)
    tibia = Rotation.from_matrix(np.asarray(scene.motion.frames(t)[1].rotation.array()))
    motion = KneeMotion.from_poses(
        PoseSeries(t, shift, np.tile([1.0, 0, 0, 0], (t.size, 1))),
        PoseSeries(t, shift, tibia.as_quat(scalar_first=True)),
    )
    return Scene(scene.patella, scene.effects, motion, scene.start)


def centre(scene: Scene) -> np.ndarray:
    """Path of the button's centre in the femur's frame [mm], always from the same start."""
    return 1e3 * np.asarray(run(scene, settled(knee()))[1].center.array())


@pytest.fixture(scope="module")
def at_rest():
    return centre(moving_knee((0, 0, 0)))


def test_a_moving_femur_that_stands_still_is_a_fixed_one(at_rest):
    assert np.ptp(at_rest, axis=0).max() > 3
    np.testing.assert_allclose(at_rest, centre(knee()), atol=1e-9)


def test_galileo(at_rest):
    np.testing.assert_allclose(centre(moving_knee((1.3, -0.7, 0.4))), at_rest, atol=1e-7)


def test_dalembert(at_rest):
    """A knee that accelerates is a knee at rest whose weight points elsewhere: g - a."""
    a = np.array([2.0, 1.0, -3.0])
    scene = moving_knee((0, 0, 0))
    turned = eqx.tree_at(lambda s: s.effects[0].acceleration, scene, vec(-a[0], -a[1], -G - a[2]))
    relative, here = centre(moving_knee((0, 0, 0), a)), centre(turned)
    assert np.abs(here - at_rest).max() > 0.2  # it matters
    np.testing.assert_allclose(relative, here, atol=0.02)  # first order in the step
