"""What clinical indices are given as: values with how they were taken, and the landmarks that they need."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from numpy.typing import ArrayLike

from fitting.prediction.clinical_norms import USUAL


class ClinicalIndex(NamedTuple):
    """One index: its value (None where the scene cannot tell), its unit, and how it was taken or why it was not."""

    value: float | None
    unit: str
    note: str


@dataclass(frozen=True)
class Landmarks:
    """Points that a scene does not hold, (3,) each [m]; None: not known."""

    asis: ArrayLike | None = None  # anterior superior iliac spine, femur frame at the first frame
    tibial_plateau: ArrayLike | None = None  # anterosuperior corner of the tibial plateau, tibia frame
    articular_inferior: ArrayLike | None = None  # lower end of the patella's articular surface, patella frame
    articular_superior: ArrayLike | None = None  # its upper end


@dataclass(frozen=True)
class ClinicalIndices:
    """The indices of a scene."""

    tt_tg: ClinicalIndex  # lateral distance from the groove's bottom to the tibial tuberosity [mm]
    q_angle: ClinicalIndex  # tuberosity lateral of the quadriceps' line: positive [deg]
    caton_deschamps: ClinicalIndex
    sulcus_angle: ClinicalIndex  # [deg]
    lateral_trochlear_inclination: ClinicalIndex  # [deg]

    def describe(self) -> str:
        """One line each, with what the literature has as usual."""
        lines = []
        for name in self.__dataclass_fields__:
            index: ClinicalIndex = getattr(self, name)
            value = "not known" if index.value is None else f"{index.value:.2f} {index.unit}".rstrip()
            usual = "" if index.value is None else f"; usual in natural knees: {USUAL[name]}"
            lines.append(f"{name.replace('_', ' ')}: {value} ({index.note}){usual}")
        return "\n".join(lines)
