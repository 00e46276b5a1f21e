"""Attachments of muscles, tendon and retinacula of a natural knee, and the initial pose of its patella.

Millimetres and degrees, in the frames of femur, patella and tibia.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.geometry.bones.anatomy import Anatomy
from pftwin.geometry.bones.patella import EDGE, PatellaShape
from pftwin.geometry.bones.tibiofemoral import FLEXION_AXIS, FemurShape, TibiaShape
from pftwin.rig.natural.motion import tibia_turn

STRANDS = {"patellar_tendon": 5, "mpfl": 3, "lpfl": 3}
SIDES = {"mpfl": -1, "lpfl": 1}  # of the knee: medial, lateral
TENDON_WIDTH = 24.0  # width of the patellar tendon at the patella [mm]; two thirds of it at the tuberosity
LINE_LENGTH = 200.0  # length of a muscle's line from its insertion to its end on the femur [mm]
# Quadriceps: share of the force by cross-section, and angle to the femoral shaft, lateral positive [deg], from
# Farahmand, Senavongse & Amis 1998, J Orthop Res 16:136. Long and oblique heads are combined; the division of the 35 %
# of the two central muscles is a choice.
QUADRICEPS = {
    "vastus_medialis": (0.25, -27.0),
    "vastus_lateralis": (0.40, 18.5),
    "vastus_intermedius": (0.20, 0.0),
    "rectus_femoris": (0.15, 0.0),
}


class Ends(NamedTuple):
    """End points of n lines of force, (n, 3) each [mm]."""

    patella: Floats  # in the patella frame
    body: Floats  # in the frame of the other body


def muscles(anatomy: Anatomy) -> Ends:
    """Returns the end points of the four quadriceps muscles, in the order of `QUADRICEPS`, in full extension."""
    shape = PatellaShape(anatomy)
    front = 0.6 * anatomy.patella_thickness_mm
    patella = np.array(
        [
            (0.5 * shape.top, 0.6 * -shape.medial, front),
            (0.8 * shape.top, 0.6 * shape.lateral, front),
            (shape.top - 2, 0.0, front - 2),
            (shape.top - 1, 0.0, front + 2),
        ]
    )
    place, turn = rest_pose(anatomy, 0.0)
    angle = np.radians([a for _, a in QUADRICEPS.values()])
    way = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    return Ends(patella, place + turn.apply(patella) + LINE_LENGTH * way)


def patellar_tendon(anatomy: Anatomy) -> Ends:
    """Returns the end points of the patellar tendon's strands, from the patella's apex to the tuberosity."""
    shape = PatellaShape(anatomy)
    across = np.linspace(-0.5, 0.5, STRANDS["patellar_tendon"])
    aside = np.stack([0 * across, TENDON_WIDTH * across, 0 * across], axis=1)
    apex = np.array([shape.bottom, shape.middle, 0.5 * anatomy.patella_thickness_mm])
    apex = apex + np.outer(4 * (2 * across) ** 2, [1.0, 0.0, 0.0])  # the patella's border rises beside its apex
    return Ends(apex + aside, np.array(TibiaShape(anatomy).tuberosity) + 2 / 3 * aside)


def retinaculum(anatomy: Anatomy, name: str) -> Ends:
    """Returns the end points of the "mpfl" or "lpfl": a fan from the patella's border to the epicondyle."""
    shape, side = PatellaShape(anatomy), SIDES[name]
    border = (shape.medial if side < 0 else shape.lateral) - 2
    up = np.linspace(0.0, 0.7, STRANDS[name])
    flat = np.ones_like(up)
    height = float(shape.articular(np.asarray(border))) + 0.5 * EDGE
    patella = np.stack([shape.top * up, side * border * flat, height * flat], axis=1)
    femur = np.stack([6 * up, side * 0.5 * anatomy.epicondylar_width_mm * flat, -6 * flat], axis=1)
    return Ends(patella, femur)


def rest_pose(anatomy: Anatomy, flexion: float) -> tuple[Floats, Rotation]:
    """Returns the patella's pose in the femur [mm] at a flexion [deg]: ridge in the groove, tendon of given length.

    Raises:
        InputError: the tendon is too long or too short for the patella to lie on the trochlea.
    """
    body, ends = FemurShape(anatomy), patellar_tendon(anatomy)
    apex, insertion = (points[STRANDS["patellar_tendon"] // 2] for points in ends)
    bent = tibia_turn(np.asarray(flexion))
    axis = np.array([FLEXION_AXIS[0], 0.0, FLEXION_AXIS[1]])
    tuberosity = axis + bent.apply(insertion - axis)

    def at(angle: float) -> tuple[Floats, Rotation]:
        radius = anatomy.trochlear_radius_mm
        if angle < 0:
            place = radius * np.array([np.sin(angle), 0.0, np.cos(angle)])
        else:
            height = radius * angle
            place = np.array([height, 0.0, radius - float(body.recession(np.array(height)))])
        return place, Rotation.from_euler("Y", min(angle, 0.0))

    def excess(angle: float) -> float:
        place, turn = at(angle)
        return float(np.linalg.norm(place + turn.apply(apex) - tuberosity))

    low, high, length = -np.radians(flexion), 1.6, anatomy.tendon_length_mm  # at `low` the apex points at the tibia
    if not excess(low) < length < excess(high):
        least, most = 100 * np.array([excess(low), excess(high)]) / anatomy.patella_height_mm
        raise InputError(
            f"a ratio of {anatomy.insall_salvati:g} and a patella {anatomy.patella_height_mm:g} mm high make a tendon "
            f"of {length:.0f} mm, which holds the patella nowhere on the trochlea at {flexion:g} deg of flexion",
            where="insall_salvati, patella_height_mm",
            expected=f"a ratio of {np.ceil(least) / 100:g} to {np.floor(most) / 100:g} for this height",
        )
    return at(float(brentq(lambda a: excess(a) - length, low, high)))
