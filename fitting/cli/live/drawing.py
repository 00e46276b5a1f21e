"""3D drawing of the live page: bones and moving parts of a knee at a frame (femur frame, mm)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from fitting.cli.live.motion import DrawnMotion
from pftwin.results.viewer import bones
from pftwin.results.viewer.bones import METAL
from pftwin.results.viewer.knee import darker, paler
from pftwin.results.viewer.recorded import Recorded
from pftwin.results.viewer.shapes import Shape, arrow_shape, ellipsoid

if TYPE_CHECKING:
    from viser import SceneApi

BUMP = (9.5, 6.5, 8.0)  # half axes of a tuberosity [mm]
POINT = 1.8  # radius of a contact point [mm]
SIDE = 55.0  # distance of the labels "lateral" and "medial" from the middle [mm]


def mesh(scene: SceneApi, name: str, shape: Shape, code: str, opacity: float = 1.0) -> Any:
    """Adds a mesh to the scene, replacing any of the same name; `code` is a colour such as "#D55E00"."""
    red, green, blue = bytes.fromhex(code[1:])
    return scene.add_mesh_simple(
        name,
        shape.vertices,
        shape.triangles,
        color=(red, green, blue),
        opacity=None if opacity >= 1 else opacity,
        side="double",
        cast_shadow=False,
        receive_shadow=False,
    )


class Bones:
    """Femur and tibia, drawn once for all treatments, and the femoral component."""

    def __init__(self, scene: SceneApi, recorded: Recorded) -> None:
        self._scene = scene
        shaft, shin = bones.femur(recorded), bones.tibia(recorded)
        mesh(scene, "/femur", shaft.shape, shaft.colour, shaft.opacity)
        self._tibia = scene.add_frame("/tibia", show_axes=False)
        mesh(scene, "/tibia/shaft", shin.shape, shin.colour, shin.opacity)
        self._extrapolated: Any = None
        self._component: Any = None  # vertices of the drawn component
        for words, y in (("lateral", SIDE), ("medial", -SIDE)):
            scene.add_label(f"/{words}", words, position=(0.0, y, 25.0), anchor="center-center")

    def set_component(self, recorded: Recorded) -> None:
        """Draws the femoral component if it changed: its mesh, or its fitted surface as a solid."""
        found = recorded.mesh("femur") or recorded.mesh("surface")
        if found is None or (self._component is not None and np.array_equal(found[0], self._component)):
            return
        self._component = found[0]
        for part in bones.femoral_component(recorded)[:1]:
            mesh(self._scene, "/component", part.shape, METAL)

    def set_extrapolated(self, shape: Shape | None) -> None:
        """Draws the extrapolated part of the fitted surface; hides it if None."""
        if shape is not None:
            self._extrapolated = mesh(self._scene, "/beyond", shape, paler(METAL, 0.5), 0.6)
        elif self._extrapolated is not None:
            self._extrapolated.visible = False

    def frame(self, shown: DrawnMotion, k: int) -> None:
        """Moves the tibia to its pose at a frame."""
        track = shown.tracks["tibia"]
        self._tibia.position, self._tibia.wxyz = track.position[k], track.wxyz[k]


class DrawnKnee:
    """The moving parts of one motion: patella and button, tendons, tuberosity, contact points, forces and paths."""

    def __init__(self, scene: SceneApi, root: str, code: str, opacity: float = 1.0) -> None:
        self._scene, self._root, self._code, self._opacity = scene, root, code, opacity
        self._whole = scene.add_frame(root, show_axes=False)
        self._moved = {part: scene.add_frame(f"{root}/{part}", show_axes=False) for part in ("patella", "tibia")}
        self._others: dict[str, Any] = {}  # tubes, tuberosities and paths
        self._shown: DrawnMotion | None = None

    def show(self, visible: bool) -> None:
        """Shows or hides all of it."""
        self._whole.visible = visible

    def set(self, shown: DrawnMotion) -> None:
        """Replaces the drawn motion."""
        others = self._others
        before = None if self._shown is None else self._shown.recorded.geometry
        places = [n for n in ("button_center", "button_vertices") if n in shown.recorded.geometry]
        if before is None or any(not shown.recorded.geometry[n].equals(before[n]) for n in places):
            self._body(shown.recorded)
        self._shown = shown
        for name, (vertices, triangles) in shown.lines.items():
            if name not in others or len(others[name].vertices) != vertices.shape[1]:  # begins or ceases to bend
                others[name] = self._mesh(name, Shape(vertices[0], triangles), paler(self._code, 0.3))
        for name, place in shown.origins.items():
            if (bump := f"tibia/{name}") not in others:
                others[bump] = self._mesh(bump, ellipsoid([0, 0, -6.0], BUMP), self._code)
            others[bump].position = place
        for name in shown.tracks.keys() - self._moved.keys():
            if name.startswith("at "):
                self._moved[name] = self._mesh(name, ellipsoid([0, 0, 0], [POINT] * 3), self._code)
            else:
                self._moved[name] = self._mesh(name, arrow_shape(), darker(self._code, 0.35))
        for name in [n for n in others if n.startswith("way ") and n not in shown.paths]:
            others[name].visible = False
        for name, way in shown.paths.items():
            others[name] = self._mesh(name, way, self._code)

    def frame(self, k: int) -> None:
        """Moves all parts to their poses at a frame."""
        shown = self._shown
        if shown is None:
            return
        for name, (vertices, _) in shown.lines.items():
            self._others[name].vertices = vertices[k]
        for name, node in self._moved.items():
            track = shown.tracks.get(name)
            node.visible = track is not None and bool(track.present[k])
            if track is not None and track.present[k]:
                node.position, node.wxyz = track.position[k], track.wxyz[k]
                if name.startswith("on "):
                    node.scale = float(track.scale[k])

    def _mesh(self, name: str, shape: Shape, code: str, opacity: float = 1.0) -> Any:
        return mesh(self._scene, f"{self._root}/{name}", shape, code, opacity * self._opacity)

    def _body(self, recorded: Recorded) -> None:
        body, *button = bones.patella_parts(recorded)
        self._mesh("patella/body", body.shape, self._code if body.opacity < 1 else paler(self._code, 0.5), body.opacity)
        for part in button:
            self._mesh("patella/button", part.shape, part.colour, part.opacity)
