"""Tensions by the knee's flexion: pulls by hand, hat functions, finite differences, batches, and their work."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import J, look
from small_scene import hanging_scene

import pftwin
from pftwin.base.errors import InputError
from pftwin.base.leaves import number, vector
from pftwin.base.rotations import tibiofemoral_orientation
from pftwin.base.spatial import Vec3
from pftwin.model.effects.base import Instant
from pftwin.model.effects.line_elements import line_of_force
from pftwin.model.effects.tension import PrescribedTension
from pftwin.model.motion import Frame
from pftwin.model.scene import Scene

KNOTS, TENSIONS, SHARES = (0.0, 30.0, 50.0), (10.0, 40.0, 20.0), (0.25, 0.75)  # [deg], [N], [1]
angle = st.floats(-1.3, 1.3)


def muscle(tensions: Any = TENSIONS, knots: tuple[float, ...] = KNOTS, name: str = "muscle") -> PrescribedTension:
    """A quarter of the tension straight up along z, three quarters along x, both at the patella's origin."""
    return PrescribedTension(
        number(tensions),
        vector([[(0.0, 0.0, 0.1), (0.2, 0.0, 0.0)]]),
        vector(np.zeros((2, 3))),
        start_time=0.0,
        interval=1.0,
        body="femur",
        knots=tuple(map(math.radians, knots)),
        share=number(SHARES),
        name=name,
    )


def bent(flexion: Any, adduction: Any = 0.2, rotation: Any = -0.1, femur: Any = None) -> Instant:
    """The patella at the femur's origin, and a tibia at these angles [rad] in the femur, turned by `femur` if any."""
    now, tibia = look(), tibiofemoral_orientation(*(J(a) for a in (flexion, adduction, rotation)))
    frames = Frame.world()
    if femur is None:
        return eqx.tree_at(lambda n: n.tibia.rotation, now, tibia.rotation())
    moved = eqx.tree_at(lambda f: f.rotation, frames, femur.rotation())
    at = eqx.tree_at(lambda f: f.rotation, frames, (femur * tibia).rotation())
    return Instant(now.patella, moved, at, J(0.0), 0.0)


@settings(deadline=None, max_examples=50)
@given(*[angle] * 6)
def test_the_knees_flexion_is_the_first_of_its_angles_whatever_the_femurs_pose(a, b, c, d, e, f):
    """By the definition of the angles, of which the tibia is made here."""
    assert float(bent(a, b, c).knee_flexion()) == pytest.approx(a, abs=1e-12)
    turned = bent(a, b, c, tibiofemoral_orientation(J(d), J(e), J(f)))
    assert float(turned.knee_flexion()) == pytest.approx(a, abs=1e-12)


