"""Programs in WebAssembly against JAX's compiled ones, on random numbers; in local variables and in memory."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from twin_in_node import computed

from fitting.cli.twin.emitter import Emitter
from pftwin.base.errors import InputError

RNG = np.random.default_rng(7)
SIZES = (5, 150)  # below and above what is kept in local variables


def numbers(*shape: int) -> jax.Array:
    return jnp.asarray(RNG.normal(size=shape))


def same(folder, function, *arguments, rtol=1e-14):
    expected = jax.tree.leaves(jax.jit(function)(*arguments))
    for found, wanted in zip(computed(folder, function, *arguments), expected, strict=True):
        np.testing.assert_allclose(found, np.asarray(wanted, float).reshape(-1), rtol=rtol, atol=1e-14)


@pytest.mark.parametrize("n", SIZES)
def test_operations_on_numbers(tmp_path, n):
    def function(x, y, k):
        p = jnp.abs(x) + 0.1
        real = [x + y, x - y, x * y, x / y, -x, jnp.abs(x), jnp.sqrt(p), x**2, x**3, x**-5, jnp.square(x), jnp.sign(x)]
        real += [
            jnp.maximum(x, y),
            jnp.minimum(x, y),
            jnp.clip(x, -0.5, 0.5),
            jnp.floor(x),
            jnp.ceil(x),
            1 / jnp.sqrt(p),
        ]
        real += [jax.lax.rsqrt(p), jnp.where(x > y, x, y), jax.lax.stop_gradient(x) - 0.0, 1.0 * x]
        real += [jnp.sin(x), jnp.cos(x), jnp.tan(x), jnp.arctan2(x, y), jnp.exp(x), jnp.log(p), jnp.tanh(x), p**y]
        truth = [
            x < y,
            x <= y,
            x > y,
            x >= y,
            x == y,
            x != y,
            jnp.isfinite(x),
            ~(x < y),
            (x < y) & (x > 0),
            (x < y) | (x > 0),
        ]
        whole = [
            k + 3,
            k - 3,
            k * k,
            -k,
            jnp.abs(k),
            jnp.maximum(k, 2),
            jnp.minimum(k, 2),
            k & 5,
            k | 5,
            ~k,
            k.astype(float) * x,
        ]
        return real, truth, whole, x.astype(int), k > 1, k.astype(bool)

    same(tmp_path, function, numbers(n), numbers(n), jnp.asarray(RNG.integers(-9, 9, n)), rtol=1e-13)


def test_numbers_that_are_none(tmp_path):
    def function(x):
        y = x[::-1]
        return jnp.maximum(x, y), jnp.minimum(x, y), jnp.isfinite(x), x < y, x == x, jnp.where(x > 0, x, y), jnp.sign(x)

    same(tmp_path, function, jnp.array([np.nan, 1.0, -2.0, np.nan, 0.5]))


@pytest.mark.parametrize("n", SIZES)
def test_places_in_arrays(tmp_path, n):
    def function(x, y):
        joined = jnp.concatenate([x, y], axis=1), jnp.stack([x, y], axis=1), jnp.stack([x[:, 0], y[:, 1]])
        parts = x[1:-1, 1:], x[::2, :1], x[2], x[:, 2], x[None], x.T, x.reshape(-1), x.T.reshape(3, -1), jnp.flip(x, 0)
        spread = jnp.broadcast_to(x[:, :1], x.shape), jnp.broadcast_to(x[0, 0], (n, 2)), jnp.full((n,), 2.0) * x[0, 1]
        return joined, parts, spread

    same(tmp_path, function, numbers(n, 3), numbers(n, 3))


@pytest.mark.parametrize("n", SIZES)
def test_sums_and_extremes(tmp_path, n):
    def function(x):
        sums = x.sum(), x.sum(axis=0), x.sum(axis=1), x.max(), x.min(axis=0), x.max(axis=1), x.prod(axis=1)
        running = [f(x[:, 1]) for f in (jax.lax.cummax, jax.lax.cummin, jax.lax.cumsum)]
        return sums, running, (x > 0).any(), (x > -9).all(axis=1)

    same(tmp_path, function, numbers(n, 3), rtol=1e-12)


@pytest.mark.parametrize("n", SIZES)
def test_loops(tmp_path, n):
    table = numbers(n, 2)

    def function(x, rows, k, start):
        def step(carry, row):
            total, i = carry
            total = total * 0.9 + row * table[jnp.minimum(i, n - 1), 1]
            return (total, i + 1), (total.sum(), row[::-1])

        forward = jax.lax.scan(step, (x, jnp.asarray(0)), rows)
        back = jax.lax.scan(step, (x, jnp.asarray(1)), rows, reverse=True)
        halved = jax.lax.while_loop(
            lambda s: jnp.abs(s[0]) > 1e-3, lambda s: (s[0] * 0.5, s[1] + 1), (start, jnp.asarray(0))
        )
        counted = jax.lax.fori_loop(0, k, lambda i, v: jax.lax.fori_loop(0, 3, lambda j, w: w + i * x.sum(), v), start)
        beyond = jax.lax.dynamic_slice(rows, (k + 1000, 0), (2, 2)), rows[k], rows[-k]
        return forward, back, halved, counted, beyond

    same(tmp_path, function, numbers(2), numbers(n, 2), jnp.asarray(3), jnp.asarray(2.5), rtol=1e-12)


def test_what_depends_on_no_input_is_computed_beforehand(tmp_path):
    table = numbers(200)
    same(tmp_path, lambda x: x * jnp.sort(table)[3] + jnp.linalg.norm(table), jnp.asarray(1.5))


def test_an_operation_that_cannot_be_written_is_named():
    with pytest.raises(InputError, match=r"'sort'.*polynomial surfaces"):
        Emitter().program("run", jnp.sort, numbers(5))


def test_numbers_in_single_precision_are_refused():
    with pytest.raises(InputError, match="float32"):
        Emitter().program("run", lambda x: x, jnp.zeros(3, jnp.float32))
