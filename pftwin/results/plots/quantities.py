"""Quantities that figures plot, simulated and measured: names, units, sign conventions and accessors."""

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

TIBIAL, FEMORAL = "patellar_tendon", "quadriceps"  # effects whose tensions are the rig's spring forces


class PlottedQuantity(NamedTuple):
    """A quantity over the frames, in a display unit."""

    words: str  # name, with its positive direction
    unit: str
    simulated: Callable[[Result], Floats | None]  # (n,); None if the scene lacks it
    measured: Callable[[Measured], Floats | None]  # (n,); None if it was not measured
    error: str  # field of `pftwin.results.metrics.Validation` with its RMSE

    @property
    def label(self) -> str:
        """Axis label with the unit."""
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
    """Returns the tension of a tendon or group of strands, with the measured force of a spring ("tibial_spring")."""
    force = f"{spring}_force"
    return PlottedQuantity(words, "N", lambda r: _reported(r, effect, "tension"), lambda m: getattr(m, force), spring)


def read(result: Result, name: str) -> PlottedQuantity:
    """Returns an observable of an effect, "EFFECT.OBSERVABLE", with its measured values."""
    first = reading(result, name)
    return PlottedQuantity(
        name, first.unit, lambda r: reading(r, name).values, lambda m: first.scale * m.readings[name], name
    )


def _reported(result: Result, effect: str | None, observable: str) -> Floats | None:
    """An observable, summed over the elements of a group; None if the result lacks it."""
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
    """Returns the named quantities; InputError for no name or an unknown one."""
    if not names:
        raise InputError("nothing to draw", where="quantities", expected="at least one name")
    if unknown := [name for name in names if name not in QUANTITIES]:
        raise InputError(f"no quantity {unknown[0]!r}", where="quantities", expected=f"of: {', '.join(QUANTITIES)}")
    return {name: QUANTITIES[name] for name in names}


def provenance(*results: Result) -> str | None:
    """Returns the note on INVALID and synthetic motion; None if there is nothing to report."""
    doubted = dict.fromkeys(f"{r.scene_name}: {r.verdict.describe()}" for r in results if not r.verdict.valid)
    return "; ".join([*doubted, *([SYNTHETIC] if any(r.scene.synthetic for r in results) else [])]) or None
