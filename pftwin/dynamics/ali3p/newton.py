r"""Solver for the equations of one step of ALI3-P (see `step`): Newton's method with multipliers, and projections.

Velocities and accelerations are projected to the closest ones, in a metric W, that satisfy the constraints J x = b:

    (W + s J^T J) x = W x* + J^T (s b - sigma),      sigma <- sigma + s (J x - b),

iterated to rounding error: each iteration reduces the violation of the constraints by the factor |W| / s. With
W = M + gamma h C + beta h^2 K and s = beta h^2 alpha the matrix is that of the step's Newton iteration. Source: Bayo &
Ledesma 1996, Nonlinear Dyn 9:113; Cuadrado et al. 1997, Mech Mach Theory 32:187; with multipliers: Dopico et al. 2014,
J Comput Nonlinear Dyn 9:041006.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.linalg import cho_factor, cho_solve
from jaxtyping import Array

from pftwin.base.leaves import filled_tangents
from pftwin.base.spatial import Scalar
from pftwin.dynamics.ali3p.bodies import Bodies, masses
from pftwin.dynamics.ali3p.natural_coordinates import LENGTH, Driven, constraints, directions, jacobian
from pftwin.model.effects.base import Load

GAMMA, BETA = 0.5, 0.25  # Newmark's average acceleration
MOST_ITERATIONS = 20
FARTHEST = LENGTH  # largest displacement of the coordinates in one iteration [m]
SETTLED = {"float64": 1e-9, "float32": 1e-4}  # largest last change of the rates of a converged step [m/s]
PENALTY = {"float64": 1e6, "float32": 1e3}  # default of beta h^2 alpha, divided by the patella's mass
TURNS = 4  # iterations of a projection


def with_penalty(metric: Array, jac: Array, scale: Array) -> Array:
    """W + s J^T J for each body (n, 12, 12)."""
    return metric + scale * jnp.einsum("nki,nkj->nij", jac, jac)


def solved(matrix: Array, right: Array) -> Array:
    """Solves matrix x = right for each body; shapes (n, 12, 12) and (n, 12)."""
    return cho_solve((cho_factor(matrix, lower=True)[0], True), right[..., None])[..., 0]


@partial(jax.custom_jvp)
def constrained(metric: Array, jac: Array, scale: Array, right: Array, wanted: Array) -> tuple[Array, Array]:
    """Solves W x + J^T sigma = right and J x = wanted for x and the multipliers sigma, for each body.

    Args:
        metric: W (n, 12, 12), symmetric, and positive definite on the null space of J.
        jac: J (n, 12, 12); rows may be zero.
        scale: s, which affects only the speed of convergence.
        right, wanted: right-hand sides (n, 12).
    """
    factor = cho_factor(with_penalty(metric, jac, scale), lower=True)[0]
    sigma = jnp.zeros_like(wanted)
    x = jnp.zeros_like(right)
    for _ in range(TURNS):
        constraint_force = jnp.einsum("nki,nk->ni", jac, scale * wanted - sigma)
        x = cho_solve((factor, True), (right + constraint_force)[..., None])[..., 0]
        sigma = sigma + scale * (jnp.einsum("nki,ni->nk", jac, x) - wanted)
    return x, sigma


@constrained.defjvp
def _constrained_jvp(primals: Any, tangents: Any) -> tuple[Any, Any]:
    """Differentiated at the solution, both equations are the same with other right-hand sides."""
    metric, jac, scale, _, _ = primals
    d_metric, d_jacobian, _, d_right, d_wanted = tangents
    x, sigma = constrained(*primals)
    right = d_right - jnp.einsum("nij,nj->ni", d_metric, x) - jnp.einsum("nki,nk->ni", d_jacobian, sigma)
    wanted = d_wanted - jnp.einsum("nki,ni->nk", d_jacobian, x)
    return (x, sigma), constrained(metric, jac, scale, right, wanted)


class Predicted(eqx.Module):
    """Inputs of a step."""

    bodies: Bodies
    place: Array  # (n, 12) coordinates at the end for zero acceleration there
    rate: Array
    second_rate: Array  # initial guess
    multipliers: Array  # initial guess
    to: Driven  # prescribed motion of guided bodies at the end
    penalty: float = eqx.field(static=True)

    def motion(self, second_rate: Array) -> tuple[Array, Array]:
        """Coordinates and rates at the end for an acceleration there."""
        h = self.bodies.step
        return self.place + BETA * h * h * second_rate, self.rate + GAMMA * h * second_rate

    def scale(self) -> Scalar:
        """beta h^2 alpha [kg]."""
        return self.penalty * self.bodies.system.mass

    def metric(self, place: Array, loads: list[Load]) -> Array:
        """M + gamma h C + beta h^2 K (n, 12, 12)."""
        h = self.bodies.step
        return self.bodies.metric(place, loads, GAMMA * h, BETA * h * h)

    def unbalanced(self, second_rate: Array, multipliers: Array) -> tuple[Array, list[Load]]:
        """M d2q/dt2 - Q + J^T multipliers (n, 12), and the loads."""
        place, rate = self.motion(second_rate)
        forces, loads, _ = self.bodies.forces(place, rate)
        held = jnp.einsum("nki,nk->ni", jacobian(place, self.to), multipliers)
        return masses(self.bodies.system)[None, :] * second_rate - forces + held, loads


@eqx.filter_custom_jvp
def solved_step(given: Predicted) -> tuple[Array, Array, Scalar]:
    """d2q/dt2 and multipliers at the end of the step, and the last change of the rates if not converged, else 0."""
    h, scale = given.bodies.step, given.scale()
    settled, alpha = SETTLED[str(h.dtype)], scale / (BETA * h * h)

    def improve(now: tuple[Array, Array, Scalar, Scalar]) -> tuple[Array, Array, Scalar, Scalar]:
        second_rate, multipliers, _, count = now
        place, _ = given.motion(second_rate)
        missed = alpha * constraints(place, given.to)
        right, loads = given.unbalanced(second_rate, multipliers + missed)
        tangent = with_penalty(given.metric(place, loads), jacobian(place, given.to), scale)
        change = solved(tangent, -right)
        displacement = BETA * h * h * jnp.sqrt(jnp.sum(change * change))
        change = change * jnp.minimum(1.0, FARTHEST / jnp.maximum(displacement, FARTHEST))
        second_rate = second_rate + change
        multipliers = multipliers + alpha * constraints(given.motion(second_rate)[0], given.to)
        return second_rate, multipliers, GAMMA * h * jnp.sqrt(jnp.sum(change * change)), count + 1

    start = given.second_rate, given.multipliers, jnp.full_like(h, jnp.inf), jnp.zeros((), int)
    second_rate, multipliers, size, _ = jax.lax.while_loop(
        lambda now: (now[2] > settled) & (now[3] < MOST_ITERATIONS), improve, start
    )
    size = jnp.where(jnp.isfinite(size), size, jnp.inf)
    return second_rate, multipliers, jnp.where(size > settled, size, 0.0)


@solved_step.def_jvp
def _solved_step_jvp(primals: Any, tangents: Any) -> tuple[Any, Any]:
    """At the solution both equations hold, whatever tangent the iteration used, and reduce to six unknowns.

    Guided bodies follow their prescribed motion, and the patella's coordinates change only along its six rigid
    displacements B, to which J^T lambda is orthogonal: B^T times the first equation gives six equations for them.
    """
    (given,) = primals
    second_rate, multipliers, left = solved_step(given)
    place, _ = given.motion(second_rate)
    h = given.bodies.step
    moving, still = eqx.partition(given, eqx.is_inexact_array)
    changes = filled_tangents(moving, tangents[0])
    per_metre = 1 / (BETA * h * h)
    basis = directions(place[0])

    predicted = jax.jvp(lambda m: eqx.combine(m, still).motion(second_rate)[0], (moving,), (changes,))[1]
    known = changes.to.place - predicted

    def residual(second_rate: Array, moving: Any) -> Array:
        return eqx.combine(moving, still).unbalanced(second_rate, multipliers)[0]

    def along(direction: Array) -> Array:
        change = jnp.zeros_like(place).at[0].set(per_metre * (basis @ direction))
        return jax.jvp(lambda a: residual(a, moving), (second_rate,), (change,))[1]

    tangent = jax.vmap(along)(jnp.eye(6, dtype=place.dtype))  # (6, n, 12)
    rest = jax.jvp(residual, (second_rate, moving), (per_metre * known, changes))[1]
    steps = jnp.linalg.solve((tangent[:, 0] @ basis).T, -(rest[0] @ basis))
    unbalanced = rest + jnp.einsum("k,kni->ni", steps, tangent)
    change = (per_metre * known).at[0].add(per_metre * (basis @ steps))
    mass = jnp.broadcast_to(jnp.diag(masses(given.bodies.system)), (len(place), 12, 12))
    holding = constrained(mass, jacobian(place, given.to), given.scale(), -unbalanced, jnp.zeros_like(rest))[1]
    return (second_rate, multipliers, left), (change, holding, jnp.zeros_like(left))
