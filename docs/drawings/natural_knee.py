"""Draws docs/natural_knee.png: the natural knee's bones, and axial cuts of its trochlea with and without dysplasia.

python docs/drawings/natural_knee.py
"""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.typing import NDArray

from pftwin import rig
from pftwin.geometry.bones.tibiofemoral import FLEXION_AXIS
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.results.plots import style
from pftwin.rig.natural.motion import tibia_turn
from pftwin.rig.natural.placing import rest_pose

FLEXION = 45.0
BONE, PATELLA = (0.91, 0.87, 0.79), (0.45, 0.66, 0.82)
VIEWS = (("from the front and lateral", 10, -35), ("from lateral", 5, -90))  # elevation and azimuth [deg]


def shaded(ax, parts: list[tuple[NDArray, SurfaceMesh, tuple]], elevation: float, azimuth: float) -> None:
    """Triangles seen from a direction, lit from beside the eye; anterior is x, medial y, proximal z of the drawing."""
    up, around = np.radians([elevation, azimuth])
    eye = np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])
    light = eye + np.array([0.2, -0.3, 0.6])
    light = light / np.linalg.norm(light)
    triangles, colours = [], []
    for points, mesh, colour in parts:
        corners = (points[:, ::-1] * [1, -1, 1])[mesh.faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
        seen = normal @ eye > -0.1
        bright = 0.3 + 0.7 * np.clip(normal @ light, 0, 1)[:, None]
        triangles.append(corners[seen])
        colours.append((np.array(colour) * bright)[seen])
    drawn, colour = np.concatenate(triangles), np.concatenate(colours)
    ax.add_collection3d(Poly3DCollection(list(drawn), facecolors=colour, edgecolors=colour, linewidths=0.2))
    low, high = drawn.reshape(-1, 3).min(axis=0), drawn.reshape(-1, 3).max(axis=0)
    middle, half = 0.5 * (low + high), 0.31 * (high - low).max()
    ax.set(xlim=middle[0] + [-half, half], ylim=middle[1] + [-half, half], zlim=middle[2] + [-half, half])
    ax.set_box_aspect((1, 1, 1))
    ax.set_proj_type("ortho")
    ax.view_init(elevation, azimuth)
    ax.set_axis_off()


def assembled(anatomy: rig.Anatomy) -> list[tuple[NDArray, SurfaceMesh, tuple]]:
    """The bones in the femur's frame, bent [mm]."""
    made = rig.bones(anatomy, 1.0)
    axis = np.array([FLEXION_AXIS[0], 0.0, FLEXION_AXIS[1]])
    bent = tibia_turn(np.asarray(FLEXION))
    tibia = axis + bent.apply(1e3 * made.tibia.vertices - axis)
    place, turn = rest_pose(anatomy, FLEXION)
    patella = place + turn.apply(1e3 * made.patella.vertices)
    parts = ((1e3 * made.femur.vertices, made.femur, BONE), (tibia, made.tibia, BONE))
    return [*parts, (patella, made.patella, PATELLA)]


def outline(femur: SurfaceMesh) -> NDArray:
    """Front of the axial cut through the trochlear axis (n, 2): y, z [mm]."""
    p = 1e3 * femur.vertices
    pairs = np.concatenate([femur.faces[:, list(k)] for k in ((0, 1), (1, 2), (2, 0))])
    a, b = p[pairs[:, 0]], p[pairs[:, 1]]
    crossed = (a[:, 0] > 0) != (b[:, 0] > 0)
    a, b = a[crossed], b[crossed]
    at = a - (a[:, :1] / (b[:, :1] - a[:, :1])) * (b - a)
    front = at[(at[:, 2] > 12) & (np.abs(at[:, 1]) < 34)]
    return front[np.argsort(front[:, 1])][:, 1:]


def main() -> None:
    """Writes the figure."""
    normal = rig.Anatomy()
    figure = plt.figure(figsize=(10, 3.6), layout="constrained")
    for place, (name, elevation, azimuth) in enumerate(VIEWS, 1):
        drawn = figure.add_subplot(1, 3, place, projection="3d")
        shaded(drawn, assembled(normal), elevation, azimuth)
        drawn.set_title(name, fontsize=style.TEXT)
    ax = figure.add_subplot(1, 3, 3)
    knees = {"normal": normal, **{f"Dejour {kind}": rig.Anatomy.dejour(kind) for kind in "ABCD"}}
    for i, (name, anatomy) in enumerate(knees.items()):
        look = {**style.line(i), "linewidth": 2.2 if name == "normal" else 1.3}
        ax.plot(*outline(rig.bones(anatomy, 1.0).femur).T, label=name, **look)
    ax.set(xlabel="across [mm]", ylabel="anterior [mm]", aspect="equal", ylim=(2, 31))
    ax.set_title("axial cut of the trochlea", fontsize=style.TEXT)
    for at, words in ((-30, "medial"), (30, "lateral")):
        ax.text(at, 4, words, ha="center", fontsize=style.SMALL)
    ax.legend(fontsize=style.SMALL, loc="lower center", ncols=2)
    figure.savefig(Path(__file__).resolve().parents[1] / "natural_knee.png", dpi=140)


if __name__ == "__main__":
    with style.house_style():
        main()
