"""Drawable geometry of a scene as an xarray Dataset: the group `geometry` of a result's file.

| variable | frame | content |
|---|---|---|
| femur_vertices, femur_triangles | femur | the contact's femoral mesh, if it has one |
| surface_vertices, surface_triangles | femur | otherwise its smooth surface over the fitted rectangle |
| continuation_vertices, ..._triangles | femur | extrapolation of that surface, where it was touched |
| button_vertices, button_triangles | patella | the button's mesh, if it has one |
| button_center, button_radius | patella | otherwise the button's sphere |
| pressure | - | pressure [Pa] over the overlap `pressed_depth` of the surfaces, if the contact computes it |
| BODY_bone_vertices, BODY_bone_triangles | BODY | surface of femur, patella or tibia, if the scene has it |
| NAME_insertion | patella | insertions of the lines of a tendon, ligament or muscle |
| NAME_origin | its attribute `body` | origins of those lines; with a time axis if they move |
| NAME_arc | its attribute `body` | points on their obstacle, NaN where straight; absent if none touches |

Lengths are in metres. Nothing is added or smoothed: the viewer itself adds schematic bones.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pftwin.base.leaves import host_array
from pftwin.base.quantities import about
from pftwin.base.spatial import Pose, Quaternion, Vec3
from pftwin.geometry.patch.closest import Surface, rectangle_of
from pftwin.geometry.wrapping.obstacle import Obstacle
from pftwin.model.effects.base import Effect
from pftwin.model.motion import KneeMotion
from pftwin.model.motion_on_host import seen_from_femur
from pftwin.model.scene import Scene

if TYPE_CHECKING:
    from xarray import Dataset

    from pftwin.model.effects.contact import Contact

ALONG = 49  # samples along each side of a fitted rectangle: the triangles stay within 0.02 mm of a trochlea
STEP = 1.5e-3  # grid spacing of an extrapolated surface, which is almost flat [m]
MARGIN = 4e-3  # extrapolation past the outermost contact point [m]
ROUNDING = 1e-9  # closer vertices are merged [m]
ON_ARC = 8  # points of a line on its obstacle: on a quarter of a circle the chords are within 0.7 % of its radius
Mesh = tuple[NDArray[np.float64], NDArray[np.int64]]  # vertices (n, 3) [m], triangles (m, 3)
Variables = dict[str, tuple[tuple[str, ...], Any, dict[str, Any]]]
Effects = dict[str, dict[str, NDArray[Any]]]  # values by effect and observable
Poses = dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]  # of bodies in the femur: see `Result.poses`


def fitted_surface(surface: Surface) -> Mesh:
    """Returns the mesh of a smooth surface over the rectangle to which it was fitted."""
    return _grid_mesh(surface, *(np.linspace(*ends, ALONG) for ends in rectangle_of(surface)))


def continuation(surface: Surface, points: NDArray[np.float64]) -> Mesh | None:
    """Returns a surface's mesh outside its rectangle as far as contact points (k, 3) [m] reach; None if all inside."""
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
    """Returns vertices and triangles from triangle corners (k, 9) [m]; duplicates (padding of a tree) are removed."""
    rows = np.asarray(corners, dtype=np.float64)
    keys, which = np.unique(np.round(rows.reshape(-1, 3) / ROUNDING).astype(np.int64), axis=0, return_inverse=True)
    faces = which.reshape(-1, 3)
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return np.multiply(keys, ROUNDING, dtype=np.float64), faces[np.sort(first)]


def _grid_mesh(surface: Any, u: NDArray[np.float64], v: NDArray[np.float64], *, outside: bool = False) -> Mesh:
    """The mesh of a grid; with `outside`, only the cells outside the surface's rectangle."""
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


