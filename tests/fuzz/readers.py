"""Every reader of files, each with valid files to start from."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

FORMATS = ("trc", "c3d", "c3d_channels", "sto", "csv", "marker_csv", "poses", "pose_matrices", "stl", "ascii_stl",
           "obj", "ply", "ascii_ply", "scene", "result", "estimate", "checkpoint", "osim", "strands")  # fmt: skip


@dataclass(frozen=True)
class Reader:
    """A reader, and a file that it takes."""

    name: str
    suffix: str
    valid: bytes
    read: Callable[[Path], Any]


def reader(name: str, folder: Path) -> Reader:
    """One of `FORMATS`.

    Args:
        name: which.
        folder: in which files are made; what the valid file refers to stays there.
    """
    return _MAKERS[name](name, folder)


def _written(name: str, file: Path, read: Callable[[Path], Any]) -> Reader:
    return Reader(name, file.suffix, file.read_bytes(), read)


def _markers() -> Any:
    from toy_scene_files import START, fixed_poses, markers_of, tibia_poses

    tibia = tibia_poses(7)
    return markers_of({"tibia": tibia, "patella": fixed_poses(tibia, *START)})


def _trc(name: str, folder: Path) -> Reader:
    from pftwin.files.mocap import read_trc, write_trc

    write_trc(folder / "a.trc", _markers())
    return _written(name, folder / "a.trc", read_trc)


def _marker_csv(name: str, folder: Path) -> Reader:
    from pftwin.files.mocap import read_markers, write_csv

    write_csv(folder / "a.csv", _markers())
    return _written(name, folder / "a.csv", read_markers)


def _c3d(name: str, folder: Path) -> Reader:
    from c3d_files import write_c3d

    from pftwin.files.mocap import read_c3d, read_c3d_channels

    markers = _markers()
    channels = {"Fz": ("N", np.arange(21.0)), "cell": ("mV/V", -np.arange(21.0))}
    file = write_c3d(folder / "a.c3d", 1e3 * markers.positions, markers.names, channels=channels)
    return _written(name, file, read_c3d_channels if name == "c3d_channels" else read_c3d)


def _sto(name: str, folder: Path) -> Reader:
    from pftwin.files.mocap import read_sto

    rows = "\n".join(f"{i / 100}\t{i}\t{-i}.5\tnan" for i in range(5))
    head = "walk\nversion=1\nnRows=5\nnColumns=4\ninDegrees=yes\nendheader\ntime\tknee_angle\tknee_tx\tforce_vx\n"
    (folder / "a.sto").write_text(head + rows + "\n")
    return _written(name, folder / "a.sto", read_sto)


def _csv(name: str, folder: Path) -> Reader:
    from pftwin.files.mocap import read_csv

    rows = "\n".join(f"{i / 100},{i},{-i}.5," for i in range(5))
    (folder / "a.csv").write_text(f'# a comment\ntime_s,force_N,"angle [deg]",Fz (kN)\n{rows}\n')
    return _written(name, folder / "a.csv", read_csv)


def _poses(name: str, folder: Path) -> Reader:
    from toy_scene_files import tibia_poses, write_poses

    from pftwin.files.mocap import read_poses

    write_poses(folder / "a.csv", {"tibia": tibia_poses(7)})
    return _written(name, folder / "a.csv", lambda path: read_poses(path, ["tibia"]))


def _pose_matrices(name: str, folder: Path) -> Reader:
    from pose_matrices import matrices, written

    from pftwin.files.mocap import read_poses

    written(folder / "a.sto", {"tibia": matrices(3)})
    return _written(name, folder / "a.sto", lambda path: read_poses(path, ["tibia"]))


def _mesh(name: str, folder: Path) -> Reader:
    import trimesh

    from pftwin.geometry.mesh.mesh import load_mesh

    kind = name.removeprefix("ascii_")
    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.02)
    more = {"encoding": "ascii"} if name == "ascii_ply" else {}
    data: Any = ball.export(file_type="stl_ascii" if name == "ascii_stl" else kind, **more)
    file = folder / f"a.{kind}"
    file.write_bytes(data.encode() if isinstance(data, str) else data)
    return _written(name, file, lambda path: load_mesh(path, units="m"))


def _scene(name: str, folder: Path) -> Reader:
    from toy_scene_files import LIGHT, write_toy

    from pftwin.files.scene_file import load_scene

    return _written(name, write_toy(folder, LIGHT), load_scene)


def _result(name: str, folder: Path) -> Reader:
    import xarray

    from pftwin.files.result_files import GEOMETRY, load_dataset, save_dataset

    times = np.arange(8.0)
    data = xarray.Dataset(
        {"patella_position": (("time", "axis"), np.ones((8, 3)), {"units": "m"}), "status": ("time", np.zeros(8, int))},
        {"time": times, "axis": ["x", "y", "z"]},
        {"title": "a result", "note": "synthetic"},
    )
    drawn = xarray.Dataset({"femur_vertices": (("vertex", "axis"), np.ones((9, 3)))})
    save_dataset(data, folder / "a.nc", groups={GEOMETRY: drawn})

    def read(path: Path) -> Any:
        return load_dataset(path), load_dataset(path, group=GEOMETRY)

    return _written(name, folder / "a.nc", read)


def _estimate(name: str, folder: Path) -> Reader:
    from made_estimates import made_estimate

    from fitting.estimate import Estimate

    made_estimate({"K1": (150.0, 3.0), "L1": (0.14, 1e-3)}).save(folder / "a.json")
    return _written(name, folder / "a.json", Estimate.load)


def _checkpoint(name: str, folder: Path) -> Reader:
    from fitting.methods.problem import load_checkpoint, save_checkpoint

    state = {"values": np.arange(6.0).reshape(2, 3), "count": 3, "deep": [{"best": np.float64(0.1)}, None, "text"]}
    save_checkpoint(folder / "a.json", "problem", state)
    return _written(name, folder / "a.json", lambda path: load_checkpoint(path, "problem"))


def _osim(name: str, folder: Path) -> Reader:
    from files.interchange.knee_models import ligaments, model

    from pftwin.files.interchange import import_osim

    def read(path: Path) -> Any:
        out = folder / "imported"
        shutil.rmtree(out, ignore_errors=True)
        return import_osim(path, out)

    (folder / "a.osim").write_text(model(ligaments(), meshes=False))
    return _written(name, folder / "a.osim", read)


def _strands(name: str, folder: Path) -> Reader:
    from pftwin.files.scene_file.line_tables import read_strands

    strand = {
        "points": [["patella", [0, 0, 0.01]], ["femur", [0.1, 0, 0]]],
        "linear_stiffness_N_per_strain": 1000.0,
        "slack_length_m": 0.05,
    }
    (folder / "a.json").write_text(json.dumps({"A1": strand, "A2": strand}))
    return _written(name, folder / "a.json", lambda path: read_strands(str(path), "femur"))


_MAKERS: dict[str, Callable[[str, Path], Reader]] = {
    "trc": _trc, "c3d": _c3d, "c3d_channels": _c3d, "sto": _sto, "csv": _csv, "marker_csv": _marker_csv,
    "poses": _poses, "pose_matrices": _pose_matrices, "stl": _mesh, "ascii_stl": _mesh, "obj": _mesh, "ply": _mesh,
    "ascii_ply": _mesh, "scene": _scene, "result": _result,
    "estimate": _estimate, "checkpoint": _checkpoint, "osim": _osim, "strands": _strands,
}  # fmt: skip
