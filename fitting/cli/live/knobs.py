"""The sliders of the page: amounts of treatments and properties of tendons, each a change of the scene."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from pftwin.base.errors import InputError
from pftwin.model.scene import Scene

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
        """The value as a number; InputError if it is none, not finite, or out of range."""
        expected = f"{self.least:g} to {self.most:g} {self.unit}"
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise InputError(f"found {value!r:.40}", where=self.label, expected=expected)
        if not self.least - _ROUNDING <= value <= self.most + _ROUNDING:
            raise InputError(f"found {value:g} {self.unit}", where=self.label, expected=expected)
        return float(min(max(value, self.least), self.most))


def _treated(kind: str, amount: str, scene: Scene, value: float) -> Scene:
    from fitting.treatments import KINDS, Treatment

    return Treatment.of(kind, {amount: KINDS[kind].amounts[amount].from_shown(value)})(scene)


def _stiffened(tendon: str, scene: Scene, value: float) -> Scene:
    import equinox as eqx

    from fitting.treatments.parts import elastic

    found = elastic(scene, tendon, "stiffness")
    return scene.with_effect(eqx.tree_at(lambda t: t.stiffness, found, found.stiffness * (0.01 * value)))


def _transfer(name: str, least: float, most: float, hint: str) -> Knob:
    change = partial(_treated, "tibial_tuberosity_transfer", name)
    return Knob(name, f"{name} [mm]", "Tibial tuberosity", "mm", least, most, 0.5, 0.0, hint, change)


def _tendon(tendon: str, words: str, kind: str) -> tuple[Knob, Knob]:
    group = words.capitalize()
    stiff = f"Stiffness of the {words}, of what the scene has; its damping stays."
    long = f"Slack length of the {words}, against that in the scene; negative: shorter."
    soften, lengthen = partial(_stiffened, tendon), partial(_treated, kind, "lengthening")
    return (
        Knob(f"{tendon}_stiffness", "stiffness [%]", group, "%", 10.0, 400.0, 5.0, 100.0, stiff, soften),
        Knob(f"{tendon}_length", "longer by [mm]", group, "mm", -60.0, 60.0, 0.5, 0.0, long, lengthen),
    )


KNOBS = (
    _transfer("medialisation", -20.0, 30.0, "Towards the midline; negative: laterally."),
    _transfer("anteriorisation", -20.0, 30.0, "Towards the front; negative: backwards."),
    _transfer("distalisation", -30.0, 30.0, "Towards the foot; negative: proximally."),
    *_tendon("quadriceps", "quadriceps tendon", "quadriceps_lengthening"),
    *_tendon("patellar_tendon", "patellar tendon", "patellar_tendon_length_change"),
)


def neutral(knobs: tuple[Knob, ...] = KNOBS) -> dict[str, float]:
    """Values that leave the scene as it is."""
    return {k.name: k.neutral for k in knobs}


def usable_knobs(scene: Scene) -> tuple[tuple[Knob, ...], dict[str, str]]:
    """The knobs for which a scene has the parts, and by group why it lacks the others."""
    found, reasons = [], {}
    for knob in KNOBS:
        try:
            knob.change(scene, knob.neutral)
        except InputError as error:
            reasons[knob.group] = f"{error.problem}"
        else:
            found.append(knob)
    return tuple(found), reasons


def scene_with_knobs(scene: Scene, knobs: tuple[Knob, ...], values: Mapping[str, float]) -> Scene:
    """The scene with every knob applied, neutral ones too, so that all values share one compiled program."""
    for knob in knobs:
        scene = knob.change(scene, knob.checked(values.get(knob.name)))
    return scene