def geometry(scene: Scene, effects: Effects | None = None, poses: Poses | None = None) -> Dataset:
    """Returns a scene's geometry dataset.

    The contact points in `effects` set how far a surface is extrapolated. Without `poses` lines have no arcs.
    """
    from xarray import Dataset

    variables: Variables = {}
    contact = scene.contact
    if contact is not None:
        femur, button = contact.femur_triangles(), contact.button_triangles()
        if femur is not None:
            variables |= _mesh("femur", indexed(femur), "femur", "the contact's mesh")
        elif scene.surface is not None:
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
        variables |= _lines(effect, scene.motion, poses)
    axes = {"long_name": "x proximal, y lateral, z anterior", "units": "1"}
    return Dataset(variables, {"axis": (("axis",), ["x", "y", "z"], axes)})


def _lines(effect: Effect, motion: KneeMotion, poses: Poses | None) -> Variables:
    """End points and arcs of an effect's lines of force; empty for an effect without lines."""
    element = effect.line_element()
    if element is None:
        return {}
    name, words = effect.name, effect.name.replace("_", " ")
    insertion, body = element.line_ends
    ends, line = np.atleast_2d(host_array(insertion)), f"{effect.name}_line"
    start = host_array(jax.vmap(element.origin_at)(jnp.asarray(motion.times, float)))
    if np.ptp(start, axis=0).max() == 0:  # origins fixed on their body
        start = start[0]
    moves = start.ndim > np.ndim(host_array(insertion))
    start = start.reshape((len(motion.times), *ends.shape) if moves else ends.shape)
    if body == "ground":  # points fixed to the ground move in the frame of a moving femur
        start, body = seen_from_femur(motion, start), "femur"
    dimensions = (line, "axis") if start.ndim == 2 else ("time", line, "axis")
    found: Variables = {
        f"{name}_insertion": ((line, "axis"), ends, _about("m", f"{words}: insertion", "patella")),
        f"{name}_origin": (dimensions, start, _about("m", f"{words}: origin", body)),
    }
    if element.wrap is not None and poses is not None:
        places = (jnp.asarray(p, float) for p in (ends, np.broadcast_to(start, (len(motion.times), *ends.shape))))
        arcs = np.asarray(_arcs(element.wrap, *places, body, poses), dtype=np.float32)
        if np.isfinite(arcs).any():
            of = _about("m", f"{words}: points on its obstacle, NaN where straight", element.wrap.body)
            found[f"{name}_arc"] = (("time", line, "arc_point", "axis"), arcs, of)
    return found


@partial(jax.jit, static_argnames="body")
def _arcs(obstacle: Obstacle, insertion: jax.Array, origin: jax.Array, body: str, poses: Poses) -> jax.Array:
    """Points of lines on their obstacle, in the frame of its body (n, lines, ON_ARC, 3) [m]; NaN where straight.

    Origins (n, lines, 3) are in the frame of `body`.
    """

    def at_frame(origin: jax.Array, poses: Poses) -> jax.Array:
        frames = {b: Pose(Vec3.from_array(p), Quaternion.from_array(q)) for b, (p, q) in poses.items()}
        ends = (Vec3.from_array(insertion), "patella"), (Vec3.from_array(origin), body)
        start, end = (frames[own].apply(p) if own in frames else p for p, own in ends)
        if obstacle.body in frames:
            start, end = (frames[obstacle.body].unapply(p) for p in (start, end))
        return jnp.swapaxes(obstacle.arc(start, end, ON_ARC).array(), 0, 1)

    return jax.vmap(at_frame)(origin, poses)


def _points(report: dict[str, NDArray[Any]]) -> NDArray[np.float64]:
    """All finite contact points that an effect reports (k, 3) [m]."""
    found = [np.asarray(v, dtype=np.float64).reshape(-1, 3) for k, v in report.items() if k.startswith("point_")]
    points = np.concatenate([*found, np.empty((0, 3))])
    return points[np.isfinite(points).all(axis=1)]


def _pressures(contact: Contact) -> Variables:
    """Table of pressure over overlap; empty for a contact without a pressure law."""
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
