"""Random triangles and poses for tests of tree searches; sizes are fixed so that programs are shared."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from pftwin.base.spatial import Pose, Quaternion, Vec3
from pftwin.geometry.mesh.mesh import SurfaceMesh


def soup(seed: int, n: int = 60, size: float = 0.02) -> SurfaceMesh:
    """Unconnected triangles of all sizes in a cube of 0.1 m; some needles, one without area."""
    rng = np.random.default_rng(seed)
    middles = rng.uniform(-0.05, 0.05, (n, 1, 3))
    arms = rng.normal(size=(n, 3, 3)) * size * 10.0 ** rng.uniform(-2, 0, (n, 1, 1))
    arms[: n // 5, 2] = 0.999 * arms[: n // 5, 1] + 1e-3 * arms[: n // 5, 0]
    corners = middles + arms
    corners[-1] = corners[-1, :1]
    return SurfaceMesh(corners.reshape(-1, 3), np.arange(3 * n).reshape(n, 3), "soup")


def point(p: np.ndarray) -> Vec3:
    return Vec3(p[..., 0], p[..., 1], p[..., 2])


def random_poses(n: int, seed: int, reach: float) -> Pose:
    """A batch of n poses: any turn, any place within reach of the origin."""
    rng = np.random.default_rng(seed)
    q = rng.normal(size=(n, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    place = rng.uniform(-reach, reach, (n, 3))
    return Pose(Vec3(*map(jnp.asarray, place.T)), Quaternion(*map(jnp.asarray, q.T)))


def corners_of(mesh: SurfaceMesh, pose: Pose | None = None) -> np.ndarray:
    """Triangles (m, 3, 3), moved by a pose."""
    p = mesh.vertices if pose is None else np.asarray(pose.apply(Vec3.from_array(mesh.vertices)).array())
    return p[mesh.faces]
