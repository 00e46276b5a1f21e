r"""Natural coordinates of rigid bodies, their constraints, and conversion of velocities and wrenches.

A body has twelve coordinates: a point r and three vectors u, v, w along its axes, each LENGTH long, in world axes [m].
In these the mass matrix is constant and there are no gyroscopic forces. There are two groups of constraints, all in
metres, so that their violations are lengths:

    rigid     (u.u - L^2) / (2 L), ...,      u.v / L, ...                              for every body
    driving   r - r_p(t),   (v.w_p(t) - w.v_p(t)) / (2 L), ...                         for guided bodies

with p(t) the natural coordinates of the recorded frame. There are 6 independent driving constraints, not 12 on the
redundant coordinates. With the rigid ones they are as many as the coordinates, so that all multipliers are unique, and
the last six are the force and, times L, the moment in the frame's axes that drive the body. All constraints are linear
or bilinear, with the constant coefficients A and D below. Source: Garcia de Jalon & Bayo 1994, Kinematic and Dynamic
Simulation of Multibody Systems, chapters 2 and 4.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from pftwin.base.spatial import Quaternion, Rotation, Twist, Vec3

LENGTH = 0.02  # length of the three vectors, about half the patella's width [m]


def _coefficients() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coefficients of rigid constraints q A q / 2, of driving ones p D q, and of the map of wrenches T = T0 + T1 q."""
    block = [slice(3 * i, 3 * i + 3) for i in range(4)]  # r, u, v, w
    rigid, drive, wrench = np.zeros((6, 12, 12)), np.zeros((3, 12, 12)), np.zeros((12, 6, 12))
    for k in range(3):
        i, j = block[1 + (k + 1) % 3], block[1 + (k + 2) % 3]  # k = x: v and w
        rigid[k, block[1 + k], block[1 + k]] = np.eye(3) / LENGTH
        rigid[3 + k, i, j] = rigid[3 + k, j, i] = np.eye(3) / LENGTH
        drive[k, j, i], drive[k, i, j] = np.eye(3) / (2 * LENGTH), -np.eye(3) / (2 * LENGTH)
        wrench[i, 3 + k, j], wrench[j, 3 + k, i] = np.eye(3) / (2 * LENGTH**2), -np.eye(3) / (2 * LENGTH**2)
    return rigid, drive, wrench


_RIGID, _DRIVE, _WRENCH = _coefficients()
_SIZES = np.array([LENGTH / 2] * 3 + [0.0] * 3)
_PLACE = np.eye(6, 12)[:3]
_FORCE = np.eye(12, 6) * (np.arange(6) < 3)


class Driven(NamedTuple):
    """Prescribed motion of the bodies at an instant; zeros for the first body, the patella, which is free."""

    place: Array  # p (n, 12)
    rate: Array  # dp/dt
    second_rate: Array  # d2p/dt2


def coordinates(origin: Vec3, axes: Rotation) -> Array:
    """Natural coordinates (12,) of a body [m]."""
    return jnp.concatenate([origin.array(), *(LENGTH * e.array() for e in (axes.ex, axes.ey, axes.ez))])


def rates(velocity: Vec3, omega: Vec3, axes: Rotation) -> Array:
    """Rates (12,) of the natural coordinates [m/s], from velocity and angular velocity in world axes."""
    return jnp.concatenate([velocity.array(), *(LENGTH * omega.cross(e).array() for e in (axes.ex, axes.ey, axes.ez))])


def axes_of(q: Array) -> Rotation:
    """Axes of a body from its coordinates (12,); unit vectors to the accuracy of its constraints."""
    return Rotation(*(Vec3.from_array(q[3 * i : 3 * i + 3] / LENGTH) for i in (1, 2, 3)))


