"""Medial and lateral patellofemoral ligaments (MPFL, LPFL) for the virtual rig, which has none by default.

Published: the stiffness of the MPFL with its attachments, 42.5 N/mm (Criscenti et al. 2016, J Mech Behav Biomed Mater
54:141, PubMed 26454357, mean of 24 knees), and of the LPFL, 16 N/mm (Merican et al. 2009, J Biomech 42:2323, mean of
8); that the MPFL is some 55 mm long, runs from the medial epicondyle to the patella's medial border, is tightest in
full extension and slackens as the knee bends (Amis et al. 2003, Knee 10:215). The attachments, spread as a fan, are
chosen from these descriptions and the rig's size. The five strands of each ligament, the toe strain, the damping and
the reference pose, in which the strands have their slack length by default, are choices too: the patella of case 1 in
full extension, within 0.4 mm and 1.1 deg of its equilibrium on the component's true surface.

Units: metres, newtons, seconds; frames of the rig (`pftwin.rig.geometry`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.leaves import number, vector
from pftwin.geometry.wrapping.obstacle import Obstacle
from pftwin.model.effects.tendon import StrandGroup
from pftwin.model.scene import Scene

STRANDS = 5
TOE_STRAIN = 0.06
DAMPING_TIME = 0.003  # [s]
REFERENCE_POSITION = (0.0244, 0.0076, 0.0476)  # of the patella's origin in the femur
REFERENCE_QUATERNION = (0.9954, 0.0892, 0.0113, 0.0337)  # of the patella in the femur, scalar first


class Ligament(NamedTuple):
    """A fan of strands between two lines of attachment points, each given by its ends."""

    stiffness: float  # of all strands together in their linear region [N/m]
    patella: tuple[tuple[float, float, float], tuple[float, float, float]]  # distal and proximal end, patella frame [m]
    femur: tuple[tuple[float, float, float], tuple[float, float, float]]  # the same on the femur, femur frame [m]


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
    """Returns one of the rig's ligaments.

    Args:
        name: "mpfl" or "lpfl".
        reference_strain: strain of the strands in the reference pose, above -1; negative: slack.

    Raises:
        InputError: unknown ligament or invalid strain.
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
    name: str,
    body: str,
    stiffness: Floats,
    slack: Floats,
    toe_strain: float,
    patella: Floats,
    origin: Floats,
    wrap: Obstacle | None = None,
) -> StrandGroup:
    """Makes n strands with this module's damping; stiffness [N per unit strain], slack lengths and end points [m]."""
    toe, damping = (number(np.full_like(slack, x)) for x in (toe_strain, DAMPING_TIME))
    ends = vector(patella), vector(origin)
    return StrandGroup(number(stiffness), number(slack), toe, damping, *ends, body, wrap=wrap, name=name)


def with_retinacula(
    scene: Scene, ligaments: Sequence[str] = ("mpfl", "lpfl"), *, reference_strain: float = 0.0
) -> Scene:
    """Adds ligaments to one of the rig's cases; replaces those that it has already.

    Args:
        scene: a scene of `pftwin.rig.case`, with any contact.
        ligaments: any of "mpfl" and "lpfl".
        reference_strain: see `ligament`.

    Raises:
        InputError: unknown ligament or invalid strain.
    """
    for name in [ligaments] if isinstance(ligaments, str) else ligaments:
        scene = scene.with_effect(ligament(name, reference_strain=reference_strain))
    return scene
