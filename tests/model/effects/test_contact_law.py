"""Contact laws: closed forms, slopes against automatic differentiation, work against stored energy."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import J

from pftwin.model.effects.contact_law import Flores, Hertz, HuntCrossley

K = J(2e6)
DEPTH, RATE, V0 = J(2e-4), J(0.05), J(0.1)
EXPONENTS = [1, 1.0, 1.5, 2, 2.2, "traced"]


def exponent(p):
    return J(1.5) if p == "traced" else p


def laws(p=1.5):
    p = exponent(p)
    return [
        Hertz(K, hertz_exponent=p),
        HuntCrossley(K, J(0.4), hertz_exponent=p),
        Flores(K, J(0.6), hertz_exponent=p),
    ]


def test_closed_forms():
    hertz, hunt, flores = (law.force(DEPTH, RATE, V0) for law in laws())
    elastic = 2e6 * 2e-4**1.5
    assert float(hertz.total) == pytest.approx(elastic)
    assert float(hunt.total) == pytest.approx(elastic * (1 + 1.5 * 0.4 * 0.05))
    assert float(flores.total) == pytest.approx(elastic * (1 + 8 * 0.4 / (5 * 0.6) * 0.05 / 0.1))
    assert all(float(f.elastic) == pytest.approx(elastic) for f in (hertz, hunt, flores))


@pytest.mark.parametrize("p", EXPONENTS)
def test_slopes_are_the_derivatives(p):
    for law in laws(p):
        for depth, rate in ((2e-4, 0.05), (2e-4, -0.02), (1e-9, 0.05)):
            here = law.force(J(depth), J(rate), V0)
            to_depth, to_rate = jax.grad(lambda d, r, law=law: law.force(d, r, V0).total, (0, 1))(J(depth), J(rate))
            assert float(here.stiffness) == pytest.approx(float(to_depth), rel=1e-12)
            assert float(here.damping) == pytest.approx(float(to_rate), rel=1e-12, abs=1e-300)


@pytest.mark.parametrize("p", EXPONENTS)
def test_stored_energy_is_the_work_of_the_elastic_force(p):
    law = laws(p)[0]
    nodes, weights = np.polynomial.legendre.leggauss(30)
    depth = 0.5e-3 * (nodes + 1)
    work = 0.5e-3 * float(np.sum(weights * np.asarray(law.force(J(depth), J(0 * depth)).elastic)))
    assert float(law.force(J(1e-3), J(0.0)).energy) == pytest.approx(work, rel=1e-5)


@pytest.mark.parametrize("p", EXPONENTS)
def test_without_contact_force_and_gradient_are_zero(p):
    for law in laws(p):
        for depth in (-1e-3, -1e-12):
            answer = law.force(J(depth), RATE, V0)
            assert [float(x) for x in answer] == [0] * 5
            gradient = jax.grad(lambda d, law=law: law.force(d, RATE, V0).total)(J(depth))
            assert float(gradient) == 0
        at_touch = jax.grad(lambda d, law=law: law.force(d, RATE, V0).total)(J(0.0))
        assert np.isfinite(at_touch)


def test_no_law_ever_pulls():
    depth, rate = np.meshgrid(np.linspace(-1e-3, 1e-3, 41), np.linspace(-20, 20, 81))
    for law in laws():
        answer = law.force(J(depth), J(rate), jnp.full(depth.shape, 0.3))
        assert float(jnp.min(answer.total)) == 0
        assert float(jnp.min(answer.stiffness)) >= 0
        assert float(jnp.min(answer.damping)) >= 0


def test_slow_touch_is_held_at_the_floor():
    law = Flores(K, J(0.6), approach_speed_floor=0.02)
    at_floor = law.force(DEPTH, RATE, J(0.02))
    for speed in (0.0, 1e-12, 0.01):
        assert float(law.force(DEPTH, RATE, J(speed)).total) == float(at_floor.total)
    assert float(law.force(DEPTH, RATE, J(0.04)).total) < float(at_floor.total)
    with pytest.raises(TypeError, match="approach speed"):
        law.force(DEPTH, RATE)


def test_restitution_from_nothing_lost_to_nearly_all():
    elastic = Flores(K, J(1.0)).force(DEPTH, RATE, V0)
    assert float(elastic.total) == float(elastic.elastic)
    lossy = Flores(K, J(1e-6)).force(DEPTH, -RATE, V0)
    assert float(lossy.total) == 0  # separates without a push, and without a pull
    assert np.isfinite(float(Flores(K, J(1e-6)).force(DEPTH, RATE, V0).total))


def test_parameters_have_derivatives():
    def force(k, p, e):
        return Flores(k, e, hertz_exponent=p).force(DEPTH, RATE, V0).total

    at = (K, J(1.5), J(0.6))
    for i, g in enumerate(jax.grad(force, (0, 1, 2))(*at)):
        h = 1e-6 * at[i]
        up, down = ([*at[:i], at[i] + s * h, *at[i + 1 :]] for s in (1, -1))
        assert float(g) == pytest.approx(float((force(*up) - force(*down)) / (2 * h)), rel=1e-6)


@pytest.mark.parametrize("p", [1, 1.5, 2])
def test_common_exponents_need_no_transcendental_function(p):
    program = str(jax.make_jaxpr(lambda d: Hertz(K, hertz_exponent=p).force(d, RATE))(DEPTH))
    assert "pow" not in program
    assert ("sqrt" in program) == (p == 1.5)
