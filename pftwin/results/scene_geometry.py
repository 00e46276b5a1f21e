"""What there is to draw of a scene, as a small dataset: the group `geometry` of a result's file.

| variable | frame | what it is |
|---|---|---|
| femur_vertices, femur_triangles | femur | the contact's mesh, where it has one |
| surface_vertices, surface_triangles | femur | else its smooth surface, over the rectangle to which it was fitted |
| continuation_vertices, ..._triangles | femur | that surface beyond its rectangle, where it was touched |
| button_vertices, button_triangles | patella | the button's mesh, where it has one |
| button_center, button_radius | patella | the button's sphere, where it is one |
| pressure | - | over the depths `pressed_depth` by which surfaces overlap, where the contact tells it [Pa] |
| BODY_bone_vertices, BODY_bone_triangles | BODY | surface of femur, patella or tibia, where the scene has it |
| NAME_insertion | patella | where a tendon's, ligament's or muscle's lines end on the patella |
| NAME_origin | its attribute `body` | where they come from; with the frames' axis where that moves |

Lengths in metres. Nothing is added or smoothed: what a viewer draws besides (bones) is the viewer's.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pftwin.base.leaves import host_array
from pftwin.base.quantities import about
from pftwin.base.spatial import Vec3
from pftwin.geometry.patch.closest import Surface
from pftwin.model.effects.base import Effect
from pftwin.model.motion import KneeMotion
from pftwin.model.motion_on_host import seen_from_femur
from pftwin.model.scene import Scene

if TYPE_CHECKING:
    from xarray import Dataset

    from pftwin.model.effects.contact import Contact

ALONG = 49  # samples of a fitted rectangle, either way: a chord of a trochlea is then within 0.02 mm of it
STEP = 1.5e-3  # of a continuation, which is all but flat [m]
MARGIN = 4e-3  # how far past the outermost contact point a surface is continued [m]
ROUNDING = 1e-9  # vertices that are nearer are one [m]
Mesh = tuple[NDArray[np.float64], NDArray[np.int64]]  # vertices (n, 3) [m], triangles (m, 3)
Variables = dict[str, tuple[tuple[str, ...], Any, dict[str, Any]]]
Effects = dict[str, dict[str, NDArray[Any]]]  # what effects reported, by effect and observable


def has_rectangle(surface: Any) -> bool:
    """Whether a smooth surface says where it ends: a surface of one's own need not."""
    return hasattr(surface, "center") and hasattr(surface, "half_size")


def rectangle_of(surface: Any) -> list[tuple[float, float]]:
    """Least and largest u, and v, to which a smooth surface was fitted [m]."""
    return [(float(c - h), float(c + h)) for c, h in zip(surface.center, surface.half_size, strict=True)]


def fitted_surface(surface: Surface) -> Mesh:
    """A smooth surface over the rectangle to which it was fitted."""
    return _grid_mesh(surface, *(np.linspace(*ends, ALONG) for ends in rectangle_of(surface)))


def continuation(surface: Surface, points: NDArray[np.float64]) -> Mesh | None:
    """A smooth surface beyond its rectangle, as far as contact points (k, 3) [m] need it; None where they do not."""
    if not points.size:
        return None
    at = surface.chart.coordinates(Vec3(*points.T))
    lines, grown = [], False
    for (low, high), c in zip(rectangle_of(surface), (np.asarray(at.x), np.asarray(at.y)), strict=True):
        first, last = min(low, c.min() - MARGIN), max(high, c.max() + MARGIN)
        grown = grown or c.min() < low or c.max() > high
        before, beyond = (np.linspace(*ends, 2 + int(np.ptp(ends) / STEP)) for ends in ((first, low), (high, last)))
        lines.append(np.unique(np.concatenate([before, np.linspace(low, high, ALONG), beyond])))
    return _grid_mesh(surface, *lines, outside=True) if grown else None


def indexed(corners: ArrayLike) -> Mesh:
    """Vertices and triangles from corners (places, 9): empty places of a tree, which hold copies, drop out."""
    rows = np.asarray(corners, dtype=np.float64)
    keys, which = np.unique(np.round(rows.reshape(-1, 3) / ROUNDING).astype(np.int64), axis=0, return_inverse=True)
    faces = which.reshape(-1, 3)
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return np.multiply(keys, ROUNDING, dtype=np.float64), faces[np.sort(first)]


def _grid_mesh(surface: Any, u: NDArray[np.float64], v: NDArray[np.float64], *, outside: bool = False) -> Mesh:
    """The mesh of a grid; of its cells outside the surface's rectangle alone, if so wanted."""
    from pftwin.geometry.patch.tessellate import points_and_normals

    points, _ = points_and_normals(surface.unstacked(), *np.meshgrid(u, v, indexing="ij"))
    k = np.arange(u.size * v.size).reshape(u.size, v.size)
    a, b, c, d = k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]
    cells = np.ones(a.shape, dtype=bool)
    if outside:
        middles = (0.5 * (x[1:] + x[:-1]) for x in (u, v))
        inside = [(low < m) & (m < high) for m, (low, high) in zip(middles, rectangle_of(surface), strict=True)]
        cells = ~np.logical_and.outer(*inside)
    faces = np.stack([a[cells], b[cells], c[cells], a[cells], c[cells], d[cells]], axis=1).reshape(-1, 3)
    used, which = np.unique(faces, return_inverse=True)
    return points.reshape(-1, 3)[used], which.reshape(-1, 3)


