"""What clinical indices are given as: values with how they were taken, and the landmarks that they need."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from numpy.typing import ArrayLike

from fitting.prediction.clinical_norms import USUAL


class Index(NamedTuple):
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

    tt_tg: Index  # lateral distance from the groove's bottom to the tibial tuberosity [mm]
    q_angle: Index  # tuberosity lateral of the quadriceps' line: positive [deg]
    caton_deschamps: Index
    sulcus_angle: Index  # [deg]
    lateral_trochlear_inclination: Index  # [deg]

    def describe(self) -> str:
        """One line each, with what the literature has as usual."""
        lines = []
        for name in self.__dataclass_fields__:
            index: Index = getattr(self, name)
            value = "not known" if index.value is None else f"{index.value:.2f} {index.unit}".rstrip()
            usual = "" if index.value is None else f"; usual in natural knees: {USUAL[name]}"
            lines.append(f"{name.replace('_', ' ')}: {value} ({index.note}){usual}")
        return "\n".join(lines)
