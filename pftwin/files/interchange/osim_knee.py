"""Which bodies of an OpenSim model are the knee's: femur, tibia and patella, with the bones that are welded to them.

Their meshes are found beside the model, scaled and brought into their bone's frame.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.files.interchange.osim_document import OsimFrame
from pftwin.files.interchange.osim_joints import Joint
from pftwin.files.interchange.osim_model import LeftOut, Mesh, OsimModel, plain_name
from pftwin.geometry.mesh.mesh import SurfaceMesh

FOLDER = "geometry"  # of meshes in a scene's folder
SIDES = {"right": "_r", "left": "_l"}


class OsimKnee(NamedTuple):
    """Names of three bodies, and the side."""

    femur: str
    tibia: str
    patella: str
    side: str

    def part(self, body: str) -> str:
        """What a body is called in a scene: "femur", "tibia", "patella"; other bodies keep their name."""
        return {self.femur: "femur", self.tibia: "tibia", self.patella: "patella"}.get(body, body)


def find_knee(model: OsimModel, side: str | None = None, **named: str | None) -> OsimKnee:
    """The knee's bodies: as the caller names them, else found by their names and the joints between them.

    Args:
        model: the file's.
        side: "right" or "left"; None: as the patella's name ends, right where that says nothing.
        named: `femur`, `tibia`, `patella`: names of bodies.

    Raises:
        InputError: a name that is no body's; no patella, femur or tibia to be found, or several.
    """
    if side is not None and side not in SIDES:
        raise InputError(f"found {side!r}", where="side", expected="right or left")
    for part, name in named.items():
        if name is not None and name not in model.bodies:
            known = ", ".join(sorted(model.bodies))
            raise InputError(
                f"no body is called {name!r}", where=f"{model.file}, --{part}", expected=f"one of: {known}"
            )
    patella = named.get("patella") or _body_by_name("patella", list(model.bodies), side, model)
    joint = model.tree.joints.get(patella)
    if joint is None:
        raise InputError(f"no joint carries {patella!r}", where=model.file, remedy="--patella NAME")
    femur = named.get("femur") or _femur(model, joint, side)
    children = [b for b, j in model.tree.joints.items() if _hangs_on(model, j, femur) and b != patella]
    tibia = named.get("tibia") or _body_by_name("tibia", children, side, model)
    sides = [s for s, end in SIDES.items() if patella.lower().endswith(end)]
    chosen = side or (sides[0] if sides else "right")
    return OsimKnee(femur, tibia, patella, chosen)


def part_and_pose(model: OsimModel, knee: OsimKnee, frame: OsimFrame) -> tuple[str, Floats]:
    """The part of the knee that carries a frame, and the frame's pose (4, 4) in it; other bodies keep their name."""
    body, pose = model.tree.welded(frame.body)
    own = {name: model.tree.welded(name) for name in (knee.femur, knee.tibia, knee.patella)}
    for name, (root, at) in own.items():
        if body == root:
            return knee.part(name), np.linalg.inv(at) @ pose @ frame.pose
    return body, pose @ frame.pose


def _femur(model: OsimModel, joint: Joint, side: str | None) -> str:
    """The body that carries the patella if it is called femur; else the one that is."""
    parent = joint.parent.body
    if "femur" in parent.lower():
        return parent
    return _body_by_name("femur", list(model.bodies), side, model)


def _hangs_on(model: OsimModel, joint: Joint, femur: str) -> bool:
    """Whether a joint with degrees of freedom joins a body to the femur or to what is welded to it."""
    return joint.kind != "WeldJoint" and model.tree.welded(joint.parent.body)[0] == model.tree.welded(femur)[0]


def _body_by_name(part: str, names: list[str], side: str | None, model: OsimModel) -> str:
    found = [n for n in names if part in n.lower()]
    if side is not None and any(n.lower().endswith(SIDES[side]) for n in found):
        found = [n for n in found if n.lower().endswith(SIDES[side])]
    if len(found) != 1:
        raise InputError(
            f"{len(found)} bodies may be the {part}: {', '.join(found)}" if found else f"no body is called {part}",
            where=model.file,
            expected="one",
            remedy=f"--{part} NAME" + (", or --side right" if len(found) > 1 else ""),
        )
    return found[0]


class Written(NamedTuple):
    """A mesh to write."""

    part: str  # of the knee: "femur", "tibia" or "patella"
    file: str  # in the scene's folder
    mesh: SurfaceMesh  # in the part's frame [m]


def load_mesh(mesh: Mesh, model: OsimModel, knee: OsimKnee, places: list[Path]) -> Written:
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

    part, pose = part_and_pose(model, knee, mesh.frame)
    if part not in ("femur", "tibia", "patella"):
        raise InputError(f"{mesh.name!r} is fixed to {part!r}", where=mesh.where, expected="a bone of the knee")
    vertices, faces = read_triangles(_mesh_file(mesh, Path(model.file).parent, places))
    points = (vertices * mesh.scale) @ pose[:3, :3].T + pose[:3, 3]
    if np.prod(mesh.scale) < 0:
        faces = faces[:, ::-1].copy()
    return Written(part, f"{FOLDER}/{plain_name(mesh.name)}.stl", SurfaceMesh(points, faces, mesh.file))


def bones(
    model: OsimModel, knee: OsimKnee, places: list[Path], taken: set[str], left: list[LeftOut]
) -> Iterator[Written]:
    """The meshes of the knee's bones; those that cannot be read are left out."""
    for body in model.bodies.values():
        for mesh in body.meshes:
            part, _ = part_and_pose(model, knee, mesh.frame)
            if part not in ("femur", "tibia", "patella"):
                continue
            try:
                found = load_mesh(mesh, model, knee, places)
            except InputError as error:
                left.append(LeftOut("Mesh", mesh.name, f"of {body.name}: {error.problem}"))
                continue
            if found.file not in taken:
                taken.add(found.file)
                yield found


def _mesh_file(mesh: Mesh, home: Path, places: list[Path]) -> Path:
    """The mesh's file, by the last part of its name alone: a model may not say where on this machine to read.

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
