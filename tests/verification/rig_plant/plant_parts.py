"""Parts of the plant (`mechanics`): springs, moving frames, and bones with prescribed motion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline


class Spring(NamedTuple):
    """A stiffening spring: F = K s (1 + e s / (L0 / 4)) + c dL/dt for the stretch s = L - L0 > 0, never negative."""

    stiffness: float  # K [N/m]
    slack_length: float  # L0 [m]
    damping: float  # c [N s/m]
    insertion: NDArray  # (3,) on the patella, relative to its centre of mass [m]
    origin: NDArray  # (3,) on the femur or the tibia [m]
    stiffening: float  # e, relative increase of stiffness at a stretch of a quarter of its length

    def force(self, length: float, lengthening: float) -> float:
        """Returns the tension [N] for a length [m] and its rate [m/s]."""
        s = length - self.slack_length
        elastic = self.stiffness * s * (1 + self.stiffening * s / (0.25 * self.slack_length))
        return max(elastic + self.damping * lengthening, 0.0) if s > 0 else 0.0

    def energy(self, length: float) -> float:
        """Returns the stored elastic energy [J] for a length [m]."""
        s = max(length - self.slack_length, 0.0)
        return self.stiffness * s * s * (0.5 + self.stiffening * s / (0.75 * self.slack_length))


class Frame(NamedTuple):
    """Pose and velocity of a body in world axes (SI units)."""

    origin: NDArray
    turn: NDArray  # (3, 3), body to world
    velocity: NDArray  # of the origin
    spin: NDArray  # angular velocity

    def point(self, p: NDArray) -> tuple[NDArray, NDArray]:
        """Returns the world position and velocity of a point p in the body's frame."""
        return self.origin + (arm := self.turn @ p), self.velocity + cross(self.spin, arm)

    def velocity_at(self, p: NDArray) -> NDArray:
        """Returns the velocity of the body's material point at the world position p."""
        return self.velocity + cross(self.spin, p - self.origin)


class GuidedBones:
    """Prescribed motion of femur and tibia: cubic splines (not-a-knot) through origins and quaternions.

    The orientation is the interpolated quaternion u, normalised; the angular velocity is 2 Im(du/dt u*) / |u|^2.
    """

    def __init__(self, times: NDArray, *poses: tuple[NDArray, NDArray]) -> None:
        """Takes times (n,) and, for each bone, origins (n, 3) and sign-continuous quaternions (n, 4), scalar first."""
        self.spline = CubicSpline(times, np.concatenate([a for pose in poses for a in pose], axis=1))
        self.slope = self.spline.derivative()

    def at(self, time: float) -> list[Frame]:
        """Returns the frames of the bones at a time [s]."""
        here, change = self.spline(time).reshape(-1, 7), self.slope(time).reshape(-1, 7)
        return [
            Frame(x[:3], matrix(x[3:]), dx[:3], 2 / (x[3:] @ x[3:]) * product(dx[3:], conjugate(x[3:]))[1:])
            for x, dx in zip(here, change, strict=True)
        ]


def cross(a: NDArray, b: NDArray) -> NDArray:
    """Returns a x b of two vectors, much faster than NumPy."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def matrix(q: NDArray) -> NDArray:
    """Returns the rotation matrix (3, 3) of a quaternion of any norm, scalar first."""
    w, x, y, z = q.tolist()
    s = 2 / (w * w + x * x + y * y + z * z)
    return np.array(
        [
            [1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
            [s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)],
            [s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)],
        ]
    )


def product(p: NDArray, q: NDArray) -> NDArray:
    """Returns the product of two quaternions."""
    return np.concatenate([[p[0] * q[0] - p[1:] @ q[1:]], p[0] * q[1:] + q[0] * p[1:] + cross(p[1:], q[1:])])


def conjugate(q: NDArray) -> NDArray:
    """Returns the conjugate quaternion."""
    return q * (1, -1, -1, -1)
