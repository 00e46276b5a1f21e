"""Prescribed motion of femur and tibia: C2 interpolation of recorded poses, with exact velocities."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from pftwin.base.errors import InputError
from pftwin.base.spatial import Quaternion, Rotation, Scalar, Vec3
from pftwin.files.mocap.poses import PoseSeries, check_same_times
from pftwin.files.mocap.tables import uniform_times

if TYPE_CHECKING:
    from pftwin.base.spatial import Pose

_FEWEST_FRAMES = 4


class Frame(eqx.Module):
    """Frame of a guided body and its velocity, at one time or a batch of times; all in world axes."""

    origin: Vec3  # [m]
    rotation: Rotation  # local to world
    velocity: Vec3  # of the origin [m/s]
    angular_velocity: Vec3  # [rad/s]

    @staticmethod
    def world() -> Frame:
        """The world frame, at rest."""
        return Frame(Vec3.zero(), Quaternion.identity().rotation(), Vec3.zero(), Vec3.zero())

    def point(self, p: Vec3) -> Vec3:
        """World coordinates of a point from its local coordinates [m]."""
        return self.origin + self.rotation.apply(p)

    def to_local(self, p: Vec3) -> Vec3:
        """Local coordinates of a point from its world coordinates [m]."""
        return self.rotation.unapply(p - self.origin)

    def direction(self, v: Vec3) -> Vec3:
        """World components of a vector from its local components."""
        return self.rotation.apply(v)

    def local_direction(self, v: Vec3) -> Vec3:
        """Local components of a vector from its world components."""
        return self.rotation.unapply(v)

    def velocity_at(self, p: Vec3) -> Vec3:
        """World velocity [m/s] of the body-fixed point at the world position p."""
        return self.velocity + self.angular_velocity.cross(p - self.origin)

    def slowed(self, factor: Scalar | float) -> Frame:
        """The same pose with velocities multiplied by a factor; 0 is at rest."""
        return Frame(self.origin, self.rotation, factor * self.velocity, factor * self.angular_velocity)

    def relative_velocity(self, velocity: Vec3, at: Vec3) -> Vec3:
        """A world velocity minus that of the body-fixed point at world position `at` [m/s]."""
        return velocity - self.velocity_at(at)

    def relative_spin(self, spin: Vec3, axes: Rotation) -> Vec3:
        """An angular velocity, expressed in `axes`, minus that of the frame [rad/s]."""
        return spin - axes.unapply(self.angular_velocity)


class SegmentMotion(eqx.Module):
    """Motion of a segment as cubic splines (not-a-knot, C2) through positions and quaternion components.

    With u the spline of the quaternions, the orientation is u/|u|, and the angular velocity in world axes is exact for
    the interpolant: omega = 2 Im(du/dt * conj(u)) / |u|^2 (the change of |u| is real and drops out). The end cubics
    extrapolate before the first and after the last knot, only to tolerate rounding errors of times.
    """

    knots: Float[Array, " n"]  # [s]
    position_coefficients: Float[Array, "4 n-1 3"]  # highest power of (t - knot) first
    quaternion_coefficients: Float[Array, "4 n-1 4"]

    @staticmethod
    def fit(poses: PoseSeries) -> SegmentMotion:
        """Splines through recorded poses, computed on the host in float64; leaves have JAX's default float type.

        Raises:
            InputError: there are fewer than four frames.
        """
        if poses.times.size < _FEWEST_FRAMES:
            raise InputError(
                f"a motion of {poses.times.size} frames is shorter than its interpolation needs",
                where=poses.source,
                expected=f"at least {_FEWEST_FRAMES} frames",
            )
        from scipy.interpolate import CubicSpline

        splines = (CubicSpline(poses.times, values).c for values in (poses.positions, poses.quaternions))
        return SegmentMotion(*_leaves(poses.times, *splines))

    def at_speed(self, factor: float, start: float) -> SegmentMotion:
        """The same poses at `factor` times the speed, with the time `start` [s] unchanged."""
        powers = factor ** np.arange(3.0, -1.0, -1.0)[:, None, None]
        knots, p, q = (np.asarray(a, float) for a in jax.tree.leaves(self))
        return SegmentMotion(*_leaves(start + (knots - start) / factor, powers * p, powers * q))

    def until_second_frame(self) -> SegmentMotion:
        """The motion between the first two knots."""
        knots, p, q = (np.asarray(a) for a in jax.tree.leaves(self))
        return SegmentMotion(*_leaves(knots[:2], p[:, :1], q[:, :1]))

    def pieces(self, interval: Scalar) -> CubicPiece:
        """The cubics between the knots `interval` and `interval` + 1 (integers of any shape)."""
        return CubicPiece(
            self.knots[interval], self.position_coefficients[:, interval], self.quaternion_coefficients[:, interval]
        )

    def frames(self, times: ArrayLike) -> Frame:
        """The frame at times [s] of any shape, which its fields then have."""
        t = jnp.asarray(times, self.knots.dtype)
        # `fit` makes the knots uniform, so the interval is found without a search.
        spacing = (self.knots[-1] - self.knots[0]) / (self.knots.shape[0] - 1)
        interval = jnp.clip(jnp.floor((t - self.knots[0]) / spacing).astype(int), 0, self.knots.shape[0] - 2)
        return self.pieces(interval).frames(t)


def _leaves(*arrays: np.ndarray) -> Iterator[Array]:
    """Arrays in JAX's default float type."""
    return (jnp.asarray(a, dtype=float) for a in arrays)


