"""Contact colours on the femur's surface: the overlap depth of the two surfaces or, for contact of elastic layers, the
pressure at that depth.

Depths are computed from the drawn meshes: depth of a femoral vertex below the tangent plane at the nearest patellar
vertex, or below the button's sphere. They show the location of contact; forces come from the simulation.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.results.viewer.recorded import Recorded
from pftwin.results.viewer.shapes import MM

FARTHEST = 6.0  # femoral vertices farther than this from the patella's vertices have depth zero [mm]
SMALLEST = 0.02  # smaller depths are not coloured [mm]
HOT = ((0.25, "#F2C14E"), (0.6, "#E4572E"), (1.0, "#7A0C2E"))  # share of the largest value, colour


def depths_on_femur(result: Recorded, vertices: Floats) -> Floats | None:
    """Returns depths of femoral vertices (v, 3) [mm] below the patella's surface at the shown frames, (n, v) [mm].

    None if the patella has no surface or the surfaces never overlap.
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
    """Whether all results have a pressure law, so that the colours show pressure."""
    return all("pressure" in r.geometry for r in results)


def pressures(result: Recorded, depths: Floats) -> Floats:
    """Returns quasi-static pressures [MPa] at depths [mm] of any shape."""
    table = result.geometry["pressure"]
    return np.interp(1e-3 * depths, table["pressed_depth"].values, 1e-6 * table.values)


def _below_mesh(points: Floats, vertices: Floats, triangles: np.ndarray) -> Floats:
    """Depths of points (n, v, 3) below a mesh [mm]; zero far from it."""
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
