"""Treatments: what a surgeon or an engineer could change, as functions from a scene to a scene.

Every function is pure and differentiable in its amounts, which are in metres and radians. A `Treatment` combines one or
several of them with their amounts, and can be printed in words.
"""

from __future__ import annotations

from fitting.treatments.changes import (
    button_position,
    deepening_shape,
    femoral_component_rotation,
    femoral_component_translation,
    femoral_derotation,
    lateral_release,
    mpfl_graft,
    patellar_tendon_length_change,
    quadriceps_lengthening,
    tibial_tuberosity_transfer,
    trochleoplasty,
)
from fitting.treatments.treatment import KINDS, Treatment

__all__ = [
    "KINDS",
    "Treatment",
    "button_position",
    "deepening_shape",
    "femoral_component_rotation",
    "femoral_component_translation",
    "femoral_derotation",
    "lateral_release",
    "mpfl_graft",
    "patellar_tendon_length_change",
    "quadriceps_lengthening",
    "tibial_tuberosity_transfer",
    "trochleoplasty",
]
