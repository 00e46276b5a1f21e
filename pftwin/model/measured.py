"""Measurements of a patella's motion and forces, for comparison with a simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.base.rotations import PatellarAngles, patellar_angles
from pftwin.base.spatial import Quaternion
from pftwin.files.mocap.tables import increasing_times

SYNTHETIC = "the motion is synthetic: computed, not recorded from a knee"  # shown with all such data
_UNIT_TOLERANCE = 1e-3
_FORCES = ("contact_force", "tibial_spring_force", "femoral_spring_force")


@dataclass(frozen=True, eq=False)
class Measured:
    """Measurements of the patella in the femur frame, at the recorded frames. Missing values are NaN.

    Args:
        times: (n,) [s], strictly increasing.
        center: (n, 3) centre of the button's sphere in the femur frame [m]; all NaN if not measured.
        quaternion: (n, 4) orientation of the patella in the femur, scalar first; None if not measured.
        contact_force: (n,) normal contact force [N]; None if not measured.
        tibial_spring_force: (n,) force of the patellar tendon [N]; None if not measured.
        femoral_spring_force: (n,) force of the quadriceps [N]; None if not measured.
        synthetic: whether these are simulated measurements, which figures and tables state.
        source: origin of the data, for messages and legends.
        readings: (n,) each, other observables of effects, keyed by "EFFECT.OBSERVABLE" ("contact.force_medial", or
            "m1.x" of a marker), in the unit of the observable.
        weights: (n,) relative weight of each frame in a fit, for all channels: the variance of its noise is
            proportional to 1/weight, and weight 0 omits the frame. None: equal weights.
        skin_markers: names of the effects among the readings that are markers on the skin. As skin slides over the
            bone, comparison with such a marker is only qualitative.

    Raises:
        InputError: times are repeated or unsorted, shapes do not match, a quaternion is not normalised, values are
            infinite, or weights are negative; the message gives the field, and the row counted from 1.
    """

    times: NDArray[np.float64]
    center: NDArray[np.float64]
    quaternion: NDArray[np.float64] | None = None
    contact_force: NDArray[np.float64] | None = None
    tibial_spring_force: NDArray[np.float64] | None = None
    femoral_spring_force: NDArray[np.float64] | None = None
    synthetic: bool = False
    source: str = "measurements"
    readings: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    weights: NDArray[np.float64] | None = None
    skin_markers: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        times = increasing_times(self.times, where=self.source)
        shapes = {"center": (times.size, 3), "quaternion": (times.size, 4), **dict.fromkeys(_FORCES, (times.size,))}
        object.__setattr__(self, "times", times)
        for name, shape in shapes.items():
            given: Any = getattr(self, name)
            if given is None and name != "center":
                continue
            values = _finite(given, shape, name, self.source)
            object.__setattr__(self, name, _unit(values, self.source) if name == "quaternion" else values)
        read = {name: _finite(given, (times.size,), name, self.source) for name, given in self.readings.items()}
        object.__setattr__(self, "readings", read)
        if self.weights is not None:
            weights = _finite(self.weights, (times.size,), "weights", self.source)
            if (bad := np.flatnonzero(~(weights >= 0))).size:
                found = f"row {bad[0] + 1} of weights is {weights[bad[0]]:g}"
                raise InputError(found, where=self.source, expected="0 or more: 0 leaves the frame out")
            object.__setattr__(self, "weights", weights)

    def during(self, spans: Sequence[tuple[float, float]]) -> Measured:
        """The measurements with weights of 0 outside the time intervals `spans`, (first, last) [s] each.

        Raises:
            InputError: an interval ends before it starts, or no frame with a positive weight remains.
        """
        inside = np.zeros(self.times.size, bool)
        slack = 1e-6 * np.median(np.diff(self.times)) if self.times.size > 1 else 0.0  # ends are given as decimals
        for first, last in spans:
            if not first <= last:
                raise InputError(f"found {first:g}:{last:g}", where="during", expected="FROM:TO in seconds")
            inside |= (self.times >= first - slack) & (self.times <= last + slack)
        weights = np.where(inside, 1.0 if self.weights is None else self.weights, 0.0)
        if not (weights > 0).any():
            found = f"no frame with a positive weight of {self.times[0]:g} s to {self.times[-1]:g} s"
            raise InputError(found, where="during", expected="spans of the recording")
        return replace(self, weights=weights)

    def __eq__(self, other: object) -> bool:
        """Compares content, so that scenes with the same measurements have the same structure."""
        return self is other or (isinstance(other, Measured) and self._content() == other._content())

    def __hash__(self) -> int:
        return hash((self.source, self.synthetic, self.times.size))

    def _content(self) -> tuple[object, ...]:
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        read = {name: given.tobytes() for name, given in self.readings.items()}
        values |= {name: v.tobytes() for name, v in values.items() if isinstance(v, np.ndarray)}
        return tuple({**values, "readings": read}.values())

    @property
    def angles(self) -> PatellarAngles | None:
        """Flexion, rotation and tilt of the patella, (n,) each [rad]; None if the orientation was not measured."""
        return None if self.quaternion is None else patellar_angles(Quaternion(*self.quaternion.T))

    @property
    def label(self) -> str:
        """Label of these data in figures."""
        return "synthetic measurements" if self.synthetic else "measured"


def _finite(given: Any, shape: tuple[int, ...], name: str, source: str) -> NDArray[np.float64]:
    """Values as an array, checked for the shape and infinite values."""
    values = np.array(given, dtype=np.float64)
    if values.shape != shape:
        raise InputError(f"{name} of shape {values.shape}", where=source, expected=f"{shape}")
    if (bad := np.flatnonzero(np.isinf(values).reshape(len(values), -1).any(axis=1))).size:
        raise InputError(f"row {bad[0] + 1} of {name} is infinite", where=source, expected="a number or NaN")
    return values


def _unit(q: NDArray[np.float64], source: str) -> NDArray[np.float64]:
    norms = np.linalg.norm(q, axis=1)
    if (bad := np.flatnonzero(np.abs(norms - 1) > _UNIT_TOLERANCE)).size:  # False for NaN: a missing row
        raise InputError(
            f"row {bad[0] + 1}: a quaternion of length {norms[bad[0]]:.6g}",
            where=source,
            expected=f"unit quaternions (w, x, y, z), to within {_UNIT_TOLERANCE:g}",
        )
    return q / norms[:, None]
