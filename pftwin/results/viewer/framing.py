"""What a page shows first, and from where: cameras, the extent that views fit, words beside it, the opening time."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.results.viewer import page
from pftwin.results.viewer.knee import k3d
from pftwin.results.viewer.recorded import Recorded
from pftwin.results.viewer.shapes import MM

if TYPE_CHECKING:
    from k3d.objects import Drawable

DISTANCE = 370.0  # of the camera, for a vertical field of view of 30 deg [mm]
ANGLE = 1.0  # vertical field of view of the page [deg]: nearly parallel, so that like knees side by side look alike
PAN_SPEED = 0.3 * np.tan(np.radians(ANGLE / 2)) / np.tan(np.radians(15.0))  # k3d multiplies it by the distance
HEIGHT = {"one": 198.0, "several": 250.0}  # minimum height of the view, of one knee or several side by side [mm]
JOINT = 50.0  # the part of the femur that views show whole: above and below the middle of the patella's path [mm]
# Direction from the joint to the camera, and the up direction: femur axes x proximal, y lateral, z anterior.
_FROM = {
    "anterior": ((0.12, 0.0, 1.0), (1, 0, 0)),
    "lateral": ((0.05, 1.0, 0.15), (1, 0, 0)),
    "medial": ((0.05, -1.0, 0.15), (1, 0, 0)),
    "skyline": ((-1.0, 0.0, 0.25), (0, 0, 1)),
}
SIDE = 5.0  # distance of the words "lateral" and "medial" from the joint and from the patella's whole path [mm]
PATELLA = ("patella", "patella (schematic)", "button")
_FEMUR = ("femur", "femur (schematic)")
_POINTS = 500  # of a part, approximately, of which the extent is taken


def views(result: Recorded, *, several: bool = False) -> dict[str, list[float]]:
    """Returns cameras by name: position, target and up direction, nine numbers each [mm].

    Several knees side by side have no side views, where one would hide the others.
    """
    center = MM * np.nanmean(result.data["sphere_center"].values, axis=0)
    target = np.array([center[0] + 8.0, center[1] * 0.5, center[2] - 12.0])
    found = {}
    names = ("anterior", "skyline") if several else _FROM
    for name, (toward, up) in ((n, _FROM[n]) for n in names):
        place = target + DISTANCE * np.asarray(toward) / np.linalg.norm(toward)
        found[name] = [float(v) for v in (*place, *target, *up)]
    return found


def extent(drawn: Sequence[Any], middle: float) -> Floats:
    """Returns corners (k, 3) [mm] of boxes round what views show whole: the femur near the joint, the patella's path.

    Args:
        drawn: the plot's objects.
        middle: height of the joint [mm].
    """
    boxes = []
    for part in drawn:
        if part.name not in (*_FEMUR, *PATELLA):
            continue
        found = part.vertices[:: max(len(part.vertices) // _POINTS, 1)]
        if part.name in _FEMUR:
            found = found[np.abs(found[:, 0] - middle) < JOINT]
        if not len(found):
            continue
        matrix = part.model_matrix
        poses = np.stack(list(matrix.values())) if isinstance(matrix, dict) else np.asarray(matrix)[None]
        placed = np.einsum("nij,vj->nvi", poses[:, :3, :3], found) + poses[:, None, :3, 3]
        boxes.append(np.stack([placed.min(axis=(0, 1)), placed.max(axis=(0, 1))]))
    return np.array([corner for box in boxes for corner in product(*box.T)], dtype=np.float64).round(1)


def sides(middle: Sequence[float], corners: Floats) -> list[Drawable]:
    """Returns the labels "lateral" and "medial" beside the knees; in the anterior view lateral is on the left."""
    look = {"color": 0x888888, "size": 0.9, "is_html": True, "label_box": False}
    words = [("lateral", corners[:, 1].max() + SIDE, "rc"), ("medial", corners[:, 1].min() - SIDE, "lc")]
    x, _, z = middle
    return [
        k3d().text(page.side(side), position=[x, float(y), z], name=side, reference_point=edge, **look)
        for side, y, edge in words
    ]


def opening(results: Sequence[Recorded]) -> float:
    """Returns the time at which a page opens [s]: that of the largest offset from the groove if a patella dislocates,
    else the beginning."""
    found = []
    for result in results:
        out, offset = result.series("dislocated"), result.series("groove_offset")
        if out is not None and offset is not None and (out > 0).any():
            far = np.where(out > 0, np.abs(offset), 0.0)
            found.append((float(far.max()), float(result.times[np.argmax(far)])))
    return max(found)[1] if found else float(min(r.times[0] for r in results))
