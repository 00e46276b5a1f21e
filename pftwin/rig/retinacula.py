"""The medial and the lateral patellofemoral ligament for the virtual rig, which has none of its own.

Published: the stiffness of the MPFL with its attachments, 42.5 N/mm (Criscenti et al. 2016, J Mech Behav Biomed Mater
54:141, PubMed 26454357, mean of 24 knees), and of the LPFL, 16 N/mm (Merican et al. 2009, J Biomech 42:2323, mean of
8); that the MPFL is some 55 mm long, runs from the medial epicondyle to the patella's medial border, is tightest in
full extension and slackens as the knee bends (Amis et al. 2003, Knee 10:215). The attachments are choices by these
descriptions and by the rig's size, spread as a fan. So are five strands each, the toe strain, the damping, and the
reference pose, where the strands are as long as when slack unless told otherwise: the patella of case 1 in full
extension, within 0.4 mm and 1.1 deg of where the component's true surface holds it.

Metres, newtons, seconds; frames of the rig (`pftwin.rig.geometry`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.leaves import number, vector
from pftwin.model.effects.tendon import StrandGroup
from pftwin.model.scene import Scene

STRANDS = 5
TOE_STRAIN = 0.06
DAMPING_TIME = 0.003  # [s]
REFERENCE_POSITION = (0.0244, 0.0076, 0.0476)  # of the patella's origin in the femur
REFERENCE_QUATERNION = (0.9954, 0.0892, 0.0113, 0.0337)  # of the patella in the femur, scalar first


class Ligament(NamedTuple):
    """A fan of strands between two lines of attachments, given by their ends."""

    stiffness: float  # of all strands together in their linear region [N/m]
    patella: tuple[tuple[float, float, float], tuple[float, float, float]]  # distal and proximal end, patella frame [m]
    femur: tuple[tuple[float, float, float], tuple[float, float, float]]  # likewise, femur frame [m]


LIGAMENTS = {
    "mpfl": Ligament(
        42.5e3,
        patella=((0.000, -0.022, -0.012), (0.016, -0.022, -0.012)),
        femur=((-0.001, -0.040, 0.006), (0.005, -0.040, 0.002)),
    ),
    "lpfl": Ligament(
        16.0e3,
        patella=((-0.004, 0.022, -0.012), (0.008, 0.022, -0.012)),
        femur=((0.001, 0.042, -0.004), (0.005, 0.042, 0.000)),
    ),
}


def ligament(name: str, *, reference_strain: float = 0.0) -> StrandGroup:
    """One of the rig's ligaments.

    Args:
        name: "mpfl" or "lpfl".
        reference_strain: of its strands in the reference pose, above -1; negative where they are lax there.

    Raises:
        InputError: no such ligament, or no such strain.
    """
    from scipy.spatial.transform import Rotation

    if name not in LIGAMENTS:
        raise InputError(f"no ligament {name!r} of the rig", where="ligament", expected=", ".join(LIGAMENTS))
    if not -1 < reference_strain < np.inf:
        raise InputError(f"found {reference_strain!r}", where="reference_strain", expected="a number above -1")
    made = LIGAMENTS[name]
    insertion, origin = (
        np.linspace(np.array(first), np.array(last), STRANDS) for first, last in (made.patella, made.femur)
    )
    there = Rotation.from_quat(REFERENCE_QUATERNION, scalar_first=True).apply(insertion) + np.array(REFERENCE_POSITION)
    slack = np.linalg.norm(there - origin, axis=1) / (1 + reference_strain)
    return strand_group(name, "femur", made.stiffness / STRANDS * slack, slack, TOE_STRAIN, insertion, origin)


def strand_group(
    name: str, body: str, stiffness: Floats, slack: Floats, toe_strain: float, patella: Floats, origin: Floats
) -> StrandGroup:
    """Strands with this module's damping: stiffness [N per unit strain] and slack lengths (n,), ends (n, 3) [m]."""
    toe, damping = (number(np.full_like(slack, x)) for x in (toe_strain, DAMPING_TIME))
    return StrandGroup(number(stiffness), number(slack), toe, damping, vector(patella), vector(origin), body, name=name)


def with_retinacula(
    scene: Scene, ligaments: Sequence[str] = ("mpfl", "lpfl"), *, reference_strain: float = 0.0
) -> Scene:
    """One of the rig's cases with ligaments; one that is there already is replaced.

    Args:
        scene: `pftwin.rig.case`, whatever its contact.
        ligaments: which of "mpfl" and "lpfl".
        reference_strain: see `ligament`.

    Raises:
        InputError: no such ligament, or no such strain.
    """
    for name in [ligaments] if isinstance(ligaments, str) else ligaments:
        scene = scene.with_effect(ligament(name, reference_strain=reference_strain))
    return scene
