"""Elastic layers in series: closed forms, slopes and energies."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pftwin.base.errors import InputError
from pftwin.model.effects.foundation_law import SQUEEZED, LinearFoundation, LogarithmicFoundation, checked_layer

SOFT = checked_layer(46.3e6, 0.46, 5e-3)
DEPTHS = jnp.asarray([1e-9, 1e-5, 1e-4, 1e-3, 3e-3, 5e-3])
K = 46.3e6 * 0.54 / (1.46 * 0.08)


@eqx.filter_jit
def press(law, depth):
    return law.press(depth)


def other(stiffer: float, thickness: float = 2.5e-3):
    return checked_layer(46.3e6 * stiffer, 0.46, thickness)


def test_two_alike_linear_layers_are_half_as_stiff_as_one():
    answer = press(LinearFoundation(SOFT, SOFT), DEPTHS)
    np.testing.assert_allclose(answer.pressure, K / 10e-3 * DEPTHS, rtol=1e-14)
    np.testing.assert_allclose(answer.slope, K / 10e-3, rtol=1e-14)
    np.testing.assert_allclose(answer.energy, 0.5 * K / 10e-3 * DEPTHS**2, rtol=1e-14)


def test_alike_logarithmic_layers_follow_the_closed_form():
    answer = press(LogarithmicFoundation(SOFT, SOFT), DEPTHS)
    np.testing.assert_allclose(answer.pressure, -K * np.log1p(-np.asarray(DEPTHS) / 10e-3), rtol=1e-13)
    np.testing.assert_allclose(answer.slope, K / (10e-3 - np.asarray(DEPTHS)), rtol=1e-13)


@pytest.mark.parametrize("stiffer", [1e-3, 0.2, 3.0, 1e3, 1e5])
def test_two_layers_bear_one_pressure_and_share_the_depth(stiffer):
    law = LogarithmicFoundation(SOFT, other(stiffer))
    total = float(law.thickness())
    d = jnp.concatenate([DEPTHS[:4], SQUEEZED * total * jnp.asarray([0.3, 0.66, 0.7, 0.99])])
    p = np.asarray(press(law, d).pressure)
    back = sum(float(x.thickness) * -np.expm1(-p / float(x.confined_modulus())) for x in (law.femur, law.button))
    np.testing.assert_allclose(back, d, rtol=1e-12)


@pytest.mark.parametrize("law", [LinearFoundation(SOFT, other(3.0)), LogarithmicFoundation(SOFT, other(3.0))])
def test_slope_and_energy_are_derivative_and_integral_of_the_pressure(law):
    d = jnp.concatenate([DEPTHS, jnp.asarray([7.2e-3, 7.6e-3, 9e-3])])  # beyond the bound of 7.125 mm too
    answer = press(law, d)

    @jax.jit
    @jax.vmap
    def slopes(x):
        return jax.grad(lambda x: law.press(x).pressure)(x), jax.grad(lambda x: law.press(x).energy)(x)

    of_pressure, of_energy = slopes(d)
    np.testing.assert_allclose(of_pressure, answer.slope, rtol=1e-12)
    np.testing.assert_allclose(of_energy, answer.pressure, rtol=1e-12)
    assert np.all(np.diff(answer.pressure) > 0)


def test_derivatives_by_parameters_are_those_of_the_implicit_function():
    def pressure(modulus, thickness):
        layer = checked_layer(1.0, 0.3, 1.0)
        layer = type(layer)(modulus, layer.poisson, thickness)
        return LogarithmicFoundation(SOFT, layer).press(jnp.asarray(2e-3)).pressure

    at = jnp.asarray(9e7), jnp.asarray(3e-3)
    value_and_slopes = jax.jit(jax.value_and_grad(pressure, (0, 1)))
    _, found = value_and_slopes(*at)
    for k, step in enumerate((1e3, 1e-8)):
        up, down = (value_and_slopes(*(a + s * step * (i == k) for i, a in enumerate(at)))[0] for s in (1.0, -1.0))
        assert float(found[k]) == pytest.approx(float(up - down) / (2 * step), rel=1e-6)


@pytest.mark.parametrize("law", [LinearFoundation(SOFT, SOFT), LogarithmicFoundation(SOFT, SOFT)])
def test_without_contact_pressure_is_zero_and_gradients_are_finite(law):
    answer = press(law, jnp.asarray([-1.0, -1e-9, 0.0]))
    assert all(np.all(np.asarray(a) == 0) for a in answer)
    assert np.isfinite(jax.jit(jax.grad(lambda x: law.press(x).energy))(jnp.asarray(0.0)))
    assert np.isfinite(press(law, jnp.ones(3)).pressure).all()


@pytest.mark.parametrize("bad", [(0.0, 0.46, 5e-3), (1e6, 0.5, 5e-3), (1e6, -0.1, 5e-3), (1e6, 0.3, float("nan"))])
def test_layers_that_make_no_sense_are_refused(bad):
    with pytest.raises(InputError, match="femur's layer"):
        checked_layer(*bad, where="femur's layer")


def test_unlike_linear_layers_give_way_one_after_the_other():
    """Springs in series: the depths add up at one pressure, so it is the thin and the hard layer that count least."""
    thin = checked_layer(10e6, 0.0, 1e-3)  # K = E without a Poisson ratio
    thick = checked_layer(40e6, 0.0, 8e-3)
    answer = press(LinearFoundation(thin, thick), jnp.asarray([3e-4]))
    pressure = 3e-4 / (1e-3 / 10e6 + 8e-3 / 40e6)  # 1 MPa: 0.1 mm of the one and 0.2 mm of the other
    np.testing.assert_allclose(answer.pressure, [1e6], rtol=1e-12)
    np.testing.assert_allclose(pressure, 1e6, rtol=1e-12)
    np.testing.assert_allclose(answer.slope, [1e6 / 3e-4], rtol=1e-12)
    np.testing.assert_allclose(answer.energy, [0.5 * 1e6 * 3e-4], rtol=1e-12)
    np.testing.assert_allclose(thick.confined_modulus(), 40e6, rtol=1e-14)


def test_unlike_logarithmic_layers_store_what_each_of_them_does():
    """At a pressure p a layer stores the integral of p over its depth, here by quadrature."""
    one, two = checked_layer(10e6, 0.0, 1e-3), checked_layer(40e6, 0.0, 8e-3)
    p = 6e6
    depth = sum(h * -np.expm1(-p / k) for k, h in ((10e6, 1e-3), (40e6, 8e-3)))
    answer = press(LogarithmicFoundation(one, two), jnp.asarray([depth]))
    stored = 0.0
    for k, h in ((10e6, 1e-3), (40e6, 8e-3)):
        end = h * -np.expm1(-p / k)
        nodes, weights = np.polynomial.legendre.leggauss(40)
        d = 0.5 * end * (nodes + 1)
        stored += 0.5 * end * (weights @ (-k * np.log1p(-d / h)))
    np.testing.assert_allclose(answer.pressure, [p], rtol=1e-10)
    np.testing.assert_allclose(answer.energy, [stored], rtol=1e-10)
