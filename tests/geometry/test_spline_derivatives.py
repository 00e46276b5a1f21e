"""Derivatives of a Newton step on a spline, whose third derivatives jump: those of the step, from cell to cell."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scenes import RADIUS, plane_chart

from pftwin.base.spatial import Vec3
from pftwin.geometry.patch.closest import newton_step
from pftwin.geometry.patch.spline import SplinePatch

J = jnp.asarray
LONGEST = 0.12 * RADIUS
HALF = np.array([0.024, 0.020])  # [m]
CELLS = 2 * HALF / (5, 7)
H = 1e-6


def bumpy() -> SplinePatch:
    c = 1e-3 * np.random.default_rng(3).normal(size=(8, 10))
    return SplinePatch(plane_chart(), J(c), (J(0.0), J(0.0)), (J(HALF[0]), J(HALF[1])))


@eqx.filter_jit
def stepped(start: jax.Array, raised: jax.Array) -> jax.Array:
    """Distance [mm] and place [m] after a step, by its start and the centre's height (mm) and a share of all bumps."""
    surface = bumpy()
    surface = eqx.tree_at(lambda s: s.coefficients, surface, surface.coefficients * (1 + raised[1])).unstacked()
    c = Vec3(J(0.001), J(0.0005), J(0.01) + 1e-3 * raised[0])
    p = newton_step(surface, c, 1e-3 * start[0], 1e-3 * start[1], J(LONGEST))
    return jnp.stack([1e3 * p.distance, p.u, p.v])


def cell(place: np.ndarray) -> tuple[float, float]:
    return tuple(np.floor((place + HALF) / CELLS))


def test_a_step_to_another_cell_has_its_own_derivative():
    found = jax.jit(jax.jacfwd(stepped, argnums=(0, 1)))
    crossed = 0
    for start in np.random.default_rng(4).uniform(-15, 15, (60, 2)):
        at, none = J(start), jnp.zeros(2)
        by_start, by_rest = (np.asarray(a)[0] for a in found(at, none))
        for k, e in enumerate(J(H * np.eye(2))):
            d_start = (stepped(at + e, none) - stepped(at - e, none))[0] / (2 * H)
            d_rest = (stepped(at, none + e) - stepped(at, none - e))[0] / (2 * H)
            np.testing.assert_allclose(by_start[k], d_start, atol=1e-7)
            np.testing.assert_allclose(by_rest[k], d_rest, atol=1e-7)
        crossed += cell(1e-3 * start) != cell(np.asarray(stepped(at, none))[1:])
    assert crossed > 15
