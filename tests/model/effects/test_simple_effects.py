"""Weight and linear damping."""

from __future__ import annotations

import equinox as eqx
import numpy as np
import pytest
from scenes import J, knee_motion, look, vec

from pftwin.base.quantities import declarations
from pftwin.base.spatial import Quaternion
from pftwin.files.mocap.poses import PoseSeries
from pftwin.model.effects.damping import LinearDamping
from pftwin.model.effects.gravity import Gravity
from pftwin.model.motion import Frame

TURN = Quaternion.from_rotation_vector(vec(0.3, -0.5, 0.2))


def test_weight_and_its_energy():
    weight = Gravity(J(0.12), vec(0, 1.0, -9.81))
    low, high = (weight.load(look(p), None)[0] for p in ((0, 0, 0), (0.3, 0.1, 0.2)))
    np.testing.assert_allclose(low.total().force.array(), [0, 0.12, -0.12 * 9.81])
    assert low.energy is not None
    assert high.energy is not None
    assert float(high.energy - low.energy) == pytest.approx(0.12 * (9.81 * 0.2 - 0.1))
    assert low.stiff == ()
    assert float(weight.observe(look((0, 0, 0)), None)["weight"]) == pytest.approx(0.12 * np.hypot(1.0, 9.81))


def moving(spin, femur: Frame | None = None):
    now = look((0.1, 0.2, 0.3), (1.0, -2.0, 0.5), TURN)
    now = eqx.tree_at(lambda n: n.patella.spin, now, vec(*spin))
    return now if femur is None else eqx.tree_at(lambda n: n.femur, now, femur)


def test_drag_is_proportional_and_only_takes_energy():
    now = moving((3.0, 1.0, -2.0))
    load, _ = LinearDamping(J(0.4), J(0.002)).load(now, None)
    w = load.total()
    np.testing.assert_allclose(w.force.array(), -0.4 * np.array([1, -2, 0.5]))
    np.testing.assert_allclose(w.moment.array(), -0.002 * np.array([3.0, 1, -2]))
    lost = 0.4 * (1 + 4 + 0.25) + 0.002 * (9 + 1 + 4)
    assert float(load.dissipation()) == pytest.approx(lost)
    assert float(load.power(now.patella)) == pytest.approx(-lost)


def test_a_patella_moving_rigidly_with_the_medium_has_no_drag():
    spin = vec(0.4, -0.3, 0.2)  # world axes
    still = look((0.1, 0.2, 0.3), orientation=TURN)
    origin, linear = vec(0.05, 0.0, -0.1), vec(0.3, 0.2, 0.1)
    femur = Frame(origin, TURN.rotation(), linear, spin)
    now = eqx.tree_at(
        lambda n: (n.femur, n.patella.velocity, n.patella.spin),
        still,
        (femur, femur.velocity_at(still.patella.position), TURN.unrotate(spin)),
    )
    w = LinearDamping(J(0.4), J(0.002)).load(now, None)[0].total()
    np.testing.assert_allclose([*w.force.array(), *w.moment.array()], 0, atol=1e-16)


def test_a_drag_of_the_ground_has_no_place_where_the_femur_is_held_still():
    segment = knee_motion(4).tibia
    assert LinearDamping(J(0.4), J(0.002), "ground").in_still_femur(segment) is None
    of_femur = LinearDamping(J(0.4), J(0.002), "femur")
    assert of_femur.in_still_femur(segment) is of_femur


def test_no_damping_is_allowed_and_negative_damping_is_not():
    quantities = [d.quantity for d in declarations(LinearDamping(J(0.4), J(0.002)))]
    assert [q.unit for q in quantities] == ["N s/m", "N m s/rad"]
    assert all(q.holds(0.0) and not q.holds(-1e-9) for q in quantities)


def test_in_a_femur_held_still_weight_turns_as_the_femur_would():
    """A femur that turns about y by 2 rad/s: in its axes the weight turns the other way."""
    t = 0.01 * np.arange(31)
    turn = np.stack([np.cos(t), 0 * t, np.sin(t), 0 * t], axis=1)  # half the angle
    femur = knee_motion(31, PoseSeries(t, np.zeros((31, 3)), turn)).femur
    assert femur is not None
    weight = Gravity(J(0.12), vec(0.5, 1.0, -9.81)).in_still_femur(femur)
    angle = 2 * 0.155
    back = np.array([[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]])
    force = weight.load(look((0, 0, 0), time=0.155), None)[0].total().force.array()
    np.testing.assert_allclose(force, 0.12 * back @ [0.5, 1.0, -9.81], rtol=1e-6)
