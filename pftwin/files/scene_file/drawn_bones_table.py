"""[bones]: surfaces of bones for drawings of the scene; they exert no force."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from pftwin.base.errors import InputError
from pftwin.files.scene_file.effect_tables import Setting
from pftwin.files.scene_file.section import Section, problem
from pftwin.files.scene_file.surface_table import MeshFileSection

if TYPE_CHECKING:
    from pftwin.geometry.mesh.mesh import SurfaceMesh
    from pftwin.model.drawn_bones import DrawnBones

SIZES = (0.015, 0.65)  # plausible longest side of a bone or a part of one [m]
FARTHEST = 0.2  # largest plausible distance of a bone's nearest point from its frame's origin [m]


class BoneSection(MeshFileSection):
    """A bone's surface in its body's frame."""

    repair: bool = Field(default=False, description="reorient triangles that face the wrong way")

    def build(self, body: str, setting: Setting) -> SurfaceMesh:
        """The surface in the scene's frame of its body.

        Raises:
            InputError: a mesh that is unreadable, has an implausible size or is far from its frame's origin.
        """
        from pftwin.geometry.mesh.mesh import load_mesh

        with setting.naming("mesh"):
            mesh = load_mesh(setting.path(self.mesh), units=self.units, size=SIZES, repair=self.repair)
        mesh = setting.side.mesh(body, self._placed(mesh))
        if (away := float(np.linalg.norm(mesh.vertices, axis=1).min())) > FARTHEST:
            raise InputError(
                f"all of it is {1e3 * away:.0f} mm or farther from the origin of the {body}'s frame",
                where=setting.where("mesh"),
                expected=f"less than {1e3 * FARTHEST:.0f} mm",
                remedy="mesh_pose, where the mesh has another frame than the bone; check units",
            )
        return mesh


class DrawnBonesSection(Section):
    """Surfaces of bones for drawings of the scene; they exert no force, and contact needs its own meshes."""

    femur: BoneSection | None = Field(default=None, description="table: the femur's surface; schematic by default")
    patella: BoneSection | None = Field(default=None, description="table: the patella's; schematic by default")
    tibia: BoneSection | None = Field(default=None, description="table: the tibia's; schematic by default")

    def _check(self) -> None:
        if not self.model_fields_set:
            raise problem("no bone", expected="femur, patella or tibia, or no such table")

    def build(self, setting: Setting) -> DrawnBones:
        """The surfaces in the table."""
        from pftwin.model.drawn_bones import DrawnBones

        given = ((body, getattr(self, body)) for body in ("femur", "patella", "tibia"))
        return DrawnBones({body: bone.build(body, setting.at(body)) for body, bone in given if bone is not None})
