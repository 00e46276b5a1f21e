"""Meshes on the page: the bones that stay, and a knee's moving parts, set to one frame after the other. Femur, mm."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from fitting.cli.live.motion import Shown, ShownTrack
from pftwin.results.viewer import bones
from pftwin.results.viewer.drawing import darker, paler
from pftwin.results.viewer.knee import BONE, METAL, PLASTIC
from pftwin.results.viewer.recorded import Recorded
from pftwin.results.viewer.shapes import Shape, arrow, behind_plane, button_cap, ellipsoid, shell, surface

if TYPE_CHECKING:
    from viser import SceneApi

BUMP = (9.5, 6.5, 8.0)  # half axes of a tuberosity [mm]
POINT = 1.8  # radius of a contact point [mm]
SIDE = 55.0  # of the words "lateral" and "medial" from the middle [mm]


def rgb(code: str) -> tuple[int, int, int]:
    """ "#0072B2" as three numbers."""
    red, green, blue = (int(code[i : i + 2], 16) for i in (1, 3, 5))
    return red, green, blue


def mesh(scene: SceneApi, name: str, shape: Shape, code: str, opacity: float = 1.0) -> Any:
    """A mesh; one that has the name already goes."""
    return scene.add_mesh_simple(
        name,
        shape.vertices,
        shape.triangles,
        color=rgb(code),
        opacity=None if opacity >= 1 else opacity,
        side="double",
        cast_shadow=False,
        receive_shadow=False,
    )


def component_of(recorded: Recorded) -> Shape | None:
    """The femoral component: its mesh, or its fitted surface with a body."""
    femur, fitted = recorded.mesh("femur"), recorded.mesh("surface")
    if femur is not None:
        return surface(femur)
    return None if fitted is None else shell(fitted)


class Bones:
    """Femur and tibia, which are drawn once, whatever the treatment."""

    def __init__(self, scene: SceneApi, recorded: Recorded, component: Shape | None) -> None:
        self._scene = scene
        shaft = bones.femur_shaft(recorded.mesh("femur") or recorded.mesh("surface"))
        mesh(scene, "/femur", shaft, BONE, 0.35)
        self.set_component(component)
        self._tibia = scene.add_frame("/tibia", show_axes=False)
        mesh(scene, "/tibia/shaft", bones.tibia_shaft(recorded), BONE, 0.5)
        self._beyond: Any = None
        for words, y in (("lateral", SIDE), ("medial", -SIDE)):
            scene.add_label(f"/{words}", words, position=(0.0, y, 25.0), anchor="center-center")

    def set_component(self, component: Shape | None) -> None:
        """The femoral component of another contact."""
        if component is not None:
            mesh(self._scene, "/component", component, METAL)

    def set_beyond(self, beyond: Shape | None) -> None:
        """The fitted surface beyond its edge, as far as it is touched."""
        if beyond is not None:
            self._beyond = mesh(self._scene, "/beyond", beyond, paler(METAL, 0.5), 0.6)
        elif self._beyond is not None:
            self._beyond.visible = False

    def frame(self, shown: Shown, k: int) -> None:
        """Sets the tibia to a frame."""
        _place(self._tibia, shown.tibia, k)


class DrawnKnee:
    """The moving parts of one motion: patella and button, tendons, tuberosity, contact points, forces and paths."""

    def __init__(self, scene: SceneApi, root: str, code: str, opacity: float = 1.0) -> None:
        self._scene, self._root, self._code, self._opacity = scene, root, code, opacity
        self._whole = scene.add_frame(root, show_axes=False)
        self._frames = {part: scene.add_frame(f"{root}/{part}", show_axes=False) for part in ("patella", "tibia")}
        self._lines: dict[str, Any] = {}
        self._bumps: dict[str, Any] = {}
        self._points: dict[str, Any] = {}
        self._arrows: dict[str, Any] = {}
        self._paths: dict[str, Any] = {}
        self._shown: Shown | None = None

    def show(self, visible: bool) -> None:
        """Shows or hides all of it."""
        self._whole.visible = visible

    def set(self, shown: Shown) -> None:
        """Draws another motion in the place of the last one."""
        if self._shown is None:
            self._body(shown.recorded)
        self._shown = shown
        for name, (vertices, triangles) in shown.lines.items():
            if name not in self._lines:
                self._lines[name] = self._mesh(name, Shape(vertices[0], triangles), paler(self._code, 0.3))
        for name, place in shown.origins.items():
            if name not in self._bumps:
                self._bumps[name] = self._mesh(f"tibia/{name}", ellipsoid([0, 0, -6.0], BUMP), self._code)
            self._bumps[name].position = place
        for name in shown.points:
            if name not in self._points:
                self._points[name] = self._mesh(f"at {name}", ellipsoid([0, 0, 0], [POINT] * 3), self._code)
        for name in shown.arrows:
            if name not in self._arrows:
                self._arrows[name] = self._mesh(f"on {name}", arrow(), darker(self._code, 0.35))
        for name, way in shown.paths.items():
            self._paths[name] = self._mesh(f"way {name}", way, self._code)
        for name in self._paths.keys() - shown.paths.keys():
            self._paths[name].visible = False

    def frame(self, k: int) -> None:
        """Sets everything to a frame."""
        shown = self._shown
        if shown is None:
            return
        _place(self._frames["patella"], shown.patella, k)
        _place(self._frames["tibia"], shown.tibia, k)
        for name, (vertices, _) in shown.lines.items():
            self._lines[name].vertices = vertices[k]
        for drawn, tracks in ((self._points, shown.points), (self._arrows, shown.arrows)):
            for name, node in drawn.items():
                track = tracks.get(name)
                if track is None or not track.present[k]:
                    node.visible = False
                    continue
                _place(node, track, k)
                node.scale = float(track.scale[k])
                node.visible = True

    def _mesh(self, name: str, shape: Shape, code: str, opacity: float = 1.0) -> Any:
        return mesh(self._scene, f"{self._root}/{name}", shape, code, opacity * self._opacity)

    def _body(self, recorded: Recorded) -> None:
        schematic = bones.patella_body(recorded)
        self._mesh("patella/body", schematic, self._code, 0.4)
        button = recorded.mesh("button")
        if button is not None:
            behind = behind_plane(surface(button), float(schematic.vertices[:, 2].mean()))
            self._mesh("patella/button", behind, PLASTIC, 0.75)
        elif "button_radius" in recorded.geometry:
            center = recorded.geometry["button_center"].values
            self._mesh("patella/button", button_cap(center, float(recorded.geometry["button_radius"])), PLASTIC, 0.75)


def _place(node: Any, track: ShownTrack, k: int) -> None:
    node.position = track.position[k]
    node.wxyz = track.wxyz[k]
