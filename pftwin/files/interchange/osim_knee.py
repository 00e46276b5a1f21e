"""Which bodies of an OpenSim model are the knee's: femur, tibia and patella, with the bones that are welded to them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.files.interchange.osim_document import OsimFrame
from pftwin.files.interchange.osim_joints import Joint
from pftwin.files.interchange.osim_model import OsimModel

Floats = NDArray[np.float64]
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
    """By what was named, else by the bodies' names and the joints between them.

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
    patella = named.get("patella") or _called("patella", list(model.bodies), side, model)
    joint = model.tree.joints.get(patella)
    if joint is None:
        raise InputError(f"no joint carries {patella!r}", where=model.file, remedy="--patella NAME")
    femur = named.get("femur") or _femur(model, joint, side)
    children = [b for b, j in model.tree.joints.items() if _hangs_on(model, j, femur) and b != patella]
    tibia = named.get("tibia") or _called("tibia", children, side, model)
    sides = [s for s, end in SIDES.items() if patella.lower().endswith(end)]
    chosen = side or (sides[0] if sides else "right")
    return OsimKnee(femur, tibia, patella, chosen)


def placed(model: OsimModel, knee: OsimKnee, frame: OsimFrame) -> tuple[str, Floats]:
    """The part of the knee that carries a frame, and the frame's pose (4, 4) in it; other bodies keep their name."""
    body, pose = model.tree.welded(frame.body)
    own = {name: model.tree.welded(name) for name in (knee.femur, knee.tibia, knee.patella)}
    for name, (root, at) in own.items():
        if body == root:
            return knee.part(name), np.linalg.inv(at) @ pose @ frame.pose
    return body, pose @ frame.pose


def _femur(model: OsimModel, joint: Joint, side: str | None) -> str:
    """What carries the patella, if that is a femur; else the body that is called so."""
    parent = joint.parent.body
    if "femur" in parent.lower():
        return parent
    return _called("femur", list(model.bodies), side, model)


def _hangs_on(model: OsimModel, joint: Joint, femur: str) -> bool:
    """Whether a joint with degrees of freedom joins a body to the femur or to what is welded to it."""
    return joint.kind != "WeldJoint" and model.tree.welded(joint.parent.body)[0] == model.tree.welded(femur)[0]


def _called(part: str, names: list[str], side: str | None, model: OsimModel) -> str:
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
