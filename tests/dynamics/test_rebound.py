"""What is said of restitution: the law's by an independent integration, the steps' by a drop on the real contact."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import MASS, RADIUS, G, J, contact, gravity, knee, knee_motion, order_of, record, state_at, system
from scipy.integrate import solve_ivp

import pftwin
from pftwin.dynamics.integrators import BDF2, Diffrax, LinearImplicit, Newmark
from pftwin.dynamics.quasi_static.step import QuasiStatic
from pftwin.dynamics.rebound import Impact, impact_of, impact_time, rebound_in_steps, rebound_of_law
from pftwin.files.mocap.poses import PoseSeries
from pftwin.model.effects.contact_law import Flores, Hertz, HuntCrossley

K = 2e8
HALF = Flores(J(K), J(0.5))
HEIGHT = 0.003  # [m]
FALLEN = float(np.sqrt(2 * G * HEIGHT))  # [m/s]


def by_radau(law, mass: float, speed: float) -> float:
    """The rebound of m d'' = -k d^p (1 + x d'), written by hand and integrated to 1e-10."""
    x = {
        Hertz: lambda: 0.0,
        HuntCrossley: lambda: 1.5 * float(law.dissipation),
        Flores: lambda: 8 * (1 - float(law.restitution)) / (5 * float(law.restitution) * max(speed, 0.01)),
    }[type(law)]()
    k, p = float(law.contact_stiffness), float(law.hertz_exponent)

    def rhs(_, y):
        return [y[1], -k / mass * max(y[0], 0.0) ** p * max(1 + x * y[1], 0.0)]

    def apart(t, y):
        return y[0] if t > 1e-7 else 1.0

    apart.terminal, apart.direction = True, -1  # type: ignore[attr-defined]
    out = solve_ivp(rhs, (0, 1), [0.0, speed], "Radau", events=apart, rtol=1e-10, atol=1e-13, first_step=1e-8)
    return -out.y[1, -1] / speed


@pytest.mark.parametrize(
    ("law", "speed"),
    [
        (Hertz(J(K)), 0.2),
        (HuntCrossley(J(K), J(0.7)), 0.3),
        (Flores(J(K), J(0.1)), 0.2),
        (Flores(J(1e6), J(0.5), hertz_exponent=1), 0.2),
        (Flores(J(K), J(0.5)), 0.004),  # below the floor
        (Flores(J(K), J(0.9), hertz_exponent=2), 0.05),
    ],
    ids=str,
)
def test_the_laws_rebound_in_closed_form(law, speed):
    assert rebound_of_law(law, speed) == pytest.approx(by_radau(law, MASS, speed), abs=1e-5)


def test_a_law_that_returns_nothing_is_no_error():
    assert 0 < rebound_of_law(Flores(J(K), J(1e-3)), 0.2) < 1e-2


def test_how_long_an_impact_lasts():
    """2.9432 d / v with d = (5 m v^2 / 4 k)^(2/5) (Johnson 1985, section 11.4); of a spring half a period."""
    deepest = (5 * MASS * 0.2**2 / (4 * K)) ** 0.4
    assert impact_time(HALF, MASS, 0.2) == pytest.approx(2.9432 * deepest / 0.2, rel=0.02)
    spring = Hertz(J(1e6), hertz_exponent=1)
    assert impact_time(spring, MASS, 0.2) == pytest.approx(np.pi * np.sqrt(MASS / 1e6), rel=0.05)


def drops(step: float, integrator, law=HALF) -> np.ndarray:
    """Speed after the first impact over that before, of a weight dropped by about 3 mm, over the places in a step."""
    sys = system(gravity(), contact(law))
    more = FALLEN * step * (np.arange(8) + 0.5) / 8  # it falls so far within parts of a step
    waited = np.sqrt(2 * HEIGHT / G) + 1.5e-3 + 2 * step

    @eqx.filter_jit
    def rebounds(heights):
        start = state_at(sys, (0, 0, 0))

        def one(z):
            states, ledger = record(sys, eqx.tree_at(lambda s: s.position.z, start, z), J(step), count, integrator)
            return states.velocity.z, states.position.z, ledger.approach[-1]

        return jax.vmap(one)(heights)

    count = int(np.ceil((waited + 2e-3) / step))
    velocity, place, approach = (np.asarray(a) for a in rebounds(jnp.asarray(RADIUS + HEIGHT + more)))
    assert approach == pytest.approx(np.sqrt(2 * G * (HEIGHT + more)), abs=2 * G * step)
    touched = np.cumsum(place < RADIUS, axis=1) > 0
    up = np.where(touched, velocity, -np.inf).max(axis=1)  # gravity slows it down from then on
    return up / FALLEN


@pytest.mark.slow
@pytest.mark.parametrize("integrator", [LinearImplicit(), BDF2()], ids=lambda i: i.text)
def test_a_drop_on_the_real_contact_rebounds_as_is_said(integrator):
    """In steps that are longer than the impact, of its length and short against it; and in the last as by the law."""
    due = by_radau(HALF, MASS, FALLEN)
    # In the drop weight acts during the impact as well: 9 mm/s within 0.9 ms, up to 4 % of 0.24 m/s.
    for step, off in ((1e-3, 0.04), (2.5e-4, 0.02), (1e-5, 0.02)):
        said = rebound_in_steps(HALF, MASS, FALLEN, step, integrator)
        found = drops(step, integrator)
        assert found.mean() == pytest.approx(said.mean(), abs=off)
        if step == 1e-5:
            assert found.mean() == pytest.approx(due, abs=0.04)
        if step == 1e-3:
            assert found.max() < 0.2 < due - 0.2


@pytest.mark.slow
def test_a_solver_of_diffrax_tells_the_approach_too():
    """Steps of a quarter of the impact: its memory of the approach is set at their ends, so they rebound short too."""
    found = drops(2.5e-4, Diffrax("Tsit5"))  # looks at the approach's speed
    assert found.mean() == pytest.approx(
        rebound_in_steps(HALF, MASS, FALLEN, 2.5e-4, Diffrax("Tsit5")).mean(), abs=0.04
    )


@pytest.mark.parametrize("integrator", [LinearImplicit(), BDF2(), Newmark()], ids=lambda i: i.text)
def test_short_steps_rebound_as_the_law_does(integrator):
    due = by_radau(HALF, MASS, 0.2)
    errors = [abs(rebound_in_steps(HALF, MASS, 0.2, h, integrator).mean() - due) for h in (2e-5, 1e-5, 5e-6)]
    assert errors[-1] < 0.02
    assert np.all(order_of(errors) > 0.7) or errors[0] < 1e-3


def test_an_impact_is_remarked_where_the_steps_miss_the_laws_rebound():
    lost, made = (Impact(0.24, 0.01, 0.47, steps, 1e-3) for steps in (0.06, 0.9))
    assert lost.unresolved
    assert made.unresolved  # more than the law returns is as wrong
    assert lost.describe() == "contacts close at up to 0.24 m/s, of which the law returns 0.47 and steps of 1 ms 0.06"
    assert not Impact(0.24, 0.01, 0.47, 0.44, 1e-5).unresolved
    slow = Impact(0.005, 0.01, 0.8, 0.8, 1e-3)
    assert not slow.unresolved
    assert slow.describe() == "contacts close at 0.005 m/s at most, too slow for it to act (below 0.01 m/s)"


def test_nothing_is_said_where_there_is_nothing_to_say():
    scene = knee()
    assert impact_of(scene.without("contact"), BDF2(), 1e-3, 0.2) is None
    assert impact_of(scene, QuasiStatic(), 1e-3, 0.2) is None
    assert impact_of(scene, BDF2(), 1e-3, 0.0) is None
    assert impact_of(scene, BDF2(), 1e-3, float("nan")) is None


@pytest.mark.slow
def test_a_result_says_what_its_steps_make_of_restitution():
    """A knee at rest, whose femur then moves away by 5 mm and comes back within 40 ms: the patella hits it."""
    calm = pftwin.simulate(knee(11), dt=1e-3)
    assert calm.impact is not None
    assert 0 < calm.impact.speed < calm.impact.slow == 0.01
    assert "restitution" not in calm.summary()
    times = np.arange(11) * 0.01
    back = np.zeros((11, 3))
    back[3:6, 2] = -0.0025, -0.005, -0.0025
    femur = PoseSeries(times, back, np.tile([1.0, 0, 0, 0], (11, 1)))
    hit = pftwin.simulate(replace(knee(11), motion=knee_motion(11, femur)), dt=1e-3)
    assert hit.impact is not None
    assert 0.05 < hit.impact.speed < 1.0
    assert hit.impact.unresolved
    assert f"remark: restitution: {hit.impact.describe()}" in hit.summary()