def geometry(scene: Scene, effects: Effects | None = None) -> Dataset:
    """The dataset of a scene; what its effects reported says how far a fitted surface was touched, and is continued."""
    from xarray import Dataset

    variables: Variables = {}
    contact = scene.contact
    if contact is not None:
        femur, button = contact.femur_triangles(), contact.button_triangles()
        if femur is not None:
            variables |= _mesh("femur", indexed(femur), "femur", "the contact's mesh")
        elif scene.surface is not None and has_rectangle(scene.surface):
            variables |= _mesh("surface", fitted_surface(scene.surface), "femur", "the contact's smooth surface")
            beyond = continuation(scene.surface, _points((effects or {}).get(contact.name, {})))
            if beyond is not None:
                variables |= _mesh("continuation", beyond, "femur", "the smooth surface beyond its rectangle")
        center = host_array(contact.tracked_point())
        if button is not None:
            vertices, faces = indexed(button)
            variables |= _mesh("button", (vertices + center, faces), "patella", "the button's mesh")
        else:
            radius = np.asarray(contact.button_radius(), dtype=np.float64)
            variables["button_center"] = (("axis",), center, _about("m", "centre of the button's sphere", "patella"))
            variables["button_radius"] = ((), radius, _about("m", "radius of the button's sphere", "patella"))
        variables |= _pressures(contact)
    for body, mesh in {} if scene.bones is None else scene.bones.surfaces.items():
        variables |= _mesh(f"{body}_bone", (mesh.vertices, mesh.faces), body, f"the {body}'s bone")
    for effect in scene.effects:
        variables |= _lines(effect, scene.motion)
    axes = {"long_name": "x proximal, y lateral, z anterior", "units": "1"}
    return Dataset(variables, {"axis": (("axis",), ["x", "y", "z"], axes)})


def _lines(effect: Effect, motion: KneeMotion) -> Variables:
    """Ends of an effect's lines of force; nothing of an effect that has none."""
    element = effect.line_element()
    if element is None:
        return {}
    name, words = effect.name, effect.name.replace("_", " ")
    insertion, body = element.line_ends
    ends, line = np.atleast_2d(host_array(insertion)), f"{effect.name}_line"
    start = host_array(jax.vmap(element.origin_at)(jnp.asarray(motion.times, float)))
    if np.ptp(start, axis=0).max() == 0:  # origins that do not move on their body
        start = start[0]
    moves = start.ndim > np.ndim(host_array(insertion))
    start = start.reshape((len(motion.times), *ends.shape) if moves else ends.shape)
    if body == "ground":  # seen from a femur that moves, so does what is fixed to the ground
        start, body = seen_from_femur(motion, start), "femur"
    dimensions = (line, "axis") if start.ndim == 2 else ("time", line, "axis")
    return {
        f"{name}_insertion": ((line, "axis"), ends, _about("m", f"{words}: insertion", "patella")),
        f"{name}_origin": (dimensions, start, _about("m", f"{words}: origin", body)),
    }


def _points(report: dict[str, NDArray[Any]]) -> NDArray[np.float64]:
    """All contact points that were reported (k, 3)."""
    found = [np.asarray(v, dtype=np.float64).reshape(-1, 3) for k, v in report.items() if k.startswith("point_")]
    points = np.concatenate([*found, np.empty((0, 3))])
    return points[np.isfinite(points).all(axis=1)]


def _pressures(contact: Contact) -> Variables:
    """The law of a contact that tells pressures, as a table."""
    if contact.pressure(jnp.zeros(())) is None:
        return {}
    from pftwin.geometry.contact.depths import DEEPEST

    depths = np.linspace(0.0, DEEPEST, 101)
    pressure = np.asarray(contact.pressure(jnp.asarray(depths)), dtype=float)
    along = ("pressed_depth",)
    return {
        "pressed_depth": (along, depths, about("m", "overlap of the surfaces")),
        "pressure": (along, pressure, about("Pa", "pressure at that overlap")),
    }


def _mesh(name: str, mesh: tuple[NDArray[Any], NDArray[Any]], frame: str, words: str) -> Variables:
    vertices, triangles = mesh[0].astype(np.float32), mesh[1].astype(np.int32)
    points = _about("m", f"{words}: vertices", frame)
    faces = _about("1", f"{words}: vertices of each triangle, counter-clockwise seen from outside", frame)
    return {
        f"{name}_vertices": ((f"{name}_vertex", "axis"), vertices, points),
        f"{name}_triangles": ((f"{name}_triangle", "corner"), triangles, faces),
    }


def _about(unit: str, long_name: str, body: str) -> dict[str, str]:
    return {**about(unit, f"{long_name} ({body} frame)"), "body": body}
