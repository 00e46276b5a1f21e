"""Vectors, rotations and poses as structures of arrays.

`Vec3(x, y, z)` is a pytree of three arrays of one shape, that of the batch. Every operation is elementwise, so XLA
fuses the physics into one vectorised loop. Arrays of shape (..., 3) occur only in input and output (files, results):
`Vec3.from_array`, `Vec3.array`.

Rotations act from the left and map coordinates of the rotated frame to those of its parent: with `X_FP` the pose of the
patella P in the femur F, `X_FP.apply(p_PQ)` is `p_FQ`. Quaternions are (w, x, y, z), unit, with Hamilton's convention.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

Scalar = Float[Array, "..."]


class Vec3(eqx.Module):
    """A vector, or a batch of vectors: three arrays of one shape."""

    x: Scalar
    y: Scalar
    z: Scalar

    @staticmethod
    def from_array(values: ArrayLike) -> Vec3:
        """The vectors along the last axis of an array of shape (..., 3)."""
        a = jnp.asarray(values)
        return Vec3(a[..., 0], a[..., 1], a[..., 2])

    @staticmethod
    def zero() -> Vec3:
        """The zero vector, in JAX's default float type."""
        return Vec3(jnp.zeros(()), jnp.zeros(()), jnp.zeros(()))

    def array(self) -> Array:
        """An array of shape (..., 3)."""
        return jnp.stack([self.x, self.y, self.z], axis=-1)

    def __add__(self, o: Vec3) -> Vec3:
        return Vec3(self.x + o.x, self.y + o.y, self.z + o.z)

    def __sub__(self, o: Vec3) -> Vec3:
        return Vec3(self.x - o.x, self.y - o.y, self.z - o.z)

    def __neg__(self) -> Vec3:
        return Vec3(-self.x, -self.y, -self.z)

    def __mul__(self, s: Scalar | float) -> Vec3:
        return Vec3(self.x * s, self.y * s, self.z * s)

    __rmul__ = __mul__

    def dot(self, o: Vec3) -> Scalar:
        """The scalar product."""
        return self.x * o.x + self.y * o.y + self.z * o.z

    def cross(self, o: Vec3) -> Vec3:
        """The vector product self x o."""
        return Vec3(self.y * o.z - self.z * o.y, self.z * o.x - self.x * o.z, self.x * o.y - self.y * o.x)

    def squared_norm(self) -> Scalar:
        """|v|^2."""
        return self.dot(self)

    def norm(self) -> Scalar:
        """|v|; its derivative at the zero vector is zero rather than NaN."""
        return safe_sqrt(self.squared_norm())

    def perpendiculars(self) -> tuple[Vec3, Vec3]:
        """Two unit vectors that complete a unit vector to a right-handed frame; they jump where its z changes sign.

        After Duff et al. 2017, J Comput Graph Tech 6(1):1.
        """
        sign = jnp.where(self.z < 0, -1.0, 1.0)
        a = -1 / (sign + self.z)
        b = self.x * self.y * a
        return (
            Vec3(1 + sign * self.x * self.x * a, sign * b, -sign * self.x),
            Vec3(b, sign + self.y * self.y * a, -self.y),
        )

    def sum(self) -> Vec3:
        """Sum over the leading axis of a group (no-op on a single vector)."""
        return jax.tree.map(lambda a: jnp.sum(a, axis=0) if jnp.ndim(a) else a, self)


def safe_sqrt(s: Scalar) -> Scalar:
    """sqrt(s) for s >= 0, with derivative 0 instead of infinity where s is 0."""
    positive = s > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, s, 1)), 0)


