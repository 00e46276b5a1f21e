"""Meshes of an OpenSim model: found beside it, scaled, brought into their body's frame, written as STL in metres."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pftwin.base.errors import InputError
from pftwin.files.interchange.osim_knee import OsimKnee, placed
from pftwin.files.interchange.osim_model import LeftOut, Mesh, OsimModel, plain_name
from pftwin.geometry.mesh.mesh import SurfaceMesh

FOLDER = "geometry"


class Written(NamedTuple):
    """A mesh to write."""

    part: str  # of the knee: "femur", "tibia" or "patella"
    file: str  # in the scene's folder
    mesh: SurfaceMesh  # in the part's frame [m]


def load(mesh: Mesh, model: OsimModel, knee: OsimKnee, places: list[Path]) -> Written:
    """A mesh of one of the knee's bones.

    Args:
        mesh: as the model names it.
        model: the file's.
        knee: its bodies.
        places: folders in which to look, besides the model's own and Geometry in it.

    Raises:
        InputError: no such file, one that cannot be read, a mesh on another body.
    """
    from pftwin.geometry.mesh.files import read_triangles

    part, pose = placed(model, knee, mesh.frame)
    if part not in ("femur", "tibia", "patella"):
        raise InputError(f"{mesh.name!r} is fixed to {part!r}", where=mesh.where, expected="a bone of the knee")
    vertices, faces = read_triangles(_found(mesh, Path(model.file).parent, places))
    points = (vertices * mesh.scale) @ pose[:3, :3].T + pose[:3, 3]
    if np.prod(mesh.scale) < 0:
        faces = faces[:, ::-1].copy()
    return Written(part, f"{FOLDER}/{plain_name(mesh.name)}.stl", SurfaceMesh(points, faces, mesh.file))


def bones(
    model: OsimModel, knee: OsimKnee, places: list[Path], taken: set[str], left: list[LeftOut]
) -> Iterator[Written]:
    """What is drawn of the knee's bones; what cannot be read is left out."""
    for body in model.bodies.values():
        for mesh in body.meshes:
            part, _ = placed(model, knee, mesh.frame)
            if part not in ("femur", "tibia", "patella"):
                continue
            try:
                found = load(mesh, model, knee, places)
            except InputError as error:
                left.append(LeftOut("Mesh", mesh.name, f"of {body.name}: {error.problem}"))
                continue
            if found.file not in taken:
                taken.add(found.file)
                yield found


def _found(mesh: Mesh, home: Path, places: list[Path]) -> Path:
    """By the last part of its name alone: a model does not say where on this machine to read.

    Models are often written where "Patella.stl" and "patella.stl" are one file: that is found if nothing else is meant.
    """
    name = mesh.file.replace("\\", "/").rpartition("/")[2]
    if not name:
        raise InputError(f"{mesh.name!r} names no file", where=mesh.where)
    folders = [home, home / "Geometry", *places]
    for folder in folders:
        if (folder / name).is_file():
            return folder / name
    for folder in folders:
        alike = [f for f in folder.glob("*") if f.name.lower() == name.lower()] if folder.is_dir() else []
        if len(alike) == 1 and alike[0].is_file():
            return alike[0]
    looked = ", ".join(str(f) for f in folders)
    raise InputError(f"no mesh {name!r}", where=mesh.where, expected=f"in {looked}", remedy="--geometry FOLDER")
