"""The angle of a complex number, in lanes: XLA's own atan2 calls the C library for one number at a time on a CPU."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp

from pftwin.base.spatial import Scalar

# atan(x) = x + x^3 P(x^2) / Q(x^2) for |x| < 0.66, of the Cephes library (S. L. Moshier 1989), below 2e-16 relative.
_P = (
    -8.750608600031904122785e-1,
    -1.615753718733365076637e1,
    -7.500855792314704667340e1,
    -1.228866684490136173410e2,
    -6.485021904942025371773e1,
)
_Q = (
    1.0,
    2.485846490142306297962e1,
    1.650270098316988542046e2,
    4.328810604912902668951e2,
    4.853903996359136964868e2,
    1.945506571482613964425e2,
)
_EIGHTH = math.tan(math.pi / 8)


@jax.custom_jvp
def angle(real: Scalar, imaginary: Scalar) -> Scalar:
    """In (-pi, pi]; 0 for zero, with derivative 0 there."""
    x, y = jnp.abs(real), jnp.abs(imaginary)
    low, high = jnp.minimum(x, y), jnp.maximum(x, y)
    far = low > _EIGHTH * high
    below = jnp.where(far, low + high, high)
    t = jnp.where(far, low - high, low) / jnp.where(below > 0, below, 1.0)
    z = t * t
    a = t + t * z * (_horner(_P, z) / _horner(_Q, z)) + jnp.where(far, math.pi / 4, 0.0)
    a = jnp.where(y > x, math.pi / 2 - a, a)
    a = jnp.where(real < 0, math.pi - a, a)
    return jnp.where(imaginary < 0, -a, a)


@angle.defjvp
def _angle_jvp(primals: tuple[Scalar, Scalar], tangents: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
    (x, y), (dx, dy) = primals, tangents
    square = x * x + y * y
    turn = jnp.where(square > 0, 1 / jnp.where(square > 0, square, 1.0), 0.0)
    return angle(x, y), turn * (x * dy - y * dx)


def _horner(coefficients: tuple[float, ...], z: Scalar) -> Scalar:
    total = jnp.full_like(z, coefficients[0])
    for c in coefficients[1:]:
        total = total * z + c
    return total
