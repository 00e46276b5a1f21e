"""Exports a result as an animated binary glTF 2.0 file (.glb), for viewers, slides and game engines.

trimesh writes the meshes and the node tree; the animation's samplers are added to its buffers. Lengths are in metres.
The node `femur` rotates the femur's frame (proximal, lateral, anterior) to glTF's: proximal is +y, anterior +z, and
lateral of a right knee -x. Its children `patella` and `tibia` have the result's poses as translation and rotation at
every frame.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.output import written_whole
from pftwin.base.rotations import continuous_signs

if TYPE_CHECKING:
    from trimesh import Scene, Trimesh

    from pftwin.results.result import Result
    from pftwin.results.viewer.recorded import Recorded


ROOT = "femur"
UPRIGHT = np.array([[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
_EVERY = 10**9  # frames: all of them
_ROD, _SIDES = "rod", 12
_TENDON = (190, 120, 100, 255)
_PALE = 110  # opacity of schematic or extrapolated parts, of 255
_SEE_THROUGH = 0.7  # parts with less opacity in drawings are pale here
_MM = 1e-3  # shapes are in mm
_FLOAT = 5126  # glTF's code of a 32-bit float


class PartTrack(NamedTuple):
    """Motion of a node in the femur's frame over n frames; the fields are named as in glTF."""

    translation: Floats  # (n, 3) [m]
    rotation: Floats  # (n, 4) scalar first, continuous in sign
    scale: Floats | None = None  # (n, 3), for parts whose length changes


def save_glb(result: Result | str | os.PathLike[str], path: str | os.PathLike[str]) -> None:
    """Writes the moving knee: component, button, bones, tendons and ligaments.

    Time starts at 0. Frames that are not finite are omitted; viewers interpolate between frames. Raises InputError for
    no such file, not a result, nothing to draw, or fewer than two finite frames; OutputError for a path that is not
    writable.
    """
    from pftwin.results.viewer.recorded import Recorded

    content = _glb(Recorded.of(result, frames=_EVERY))
    with written_whole(path) as temporary:
        Path(temporary).write_bytes(content)


def _glb(result: Recorded) -> bytes:
    """Content of the file."""
    from trimesh.exchange.gltf import export_glb

    rods = _rods(result)
    scene = _scene(result, rods)
    bodies = {
        body: PartTrack(result.data[f"{body}_position"].values, result.data[f"{body}_quaternion"].values)
        for body in ("patella", "tibia")
    }
    times = result.times - result.times[0]
    if not (np.diff(times) > 0).all():
        raise InputError("times that do not increase", where=result.name, expected="a recording")

    def animate(buffers: Any, tree: dict[str, Any]) -> None:
        _animate(buffers, tree, times, {**bodies, **rods})

    return export_glb(scene, include_normals=True, buffer_postprocessor=animate)


def _rods(result: Recorded) -> dict[str, PartTrack]:
    """Tracks of all lines of force as rods: they move a cylinder of length and radius 1 along z, centred at 0.

    A line that runs over an obstacle is several rods, from insertion to origin.
    """
    found = {}
    for name, group in result.lines.items():
        paths = group.paths
        _, count, points, _ = paths.shape
        for k in range(count):
            label = name.replace("_", " ") + (f" {k + 1}" if count > 1 else "")
            for j in range(points - 1):
                part = f", part {j + 1}" if points > 2 else ""
                found[label + part] = rod(paths[:, k, j + 1], paths[:, k, j], group.radius)
    return found


def rod(start: Floats, end: Floats, radius: float) -> PartTrack:
    """Track of a rod of a radius [m] between points (n, 3) [m]."""
    along = end - start
    length = np.linalg.norm(along, axis=1)
    x, y, z = (along / np.where(length > 0, length, 1.0)[:, None]).T
    turn = np.stack([1.0 + z, -y, x, np.zeros_like(z)], axis=1)  # the shortest rotation from z
    size = np.linalg.norm(turn, axis=1)
    turn = np.where((size > 1e-6)[:, None], turn, [0.0, 1.0, 0.0, 0.0])
    turn /= np.linalg.norm(turn, axis=1)[:, None]
    thick = np.full_like(length, radius)
    return PartTrack(0.5 * (start + end), continuous_signs(turn), np.stack([thick, thick, length], axis=1))


