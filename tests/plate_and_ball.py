"""A ball that is pressed on a plate, as files: meshes and recorded poses."""

from __future__ import annotations

from pathlib import Path

from height_meshes import plate

from pftwin.geometry.mesh.icosphere import icosphere
from pftwin.geometry.mesh.mesh import save_mesh

RADIUS = 0.02
PARTS = ("px_m", "py_m", "pz_m", "qw", "qx", "qy", "qz")
HEADER = ",".join(["time_s", *(f"{b}_{p}" for b in ("femur", "patella") for p in PARTS)])


def write_poses(path: Path, depths: list[float]) -> Path:
    """The femur turned over and moved, the ball so deep in it."""
    turned = "0.1,0.2,0.3,0,1,0,0"  # half a turn about x
    rows = [f"{0.1 * k:.1f},{turned},0.1,0.2,{0.3 - (RADIUS - d):.9f},1,0,0,0" for k, d in enumerate(depths)]
    path.write_text("\n".join([HEADER, *rows, ""]))
    return path


def write_plate_and_ball(folder: Path, depths: list[float]) -> None:
    save_mesh(plate(12), folder / "plate.stl")
    save_mesh(icosphere(RADIUS, 40), folder / "ball.stl")
    write_poses(folder / "poses.csv", depths)
