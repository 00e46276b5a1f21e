"""Where the patella presses on the femur, as colours on the femur's surface: how deep the two surfaces overlap, or,
where the contact tells it (elastic layers), the pressure at that depth.

Depths are those of the drawing: of the femur's vertices below the patella's, by the plane of the nearest vertex, or
below the button's sphere. They show where contact is and how it moves; forces and pressures are the simulation's.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.results.viewer.recorded import Recorded
from pftwin.results.viewer.shapes import MM

FARTHEST = 6.0  # nearest vertices that are farther are of another part [mm]
SMALLEST = 0.02  # depths below it are not coloured at all [mm]
HOT = ((0.25, "#F2C14E"), (0.6, "#E4572E"), (1.0, "#7A0C2E"))  # share of the largest depth, colour


def depths_on_femur(result: Recorded, vertices: Floats) -> Floats | None:
    """Depths of vertices (v, 3) [mm] of the femur below the patella's surface, at the frames shown (n, v) [mm].

    None where the patella has no surface, or is nowhere below it.
    """
    turn, place = (result.patella[:, :3, k].astype(np.float64) for k in (slice(0, 3), 3))
    local = np.einsum("nji,nvj->nvi", turn, vertices - place[:, None])  # in the patella's frame
    mesh = result.mesh("button")
    if mesh is not None:
        depth = _below_mesh(local, MM * mesh[0], mesh[1])
    elif "button_radius" in result.geometry:
        center = MM * result.geometry["button_center"].values
        depth = MM * float(result.geometry["button_radius"]) - np.linalg.norm(local - center, axis=2)
    else:
        return None
    depth = np.where(depth > SMALLEST, depth, 0.0)
    return depth if depth.any() else None


def tells_pressure(results: Sequence[Recorded]) -> bool:
    """Whether the contacts of all results tell pressures, which their colours then show."""
    return all("pressure" in r.geometry for r in results)


def pressures(result: Recorded, depths: Floats) -> Floats:
    """Pressures at rest [MPa] at depths [mm] of any shape."""
    table = result.geometry["pressure"]
    return np.interp(1e-3 * depths, table["pressed_depth"].values, 1e-6 * table.values)


def _below_mesh(points: Floats, vertices: Floats, triangles: np.ndarray) -> Floats:
    """Depths of points (n, v, 3) below a mesh, zero far from it."""
    from scipy.spatial import KDTree
    from trimesh import Trimesh

    mesh = Trimesh(vertices, triangles, process=False)
    low, high = vertices.min(axis=0) - FARTHEST, vertices.max(axis=0) + FARTHEST
    near = ((points > low) & (points < high)).all(axis=2)
    asked = points[near]
    distance, nearest = (np.asarray(a) for a in KDTree(vertices).query(asked, distance_upper_bound=FARTHEST))
    found = np.isfinite(distance)
    foot = nearest[found]
    below = np.zeros(len(asked))
    below[found] = np.einsum("ki,ki->k", vertices[foot] - asked[found], mesh.vertex_normals[foot])
    depth = np.zeros(near.shape)
    depth[near] = below
    return depth
