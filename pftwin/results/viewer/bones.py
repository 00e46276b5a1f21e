"""The solid parts of a knee as every drawing shows them: bones, component, button. Bones that a scene has no surfaces
of are simple solids, called schematic."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pftwin.results.viewer.recorded import Mesh, Recorded
from pftwin.results.viewer.shapes import (
    MM,
    MOST_TRIANGLES,
    Shape,
    behind_plane,
    button_cap,
    ellipsoid,
    shell,
    solid_of_revolution,
    surface,
)

METAL, BONE, PLASTIC = "#A9B4C0", "#E9DFC9", "#F4F1E6"
# Half width and height along the bone [mm]: the femur's from behind its component upwards, the tibia's down from its
# plateau. Between them the outline is smooth.
FEMUR = ((0, -20), (12, -19.5), (21, -16), (26, -8), (26, 3), (21, 16), (15, 34), (12.5, 60), (12.5, 150), (0, 150))
TIBIA = ((0, -150), (11, -150), (12, -80), (15, -58), (20, -40), (28, -22), (35, -9), (36, -4), (33, -0.5), (0, 0))
DEPTH = 0.72  # of a bone, front to back, as a share of its width
PLATEAU_AT = 0.45  # of the way from the tibia's origin down to the tuberosity
PROUD = 2.0  # of the tuberosity before the plateau's front [mm]
RIM = 4.0  # of the patella's body beyond its tendons [mm]
SAME = 1e-6  # vertices of files that are nearer are one [m]
BEHIND = 30.0  # the femur's axis behind the front of its component [mm]


class Solid(NamedTuple):
    """A part, and how it is drawn where nothing else is said."""

    name: str
    frame: str  # that carries it: "femur", "tibia" or "patella"
    shape: Shape  # in that frame [mm]
    colour: str
    opacity: float = 1.0


def bone(result: Recorded, body: str, most: int = MOST_TRIANGLES) -> Solid | None:
    """A bone's own surface, thinned to `most` triangles; None where the scene has none."""
    mesh = result.mesh(f"{body}_bone")
    return None if mesh is None else Solid(body, body, surface(mesh, most), BONE)


def femur(result: Recorded, most: int = MOST_TRIANGLES) -> Solid:
    """The bone, or a schematic shaft that goes up from behind the femoral component."""
    if (own := bone(result, "femur", most)) is not None:
        return own
    component = result.mesh("femur") or result.mesh("surface")
    points = np.zeros((1, 3)) if component is None else MM * component[0]
    low, high = points.min(axis=0), points.max(axis=0)
    place = [0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), high[2] - BEHIND]
    return Solid("femur (schematic)", "femur", solid_of_revolution(_smooth(FEMUR), place, "x", DEPTH), BONE, 0.35)


def femoral_component(result: Recorded, most: int = MOST_TRIANGLES) -> list[Solid]:
    """Its mesh, thinned to `most` triangles, or its smooth surface with a continuation where it was touched beyond.
    Nothing where it is part of the bone's surface.
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
    """The bone, or a schematic plateau and shaft, just behind the patellar tendon's origin."""
    if (own := bone(result, "tibia", most)) is not None:
        return own
    ends = [MM * lines.origin.reshape(-1, 3) for lines in result.lines.values() if lines.body == "tibia"]
    tuberosity = np.concatenate(ends).mean(axis=0) if ends else np.array([-75.0, 0.0, 40.0])
    top = PLATEAU_AT * tuberosity[0] if tuberosity[0] < 0 else tuberosity[0] + 40.0
    front = DEPTH * max(half for half, _ in TIBIA)
    place = [top, 0.0, tuberosity[2] - front - PROUD]
    return Solid("tibia (schematic)", "tibia", solid_of_revolution(_smooth(TIBIA), place, "x", DEPTH), BONE, 0.5)


def patella_parts(result: Recorded, most: int = MOST_TRIANGLES) -> list[Solid]:
    """The patella, schematic where the scene has no surface of it, and its button where there is one besides."""
    schematic = Solid("patella (schematic)", "patella", _patella_body(result), BONE, 0.4)
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
    """Whether a mesh's vertices are vertices of a bone, as those of its cartilage may be."""
    from scipy.spatial import KDTree

    return whole is not None and bool(np.max(KDTree(whole[0]).query(mesh[0])[0]) < SAME)


def _patella_body(result: Recorded) -> Shape:
    """A rounded disc that holds all insertions."""
    ends = [MM * lines.insertion for lines in result.lines.values()]
    if not ends:
        center = MM * result.geometry["button_center"].values if "button_center" in result.geometry else np.zeros(3)
        return ellipsoid(center - [0.0, 0.0, 8.0], [22.0, 21.0, 8.0])
    points = np.concatenate(ends)
    low, high = points.min(axis=0), points.max(axis=0)
    long = max(0.5 * (high[0] - low[0]) + RIM, 15.0)
    wide = max(0.5 * (high[1] - low[1]) + RIM, 0.95 * long)
    return ellipsoid(0.5 * (low + high), [long, wide, max(0.5 * (high[2] - low[2]), 8.0)])


def _smooth(outline: tuple[tuple[float, float], ...]) -> NDArray[np.float64]:
    """An outline's points with more between them."""
    from scipy.interpolate import PchipInterpolator

    points = np.asarray(outline, dtype=np.float64)
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    return PchipInterpolator(way, points)(np.unique(np.concatenate([way, np.linspace(0.0, way[-1], 60)])))
