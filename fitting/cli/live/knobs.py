"""Sliders of the live page: amounts of all treatments, and stiffnesses of the tendons."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import numpy as np

from fitting.treatments import KINDS, Treatment
from fitting.treatments.parts import PATELLAR_TENDON, QUADRICEPS, elastic
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.model.scene import Scene

if TYPE_CHECKING:
    from fitting.estimate import Estimate

_ROUNDING = 1e-9  # tolerance for rounding of values from a browser
_STEPS = {"mm": 0.5, "deg": 0.5, "%": 5.0}
_TENDONS = {QUADRICEPS: KINDS["quadriceps_lengthening"].part, PATELLAR_TENDON: PATELLAR_TENDON.replace("_", " ")}


class Knob(NamedTuple):
    """A slider of the live page; values are in its display unit."""

    name: str
    label: str  # with the unit
    group: str
    unit: str
    least: float
    most: float
    neutral: float  # value that leaves the scene unchanged
    hint: str
    size: float  # one display unit in SI units

    @property
    def step(self) -> float:
        """Distance between two values, in its unit."""
        return _STEPS[self.unit]

    def checked(self, value: Any) -> float:
        """The value as a float; InputError if it is not a number, not finite, or out of range."""
        where, expected = f"{self.group}, {self.label}", f"{self.least:g} to {self.most:g} {self.unit}"
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise InputError(f"found {value!r:.40}", where=where, expected=expected)
        if not self.least - _ROUNDING <= value <= self.most + _ROUNDING:
            raise InputError(f"found {value:g} {self.unit}", where=where, expected=expected)
        return float(min(max(value, self.least), self.most))


def _group(part: str) -> str:
    return f"{part[:1].upper()}{part[1:]}"


def _stiffness(tendon: str) -> Knob:
    hint = "Percentage of the scene's stiffness; damping is unchanged."
    return Knob(f"{tendon}.stiffness", "stiffness [%]", _group(_TENDONS[tendon]), "%", 10.0, 400.0, 100.0, hint, 0.01)


def _amount(kind: str, name: str) -> Knob:
    part, way = KINDS[kind].part, KINDS[kind].amounts[name]
    label = f"{name.replace('_', ' ')} [{way.shown_unit}]"
    hint = f"Positive: {way.more}{f'; negative: {way.less}' if way.usual[0] < 0 else ''}."
    size = float(way.from_shown(1.0))
    return Knob(f"{kind}.{name}", label, _group(part), way.shown_unit, *way.usual, 0.0, hint, size)


KNOBS = (*map(_stiffness, _TENDONS), *(_amount(kind, name) for kind, about in KINDS.items() for name in about.amounts))
GROUPS = tuple(dict.fromkeys(_group(about.part) for about in KINDS.values()))  # in the order of the page


def neutral() -> dict[str, float]:
    """Slider values that leave a scene unchanged, by name."""
    return {k.name: k.neutral for k in KNOBS}


class AppliedSliders(eqx.Module):
    """Pure function from a row of numbers [SI] to a scene: first fitted parameters, if any, then slider values."""

    fitted: Any  # function of scene and parameters that applies an estimate; None without one
    parameters: int = eqx.field(static=True)  # number of fitted parameters
    tendons: tuple[str, ...] = eqx.field(static=True)
    treatment: Treatment

    def __call__(self, scene: Scene, row: Any) -> Scene:
        """Applies the parameters, the stiffnesses and the treatment to a scene."""
        if self.fitted is not None:
            scene = self.fitted(scene, row[: self.parameters])
        amounts = self.parameters + len(self.tendons)
        for tendon, share in zip(self.tendons, row[self.parameters : amounts], strict=True):
            scene = scene.with_effect(elastic(scene, tendon, "stiffness").stiffened(share))
        return self.treatment.with_values(row[amounts:])(scene)


_apply_sliders = eqx.filter_jit(lambda applied, scene, row: applied(scene, row))


class Knobs(NamedTuple):
    """The sliders that a scene has the parts for."""

    scene: Scene  # with nominal parameters
    estimate: Estimate | None
    applied: AppliedSliders
    missing: dict[str, str]  # reasons why sliders are missing, by group

    @classmethod
    def of(cls, scene: Scene, estimate: Estimate | None = None) -> Knobs:
        """Finds the sliders that apply to a scene; InputError for a scene without the fitted parameters."""
        fitted = None if estimate is None else estimate.apply
        own, treatment, tendons = scene if fitted is None else fitted(scene), Treatment(), []
        missing: dict[str, str] = {}
        for tendon in _TENDONS:
            try:
                elastic(own, tendon, "stiffness")
            except InputError as error:
                missing[_group(_TENDONS[tendon])] = error.problem
            else:
                tendons.append(tendon)
        for kind, about in KINDS.items():
            try:
                treatment = treatment.then(Treatment.of(kind, dict.fromkeys(about.amounts, 0.0)).prepared(own))
            except InputError as error:
                missing[_group(about.part)] = error.problem
        parameters = 0 if estimate is None else estimate.shared
        return cls(scene, estimate, AppliedSliders(fitted, parameters, tuple(tendons), treatment), missing)

    @property
    def usable(self) -> tuple[Knob, ...]:
        """The sliders that apply, in the order of the numbers of `applied`."""
        names = [*(f"{tendon}.stiffness" for tendon in self.applied.tendons), *self.applied.treatment.names]
        by_name = {k.name: k for k in KNOBS}
        return tuple(by_name[name] for name in names)

    def scene_with(self, values: Mapping[str, float], theta: Floats | None = None) -> Scene:
        """The scene with all sliders applied, neutral ones too, so that all values share one compiled program.

        Parameters `theta` (p,) default to the estimate's. Raises InputError for a value that is not allowed.
        """
        amounts = [k.checked(values.get(k.name)) * k.size for k in self.usable]
        own = () if self.estimate is None else self.estimate.values[: self.applied.parameters]
        return _apply_sliders(self.applied, self.scene, np.array([*(own if theta is None else theta), *amounts]))