class Rotation(eqx.Module):
    """A rotation as the three columns of its matrix: the rotated frame's axes in the parent frame."""

    ex: Vec3
    ey: Vec3
    ez: Vec3

    def apply(self, v: Vec3) -> Vec3:
        """From the rotated frame to the parent: R v."""
        return v.x * self.ex + v.y * self.ey + v.z * self.ez

    def unapply(self, v: Vec3) -> Vec3:
        """From the parent to the rotated frame: R^T v."""
        return Vec3(self.ex.dot(v), self.ey.dot(v), self.ez.dot(v))

    def array(self) -> Array:
        """Matrices of shape (..., 3, 3)."""
        return jnp.stack([self.ex.array(), self.ey.array(), self.ez.array()], axis=-1)

    @staticmethod
    def from_array(matrix: ArrayLike) -> Rotation:
        """From matrices of shape (..., 3, 3)."""
        m = jnp.asarray(matrix)
        return Rotation(*(Vec3.from_array(m[..., :, i]) for i in range(3)))


class Quaternion(eqx.Module):
    """A unit quaternion (w, x, y, z), or a batch of them."""

    w: Scalar
    x: Scalar
    y: Scalar
    z: Scalar

    @staticmethod
    def from_array(values: ArrayLike) -> Quaternion:
        """From arrays of shape (..., 4), scalar part first."""
        a = jnp.asarray(values)
        return Quaternion(a[..., 0], a[..., 1], a[..., 2], a[..., 3])

    @staticmethod
    def identity() -> Quaternion:
        """No rotation."""
        return Quaternion(jnp.ones(()), jnp.zeros(()), jnp.zeros(()), jnp.zeros(()))

    @staticmethod
    def from_rotation_vector(v: Vec3) -> Quaternion:
        """exp(v): the rotation by |v| rad about v; smooth at v = 0."""
        s = v.squared_norm()
        small = s < 1e-8  # below, the series is exact to float64's last digit (next term s^3/645120)
        angle = jnp.sqrt(jnp.where(small, 1.0, s))
        w = jnp.where(small, 1 - s / 8 + s * s / 384, jnp.cos(angle / 2))
        k = jnp.where(small, 0.5 - s / 48 + s * s / 3840, jnp.sin(angle / 2) / angle)
        return Quaternion(w, k * v.x, k * v.y, k * v.z)

    def turned(self, v: Vec3) -> Quaternion:
        """self * exp(v) for the rotation vector v of one time step [rad]: exact to 1e-12 up to 0.3 rad.

        For speed, it avoids the transcendental functions and the square root of the general formulas.
        """
        s = v.squared_norm()
        w = 1 + s * (-1 / 8 + s * (1 / 384 - s * (1 / 46080)))
        k = 0.5 + s * (-1 / 48 + s * (1 / 3840 - s * (1 / 645120)))
        q = self * Quaternion(w, k * v.x, k * v.y, k * v.z)
        size = q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z
        # 1 / sqrt(size) near 1: keeps rounding errors from accumulating over steps; its derivative is negligible.
        n = 1.5 - 0.5 * jax.lax.stop_gradient(size)
        return Quaternion(n * q.w, n * q.x, n * q.y, n * q.z)

    @staticmethod
    def from_rotation(r: Rotation) -> Quaternion:
        """From a rotation matrix, by means of the largest of the four components (Shepperd 1978), with w >= 0."""
        xx, yy, zz = r.ex.x, r.ey.y, r.ez.z
        a, b, c = r.ey.z - r.ez.y, r.ez.x - r.ex.z, r.ex.y - r.ey.x
        d, e, f = r.ex.y + r.ey.x, r.ex.z + r.ez.x, r.ey.z + r.ez.y
        candidates = (
            (1 + xx + yy + zz, a, b, c),
            (a, 1 + xx - yy - zz, d, e),
            (b, d, 1 - xx + yy - zz, f),
            (c, e, f, 1 - xx - yy + zz),
        )
        best, size = candidates[0], candidates[0][0]
        for i, q in enumerate(candidates[1:], start=1):
            larger = q[i] > size
            best = tuple(jnp.where(larger, new, old) for new, old in zip(q, best, strict=True))
            size = jnp.where(larger, q[i], size)
        sign = jnp.where(best[0] < 0, -1.0, 1.0)
        return Quaternion(*(sign * q for q in best)).normalised()

    def rotation_vector(self) -> Vec3:
        """log(q): axis times angle, angle in [0, pi]; smooth at the identity."""
        sign = jnp.where(self.w < 0, -1.0, 1.0)
        w = sign * self.w
        s = self.x * self.x + self.y * self.y + self.z * self.z
        small = s < 1e-12
        sine = jnp.sqrt(jnp.where(small, 1.0, s))
        k = sign * jnp.where(small, 2 + s / 3, 2 * jnp.arctan2(sine, w) / sine)
        return Vec3(k * self.x, k * self.y, k * self.z)

    def array(self) -> Array:
        """An array of shape (..., 4), scalar part first."""
        return jnp.stack([self.w, self.x, self.y, self.z], axis=-1)

    def __mul__(self, o: Quaternion) -> Quaternion:
        """Composition: first o, then self."""
        return Quaternion(
            self.w * o.w - self.x * o.x - self.y * o.y - self.z * o.z,
            self.w * o.x + self.x * o.w + self.y * o.z - self.z * o.y,
            self.w * o.y - self.x * o.z + self.y * o.w + self.z * o.x,
            self.w * o.z + self.x * o.y - self.y * o.x + self.z * o.w,
        )

    def conjugate(self) -> Quaternion:
        """The inverse rotation."""
        return Quaternion(self.w, -self.x, -self.y, -self.z)

    def normalised(self) -> Quaternion:
        """Scaled back to unit length."""
        k = 1 / jnp.sqrt(self.w * self.w + self.x * self.x + self.y * self.y + self.z * self.z)
        return Quaternion(k * self.w, k * self.x, k * self.y, k * self.z)

    def rotation(self) -> Rotation:
        """The rotation matrix, by columns."""
        w, x, y, z = self.w, self.x, self.y, self.z
        return Rotation(
            Vec3(1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
            Vec3(2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
            Vec3(2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
        )

    def rotate(self, v: Vec3) -> Vec3:
        """From the rotated frame to the parent."""
        return self.rotation().apply(v)

    def unrotate(self, v: Vec3) -> Vec3:
        """From the parent to the rotated frame."""
        return self.rotation().unapply(v)


class Pose(eqx.Module):
    """Position and orientation of a frame in its parent; `X_AB` is the pose of B in A."""

    position: Vec3
    orientation: Quaternion

    def apply(self, p: Vec3) -> Vec3:
        """A point's coordinates in the parent from those in this frame."""
        return self.position + self.orientation.rotate(p)

    def unapply(self, p: Vec3) -> Vec3:
        """A point's coordinates in this frame from those in the parent."""
        return self.orientation.unrotate(p - self.position)

    def __mul__(self, o: Pose) -> Pose:
        """X_AC = X_AB * X_BC."""
        return Pose(self.apply(o.position), self.orientation * o.orientation)


class Twist(eqx.Module):
    """Velocity of a body's reference point and angular velocity; also an acceleration or a small displacement."""

    linear: Vec3  # [m/s]
    angular: Vec3  # [rad/s]

    def plus(self, factor: Scalar | float, other: Twist) -> Twist:
        """self + factor other."""
        return Twist(self.linear + factor * other.linear, self.angular + factor * other.angular)

    def times(self, factor: Scalar | float) -> Twist:
        """factor self."""
        return Twist(factor * self.linear, factor * self.angular)

    def velocity_at(self, arm: Vec3) -> Vec3:
        """Velocity [m/s] of the body's point at the offset `arm` [m] from the reference point."""
        return self.linear + self.angular.cross(arm)


class Wrench(eqx.Module):
    """A force and its moment about a reference point."""

    force: Vec3  # [N]
    moment: Vec3  # [N m]

    @staticmethod
    def zero() -> Wrench:
        """Zero force and moment."""
        return Wrench(Vec3.zero(), Vec3.zero())

    def __add__(self, o: Wrench) -> Wrench:
        return Wrench(self.force + o.force, self.moment + o.moment)

    def power(self, twist: Twist) -> Scalar:
        """Power on a body that moves with `twist` [W]."""
        return self.force.dot(twist.linear) + self.moment.dot(twist.angular)
