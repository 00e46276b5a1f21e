"""`Treatment`: one or several changes of a scene in sequence, with their amounts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike

from fitting.treatments import changes
from pftwin.base.errors import InputError
from pftwin.base.quantities import as_read
from pftwin.base.spatial import Scalar
from pftwin.model.scene import Scene


class Way(NamedTuple):
    """Unit and wording of one amount of a treatment."""

    unit: str  # "m", "rad" or "1"
    more: str  # effect of a positive amount, in words
    less: str  # effect of a negative one
    usual: tuple[float, float]  # range of a slider, in the unit shown

    @property
    def shown_unit(self) -> str:
        """The unit shown to readers: mm, deg or %."""
        return as_read(self.unit, percent=True)[1]

    def shown(self, value: ArrayLike) -> np.ndarray:
        """Converts SI values to the unit shown."""
        return as_read(self.unit, percent=True)[0] * np.asarray(value, dtype=np.float64)

    def from_shown(self, value: Any) -> np.ndarray:
        """Converts values in the unit shown to SI."""
        return np.asarray(value, dtype=np.float64) / as_read(self.unit, percent=True)[0]


class TreatmentKind(NamedTuple):
    """A kind of treatment: its function, the part that it changes, in words, and its amounts."""

    change: Callable[..., Scene]
    part: str
    amounts: dict[str, Way]


_MEDIAL = Way("m", "medially", "laterally", (-20.0, 30.0))
_DISTAL = Way("m", "distally", "proximally", (-30.0, 30.0))
_ANTERIOR = Way("m", "anteriorly", "posteriorly", (-20.0, 30.0))
_LONGER = Way("m", "longer", "shorter", (-60.0, 60.0))
_MOVED = {"medialisation": _MEDIAL, "distalisation": _DISTAL, "anteriorisation": _ANTERIOR}
_TURNED = {
    "external_rotation": Way("rad", "externally", "internally", (-20.0, 20.0)),
    "flexion": Way("rad", "into flexion", "into extension", (-20.0, 20.0)),
    "varus": Way("rad", "into varus", "into valgus", (-20.0, 20.0)),
}
_GRAFTED = {
    "stiffening": Way("1", "stiffer", "softer", (-90.0, 300.0)),
    "shortening": Way("m", "shorter", "longer", (-30.0, 30.0)),
    "proximalisation": Way("m", "proximally on the femur", "distally on the femur", (-20.0, 20.0)),
    "anteriorisation": Way("m", "anteriorly on the femur", "posteriorly on the femur", (-20.0, 20.0)),
}
_TUBEROSITY = {"medialisation": _MEDIAL, "anteriorisation": _ANTERIOR, "distalisation": _DISTAL}

KINDS = {
    change.__name__: TreatmentKind(change, part, amounts)
    for change, part, amounts in (
        (changes.tibial_tuberosity_transfer, "tibial tuberosity", _TUBEROSITY),
        (changes.patellar_tendon_length_change, "patellar tendon", {"lengthening": _LONGER}),
        (changes.quadriceps_lengthening, "quadriceps tendon", {"lengthening": _LONGER}),
        (changes.trochleoplasty, "trochlear groove", {"deepening": Way("m", "deeper", "shallower", (-5.0, 10.0))}),
        (changes.femoral_component_rotation, "femoral component turned", _TURNED),
        (changes.femoral_component_translation, "femoral component", _MOVED),
        (changes.femoral_derotation, "femur below its cut", {"external_rotation": _TURNED["external_rotation"]}),
        (changes.button_position, "button", _MOVED),
        (changes.lateral_release, "lateral strands", {"release": Way("1", "released", "tightened", (0.0, 100.0))}),
        (changes.mpfl_graft, "MPFL graft", _GRAFTED),
    )
}


class TreatmentStep(eqx.Module):
    """One change of a treatment."""

    kind: str = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)  # of the amounts; jit would sort a dictionary's keys
    amounts: tuple[Scalar, ...]  # SI units; a leading axis makes a batch of variants
    parts: tuple[tuple[str, str], ...] = eqx.field(static=True, default=())  # part names given by the user
    shape: Array | None = None  # prepared on the host for a trochleoplasty

    def __call__(self, scene: Scene) -> Scene:
        """The scene with this change."""
        prepared = {} if self.shape is None else {"shape": self.shape}
        amounts = dict(zip(self.names, self.amounts, strict=True))
        return KINDS[self.kind].change(scene, **amounts, **prepared, **dict(self.parts))


class Treatment(eqx.Module):
    """Changes of a scene in sequence, each with its amounts. Amounts are leaves: vmap, jvp and grad apply.

    treatment = Treatment.of("tibial_tuberosity_transfer", medialisation=0.010)
    treated = treatment.then(Treatment.of("trochleoplasty", deepening=0.002))(scene)
    """

    steps: tuple[TreatmentStep, ...] = ()

    @staticmethod
    def of(kind: str, amounts: Mapping[str, ArrayLike] | None = None, /, **more: Any) -> Treatment:
        """A treatment of one kind.

        Args:
            kind: a name in `KINDS`.
            amounts: by name, in metres, radians or shares.
            **more: amounts as keywords; `tendon=` or `strands=` names the scene's part.

        Raises:
            InputError: no such kind or amount; an amount that is not a finite number.
        """
        if kind not in KINDS:
            raise InputError(f"no treatment {kind!r}", where="Treatment", expected=f"one of: {', '.join(KINDS)}")
        ways, given = KINDS[kind].amounts, {**(amounts or {}), **more}
        parts = {k: v for k, v in given.items() if k in ("tendon", "strands") and isinstance(v, str)}
        values = {}
        for name, value in given.items():
            if name in parts:
                continue
            if name not in ways:
                raise InputError(f"no amount {name!r}", where=kind, expected=f"one of: {', '.join(ways)}")
            values[name] = _number(value, f"{kind}.{name}")
        return Treatment((TreatmentStep(kind, tuple(values), tuple(values.values()), tuple(sorted(parts.items()))),))

    def then(self, after: Treatment) -> Treatment:
        """This treatment, followed by another one."""
        return Treatment((*self.steps, *after.steps))

    def __call__(self, scene: Scene) -> Scene:
        """The treated scene, without measurements, since these are of the untreated knee, as is the recorded start.

        Raises:
            InputError: the scene lacks the part that a step changes.
        """
        for step in self.steps:
            scene = step(scene)
        if not self.steps:
            return scene
        limits = None if scene.limits is None else scene.limits.of_treated()
        return replace(scene, measured=None, limits=limits)

    def prepared(self, scene: Scene) -> Treatment:
        """The treatment with what it needs from the untreated scene, ready to be traced.

        Raises:
            InputError: the scene lacks a part that a step changes.
        """
        steps = self.steps
        if any(step.kind == "trochleoplasty" for step in steps):
            shape = jnp.asarray(changes.deepening_shape(changes.patch_of(scene, "trochleoplasty")), dtype=float)
            steps = tuple(replace(s, shape=shape) if s.kind == "trochleoplasty" else s for s in steps)
        for step in steps:
            step(scene)  # raises for a missing part
        return Treatment(steps)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the amounts: "tibial_tuberosity_transfer.medialisation"; a repeated kind is numbered."""
        kinds = [s.kind for s in self.steps]
        labels = (k if kinds.count(k) == 1 else f"{k}_{kinds[: i + 1].count(k)}" for i, k in enumerate(kinds))
        return tuple(f"{label}.{name}" for label, step in zip(labels, self.steps, strict=True) for name in step.names)

    @property
    def ways(self) -> tuple[Way, ...]:
        """Unit and words of each amount, in the order of `names`."""
        return tuple(KINDS[step.kind].amounts[name] for step in self.steps for name in step.names)

    @property
    def values(self) -> tuple[Scalar, ...]:
        """The amounts, in the order of `names`."""
        return tuple(value for step in self.steps for value in step.amounts)

    def with_values(self, values: Any) -> Treatment:
        """The treatment with other amounts: a sequence in the order of `names`."""
        rest = iter(values)
        return Treatment(tuple(replace(s, amounts=tuple(next(rest) for _ in s.names)) for s in self.steps))

    @property
    def form(self) -> tuple[Any, ...]:
        """The structure that treatments must share to run in one batch: kinds, names of amounts, names of parts."""
        return tuple((s.kind, s.names, s.parts) for s in self.steps)

    def describe(self) -> str:
        """The treatment in words, with amounts in the units shown to readers."""
        said = []
        for step in self.steps:
            ways = (KINDS[step.kind].amounts[name] for name in step.names)
            amounts = ", ".join(filter(None, map(_amount, ways, step.amounts)))
            said.append(f"{KINDS[step.kind].part} {amounts or 'as it is'}")
        return "; ".join(said) or "no treatment"

    __str__ = describe


def _number(value: ArrayLike, where: str) -> Scalar:
    if isinstance(value, Tracer):
        return value
    try:
        finite = bool(np.isfinite(np.asarray(value, dtype=np.float64)).all())
    except (TypeError, ValueError):
        finite = False
    if not finite:
        raise InputError(f"found {value!r}", where=where, expected="a finite number, in metres, radians or as a share")
    return jnp.asarray(value, dtype=float)


def _amount(way: Way, value: Scalar) -> str:
    """ "10 mm medially"; empty if it is zero."""
    shown = way.shown(value)
    if shown.ndim:
        return f"{shown.min():g} to {shown.max():g} {way.shown_unit} {way.more}"
    number = float(shown)
    return f"{abs(number):.4g} {way.shown_unit} {way.more if number > 0 else way.less}" if number else ""