def _scene(result: Recorded, rods: dict[str, PartTrack]) -> Scene:
    """Nodes and meshes at the first frame: femoral component, bones, button and rods."""
    from trimesh import Scene, Trimesh
    from trimesh.creation import cylinder

    from pftwin.results.viewer import bones

    scene = Scene(base_frame="knee")
    scene.metadata.update(_about(result))
    scene.graph.update(frame_to=ROOT, frame_from="knee", matrix=UPRIGHT)
    for body in ("patella", "tibia"):
        scene.graph.update(frame_to=body, frame_from=ROOT, matrix=np.eye(4))
    every = sys.maxsize  # triangles
    shafts = bones.femur(result, every), bones.tibia(result, every)
    for part in (*bones.femoral_component(result, every), *shafts, *bones.patella_parts(result, every)):
        colour = *bytes.fromhex(part.colour.removeprefix("#")), _PALE if part.opacity < _SEE_THROUGH else 255
        vertices, triangles = _MM * part.shape.vertices.astype(np.float64), part.shape.triangles.astype(np.int64)
        mesh = _painted(Trimesh(vertices, triangles, process=False), colour)
        scene.add_geometry(mesh, geom_name=part.name, node_name=part.name, parent_node_name=part.frame)
    if rods:
        scene.geometry[_ROD] = _painted(cylinder(radius=1.0, height=1.0, sections=_SIDES), _TENDON)
    for name in rods:
        scene.graph.update(frame_to=name, frame_from=ROOT, matrix=np.eye(4), geometry=_ROD)
    return scene


def _painted(mesh: Trimesh, colour: tuple[int, ...]) -> Trimesh:
    from trimesh.visual.material import PBRMaterial
    from trimesh.visual.texture import TextureVisuals

    paint = PBRMaterial(
        baseColorFactor=list(colour),
        metallicFactor=0.0,
        roughnessFactor=0.7,
        doubleSided=True,
        alphaMode="BLEND" if colour[3] < 255 else "OPAQUE",
    )
    mesh.visual = TextureVisuals(material=paint)
    return mesh


def _about(result: Recorded) -> dict[str, Any]:
    """Metadata of the file: title, source, frame and first time."""
    return {
        "title": str(result.data.attrs.get("title", result.name)),
        "source": str(result.data.attrs.get("source", "")),
        "frame": "below the node femur: x proximal, y lateral, z anterior, a right knee; metres",
        "begins_at_s": float(result.times[0]),
        **({"note": result.note} if result.note else {}),
    }


def _animate(buffers: Any, tree: dict[str, Any], times: Floats, tracks: dict[str, PartTrack]) -> None:
    """Adds animation channels (translation, rotation, scale) of the moving nodes to the glTF tree made by trimesh."""

    def accessor(key: str, values: Floats) -> int:
        """Adds an accessor for the rows of `values` and returns its number."""
        data = np.ascontiguousarray(values, dtype="<f4")
        width = data.shape[1]
        buffers[f"animation {key}"] = data.tobytes()  # a multiple of four bytes
        tree["accessors"][f"animation {key}"] = {
            "bufferView": len(buffers) - 1,
            "componentType": _FLOAT,
            "type": "SCALAR" if width == 1 else f"VEC{width}",
            "count": len(data),
            "min": data.min(axis=0).tolist(),
            "max": data.max(axis=0).tolist(),
        }
        return len(tree["accessors"]) - 1

    numbers = {node.get("name"): k for k, node in enumerate(tree["nodes"])}
    shared = accessor("times", times[:, None])
    channels: list[dict[str, Any]] = []
    samplers: list[dict[str, Any]] = []
    for name, track in tracks.items():
        node = tree["nodes"][numbers[name]]
        node.pop("matrix", None)  # animated nodes must not have a matrix
        turn = track.rotation[:, [1, 2, 3, 0]]  # glTF's quaternions have the scalar last
        for path, values in track._replace(rotation=turn)._asdict().items():
            if values is not None:
                node[path] = values[0].astype(np.float32).tolist()
                channels.append({"sampler": len(samplers), "target": {"node": numbers[name], "path": path}})
                output = accessor(f"{name} {path}", values)
                samplers.append({"input": shared, "output": output, "interpolation": "LINEAR"})
    tree["animations"] = [{"name": "motion", "channels": channels, "samplers": samplers}]
