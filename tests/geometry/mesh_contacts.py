"""Buttons pressed into the rig's implant, for tests of mesh contact."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from mesh_samples import corners_of, point, random_poses
from scipy.spatial.transform import Rotation

from pftwin.base.spatial import Pose, Quaternion, Vec3
from pftwin.geometry.bvh.tree import build_tree
from pftwin.geometry.bvh.triangle import Triangle, closest_on_triangle
from pftwin.geometry.bvh.wide import WideTree, nearest_wide, wide_tree
from pftwin.geometry.contact import contour
from pftwin.geometry.contact.patch_mesh import lateral_of_groove
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.geometry.patch.implant import rig_region
from pftwin.rig.contacts import implant_mesh

RADIUS = 0.025
mesh_pair = eqx.filter_jit(contour.mesh_pair)  # operation by operation it takes a quarter of a minute for each shape


def lateral(mesh: SurfaceMesh) -> np.ndarray:
    """Which triangles of the rig's implant are on the lateral facet."""
    return lateral_of_groove(mesh, rig_region(mesh))


def _foot(corners: jax.Array, p: jax.Array) -> jax.Array:
    """The point of a triangle nearest to p."""
    return closest_on_triangle(Triangle.of_rows(corners.reshape(9)), point(p)).point.array()


_feet = jax.jit(jax.vmap(_foot))


@eqx.filter_jit
def _nearest(wide: WideTree, triangles: jax.Array, places: jax.Array) -> jax.Array:
    return jax.vmap(lambda p: nearest_wide(wide, triangles, point(p)).place)(places)


def on_the_groove(n: int, depth: float, seed: int = 0, least: float = 0.2, mesh: SurfaceMesh | None = None) -> Pose:
    """Poses of a button, turned anyhow, inside the rig's implant by `least` to 1 times some depth [m]."""
    mesh, rng = implant_mesh() if mesh is None else mesh, np.random.default_rng(seed)
    middles, normals = corners_of(mesh).mean(axis=1), mesh.area_vectors / mesh.face_areas[:, None]
    near = np.flatnonzero((np.abs(middles[:, 1]) < 0.012) & (normals[:, 2] > 0.2))
    which = rng.choice(near, n)
    place = middles[which] + RADIUS * normals[which]
    wanted, corners = RADIUS - rng.uniform(least, 1, n) * depth, corners_of(mesh)
    tree = build_tree(mesh, leaf=1)
    wide = wide_tree(tree)
    for _ in range(4):  # off the facet that is nearest, until that is as deep as wanted
        nearest = tree.source_index()[_nearest(wide, tree.triangles, jnp.asarray(place))]
        on = np.asarray(_feet(corners[nearest], place))
        away = place - on
        place = on + (wanted / np.linalg.norm(away, axis=1))[:, None] * away
    return Pose(Vec3.from_array(jnp.asarray(place)), random_poses(n, seed, 0.0).orientation)


def member(poses: Pose, k: int) -> Pose:
    """One pose of a batch."""
    return jax.tree.map(lambda x: x[k], poses)


def at(x: float, y: float, z: float, turn: tuple[float, float, float] = (0.1, 0.2, 0.3)) -> Pose:
    q = Rotation.from_rotvec(turn).as_quat(scalar_first=True)
    place, orientation = ([jnp.asarray(float(c)) for c in given] for given in ((x, y, z), q))
    return Pose(Vec3(*place), Quaternion(*orientation))