@pytest.mark.parametrize(
    ("flexion", "total"), [(-20, 10), (0, 10), (12, 22), (30, 40), (45, 25), (50, 20), (51, 20), (170, 20)]
)
def test_the_pull_at_a_flexion(flexion, total):
    """By hand: 1 N/deg up to 30 deg, then -1 N/deg; constant beyond the knots."""
    now = bent(np.radians(flexion))
    w = muscle().load(now, None)[0].total()
    np.testing.assert_allclose(w.force.array(), [0.75 * total, 0, 0.25 * total], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(w.moment.array(), 0, atol=1e-12)
    assert float(muscle().observe(now, None)["tension"]) == pytest.approx(total, rel=1e-12)


@st.composite
def knots_and_flexion(draw: Any) -> tuple[list[float], list[float], float]:
    steps = draw(st.lists(st.floats(0.5, 40), min_size=1, max_size=5))
    knots = draw(st.floats(-20, 20)) + np.cumsum([0.0, *steps])
    tensions = draw(st.lists(st.floats(0, 500), min_size=len(knots), max_size=len(knots)))
    return knots.tolist(), tensions, draw(st.floats(-60, 170))


@settings(deadline=None, max_examples=30)
@given(knots_and_flexion())
def test_the_derivative_by_a_knot_is_its_hat_function(drawn):
    """1 at its knot and 0 at the others: `np.interp` of unit vectors. Forward and reverse mode agree with it."""
    knots, tensions, flexion = drawn
    now = bent(np.radians(flexion))

    def total(values: jax.Array) -> jax.Array:
        return eqx.tree_at(lambda m: m.tension, muscle(tensions, tuple(knots)), values).observe(now, None)["tension"]

    hats = [np.interp(flexion, knots, unit) for unit in np.eye(len(knots))]
    assert sum(hats) == pytest.approx(1)
    assert float(total(J(np.asarray(tensions)))) == pytest.approx(np.dot(hats, tensions), rel=1e-9, abs=1e-9)
    for mode in (jax.jacfwd, jax.jacrev):
        np.testing.assert_allclose(mode(total)(J(np.asarray(tensions))), hats, atol=1e-9)


def test_it_never_pushes_where_no_knot_does():
    found = [float(muscle((0.0, 30.0, 0.0)).tensions(bent(np.radians(a))).min()) for a in np.linspace(-5, 60, 27)]
    assert min(found) == 0
    assert max(found) > 5


def test_the_slope_by_flexion_is_that_of_the_piece():
    def total(flexion: Any) -> Any:
        return muscle().observe(bent(flexion), None)["tension"]

    for flexion, slope in ((-3.0, 0.0), (12.0, 1.0), (45.0, -1.0), (60.0, 0.0)):
        for mode in (jax.jacfwd, jax.jacrev):
            assert float(mode(total)(J(np.radians(flexion)))) == pytest.approx(np.degrees(slope), abs=1e-9)


def test_which_lines_can_pull():
    assert muscle().pulls().tolist() == [True, True]
    assert muscle((0.0, 0.0, 0.0)).pulls().tolist() == [False, False]
    one = eqx.tree_at(lambda m: m.share, muscle(), J(np.array([0.0, 1.0])))
    assert one.pulls().tolist() == [False, True]


@pytest.mark.parametrize(
    ("knots", "tensions", "said"),
    [
        ((10.0,), (5.0,), "tensions at flexions of 10 deg; expected: at least two"),
        ((10.0, 10.0), (5.0, 6.0), "flexions of 10, 10 deg"),
        ((10.0, 5.0), (5.0, 6.0), "each larger than the one before"),
        ((10.0, float("nan")), (5.0, 6.0), "10, nan deg"),
        ((10.0, float("inf")), (5.0, 6.0), "10, inf deg"),
        ((10.0, 20.0), (5.0, 6.0, 7.0), "3 tensions at 2 flexions"),
    ],
)
def test_knots_that_make_no_function_are_refused(knots, tensions, said):
    with pytest.raises(InputError, match=said):
        muscle(tensions, knots)


def test_shares_belong_to_knots():
    lines = J(np.ones((1, 2))), vector(np.ones((1, 2, 3))), vector(np.zeros((2, 3))), 0.0, 1.0, "femur"
    for how in ({"share": J(np.ones(2))}, {"knots": (0.0, 1.0)}):
        with pytest.raises(InputError, match="knots or shares alone"):
            PrescribedTension(*lines, **how, name="muscle")  # type: ignore[arg-type]


def test_tensions_over_time_pay_nothing_for_it():
    """Two samples of a series each, and the wrench along the lines: no more, and nothing of the knee's flexion."""
    constant = PrescribedTension(
        J(np.array([[10.0, 20.0]])), muscle().origin, muscle().insertion, 0.0, 1.0, "femur", name="muscle"
    )

    def sampled(series: Any, time: Any) -> Any:
        whole = jnp.clip(jnp.floor((time - 0.0) / 1.0), 0.0, 0.0)
        first, part = jnp.asarray(whole, int), jnp.clip((time - 0.0) / 1.0 - whole, 0.0, 1.0)
        return jax.tree.map(lambda a: a[first] + part * (a[jnp.minimum(first + 1, 0)] - a[first]), series)

    def needed(effect: PrescribedTension, now: Instant) -> Any:
        tension, origin = sampled(effect.tension, now.time), sampled(effect.origin, now.time)
        zero = jnp.zeros_like(tension)
        return line_of_force(now, effect.insertion, "femur", origin).term(tension, tension, zero, zero).wrench()

    def loaded(effect: PrescribedTension, now: Instant) -> Any:
        return effect.load(now, None)[0].wrench

    def program(function: Any, effect: PrescribedTension) -> str:
        arrays, rest = eqx.partition((effect, bent(0.3)), eqx.is_array)
        return str(jax.make_jaxpr(lambda a: function(*eqx.combine(a, rest)))(arrays))

    assert program(loaded, constant).count(" = ") <= program(needed, constant).count(" = ")
    assert "atan2" not in program(loaded, constant)
    assert "atan2" in program(loaded, muscle())


# In motion: the patella is held by strands from the femur, and the knee bends from 45 to 55 deg and back.
MOTIONS_KNOTS = (46.0, 50.0, 54.0)  # [deg]
IN_MOTION = {"quadriceps.tension[0]": 3.0, "quadriceps.tension[1]": 0.5, "quadriceps.tension[2]": 4.0}


@cache
def pulled() -> Scene:
    """The fixed femur's strands and a muscle whose knots lie in the motion; nothing from the tibia, which does work."""
    scene = hanging_scene(41).without("patellar_tendon").without("quadriceps")
    line = PrescribedTension(
        number(tuple(IN_MOTION.values())),
        vector([[(0.22, 0.006, 0.035), (0.2, -0.01, 0.04)]]),
        vector([(0.02, 0.0, -0.008), (0.02, 0.004, -0.008)]),
        start_time=0.0,
        interval=1.0,
        body="femur",
        knots=tuple(map(math.radians, MOTIONS_KNOTS)),
        share=number((0.4, 0.6)),
        name="quadriceps",
    )
    return scene.with_effect(line)


@eqx.filter_jit
def path(scene: Scene) -> pftwin.Trajectory:
    return pftwin.trajectory(scene, integrator=pftwin.BDF2(), dt=1e-3, energy_budget=True)


def at(values: Any) -> Scene:
    return eqx.tree_at(lambda s: s.effect("quadriceps").tension, pulled(), values)


START = np.array(list(IN_MOTION.values()))


def test_the_tension_in_a_motion_is_that_of_each_frames_flexion():
    found = path(pulled())
    flexion = np.degrees(found.knee.flexion)
    assert (flexion.min(), flexion.max()) == (pytest.approx(45, abs=0.1), pytest.approx(55, abs=0.1))
    expected = np.interp(flexion, MOTIONS_KNOTS, START)
    np.testing.assert_allclose(found.tensions["quadriceps"], expected, rtol=1e-9)


def test_its_work_is_that_of_its_pull_along_its_lines():
    """- sum of T dL, as the lines' femur is still: by the trapezoidal rule between frames; and the account closes."""
    found, line = path(pulled()), pulled().effect("quadriceps")
    ends = [np.asarray(a.array()) for a in (line.insertion, jax.tree.map(lambda a: a[0], line.origin))]
    q = found.patella.orientation
    turned = np.stack([np.asarray(q.rotate(Vec3.from_array(e)).array()) for e in ends[0]], axis=1)
    there = np.asarray(found.position.array())[:, None] + turned
    lengths = np.linalg.norm(ends[1] - there, axis=2) @ np.array([0.4, 0.6])
    tension = np.asarray(found.tensions["quadriceps"])
    work = np.concatenate([[0.0], np.cumsum(-0.5 * (tension[1:] + tension[:-1]) * np.diff(lengths))])
    assert np.abs(work).max() > 1e-3
    np.testing.assert_allclose(found.work, work, atol=0.06 * np.abs(work).max())
    energy = np.asarray(sum(found.stored_energy.values(), start=found.kinetic_energy))
    assert found.stored_energy.get("quadriceps") is None
    gap = energy - energy[0] - found.work + found.heat + found.numerical_dissipation
    assert np.abs(gap).max() < 2e-3 * np.abs(work).max()


@pytest.mark.slow
def test_motions_derivatives_are_those_of_finite_differences():
    def heights(values: Any) -> Any:
        return jnp.sum(path(at(values)).center.x)

    forward, reverse = (np.asarray(mode(heights)(J(START))) for mode in (jax.jacfwd, jax.jacrev))
    step = 1e-4
    apart = [(heights(J(START + step * e)) - heights(J(START - step * e))) / (2 * step) for e in np.eye(3)]
    assert np.abs(apart).min() > 1e-4
    np.testing.assert_allclose(forward, apart, rtol=1e-5)
    np.testing.assert_allclose(reverse, forward, rtol=1e-8)


def test_a_batch_of_knots_is_each_of_them():
    many = J(START * np.array([[1.0, 1.0, 1.0], [2.0, 1.0, 0.5]]))
    together = jax.vmap(lambda v: path(at(v)).center.array())(many)
    for values, one in zip(many, together, strict=True):
        np.testing.assert_allclose(one, path(at(values)).center.array(), atol=1e-12)
    assert np.abs(together[0] - together[1]).max() > 1e-4


def test_each_knot_is_a_parameter_by_name():
    scene = pulled()
    assert {name: float(scene.get(name)) for name in IN_MOTION} == IN_MOTION
    assert float(scene.get("quadriceps.tension[:]")) == pytest.approx(2.5)
    twice = scene.set("quadriceps.tension[:]", 5.0)
    np.testing.assert_allclose(twice.get("quadriceps.tension"), [6.0, 1.0, 8.0])
    assert float(twice.set("quadriceps.tension[1]", 7.0).get("quadriceps.tension[1]")) == 7.0
    with pytest.raises(InputError, match="expected: zero or a positive number"):
        pftwin.simulate(scene.set("quadriceps.tension[1]", -1.0))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"share": number((1.0,))}, r"shares of shape \(1,\).*one for each line, \(2,\)"),
        ({"share": number(0.5)}, r"shares of shape \(\)"),
        ({"tension": number([TENSIONS])}, r"an array of shape \(1, 3\) of tensions at 3 flexions"),
        ({"knots": (0.0, 0.5, 3.2)}, "from -180 to 180 deg"),
    ],
)
def test_what_would_multiply_a_force_is_refused(change, words):
    right = muscle()
    given = {n: getattr(right, n) for n in ("tension", "origin", "insertion", "knots", "share", "name")} | change
    with pytest.raises(InputError, match=words):
        PrescribedTension(**given, start_time=0.0, interval=1.0, body="femur")


def test_tension_and_origin_are_sampled_each_by_its_own_length():
    """Three tensions over time, from an origin that does not move."""
    over_time = PrescribedTension(
        number([[10.0], [20.0], [30.0]]),
        vector([[(0.0, 0.0, 0.1)]]),
        vector(np.zeros((1, 3))),
        start_time=0.0,
        interval=1.0,
        body="femur",
        name="muscle",
    )
    times = {0.0: 10.0, 0.5: 15.0, 1.5: 25.0, 2.5: 30.0}
    assert {t: float(over_time.at(J(t))[0][0]) for t in times} == times
    assert float(over_time.at(J(1.5))[1].z[0]) == 0.1
    with pytest.raises(InputError, match="a tension by flexion has no value at a time"):
        muscle().at(0.0)
