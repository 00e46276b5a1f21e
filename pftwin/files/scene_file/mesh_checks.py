"""What is refused of contacts of meshes before anything is computed with them."""

from __future__ import annotations

import numpy as np

from pftwin.base.errors import InputError
from pftwin.files.scene_file.host_pose import HostPose
from pftwin.files.scene_file.mesh_tables import At, ButtonMesh, FemurMesh
from pftwin.files.scene_file.setting import Setting


def refuse_patch(setting: Setting, at: At) -> None:
    """A patch asked for on the command line cannot take the place of meshes."""
    if setting.contact is not None:
        place, _, _ = setting.document.locate(at)
        raise InputError(
            f"{setting.contact} was asked for, and this contact is of meshes",
            where=setting.document.describe(place),
            remedy="leave --contact out, or a scene file with a [contact] table",
        )


def check_start(femur: FemurMesh, button: ButtonMesh, setting: Setting, at: At) -> None:
    """Refuse a start that no search for an equilibrium can find a way out of; a note on one that may be hard.

    Raises:
        InputError: most of the button behind the femur's surface, or all of it far away.
    """
    from pftwin.geometry.contact.behind import mutual_place
    from pftwin.geometry.contact.depths import DEEPEST
    from pftwin.geometry.mesh.mesh import PLAUSIBLE

    start = setting.start @ HostPose(button.origin, np.eye(3))
    found = mutual_place(femur.mesh, button.mesh, start.position, start.matrix)
    where = setting.document.describe(setting.document.locate(at)[0])
    poses = "[patella] start, center_m and mesh_pose of both meshes, and [axes]"
    if found.behind > 0.5:
        raise InputError(
            f"at the first frame {found.behind:.0%} of the button are inside the femur",
            where=where,
            expected="a start at which they hardly touch",
            remedy=f"check {poses}; flip = true if normals point inward (pftwin doctor-mesh)",
        )
    if found.gap > PLAUSIBLE[1]:
        raise InputError(
            f"at the first frame button and femur are {1e3 * found.gap:.0f} mm apart",
            where=where,
            expected=f"less than {1e3 * PLAUSIBLE[1]:.0f} mm",
            remedy=f"check {poses}",
        )
    if found.deepest > DEEPEST:
        setting.notes.append(
            f"{where}: at the first frame the button is {1e3 * found.deepest:.2g} mm deep in the femur: "
            "deeper than contact is made for, so the search for equilibrium may fail"
        )
