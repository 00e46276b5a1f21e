"""What there is to draw of a scene, as a small dataset: the group `geometry` of a result's file.

| variable | frame | what it is |
|---|---|---|
| femur_vertices, femur_triangles | femur | the contact's mesh, where it has one |
| surface_vertices, surface_triangles | femur | else its smooth surface, over the rectangle to which it was fitted |
| continuation_vertices, ..._triangles | femur | that surface beyond its rectangle, where it was touched |
| button_vertices, button_triangles | patella | the button's mesh, where it has one |
| button_center, button_radius | patella | the button's sphere, where it is one |
| NAME_insertion | patella | where a tendon's, ligament's or muscle's lines end on the patella |
| NAME_origin | its attribute `body` | where they come from; with the frames' axis where that moves |

Lengths in metres. Nothing is added or smoothed: what a viewer draws besides (bones) is the viewer's.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from pftwin.base.spatial import Vec3
from pftwin.model.effects.base import Effect
from pftwin.model.motion import KneeMotion
from pftwin.model.motion_on_host import seen_from_femur
from pftwin.model.scene import Scene

if TYPE_CHECKING:
    from xarray import Dataset

Variables = dict[str, tuple[tuple[str, ...], Any, dict[str, Any]]]
Effects = dict[str, dict[str, NDArray[Any]]]  # what effects reported, by effect and observable


def geometry(scene: Scene, effects: Effects | None = None) -> Dataset:
    """The dataset of a scene.

    Args:
        scene: what was simulated.
        effects: what its effects reported: contact points say how far a fitted surface has to be continued.
    """
    from xarray import Dataset

    from pftwin.results.drawn_surface import continuation, fitted_surface, has_rectangle, indexed

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
        center = _rows(contact.tracked_point())
        if button is not None:
            vertices, faces = indexed(button)
            variables |= _mesh("button", (vertices + center, faces), "patella", "the button's mesh")
        else:
            radius = np.asarray(contact.button_radius(), dtype=np.float64)
            variables["button_center"] = (("axis",), center, _about("m", "centre of the button's sphere", "patella"))
            variables["button_radius"] = ((), radius, _about("m", "radius of the button's sphere", "patella"))
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
    ends, line = np.atleast_2d(_rows(insertion)), f"{effect.name}_line"
    start = _rows(jax.vmap(element.origin_at)(jnp.asarray(motion.times, float)))
    if np.ptp(start, axis=0).max() == 0:  # origins that do not move on their body
        start = start[0]
    moves = start.ndim > np.ndim(_rows(insertion))
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


def _mesh(name: str, mesh: tuple[NDArray[Any], NDArray[Any]], frame: str, words: str) -> Variables:
    vertices, triangles = mesh
    return {
        f"{name}_vertices": (
            (f"{name}_vertex", "axis"),
            vertices.astype(np.float32),
            _about("m", f"{words}: vertices", frame),
        ),
        f"{name}_triangles": (
            (f"{name}_triangle", "corner"),
            triangles.astype(np.int32),
            _about("1", f"{words}: vertices of each triangle, counter-clockwise seen from outside", frame),
        ),
    }


def _about(unit: str, long_name: str, body: str) -> dict[str, str]:
    return {"units": unit, "long_name": f"{long_name} ({body} frame)", "body": body}


def _rows(v: Vec3) -> NDArray[np.float64]:
    return np.stack([np.asarray(c, dtype=np.float64) for c in (v.x, v.y, v.z)], axis=-1)
