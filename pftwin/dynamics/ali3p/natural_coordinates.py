r"""Natural coordinates of rigid bodies, their constraints, and what velocities and wrenches are in them.

A body has twelve: a point r and three vectors u, v, w along its axes, each LENGTH long, all in world axes [m]. With
them the mass matrix is constant and there are no gyroscopic forces. Two groups of constraints hold them, all in metres,
so that what is left of them reads as a length:

    rigid     (u.u - L^2) / (2 L), ...,      u.v / L, ...                              for every body
    driving   r - r_p(t),   (v.w_p(t) - w.v_p(t)) / (2 L), ...                         for guided bodies

with p(t) the natural coordinates that the recorded frame has. The driving ones are 6 and independent, not 12 on the
redundant coordinates: together with the rigid ones they are as many as the coordinates, so that every multiplier is
unique, and the last six are the force and, times L, the moment in the frame's axes that drive the body. All are linear
or bilinear: A and D below are their constant coefficients. Source: Garcia de Jalon & Bayo 1994, Kinematic and Dynamic
Simulation of Multibody Systems, chapters 2 and 4.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from pftwin.base.spatial import Quaternion, Rotation, Twist, Vec3

LENGTH = 0.02  # of the three vectors: about the patella's half width [m]


def _coefficients() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of rigid constraints q A q / 2, of driving ones p D q, and of the map from wrenches, T = T0 + T1 q."""
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
    """What the bodies are to follow at an instant; the first body, the patella, follows nothing: zeros."""

    place: Array  # p (n, 12)
    rate: Array  # dp/dt
    second_rate: Array  # d2p/dt2


def coordinates(origin: Vec3, axes: Rotation) -> Array:
    """(12,) natural coordinates of a body."""
    return jnp.concatenate([origin.array(), *(LENGTH * e.array() for e in (axes.ex, axes.ey, axes.ez))])


def rates(velocity: Vec3, omega: Vec3, axes: Rotation) -> Array:
    """(12,) their rates; velocity and angular velocity in world axes."""
    return jnp.concatenate([velocity.array(), *(LENGTH * omega.cross(e).array() for e in (axes.ex, axes.ey, axes.ez))])


def axes_of(q: Array) -> Rotation:
    """The axes of a body (12,), unit vectors as far as its constraints hold."""
    return Rotation(*(Vec3.from_array(q[3 * i : 3 * i + 3] / LENGTH) for i in (1, 2, 3)))


def twist_of(q: Array, dq: Array) -> Twist:
    """Velocity of a body's point in world axes, and its angular velocity in the body's own."""
    axes, change = axes_of(q), axes_of(dq)
    spin = Vec3(
        0.5 * (change.ey.dot(axes.ez) - change.ez.dot(axes.ey)),
        0.5 * (change.ez.dot(axes.ex) - change.ex.dot(axes.ez)),
        0.5 * (change.ex.dot(axes.ey) - change.ey.dot(axes.ex)),
    )
    return Twist(Vec3.from_array(dq[:3]), spin)


def as_rigid(q: Array, to: Driven) -> Array:
    """Coordinates (n, 12) near by that fulfil every constraint: for steps that were not solved."""
    turn = Quaternion.from_rotation(axes_of(q[0])).rotation()
    return to.place.at[0].set(coordinates(Vec3.from_array(q[0, :3]), turn))


def wrench_map(q: Array) -> Array:
    """T (12, 6): generalised forces of a force in world axes and a moment about r in the body's; T^T dq/dt: its twist.

    Of all forces that do the same work on a rigid body it gives the smallest: none along the rigid constraints.
    """
    return _with_dtype_of(_FORCE, q) + _with_dtype_of(_WRENCH, q) @ q


def directions(q: Array) -> Array:
    """(12, 6): a body's displacements per metre in the world and per angle about its own axes."""
    return wrench_map(q) * jnp.asarray([1.0] * 3 + [2 * LENGTH**2] * 3, q.dtype)[None, :]


def _with_dtype_of(coefficients: np.ndarray, like: Array) -> Any:
    return jnp.asarray(coefficients, like.dtype)


def _driven(values: list[Array]) -> Array:
    """Constraints of all bodies (n, 6): none of the first."""
    both = jnp.concatenate(values, axis=1)
    return both.at[0].set(0.0)


def constraints(q: Array, to: Driven) -> Array:
    """(n, 12) of bodies (n, 12): 6 rigid ones and 6 driving ones, which are zeros for the first body [m]."""
    rigid = 0.5 * jnp.einsum("ni,kij,nj->nk", q, _with_dtype_of(_RIGID, q), q) - _with_dtype_of(_SIZES, q)[None, :]
    turn = jnp.einsum("ni,kij,nj->nk", to.place, _with_dtype_of(_DRIVE, q), q)
    return jnp.concatenate([rigid, _driven([(q - to.place)[:, :3], turn])], axis=1)


def jacobian(q: Array, to: Driven) -> Array:
    """(n, 12, 12): rows as in `constraints`."""
    rigid = jnp.einsum("kij,nj->nki", _with_dtype_of(_RIGID, q), q)
    place = jnp.broadcast_to(_with_dtype_of(_PLACE, q), (q.shape[0], 3, 12))
    return jnp.concatenate(
        [rigid, _driven([place, jnp.einsum("ni,kij->nkj", to.place, _with_dtype_of(_DRIVE, q))])], axis=1
    )


def rates_wanted(q: Array, to: Driven) -> Array:
    """(n, 12): what jacobian dq/dt has to be, so that the constraints stay."""
    turn = -jnp.einsum("ni,kij,nj->nk", to.rate, _with_dtype_of(_DRIVE, q), q)
    return jnp.concatenate([jnp.zeros_like(q[:, :6]), _driven([to.rate[:, :3], turn])], axis=1)


def second_rates_wanted(q: Array, dq: Array, to: Driven) -> Array:
    """(n, 12): what jacobian d2q/dt2 has to be, so that their rates stay."""
    rigid = -jnp.einsum("ni,kij,nj->nk", dq, _with_dtype_of(_RIGID, q), dq)
    drive = _with_dtype_of(_DRIVE, q)
    turn = 2 * jnp.einsum("ni,kij,nj->nk", to.rate, drive, dq) + jnp.einsum("ni,kij,nj->nk", to.second_rate, drive, q)
    return jnp.concatenate([rigid, _driven([to.second_rate[:, :3], -turn])], axis=1)
