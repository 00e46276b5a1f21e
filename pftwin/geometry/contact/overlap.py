"""Indentations from the patch inside a sphere: of each facet, and of both if they have merged into one contact.

See `pftwin.model.effects.mesh_volume_contact` for the law that this serves.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import ArrayLike, NDArray

from pftwin.base.errors import InputError
from pftwin.base.spatial import Scalar, Vec3, safe_sqrt
from pftwin.geometry.contact.ball_cut import BallCut
from pftwin.geometry.contact.patch_mesh import PatchMesh, SeamDepth
from pftwin.geometry.contact.sphere_patch import Patch, sphere_patch
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.geometry.patch.region import TrochlearRegion

ONE_CONTACT = 3.0  # value of depth^2 pi r (1 / V_m + 1 / V_l) from which two facets form one contact
MICRO = 1e6  # micrometres per metre: squares of denominators stay in single precision's range down to 0.001 nm
_PARABOLA = 1.25  # height of a parabola divided by the ratio of the integrals of its square and itself


class Overlap(NamedTuple):
    """Indentations of a mesh by a sphere; pairs are the medial and the lateral facet."""

    depths: tuple[Scalar, Scalar]  # d [m]
    normals: tuple[Vec3, Vec3]  # -grad d with respect to the centre, mesh frame; of length 1 on a smooth surface
    joint_depth: Scalar  # d of the sum of both volumes [m]
    parts: tuple[Scalar, Scalar]  # slope of the joint depth with respect to each d
    merged: Scalar  # s, from 0 (two contacts) to 1 (one contact)
    merged_slope: Vec3  # grad s [1/m]
    areas: tuple[Scalar, Scalar]  # [m^2]
    arms: tuple[Vec3, Vec3]  # first moment of the area about the centre [m^3]
    overflow: Array


def overlap(patch: Patch, radius: Scalar, effective_radius: Scalar) -> Overlap:
    """Indentations of a patch inside a sphere of radius R (`radius`), with the gap's effective radius r [m]."""
    cuts, seam = patch.sums.facets, patch.sums.seam
    scale = 2 * math.pi * effective_radius * radius  # V / (pi r) from 2 R V
    squares = [jnp.maximum(c.doubled, 0.0) / scale for c in cuts]
    # A centre behind the surface has to move out the long way.
    behind = cuts[0].flux + cuts[1].flux > 0
    means = [safe_sqrt(x) for x in squares]
    joint = safe_sqrt(squares[0] + squares[1])
    joint_depth, joint_slope = _out_of_power(joint, radius, behind)
    depths, normals, parts = [], [], []
    for cut, mean in zip(cuts, means, strict=True):
        d, slope = _out_of_power(mean, radius, behind)
        touched = mean > 0
        over = jnp.where(touched, 1 / (scale * jnp.where(touched, mean, 1.0)), 0.0)
        depths.append(jnp.where(touched, d, 0.0))
        normals.append((-slope * over) * cut.moment)
        parts.append(jnp.where(touched, joint_slope * mean / (slope * jnp.where(joint > 0, joint, 1.0)), 0.0))
    joint_depth = jnp.where(joint > 0, joint_depth, 0.0)
    merged, merged_slope = _merged_square(cuts, squares, seam, scale)
    return Overlap(
        (depths[0], depths[1]),
        (normals[0], normals[1]),
        joint_depth,
        (parts[0], parts[1]),
        merged,
        merged_slope,
        (cuts[0].area, cuts[1].area),
        (cuts[0].moment, cuts[1].moment),
        patch.overflow,
    )


def _out_of_power(power: Scalar, radius: Scalar, behind: Array) -> tuple[Scalar, Scalar]:
    """Indentation of a point with the power (R^2 - |q|^2) / (2 R), and its slope.

    R - sqrt(R^2 - 2 R power) = power (1 + x / 2 + x^2 / 2 + 5 x^3 / 8 + ...) with x = power / R. The series, unlike the
    root, is defined for every power; its error is within 1e-5 up to a twentieth of the radius.
    """
    x = power / radius
    d, slope = power * (1 + 0.5 * x * (1 + x * (1 + 1.25 * x))), 1 + x * (1 + x * (1.5 + 2.5 * x))
    return jnp.where(behind, 2 * radius - d, d), jnp.where(behind, -slope, slope)