class CubicPiece(eqx.Module):
    """Cubics of a segment between two knots, or a batch of them."""

    knot: Scalar  # time of the first knot [s]
    position_coefficients: Array  # (4, ..., 3)
    quaternion_coefficients: Array  # (4, ..., 4)

    def frames(self, times: Scalar) -> Frame:
        """The frame at one time [s] per piece."""
        s = (times - self.knot)[..., None]
        p, velocity = _cubic(self.position_coefficients, s)
        u, change = _cubic(self.quaternion_coefficients, s)
        quaternion, rate = Quaternion.from_array(u), Quaternion.from_array(change)
        spin = rate * quaternion.conjugate()
        twice = 2 / (quaternion * quaternion.conjugate()).w
        omega = Vec3(twice * spin.x, twice * spin.y, twice * spin.z)
        rotation = quaternion.normalised().rotation()
        return Frame(Vec3.from_array(p), rotation, Vec3.from_array(velocity), omega)


def _cubic(c: Array, s: Scalar) -> tuple[Scalar, Scalar]:
    """Value and derivative of c0 s^3 + c1 s^2 + c2 s + c3."""
    value = ((c[0] * s + c[1]) * s + c[2]) * s + c[3]
    slope = (3 * c[0] * s + 2 * c[1]) * s + c[2]
    return value, slope


class KneeMotion(eqx.Module):
    """Guided motion of a knee.

    `femur` is None if the femur does not move. The world is then the femur frame, in which the tibia moves, and
    gravity, which is given in world axes, is given in the femur's.
    """

    femur: SegmentMotion | None
    tibia: SegmentMotion
    start_time: float = eqx.field(static=True)  # [s]
    frame_interval: float = eqx.field(static=True)  # between recorded frames [s]
    n_frames: int = eqx.field(static=True)

    @staticmethod
    def from_poses(femur: PoseSeries | Pose | None, tibia: PoseSeries) -> KneeMotion:
        """Interpolates recorded poses.

        Args:
            femur: recorded poses in the world; or one fixed pose in the world (the tibia is then re-expressed in the
                femur frame); or None if `tibia` is given in the femur frame.
            tibia: recorded poses, at the same times.

        Raises:
            InputError: fewer than four frames, or times that are not uniform (naming the row) or differ between both.
        """
        moving = None
        if isinstance(femur, PoseSeries):
            check_same_times(femur, tibia)
            moving = femur
        elif femur is not None:
            tibia = tibia.seen_from(femur)
        if tibia.times.size < _FEWEST_FRAMES:
            SegmentMotion.fit(tibia)  # raises
        times = uniform_times(tibia.times, where=tibia.source)

        def fit(poses: PoseSeries) -> SegmentMotion:
            return SegmentMotion.fit(PoseSeries(times, poses.positions, poses.quaternions, source=poses.source))

        # Rounded, so that recordings with the same rate share one compiled program.
        interval = _rounded((times[-1] - times[0]) / (times.size - 1))
        start = _rounded(times[0])
        return KneeMotion(None if moving is None else fit(moving), fit(tibia), start, interval, times.size)

    def at_speed(self, factor: float) -> KneeMotion:
        """The same poses at `factor` times the speed (computed on the host).

        Raises:
            InputError: the factor is not a finite positive number.
        """
        if not (np.isfinite(factor) and factor > 0):
            raise InputError(f"found {factor!r}", where="speed", expected="a positive number, 1 as it was recorded")
        femur = None if self.femur is None else self.femur.at_speed(factor, self.start_time)
        tibia, interval = self.tibia.at_speed(factor, self.start_time), _rounded(self.frame_interval / factor)
        return KneeMotion(femur, tibia, self.start_time, interval, self.n_frames)

    def until_second_frame(self) -> KneeMotion:
        """The motion between the first two frames (computed on the host)."""
        femur = None if self.femur is None else self.femur.until_second_frame()
        return KneeMotion(femur, self.tibia.until_second_frame(), self.start_time, self.frame_interval, 2)

    @property
    def end_time(self) -> float:
        """Time of the last recorded frame [s]."""
        return self.start_time + self.frame_interval * (self.n_frames - 1)

    @property
    def times(self) -> np.ndarray:
        """Times of the recorded frames (n,) [s], float64 on the host."""
        return self.start_time + self.frame_interval * np.arange(self.n_frames)

    def frame_times(self) -> Array:
        """`times` as a JAX array, for use in programs in which start and interval may be traced."""
        return self.start_time + self.frame_interval * jnp.arange(self.n_frames).astype(float)

    def frames(self, times: ArrayLike) -> tuple[Frame | None, Frame]:
        """Frames of femur (None if it is the world) and tibia at times [s] of any shape."""
        return None if self.femur is None else self.femur.frames(times), self.tibia.frames(times)

    def between_frames(self, index: Scalar) -> MotionPiece:
        """The motion between the recorded frames `index` and `index` + 1, for lookups in a loop over steps."""
        return MotionPiece(None if self.femur is None else self.femur.pieces(index), self.tibia.pieces(index))


class MotionPiece(eqx.Module):
    """Guided motion of a knee between two recorded frames."""

    femur: CubicPiece | None
    tibia: CubicPiece

    def frames(self, time: Scalar) -> tuple[Frame | None, Frame]:
        """Frames of femur (None if it is the world) and tibia at a time [s]."""
        return None if self.femur is None else self.femur.frames(time), self.tibia.frames(time)


def _rounded(value: float) -> float:
    return float(f"{value:.12g}")
