"""Cases of the virtual rig: its whole knee and motion of 7.2 s, with some of its numbers multiplied."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from pftwin import rig
from pftwin.geometry.patch.charts import CylindricalChart
from pftwin.model.scene import Scene
from pftwin.rig import geometry
from pftwin.rig.contacts import contact_fit
from pftwin.studies.hard_cases.ground import CYLINDER
from pftwin.studies.hard_cases.knee import Law

STIFFNESS = "contact.law.contact_stiffness"


@dataclass(frozen=True)
class RigNumbers:
    """A case of the rig, which tells what `pftwin.studies.hard_cases.knee.KneeNumbers` does."""

    case: int
    factors: Mapping[str, float] = field(default_factory=dict)  # by the numbers' names

    @property
    def law(self) -> Law:
        """Of the contact."""
        return Law(geometry.CONTACT_STIFFNESS * self.factors.get(STIFFNESS, 1.0), restitution=geometry.RESTITUTION)

    @property
    def radius(self) -> float:
        """Of the button [m]."""
        return geometry.BUTTON_RADIUS

    def scene_on(self, kind: str, name: str) -> Scene:
        """See `KneeNumbers`."""
        patch, chart = _parts(kind)
        scene = rig.case(self.case, contact=patch, chart=chart)
        for number, factor in self.factors.items():
            scene = scene.set(number, scene.get(number) * factor)
        return dataclasses.replace(scene, name=name)

    def axis_below(self, kind: str) -> float:
        """See `KneeNumbers`."""
        patch, chart = _parts(kind)
        surface = contact_fit(patch, chart=chart).patch
        return float(surface.chart.radius) if isinstance(surface.chart, CylindricalChart) else 0.0


def _parts(kind: str) -> tuple[str, Literal["plane", "cylinder"]]:
    """The patch's name, and its chart."""
    return kind.removesuffix(CYLINDER), "cylinder" if kind.endswith(CYLINDER) else "plane"
