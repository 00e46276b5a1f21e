"""What of a result there is to animate: solid parts, each carried by a frame, and lines of force whose ends move."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from pftwin.results.viewer.recorded import Recorded
    from pftwin.results.viewer.shapes import Shape

MM = 1e-3  # shapes are drawn in mm
METAL, BONE, PLASTIC, TENDON = (169, 180, 192, 255), (233, 223, 201, 255), (244, 241, 230, 255), (190, 120, 100, 255)
PALE = 110  # opacity of what is schematic, of 255
FEW = 4  # lines of an effect that are as thick as a tendon
THICK, THIN = 1.7e-3, 0.55e-3  # their radii [m]
Floats = NDArray[np.float64]


class MovingPart(NamedTuple):
    """A solid that moves with a frame."""

    name: str
    frame: str  # "femur", "tibia" or "patella"
    vertices: Floats  # (n, 3) in that frame [m]
    triangles: NDArray[np.int64]  # (m, 3)
    colour: tuple[int, int, int, int]


class PartTrack(NamedTuple):
    """Where something is in the femur's frame, frame by frame (n)."""

    translation: Floats  # (n, 3) [m]
    rotation: Floats  # (n, 4) scalar first, continuous in sign
    scale: Floats | None = None  # (n, 3), of what changes its length


def parts(result: Recorded) -> list[MovingPart]:
    """The femoral component, the button, and schematic bones."""
    from pftwin.results.viewer import bones
    from pftwin.results.viewer.shapes import behind_plane, button_cap, shell

    found = []
    mesh, fitted, beyond = (result.mesh(n) for n in ("femur", "surface", "continuation"))
    if mesh is not None:
        found.append(MovingPart("femoral mesh", "femur", *mesh, METAL))
    if fitted is not None:
        found.append(_drawn("femoral surface", "femur", shell(fitted), METAL))
    if beyond is not None:
        found.append(MovingPart("surface continued", "femur", *beyond, (*METAL[:3], PALE)))
    pale = (*BONE[:3], PALE)
    found.append(_drawn("femur (schematic)", "femur", bones.femur_shaft(mesh or fitted), pale))
    found.append(_drawn("tibia (schematic)", "tibia", bones.tibia_shaft(result), pale))
    patella = bones.patella_body(result)
    found.append(_drawn("patella (schematic)", "patella", patella, pale))
    button = result.mesh("button")
    if button is not None:
        from pftwin.results.viewer.shapes import Shape

        whole = Shape((button[0] / MM).astype(np.float32), button[1].astype(np.uint32))
        behind = behind_plane(whole, float(patella.vertices[:, 2].mean()))
        found.append(_drawn("button", "patella", behind, PLASTIC))
    elif "button_radius" in result.geometry:
        cap = button_cap(result.geometry["button_center"].values, float(result.geometry["button_radius"]))
        found.append(_drawn("button", "patella", cap, PLASTIC))
    return found


def frames(result: Recorded) -> dict[str, PartTrack]:
    """How patella and tibia move in the femur."""
    return {
        body: PartTrack(result.data[f"{body}_position"].values, result.data[f"{body}_quaternion"].values)
        for body in ("patella", "tibia")
    }


def lines(result: Recorded) -> dict[str, PartTrack]:
    """Every line of force as a rod: what carries a cylinder of length and radius 1 along z, its middle at nought."""
    moving = frames(result)
    found = {}
    for name, group in result.lines.items():
        ends = _carried(moving["patella"], group.insertion)
        start = _carried(moving["tibia"], group.origin) if group.body == "tibia" else group.origin
        start = np.broadcast_to(start, ends.shape)
        count = ends.shape[1]
        radius = THICK if count <= FEW else THIN
        for k in range(count):
            label = name.replace("_", " ") + (f" {k + 1}" if count > 1 else "")
            found[label] = rod(start[:, k], ends[:, k], radius)
    return found


def rod(start: Floats, end: Floats, radius: float) -> PartTrack:
    """Between points (n, 3) [m]."""
    along = end - start
    length = np.linalg.norm(along, axis=1)
    x, y, z = (along / np.where(length > 0, length, 1.0)[:, None]).T
    turn = np.stack([1.0 + z, -y, x, np.zeros_like(z)], axis=1)  # the shortest way from z there
    size = np.linalg.norm(turn, axis=1)
    turn = np.where((size > 1e-6)[:, None], turn, [0.0, 1.0, 0.0, 0.0])
    turn /= np.linalg.norm(turn, axis=1)[:, None]
    flips = np.where(np.einsum("ij,ij->i", turn[1:], turn[:-1]) < 0, -1.0, 1.0)
    turn = turn * np.concatenate([[1.0], np.cumprod(flips)])[:, None]
    thick = np.full_like(length, radius)
    return PartTrack(0.5 * (start + end), turn, np.stack([thick, thick, length], axis=1))


def _carried(frame: PartTrack, points: Floats) -> Floats:
    """Points (k, 3), or (n, k, 3) that move in it, of a frame: (n, k, 3) in the femur."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_quat(frame.rotation, scalar_first=True).as_matrix()
    points = np.broadcast_to(points, (len(turn), *points.shape[-2:]))
    return np.einsum("nij,nkj->nki", turn, points) + frame.translation[:, None]


def _drawn(name: str, frame: str, shape: Shape, colour: tuple[int, int, int, int]) -> MovingPart:
    return MovingPart(name, frame, MM * shape.vertices.astype(np.float64), shape.triangles.astype(np.int64), colour)
