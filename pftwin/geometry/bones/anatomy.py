"""Anatomical parameters of a natural knee, with the ranges measured in knees.

Angles and lengths are those of radiology, in the units of their names. Four parameters define the trochlea's axial
section at the height of the trochlear axis, some 3 cm above the joint line: from the deepest point the lateral facet
rises to its ridge at `lateral_inclination_deg`, the medial one at 180 deg less this and the sulcus angle. `facet_ratio`
is the ratio of the facets' widths, and the trochlear depth the mean height of both ridges.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from numbers import Real
from typing import Any

from pftwin.base.errors import InputError

EPICONDYLE = 2.0  # protrusion of the epicondyles beside the condyles [mm]
RIDGE_TO_SIDE = 4.0  # smallest distance from a ridge of the trochlea to the condyle's side [mm]


def _number(default: float, low: float, high: float, source: str) -> Any:
    return field(default=default, metadata={"low": low, "high": high, "source": source})


@dataclass(frozen=True)
class Anatomy:
    """A knee's anatomy; the defaults are those of a normal adult knee.

    Ranges cover values measured in normal and in dysplastic knees; some are assumptions. `Anatomy.ranges()` returns
    them with their sources.

    Raises:
        InputError: a parameter outside its range, or parameters that give no valid trochlea.
    """

    sulcus_angle_deg: float = _number(138.0, 115.0, 179.0, "138 (6) Merchant 1974; 146 (5.5) Shih 2004")
    lateral_inclination_deg: float = _number(22.0, 0.5, 35.0, "20 (5) Shih 2004; below 11 dysplastic, Carrillon 2000")
    facet_ratio: float = _number(0.65, 0.05, 1.0, "medial by lateral facet; below 0.4 dysplastic, Pfirrmann 2000")
    trochlear_depth_mm: float = _number(
        5.2, 0.1, 10.0, "a choice; 6.0 in CT (PMC5134791); below 3 dysplastic, Pfirrmann 2000"
    )
    trochlear_radius_mm: float = _number(23.0, 15.0, 35.0, "sagittal, of the groove: 23 (4) Iranpour 2010")
    prominence_mm: float = _number(-0.8, -9.0, 9.0, "floor before the cortex: -0.8 (2.9), > 3 dysplastic, Dejour 1994")
    condyle_radius_mm: float = _number(23.0, 16.0, 32.0, "like the groove's, Monk 2014; range a choice")
    epicondylar_width_mm: float = _number(82.0, 62.0, 100.0, "a choice, by the other numbers' scale")
    patella_height_mm: float = _number(43.0, 28.0, 58.0, "1.3 articular lengths, 32.7 (3.8) Kerdari 2020")
    patella_width_mm: float = _number(44.6, 31.0, 58.0, "44.6 (4.3) Kerdari 2020")
    patella_thickness_mm: float = _number(25.0, 18.0, 32.0, "with cartilage: 25.1 (2.3) Kerdari 2020")
    ridge_angle_deg: float = _number(132.0, 100.0, 175.0, "between the patellar facets, Wiberg 1941; range a choice")
    wiberg_ratio: float = _number(1.4, 0.8, 4.0, "lateral by medial patellar facet: types I to III, Wiberg 1941")
    patellar_cartilage_mm: float = _number(4.1, 1.0, 8.0, "4.1 (1.3), 43 adults, Bone Joint J 95-B Suppl 14")
    trochlear_cartilage_mm: float = _number(2.4, 0.5, 6.0, "mean of a knee 1.6 to 2.4, PubMed 11237657")
    insall_salvati: float = _number(1.02, 0.6, 1.7, "tendon by patella: 1.02 (0.13) Insall & Salvati 1971")
    tt_tg_mm: float = _number(12.7, -2.0, 30.0, "12.7 (3.4), in dislocators 19.8 (1.6), Dejour 1994")

    def __post_init__(self) -> None:
        for name, (low, high, source) in self.ranges().items():
            value = getattr(self, name)
            if not (isinstance(value, Real) and low <= float(value) <= high):  # NaN, too
                raise InputError(f"found {value!r}", where=name, expected=f"{low:g} to {high:g} ({source})")
        if self.medial_inclination_deg <= 0:
            raise InputError(
                f"a sulcus angle of {self.sulcus_angle_deg:g} deg leaves nothing for the medial facet beside a lateral "
                f"one inclined by {self.lateral_inclination_deg:g} deg",
                where="sulcus_angle_deg",
                expected=f"less than {180 - self.lateral_inclination_deg:g} deg",
            )
        room = 0.5 * self.epicondylar_width_mm - EPICONDYLE - RIDGE_TO_SIDE  # the lateral facet is the wider one
        if self.lateral_facet_mm > room:
            deepest = self.trochlear_depth_mm * room / self.lateral_facet_mm
            raise InputError(
                f"a lateral facet {self.lateral_facet_mm:.1f} mm wide does not fit on a femur of "
                f"{self.epicondylar_width_mm:g} mm",
                where="trochlear_depth_mm",
                expected=f"at most {math.floor(100 * deepest) / 100:g} mm at these inclinations",
            )

    @staticmethod
    def ranges() -> dict[str, tuple[float, float, str]]:
        """Lowest and highest value of each parameter, and their sources."""
        found = dataclasses.fields(Anatomy)
        return {f.name: (f.metadata["low"], f.metadata["high"], f.metadata["source"]) for f in found}

    @staticmethod
    def dejour(kind: str) -> Anatomy:
        """A dysplastic trochlea of Dejour's type A, B, C or D.

        A is shallow; B flat with a prominence; C asymmetric with a hypoplastic medial facet; D combines B and C, but
        without the cliff of this type (D. Dejour & Le Coultre 2007, Sports Med Arthrosc 15:39). The values are
        assumptions from this description and the limits of dysplasia in `ranges`; they are not means of patients.

        Raises:
            InputError: an unknown type.
        """
        if kind not in _DEJOUR:
            raise InputError(f"no type {kind!r} of trochlear dysplasia", expected=f"one of: {', '.join(_DEJOUR)}")
        sulcus, lateral, ratio, depth, prominence = _DEJOUR[kind]
        return Anatomy(sulcus, lateral, ratio, depth, prominence_mm=prominence)

    @property
    def medial_inclination_deg(self) -> float:
        """Inclination of the medial facet, from the sulcus angle and the lateral facet."""
        return 180 - self.sulcus_angle_deg - self.lateral_inclination_deg

    @property
    def lateral_facet_mm(self) -> float:
        """Width of the lateral facet, from the groove to its ridge."""
        lateral, medial = _slope(self.lateral_inclination_deg), _slope(self.medial_inclination_deg)
        return 2 * self.trochlear_depth_mm / (lateral + self.facet_ratio * medial)

    @property
    def medial_facet_mm(self) -> float:
        """Width of the medial facet."""
        return self.facet_ratio * self.lateral_facet_mm

    @property
    def lateral_height_mm(self) -> float:
        """Height of the lateral ridge above the groove's deepest point."""
        return self.lateral_facet_mm * _slope(self.lateral_inclination_deg)

    @property
    def medial_height_mm(self) -> float:
        """Height of the medial ridge above the groove's deepest point."""
        return self.medial_facet_mm * _slope(self.medial_inclination_deg)

    @property
    def tendon_length_mm(self) -> float:
        """Length of the patellar tendon."""
        return self.insall_salvati * self.patella_height_mm


def _slope(inclination_deg: float) -> float:
    return math.tan(math.radians(inclination_deg))


# For each type: sulcus angle, lateral inclination, facet ratio, trochlear depth, prominence.
_DEJOUR = {
    "A": (150.0, 15.0, 0.6, 2.8, -0.8),
    "B": (165.0, 8.0, 0.6, 1.6, 4.0),
    "C": (162.0, 9.0, 0.3, 1.8, 1.0),
    "D": (168.0, 6.0, 0.25, 1.2, 5.5),
}
