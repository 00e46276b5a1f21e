"""Solid parts of a drawn knee: bones, femoral component and button. Bones without a surface in the scene are schematic
bones of a normal knee, placed below the contact surfaces; they have no effect on the simulation. Contact colours on the
femur show the overlap depth of the two surfaces or, for contact of elastic layers, the pressure at that depth.

Depths are computed from the drawn meshes: depth of a femoral vertex below the tangent plane at the nearest patellar
vertex, or below the button's sphere. They show the location of contact; forces come from the simulation.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pftwin.base.arrays import Floats
from pftwin.geometry.bones.anatomy import Anatomy
from pftwin.geometry.bones.implicit import smooth_step
from pftwin.geometry.bones.surfaces import bones
from pftwin.geometry.bones.tibiofemoral import TibiaShape
from pftwin.results.viewer.recorded import Mesh, Recorded
from pftwin.results.viewer.shapes import (
    CAP,
    MM,
    MOST_TRIANGLES,
    Shape,
    behind_plane,
    button_cap,
    shell,
    surface,
)

METAL, BONE, PLASTIC = "#A9B4C0", "#E9DFC9", "#F4F1E6"
NORMAL = Anatomy(tt_tg_mm=0.0)  # anatomy of schematic bones
PLATEAU_AT = 0.45  # height of the plateau as a share of the way from the tibia's origin down to the tuberosity
PROUD = 2.0  # height of a tendon's origin above the tuberosity [mm]
BUMP = 26.0, 13.0  # length scales of the tuberosity along and across the tibia [mm]
MOST_FORWARD = 12.0  # largest anterior or posterior shift of a schematic tibia towards its tendon [mm]
COARSE = 2.5  # triangle size of schematic bones [mm]
UNDER = 3.0  # depth of the schematic femur below its component [mm]
FADING = 20.0, 60.0  # angles past the component's upper and lower ends over which that depth fades out [deg]
RIM = 4.0  # margin of the patella's body around its tendons [mm]
FARTHEST = 6.0  # femoral vertices farther than this from the patella's vertices have depth zero [mm]
SMALLEST = 0.02  # smaller depths are not coloured [mm]
HOT = ((0.25, "#F2C14E"), (0.6, "#E4572E"), (1.0, "#7A0C2E"))  # share of the largest value, colour
SAME = 1e-6  # vertices of files that are closer are equal [m]


class Solid(NamedTuple):
    """A solid part with its default look."""

    name: str
    frame: str  # body that carries it: "femur", "tibia" or "patella"
    shape: Shape  # in that frame [mm]
    colour: str
    opacity: float = 1.0


def bone(result: Recorded, body: str, most: int = MOST_TRIANGLES) -> Solid | None:
    """Returns a bone's surface from the scene, reduced to `most` triangles; None if the scene has none."""
    mesh = result.mesh(f"{body}_bone")
    return None if mesh is None else Solid(body, body, surface(mesh, most), BONE)


def femur(result: Recorded, most: int = MOST_TRIANGLES) -> Solid:
    """Returns the scene's femur, or else a schematic one below the femoral component."""
    if (own := bone(result, "femur", most)) is not None:
        return own
    component = result.mesh("femur") or result.mesh("surface")
    vertices, triangles = _normal("femur")
    if component is not None:
        points = MM * component[0]
        low, high = points.min(axis=0), points.max(axis=0)
        axis = np.array([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), high[2] - NORMAL.trochlear_radius_mm - 4])
        vertices = axis + _below(vertices, points - axis)
    return Solid("femur (schematic)", "femur", Shape(vertices.astype(np.float32), triangles), BONE)


def _below(vertices: Floats, component: Floats) -> Floats:
    """Moves a femur's vertices (n, 3) below a component's (m, 3) along rays from the trochlear axis, y [mm]."""
    from scipy.interpolate import NearestNDInterpolator

    def cylindrical(points: Floats) -> tuple[Floats, Floats, Floats]:
        return np.degrees(np.arctan2(points[:, 0], points[:, 2])), np.hypot(points[:, 0], points[:, 2]), points[:, 1]

    around, out, across = cylindrical(component)
    low, high = around.min(), around.max()
    angle, radius, y = cylindrical(vertices)
    within = np.clip(angle, low, high)
    limit = NearestNDInterpolator(np.stack([0.4 * around, across], axis=1), out)(0.4 * within, y) - UNDER
    share = 1 - smooth_step(np.abs(angle - within) / np.where(angle > high, *FADING))
    factor = 1 - share * np.maximum(1 - limit / radius, 0.0)
    return vertices * np.stack([factor, np.ones_like(factor), factor], axis=1)


