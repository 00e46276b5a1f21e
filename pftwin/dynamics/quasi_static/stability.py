"""Whether an equilibrium is stable: a disturbance dies out, in a viscous medium without inertia.

There, d' = -K d / c: it dies out where every eigenvalue of K has a positive real part. Where forces have a potential K
is symmetric, and that is the same as definite. Those of meshes' contours have none: with a K of eigenvalues all
positive, its symmetric part is often indefinite, and says nothing of a fold.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.spatial import Scalar
from pftwin.dynamics.solve import inverse_with_pivots

NEUTRAL = 1e-6  # of the tangent's trace: a stiffness down to minus that counts as none, neutral and not unstable
SQUARINGS = 16  # from a factor that is 0.2 % off 1, as the slack's and the trace's own are, to one of 1e-57


def is_stable(tangent: Array) -> Scalar:
    """Whether a (6, 6) tangent at rest [N/m] is that of a stable or a neutral equilibrium.

    A definite symmetric part is enough. Where it is not definite, C = (K - s) (K + s)^-1 turns eigenvalues of positive
    real part into some below 1 in size, whose powers vanish, and the others into some above, whose powers grow.
    """
    one = jnp.eye(6, dtype=tangent.dtype)
    trace = jnp.trace(tangent)
    slack = trace * jnp.asarray(NEUTRAL, tangent.dtype)
    shifted = tangent + slack * one
    definite = inverse_with_pivots(0.5 * (shifted + shifted.T))[1]
    scale = jnp.asarray(NEUTRAL**0.5, tangent.dtype) * trace  # geometric mean of the slack and the trace

    def squared(now: tuple[Array, Scalar]) -> tuple[Array, Scalar]:
        power, count = now
        first = one - 2 * scale * inverse_with_pivots(power + scale * one)[0]
        return jnp.where(count == 0, first, power @ power), count + 1

    # Not one round where the symmetric part is definite, as it is wherever forces have a potential.
    most = jnp.where(definite, 0, SQUARINGS + 1)
    power, _ = jax.lax.while_loop(lambda now: now[1] < most, squared, (shifted, jnp.zeros_like(most)))
    return definite | ((trace > 0) & (jnp.max(jnp.abs(power)) < 1))
