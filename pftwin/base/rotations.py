"""Joint angles (clinical conventions) from orientations and back, for JAX and NumPy arrays.

All frames have x proximal, y lateral (on a right knee; a left one is mirrored on input) and z anterior. Both joints are
described by three rotations, in this order: about the femur's medial-lateral axis y, about the floating axis
perpendicular to it and to the moving bone's long axis, and about that long axis x. Angles are in radians.

patella in femur     R_FP = Ry(-flexion) Rz(rotation) Rx(-tilt)
tibia in femur       R_FT = Ry(-flexion) Rz(adduction) Rx(internal rotation)

flexion              positive as the knee bends: the patella's front turns distally, the tibia's distal end posteriorly
patellar rotation    positive internal (medial): the inferior pole moves medially
patellar tilt        positive lateral: the lateral edge moves posteriorly
tibial adduction     positive as the distal end moves medially (varus)
internal rotation    positive as the tibia's front turns medially

Gimbal lock occurs at a floating angle of +-90 deg, far outside any knee, where the first and the last axis coincide.
The last angle is then set to 0 and the first contains the whole rotation, so that the orientation is still correct and
derivatives stay finite.

Sources: Bull et al. 2002, Knee Surg Sports Traumatol Arthrosc 10:184, as used in Michaud et al. 2024 (section 2.5:
tilt, flexion and roll about x, y and z); Grood and Suntay 1983, J Biomech Eng 105:136.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from pftwin.base.spatial import Quaternion, Rotation

Angle = Any  # a JAX array or tracer, or a numpy array or number on the host [rad]

GIMBAL = 1e-7  # sine of the angle to gimbal lock below which the last angle is set to zero


class PatellarAngles(NamedTuple):
    """Orientation of the patella in the femur [rad]."""

    flexion: Angle
    rotation: Angle  # internal (medial) positive
    tilt: Angle  # lateral positive


class TibiofemoralAngles(NamedTuple):
    """Orientation of the tibia in the femur [rad]."""

    flexion: Angle
    adduction: Angle
    internal_rotation: Angle


def patellar_angles(q_FP: Quaternion) -> PatellarAngles:
    """Flexion, rotation and tilt of the patella [rad] from its orientation in the femur, in any batch."""
    y, z, x = _turns(q_FP)
    return PatellarAngles(-y, z, -x)


def patellar_orientation(flexion: Angle, rotation: Angle, tilt: Angle) -> Quaternion:
    """Orientation of the patella in the femur from its angles [rad], all of one shape."""
    return _composed(-flexion, rotation, -tilt)


def tibiofemoral_angles(q_FT: Quaternion) -> TibiofemoralAngles:
    """Flexion, adduction and internal rotation of the tibia [rad] from its orientation in the femur, in any batch."""
    y, z, x = _turns(q_FT)
    return TibiofemoralAngles(-y, z, x)


def tibiofemoral_orientation(flexion: Angle, adduction: Angle, internal_rotation: Angle) -> Quaternion:
    """Orientation of the tibia in the femur from its angles [rad], all of one shape."""
    return _composed(-flexion, adduction, internal_rotation)


def continuous_signs(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Quaternions (n, 4) with signs chosen such that successive ones are close: q and -q are the same rotation."""
    flips = np.where(np.einsum("ij,ij->i", quaternions[1:], quaternions[:-1]) < 0, -1.0, 1.0)
    return quaternions * np.concatenate([[1.0], np.cumprod(flips)])[:, None]


def _turns(q: Quaternion) -> tuple[Any, Any, Any]:
    """Angles (a, b, c) of R = Ry(a) Rz(b) Rx(c), with b in [-pi/2, pi/2] and a, c in (-pi, pi]."""
    xp = _namespace(q.w)
    r: Rotation = q.rotation()
    cosine_squared = r.ex.x * r.ex.x + r.ex.z * r.ex.z
    locked = cosine_squared < GIMBAL * GIMBAL
    cosine = xp.where(locked, 0.0, xp.sqrt(xp.where(locked, 1.0, cosine_squared)))
    # If both arguments of an arctangent vanish, its derivative is NaN even where the value is unused.
    safe_x, safe_z = xp.where(locked, r.ez.z, r.ex.x), xp.where(locked, r.ez.x, -r.ex.z)
    a = xp.arctan2(safe_z, safe_x)
    b = xp.arctan2(r.ex.y, cosine)
    c = xp.where(locked, 0.0, xp.arctan2(xp.where(locked, 0.0, -r.ez.y), xp.where(locked, 1.0, r.ey.y)))
    return a, b, c


def _composed(a: Any, b: Any, c: Any) -> Quaternion:
    """The quaternion of Ry(a) Rz(b) Rx(c)."""
    xp = _namespace(a)
    (ca, sa), (cb, sb), (cc, sc) = ((xp.cos(0.5 * t), xp.sin(0.5 * t)) for t in (a, b, c))
    zero = xp.zeros_like(ca)
    return Quaternion(ca, zero, sa, zero) * Quaternion(cb, zero, zero, sb) * Quaternion(cc, sc, zero, zero)


def _namespace(value: Any) -> Any:
    """numpy on the host (float64 whatever JAX's setting), jax.numpy for JAX's arrays and tracers."""
    return np if isinstance(value, np.ndarray | np.generic | float | int) else jnp
