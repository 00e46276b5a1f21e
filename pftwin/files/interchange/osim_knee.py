"""Finds femur, tibia and patella among the bodies of an OpenSim model, with the bones that are welded to them.

Their meshes are read from folders beside the model, scaled and transformed to their bone's frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.files.interchange.osim_document import OsimFrame
from pftwin.files.interchange.osim_model import LeftOut, Mesh, OsimModel, loose_name, valid_name
from pftwin.geometry.mesh.files import read_triangles
from pftwin.geometry.mesh.mesh import SurfaceMesh

FOLDER = "geometry"  # folder of meshes in a scene's folder
PARTS = ("femur", "tibia", "patella")
SIDES = {"right": "_r", "left": "_l"}


class OsimKnee(NamedTuple):
    """Names of the knee's bodies in a model, and the side."""

    model: OsimModel
    femur: str
    tibia: str
    patella: str
    side: str

    def name(self, part: str) -> str:
        """The model's name of a part "femur", "tibia" or "patella"; other names are returned unchanged."""
        return getattr(self, part) if part in PARTS else part

    def placed(self, frame: OsimFrame) -> tuple[str, Floats]:
        """The part that carries a frame (or another body's name), and the frame's pose (4, 4) in it.

        Bodies welded to a bone are part of it.
        """
        body, pose = self.model.tree.welded(frame.body)
        for part in PARTS:
            root, at = self.model.tree.welded(self.name(part))
            if body == root:
                return part, np.linalg.inv(at) @ pose @ frame.pose
        return body, pose @ frame.pose

    def point(self, frame: OsimFrame, place: Floats) -> tuple[str, Floats]:
        """The part that carries a point (3,) of a frame, and the point in that part's frame [m]."""
        part, pose = self.placed(frame)
        return part, pose[:3, :3] @ place + pose[:3, 3]


def find_knee(model: OsimModel, side: str | None = None, **named: str | None) -> OsimKnee:
    """Finds the knee's bodies, unless the caller names them, by their names and the joints between them.

    The side is "right" or "left"; None: by the ends of the bodies' names, else right. Raises InputError for an unknown
    body, and for no or several candidates for patella, femur or tibia. A body whose name ends with the other side is
    none, unless it is named.
    """
    tree, file = model.tree, model.root.file
    if side is not None and side not in SIDES:
        raise InputError(f"found {side!r}", where="side", expected="right or left")
    for part, name in named.items():
        if name is not None and name not in model.bodies:
            known = ", ".join(sorted(model.bodies))
            raise InputError(f"no body is called {name!r}", where=f"{file}, --{part}", expected=f"one of: {known}")

    def by_name(part: str, names: Iterable[str], side: str | None) -> str:
        found = [n for n in names if part in n.lower()]
        if side is not None:
            other = next(s for s in SIDES if s != side)
            may = [n for n in found if not n.lower().endswith(SIDES[other])]
            if found and not may:
                only = f"no {part} of the {side} side, only: {', '.join(found)}"
                raise InputError(only, where=file, remedy=f"--{part} NAME, or --side {other}")
            found = [n for n in may if n.lower().endswith(SIDES[side])] or may
        if len(found) != 1:
            raise InputError(
                f"{len(found)} bodies may be the {part}: {', '.join(found)}" if found else f"no body is called {part}",
                where=file,
                expected="one",
                remedy=f"--{part} NAME" + (", or --side right" if len(found) > 1 else ""),
            )
        return found[0]

    def side_of(body: str) -> str | None:
        return next((s for s, end in SIDES.items() if body.lower().endswith(end)), None)

    patella = named.get("patella") or by_name("patella", model.bodies, side)
    side = side or side_of(patella)
    if patella not in tree.joints:
        raise InputError(f"no joint carries {patella!r}", where=file, remedy="--patella NAME")
    carrier = tree.joints[patella].parent.body
    femur = named.get("femur") or by_name("femur", [carrier] if "femur" in carrier.lower() else model.bodies, side)
    side = side or side_of(femur)
    moving = (b for b, j in tree.joints.items() if j.kind != "WeldJoint" and b != patella)
    on_femur = (b for b in moving if tree.welded(tree.joints[b].parent.body)[0] == tree.welded(femur)[0])
    tibia = named.get("tibia") or by_name("tibia", on_femur, side)
    return OsimKnee(model, femur, tibia, patella, side or side_of(tibia) or "right")


class Written(NamedTuple):
    """A mesh to write."""

    part: str  # of the knee: "femur", "tibia" or "patella"
    file: str  # in the scene's folder
    mesh: SurfaceMesh  # in the part's frame [m]


def load_mesh(mesh: Mesh, knee: OsimKnee, places: list[Path]) -> Written:
    """Loads a mesh of one of the knee's bones from the model's folder, its subfolder geometry, or other `places`.

    Raises InputError for no such file, an unreadable file, and a mesh on another body.
    """
    part, pose = knee.placed(mesh.frame)
    if part not in PARTS:
        raise InputError(f"{mesh.name!r} is fixed to {part!r}", where=mesh.where, expected="a bone of the knee")
    vertices, faces = read_triangles(_mesh_file(mesh, Path(knee.model.root.file).parent, places))
    points = (vertices * mesh.scale) @ pose[:3, :3].T + pose[:3, 3]
    if np.prod(mesh.scale) < 0:
        faces = faces[:, ::-1].copy()
    return Written(part, f"{FOLDER}/{valid_name(mesh.name)}.stl", SurfaceMesh(points, faces, mesh.file))


def bones(knee: OsimKnee, places: list[Path], taken: set[str], left: list[LeftOut]) -> Iterator[Written]:
    """Meshes of the knee's bones; unreadable ones are added to `left`."""
    meshes = ((body.name, mesh) for body in knee.model.bodies.values() for mesh in body.meshes)
    for body, mesh in meshes:
        if knee.placed(mesh.frame)[0] not in PARTS:
            continue
        try:
            found = load_mesh(mesh, knee, places)
        except InputError as error:
            left.append(LeftOut("Mesh", mesh.name, f"of {body}: {error.problem}"))
            continue
        if found.file not in taken:
            taken.add(found.file)
            yield found


def _mesh_file(mesh: Mesh, home: Path, places: list[Path]) -> Path:
    """Finds a mesh's file by the last part of its name only, since a model must not choose where to read.

    Models often come from systems that ignore case, and downloads rename files: an exact name comes first, then one
    that differs in case alone, then one that differs in dots, underscores, blanks or hyphens too.
    """
    name = mesh.file.replace("\\", "/").rpartition("/")[2]
    if not name:
        raise InputError(f"{mesh.name!r} names no file", where=mesh.where)
    own = sorted(f for f in home.glob("*") if f.name.lower() == "geometry" and f.is_dir())
    folders = [home, *own, *places]
    files = [sorted(f for f in folder.glob("*") if f.is_file()) for folder in folders if folder.is_dir()]
    for spelling in (str, str.lower, loose_name):
        for held in files:
            alike = [f for f in held if spelling(f.name) == spelling(name)]
            if len(alike) > 1:
                several = ", ".join(f.name for f in alike)
                raise InputError(
                    f"no mesh {name!r}, and several that it may be: {several}",
                    where=mesh.where,
                    expected=f"one in {alike[0].parent}",
                    remedy="remove or rename the others",
                )
            if alike:
                return alike[0]
    searched = ", ".join(str(f) for f in (folders if own else [home, home / "Geometry", *places]))
    raise InputError(f"no mesh {name!r}", where=mesh.where, expected=f"in {searched}", remedy="--geometry FOLDER")
