"""The kinds of treatment: which function makes them, their amounts, units, and what both are called in words."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import ArrayLike

from fitting.treatments import patella, tendons, trochlea
from pftwin.model.scene import Scene

_SHOWN = {"m": (1e3, "mm"), "rad": (180 / np.pi, "deg"), "1": (100.0, "%")}  # at the edges


class Way(NamedTuple):
    """One amount of a treatment."""

    unit: str  # "m", "rad" or "1"
    more: str  # what a positive amount does, in words
    less: str  # a negative one

    @property
    def shown_unit(self) -> str:
        """The unit in which people read it."""
        return _SHOWN[self.unit][1]

    def shown(self, value: ArrayLike) -> np.ndarray:
        """In that unit."""
        return _SHOWN[self.unit][0] * np.asarray(value, dtype=np.float64)

    def from_shown(self, value: Any) -> np.ndarray:
        """In SI from that unit."""
        return np.asarray(value, dtype=np.float64) / _SHOWN[self.unit][0]


class TreatmentKind(NamedTuple):
    """A kind of treatment: its function, its amounts, and what it changes in words."""

    change: Callable[..., Scene]
    part: str
    amounts: dict[str, Way]


_MEDIAL = Way("m", "medially", "laterally")
_DISTAL = Way("m", "distally", "proximally")
_ANTERIOR = Way("m", "anteriorly", "posteriorly")
_LONGER = Way("m", "longer", "shorter")

KINDS = {
    "tibial_tuberosity_transfer": TreatmentKind(
        tendons.tibial_tuberosity_transfer,
        "tibial tuberosity",
        {"medialisation": _MEDIAL, "anteriorisation": _ANTERIOR, "distalisation": _DISTAL},
    ),
    "patellar_tendon_length_change": TreatmentKind(
        tendons.patellar_tendon_length_change, "patellar tendon", {"lengthening": _LONGER}
    ),
    "quadriceps_lengthening": TreatmentKind(
        tendons.quadriceps_lengthening, "quadriceps tendon", {"lengthening": _LONGER}
    ),
    "trochleoplasty": TreatmentKind(
        trochlea.trochleoplasty, "trochlear groove", {"deepening": Way("m", "deeper", "shallower")}
    ),
    "femoral_component_rotation": TreatmentKind(
        trochlea.femoral_component_rotation,
        "femoral component turned",
        {
            "external_rotation": Way("rad", "externally", "internally"),
            "flexion": Way("rad", "into flexion", "into extension"),
            "varus": Way("rad", "into varus", "into valgus"),
        },
    ),
    "femoral_component_translation": TreatmentKind(
        trochlea.femoral_component_translation,
        "femoral component",
        {"medialisation": _MEDIAL, "distalisation": _DISTAL, "anteriorisation": _ANTERIOR},
    ),
    "button_position": TreatmentKind(
        patella.button_position,
        "button",
        {"medialisation": _MEDIAL, "distalisation": _DISTAL, "anteriorisation": _ANTERIOR},
    ),
    "lateral_release": TreatmentKind(
        patella.lateral_release, "lateral strands", {"release": Way("1", "released", "tightened")}
    ),
    "mpfl_graft": TreatmentKind(
        patella.mpfl_graft,
        "MPFL graft",
        {
            "stiffening": Way("1", "stiffer", "softer"),
            "shortening": Way("m", "shorter", "longer"),
            "proximalisation": Way("m", "proximally on the femur", "distally on the femur"),
            "anteriorisation": Way("m", "anteriorly on the femur", "posteriorly on the femur"),
        },
    ),
}