def twist_of(q: Array, dq: Array) -> Twist:
    """Velocity of a body's point r in world axes, and angular velocity in the body's axes."""
    axes, change = axes_of(q), axes_of(dq)
    spin = Vec3(
        0.5 * (change.ey.dot(axes.ez) - change.ez.dot(axes.ey)),
        0.5 * (change.ez.dot(axes.ex) - change.ex.dot(axes.ez)),
        0.5 * (change.ex.dot(axes.ey) - change.ey.dot(axes.ex)),
    )
    return Twist(Vec3.from_array(dq[:3]), spin)


def as_rigid(q: Array, to: Driven) -> Array:
    """Coordinates (n, 12) close to q that satisfy all constraints, for steps that were not solved."""
    turn = Quaternion.from_rotation(axes_of(q[0])).rotation()
    return to.place.at[0].set(coordinates(Vec3.from_array(q[0, :3]), turn))


def wrench_map(q: Array) -> Array:
    """T (12, 6): maps a force in world axes and a moment about r in body axes to generalised forces; T^T dq/dt is the
    twist. Of all forces with the same work on a rigid body, the result is the smallest, without components along the
    rigid constraints."""
    return _with_dtype_of(_FORCE, q) + _with_dtype_of(_WRENCH, q) @ q


def directions(q: Array) -> Array:
    """Displacements of a body (12, 6) per translation along world axes [m] and per rotation about its axes [rad]."""
    return wrench_map(q) * jnp.asarray([1.0] * 3 + [2 * LENGTH**2] * 3, q.dtype)[None, :]


def _with_dtype_of(coefficients: np.ndarray, like: Array) -> Any:
    return jnp.asarray(coefficients, like.dtype)


def _driven(values: list[Array]) -> Array:
    """Driving constraints of all bodies (n, 6); zeros for the first."""
    both = jnp.concatenate(values, axis=1)
    return both.at[0].set(0.0)


def constraints(q: Array, to: Driven) -> Array:
    """Constraints (n, 12) of bodies with coordinates (n, 12): 6 rigid, then 6 driving, zeros for the first body [m]."""
    rigid = 0.5 * jnp.einsum("ni,kij,nj->nk", q, _with_dtype_of(_RIGID, q), q) - _with_dtype_of(_SIZES, q)[None, :]
    turn = jnp.einsum("ni,kij,nj->nk", to.place, _with_dtype_of(_DRIVE, q), q)
    return jnp.concatenate([rigid, _driven([(q - to.place)[:, :3], turn])], axis=1)


def jacobian(q: Array, to: Driven) -> Array:
    """Jacobian (n, 12, 12) of `constraints`, one row per constraint."""
    rigid = jnp.einsum("kij,nj->nki", _with_dtype_of(_RIGID, q), q)
    place = jnp.broadcast_to(_with_dtype_of(_PLACE, q), (q.shape[0], 3, 12))
    return jnp.concatenate(
        [rigid, _driven([place, jnp.einsum("ni,kij->nkj", to.place, _with_dtype_of(_DRIVE, q))])], axis=1
    )


def rates_wanted(q: Array, to: Driven) -> Array:
    """Value (n, 12) of J dq/dt, with J the Jacobian, for which the constraints stay satisfied."""
    turn = -jnp.einsum("ni,kij,nj->nk", to.rate, _with_dtype_of(_DRIVE, q), q)
    return jnp.concatenate([jnp.zeros_like(q[:, :6]), _driven([to.rate[:, :3], turn])], axis=1)


def second_rates_wanted(q: Array, dq: Array, to: Driven) -> Array:
    """Value (n, 12) of J d2q/dt2, with J the Jacobian, for which the rates of the constraints stay satisfied."""
    rigid = -jnp.einsum("ni,kij,nj->nk", dq, _with_dtype_of(_RIGID, q), dq)
    drive = _with_dtype_of(_DRIVE, q)
    turn = 2 * jnp.einsum("ni,kij,nj->nk", to.rate, drive, dq) + jnp.einsum("ni,kij,nj->nk", to.second_rate, drive, q)
    return jnp.concatenate([rigid, _driven([to.second_rate[:, :3], -turn])], axis=1)