def femoral_component(result: Recorded, most: int = MOST_TRIANGLES) -> list[Solid]:
    """Returns the component's mesh, reduced to `most` triangles, or its smooth surface and the extrapolated part that
    was touched. Empty if the mesh is part of the bone's surface.
    """
    mesh, fitted, beyond = (result.mesh(name) for name in ("femur", "surface", "continuation"))
    found = []
    if mesh is not None and not _part_of(mesh, result.mesh("femur_bone")):
        found.append(Solid("femoral mesh", "femur", surface(mesh, most), METAL))
    if fitted is not None:
        found.append(Solid("femoral surface", "femur", shell(fitted), METAL))
    if beyond is not None:
        found.append(Solid("surface continued", "femur", surface(beyond, most), METAL, 0.6))
    return found


def tibia(result: Recorded, most: int = MOST_TRIANGLES) -> Solid:
    """Returns the scene's tibia, or else a schematic one with its tuberosity behind the patellar tendon's origin."""
    if (own := bone(result, "tibia", most)) is not None:
        return own
    ends = [MM * lines.origin.reshape(-1, 3) for lines in result.lines.values() if lines.body == "tibia"]
    tuberosity = np.concatenate(ends).mean(axis=0) if ends else np.array([-75.0, 0.0, 40.0])
    top = PLATEAU_AT * tuberosity[0] if tuberosity[0] < 0 else tuberosity[0] + 40.0
    vertices, triangles = _normal("tibia")
    shape = TibiaShape(NORMAL)
    at = np.array(shape.tuberosity)
    stretch = (tuberosity[0] - top) / (at[0] - shape.plateau)
    forward = np.clip(tuberosity[2] - PROUD - at[2], -MOST_FORWARD, MOST_FORWARD)
    placed = (vertices - [shape.plateau, 0, 0]) * [stretch, 1, 1] + [top, 0.0, forward]
    near = np.exp(-(((placed[:, :2] - tuberosity[:2]) / BUMP) ** 2)).prod(axis=1) * np.clip(placed[:, 2] / at[2], 0, 1)
    placed[:, 2] += max(tuberosity[2] - PROUD - at[2] - forward, 0.0) * near
    return Solid("tibia (schematic)", "tibia", Shape(placed.astype(np.float32), triangles), BONE)


def patella_parts(result: Recorded, most: int = MOST_TRIANGLES) -> list[Solid]:
    """Returns the patella, schematic if the scene has no surface of it, and its button if it is a separate part."""
    schematic = Solid("patella (schematic)", "patella", _patella_body(result), BONE)
    body = bone(result, "patella", most) or schematic
    mesh = result.mesh("button")
    if mesh is not None and _part_of(mesh, result.mesh("patella_bone")):
        return [body]
    if mesh is not None:
        button = behind_plane(surface(mesh, most), float(body.shape.vertices[:, 2].mean()))
    elif "button_radius" in result.geometry:
        button = button_cap(result.geometry["button_center"].values, float(result.geometry["button_radius"]))
    else:
        return [body]
    return [body, Solid("button", "patella", button, PLASTIC, 0.75)]


def _part_of(mesh: Mesh, whole: Mesh | None) -> bool:
    """Whether all vertices of a mesh are vertices of a bone's surface, as may be the case for its cartilage."""
    from scipy.spatial import KDTree

    return whole is not None and bool(np.max(KDTree(whole[0]).query(mesh[0])[0]) < SAME)


def _patella_body(result: Recorded) -> Shape:
    """A schematic patella that covers all insertions, with a flat back if it carries a button."""
    vertices, triangles = _normal("patella")
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    ends = [MM * lines.insertion for lines in result.lines.values()]
    points = np.concatenate(ends) if ends else np.array([[20.0, 0, -8], [-20.0, 0, -8]])
    first, last = points.min(axis=0), points.max(axis=0)
    scale = np.clip((last[0] - first[0] + 2 * RIM) / (high[0] - low[0]), 0.8, 1.3)
    middle = 0.5 * (first + last)
    vertices = scale * (vertices - 0.5 * (low + high)) + middle
    back = _back_of_bone(result)
    if back is not None:
        depth = vertices[:, 2].max() - back
        vertices[:, 2] = np.maximum(vertices[:, 2] + max(0.0, 10.0 - depth), back)
    return Shape(vertices.astype(np.float32), triangles)


def _back_of_bone(result: Recorded) -> float | None:
    """Depth z, in the patella's frame, at which the button's sphere meets the bone [mm]; None without a sphere."""
    if "button_radius" not in result.geometry:
        return None
    radius = MM * float(result.geometry["button_radius"])
    return float(MM * result.geometry["button_center"].values[2]) - radius * np.cos(CAP)


def _normal(body: str) -> tuple[Floats, NDArray[np.uint32]]:
    """A bone of a normal knee in its own frame: vertices [mm] and triangles."""
    mesh = getattr(bones(NORMAL, COARSE), body)
    return MM * mesh.vertices, mesh.faces.astype(np.uint32)


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
