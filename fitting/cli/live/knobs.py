"""What can be turned on the page: amounts of treatments and properties of tendons, each a change of the scene."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from pftwin.base.errors import InputError
from pftwin.model.scene import Scene

QUADRICEPS, PATELLAR_TENDON = "quadriceps", "patellar_tendon"
_ROUNDING = 1e-9  # of a value that a browser sends


@dataclass(frozen=True)
class Knob:
    """One slider."""

    name: str
    label: str  # with the unit
    group: str
    unit: str
    least: float
    most: float
    step: float
    neutral: float  # where the scene is as it was
    hint: str
    change: Callable[[Scene, float], Scene]  # from a value in `unit`

    def checked(self, value: Any) -> float:
        """The value as a number within the knob's range.

        Raises:
            InputError: no number, not finite, or out of range.
        """
        expected = f"{self.least:g} to {self.most:g} {self.unit}"
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise InputError(f"found {_short(value)}", where=self.label, expected=expected)
        if not self.least - _ROUNDING <= value <= self.most + _ROUNDING:
            raise InputError(f"found {value:g} {self.unit}", where=self.label, expected=expected)
        return float(min(max(value, self.least), self.most))


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


def _transferred(amount: str, scene: Scene, value: float) -> Scene:
    from fitting.treatments import tibial_tuberosity_transfer

    amounts = {amount: 1e-3 * value}
    return tibial_tuberosity_transfer(scene, **amounts)  # type: ignore[arg-type]


def _lengthened(tendon: str, scene: Scene, value: float) -> Scene:
    from fitting.treatments import patellar_tendon_length_change, quadriceps_lengthening

    change = quadriceps_lengthening if tendon == QUADRICEPS else patellar_tendon_length_change
    return change(scene, 1e-3 * value)


def _stiffened(tendon: str, scene: Scene, value: float) -> Scene:
    import equinox as eqx

    from fitting.treatments.parts import elastic

    found = elastic(scene, tendon, "stiffness")
    return scene.with_effect(eqx.tree_at(lambda t: t.stiffness, found, found.stiffness * (0.01 * value)))


def _transfer(name: str, least: float, most: float, hint: str) -> Knob:
    label = f"{name} [mm]"
    return Knob(name, label, "Tibial tuberosity", "mm", least, most, 0.5, 0.0, hint, partial(_transferred, name))


def _tendon(tendon: str, words: str, length: float) -> tuple[Knob, Knob]:
    stiff = f"Stiffness of the {words}, of what the scene has; its damping stays."
    long = f"Slack length of the {words}, against that in the scene; negative: shorter."
    return (
        Knob(
            f"{tendon}_stiffness",
            "stiffness [%]",
            words.capitalize(),
            "%",
            *(10.0, 400.0, 5.0, 100.0),
            stiff,
            partial(_stiffened, tendon),
        ),
        Knob(
            f"{tendon}_length",
            "longer by [mm]",
            words.capitalize(),
            "mm",
            *(-length, length, 0.5, 0.0),
            long,
            partial(_lengthened, tendon),
        ),
    )


KNOBS = (
    _transfer("medialisation", -20.0, 30.0, "Towards the midline; negative: laterally."),
    _transfer("anteriorisation", -20.0, 30.0, "Towards the front; negative: backwards."),
    _transfer("distalisation", -30.0, 30.0, "Towards the foot; negative: proximally."),
    *_tendon(QUADRICEPS, "quadriceps tendon", 60.0),
    *_tendon(PATELLAR_TENDON, "patellar tendon", 60.0),
)


def neutral(knobs: tuple[Knob, ...] = KNOBS) -> dict[str, float]:
    """Values that leave the scene as it is."""
    return {k.name: k.neutral for k in knobs}


def usable(scene: Scene) -> tuple[tuple[Knob, ...], dict[str, str]]:
    """The knobs that a scene has the parts for, and of the others, by group, why not."""
    found, reasons = [], {}
    for knob in KNOBS:
        try:
            knob.change(scene, knob.neutral)
        except InputError as error:
            reasons[knob.group] = f"{error.problem}"
        else:
            found.append(knob)
    return tuple(found), reasons


def turned(scene: Scene, knobs: tuple[Knob, ...], values: Mapping[str, float]) -> Scene:
    """The scene with every knob applied, neutral ones too: its leaves are then of one kind, and so is its program.

    Raises:
        InputError: a value that is no number within its knob's range, or one that is missing.
    """
    for knob in knobs:
        scene = knob.change(scene, knob.checked(values.get(knob.name)))
    return scene