def _merged_square(
    cuts: tuple[BallCut, BallCut], squares: list[Scalar], seam: SeamDepth, scale: Scalar
) -> tuple[Scalar, Vec3]:
    """s and its gradient with respect to the sphere's centre; computed in micrometres."""
    both = (squares[0] > 0) & (squares[1] > 0) & (seam.depth > 0) & (seam.square > 0)
    area, volume = MICRO**2, MICRO**3
    micro = (area * squares[0], area * squares[1], area * seam.depth, volume * seam.square)
    m, v, along, square = (jnp.where(both, x, 1.0) for x in micro)
    depth = _PARABOLA * square / along
    t = (depth * depth / ONE_CONTACT) * (1 / m + 1 / v)
    partly = both & (t < 1)
    u = jnp.where(partly, t, 1.0)
    s = jnp.where(both, u * u * (3 - 2 * u), 0.0)
    slope = jnp.where(partly, 6 * u * (1 - u), 0.0)
    # The derivative of t by the depth, and by each volume V, where 2 R V has the gradient 2 * moment.
    by_depth = (2 * t * slope) * ((volume / square) * seam.square_slope - (area / along) * seam.depth_slope)
    # Quotients of similar size, since 1 / m^2 has a derivative with m^4, too small for single precision if shallow.
    rest, by_m, by_v = (slope / ONE_CONTACT) * (-2 / scale), MICRO * depth / m, MICRO * depth / v
    by_volume = (rest * by_m * by_m) * cuts[0].moment + (rest * by_v * by_v) * cuts[1].moment
    return s, by_depth + by_volume


DEPTH = 0.008  # indentation at which the effective radius is measured, in radii
PLACES = 256  # sample points on the mesh
LEAST = 16  # fewest sample points with a single contact


def effective_radius(mesh: SurfaceMesh, patch: PatchMesh, radius: float, near: ArrayLike | None = None) -> float:
    """Effective radius of the gap [m]: median of V / (pi d^2) over points where a sphere indents the mesh by d.

    Args:
        mesh: in the femur's frame [m].
        patch: the same mesh, from `patch_mesh`.
        radius: of the sphere [m].
        near: which vertices to use, (n,) bool, for instance from `beside_groove`; None: all.

    Raises:
        InputError: a mask that does not match the mesh; too few points where the sphere is not deeper elsewhere.
    """
    used = np.ones(len(mesh.vertices), bool) if near is None else np.asarray(near)
    if used.shape != (len(mesh.vertices),):
        raise InputError(f"a mask of shape {used.shape}", where="near", expected=f"({len(mesh.vertices)},)")
    faces = np.flatnonzero(used[mesh.faces].all(axis=1) & (mesh.face_areas > 0))
    if not len(faces):
        raise InputError("no triangle to measure on", where=mesh.source, expected="a mask with triangles in it")
    faces = faces[np.linspace(0, len(faces) - 1, PLACES).astype(int)]
    depth = DEPTH * radius
    normals = mesh.area_vectors[faces] / mesh.face_areas[faces, None]
    centers = mesh.vertices[mesh.faces[faces]].mean(axis=1) + (radius - depth) * normals
    dtype = patch.facets.triangles.dtype
    found = _volumes(patch.prepared(), jnp.asarray(centers, dtype), jnp.asarray(radius, dtype))
    doubled, distance = (np.asarray(a, dtype=np.float64) for a in found)
    alone = np.abs(distance - (radius - depth)) < 0.1 * depth
    if alone.sum() < LEAST:
        raise InputError(
            f"a sphere of radius {1e3 * radius:g} mm touches at {alone.sum()} of {PLACES} places without going deeper"
            " elsewhere",
            where=mesh.source,
            remedy="give the effective radius of the contact yourself",
        )
    power = depth - depth**2 / (2 * radius)
    return float(np.median(doubled[alone])) / (2 * radius * math.pi * power**2)


@jax.jit
def _volumes(patch: PatchMesh, centers: jax.Array, radius: jax.Array) -> tuple[jax.Array, jax.Array]:
    """2 R V, and the distance to the surface [m], for each centre."""

    def one(c: jax.Array) -> tuple[jax.Array, jax.Array]:
        center = Vec3.from_array(c)
        medial, lateral = sphere_patch(patch, center, radius).sums.facets
        distances = jnp.stack([p.distance for p in patch.facets.points(center)])
        return medial.doubled + lateral.doubled, jnp.min(distances)

    return jax.lax.map(one, centers)


def beside_groove(mesh: SurfaceMesh, region: TrochlearRegion, distance: float) -> NDArray[np.bool_]:
    """Which vertices are in a region and within `distance` [m] of its groove line, (n,): where a button tracks."""
    gap = np.linalg.norm(mesh.vertices[:, None] - region.groove[None], axis=2).min(axis=1)
    return region.mask & (gap <= distance)
