r"""Velocities and accelerations projected on the constraints: the nearest, in a metric W, that fulfil them.

    (W + s J^T J) x = W x* + J^T (s b - sigma),      sigma <- sigma + s (J x - b),

iterated to rounding: each turn leaves the share |W| / s of what the constraints J x = b still miss. With W = M + gamma
h C + beta h^2 K and s = beta h^2 alpha the matrix is that of the step's own Newton iteration. Source: Bayo & Ledesma
1996, Nonlinear Dyn 9:113; Cuadrado et al. 1997, Mech Mach Theory 32:187; with multipliers: Dopico et al. 2014, J Comput
Nonlinear Dyn 9:041006.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax.scipy.linalg import cho_factor, cho_solve
from jaxtyping import Array

TURNS = 4


def with_penalty(metric: Array, jacobian: Array, scale: Array) -> Array:
    """W + s J^T J for each body (n, 12, 12)."""
    return metric + scale * jnp.einsum("nki,nkj->nij", jacobian, jacobian)


def solved(matrix: Array, right: Array) -> Array:
    """x with matrix x = right, for each body: (n, 12, 12), (n, 12)."""
    return cho_solve((cho_factor(matrix, lower=True)[0], True), right[..., None])[..., 0]


@partial(jax.custom_jvp)
def constrained(metric: Array, jacobian: Array, scale: Array, right: Array, wanted: Array) -> tuple[Array, Array]:
    """x and multipliers sigma with W x + J^T sigma = right and J x = wanted, for each body.

    Args:
        metric: W (n, 12, 12), symmetric, positive definite where J vanishes.
        jacobian: J (n, 12, 12); rows may be zero.
        scale: s; it changes how fast this converges and nothing else.
        right, wanted: (n, 12).
    """
    factor = cho_factor(with_penalty(metric, jacobian, scale), lower=True)[0]
    sigma = jnp.zeros_like(wanted)
    x = jnp.zeros_like(right)
    for _ in range(TURNS):
        push = jnp.einsum("nki,nk->ni", jacobian, scale * wanted - sigma)
        x = cho_solve((factor, True), (right + push)[..., None])[..., 0]
        sigma = sigma + scale * (jnp.einsum("nki,ni->nk", jacobian, x) - wanted)
    return x, sigma


@constrained.defjvp
def _constrained_jvp(primals: Any, tangents: Any) -> tuple[Any, Any]:
    """Both equations, differentiated at their solution, are the same ones with other right-hand sides."""
    metric, jacobian, scale, _, _ = primals
    d_metric, d_jacobian, _, d_right, d_wanted = tangents
    x, sigma = constrained(*primals)
    right = d_right - jnp.einsum("nij,nj->ni", d_metric, x) - jnp.einsum("nki,nk->ni", d_jacobian, sigma)
    wanted = d_wanted - jnp.einsum("nki,ni->nk", d_jacobian, x)
    return (x, sigma), constrained(metric, jacobian, scale, right, wanted)
