"""What figures draw of a result and of measurements: names, units, signs, and where the values are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.model.measured import SYNTHETIC
from pftwin.results.metrics import reading, summed

if TYPE_CHECKING:
    from pftwin.model.measured import Measured
    from pftwin.results.result import Result

TIBIAL, FEMORAL = "patellar_tendon", "quadriceps"  # effects whose tensions the springs' forces are, on the rig


class PlottedQuantity(NamedTuple):
    """A course over the frames, in the unit in which people read it."""

    words: str  # with the sense of its sign
    unit: str
    simulated: Callable[[Result], Floats | None]  # (n,); None where the scene has no such thing
    measured: Callable[[Measured], Floats | None]  # (n,); None where it was not measured
    error: str  # the field of `pftwin.results.metrics.Validation` that is its RMSE

    @property
    def label(self) -> str:
        """Label of an axis."""
        return f"{self.words} [{self.unit}]"


def _angle(name: str, words: str) -> PlottedQuantity:
    def of(source: Any) -> Floats | None:
        return None if source.angles is None else np.degrees(getattr(source.angles, name))

    return PlottedQuantity(words, "deg", of, of, "internal_rotation" if name == "rotation" else name)


def _place(axis: int, words: str) -> PlottedQuantity:
    def of(source: Any) -> Floats:
        return 1e3 * source.center[:, axis]

    return PlottedQuantity(words, "mm", of, of, "xyz"[axis])


def tension(effect: str, words: str, spring: str) -> PlottedQuantity:
    """The tension of a tendon or a group of strands, beside the measured force of a spring, "tibial_spring"."""
    force = f"{spring}_force"
    return PlottedQuantity(words, "N", lambda r: _reported(r, effect, "tension"), lambda m: getattr(m, force), spring)


def read(result: Result, name: str) -> PlottedQuantity:
    """What an effect reports, "EFFECT.OBSERVABLE", beside what was measured of it."""
    told = reading(result, name)
    return PlottedQuantity(
        name, told.unit, lambda r: reading(r, name).values, lambda m: told.scale * m.readings[name], name
    )


def _reported(result: Result, effect: str | None, observable: str) -> Floats | None:
    """An observable, of a group summed over its elements; None where there is none."""
    values = result.effects.get(effect or "", {}).get(observable)
    return None if values is None else summed(values)


QUANTITIES: dict[str, PlottedQuantity] = {
    "tilt": _angle("tilt", "tilt, lateral positive"),
    "shift": _place(1, "shift, lateral positive"),
    "rotation": _angle("rotation", "rotation, internal positive"),
    "flexion": _angle("flexion", "patellar flexion"),
    "contact_force": PlottedQuantity(
        "contact force", "N", lambda r: _reported(r, r.contact, "force"), lambda m: m.contact_force, "contact_force"
    ),
    "x": _place(0, "centre x, proximal"),
    "y": _place(1, "centre y, lateral"),
    "z": _place(2, "centre z, anterior"),
    "tibial_spring": tension(TIBIAL, "patellar tendon", "tibial_spring"),
    "femoral_spring": tension(FEMORAL, "quadriceps", "femoral_spring"),
}


def quantities(names: Sequence[str]) -> dict[str, PlottedQuantity]:
    """Some of them, by name; InputError for none or an unknown one."""
    if not names:
        raise InputError("nothing to draw", where="quantities", expected="at least one name")
    if unknown := [name for name in names if name not in QUANTITIES]:
        raise InputError(f"no quantity {unknown[0]!r}", where="quantities", expected=f"of: {', '.join(QUANTITIES)}")
    return {name: QUANTITIES[name] for name in names}


def provenance(*results: Result) -> str | None:
    """What has to be said of motions that are INVALID, and of synthetic ones; None where there is nothing to say."""
    doubted = dict.fromkeys(f"{r.scene_name}: {r.verdict.describe()}" for r in results if not r.verdict.valid)
    return "; ".join([*doubted, *([SYNTHETIC] if any(r.scene.synthetic for r in results) else [])]) or None
