"""Force-length curves of OpenSim's muscles: normalised forces of active fibre, passive fibre and tendon.

Lengths are normalised by the fibre's optimal length or the tendon's slack length. Millard's curves consist of quintic
Bezier segments ("corners"), each tangent to two lines; Thelen's are exponentials.

Sources: Millard et al. 2013, J Biomech Eng 135:021005, and OpenSim's SmoothSegmentedFunctionFactory for the corners;
Thelen 2003, J Biomech Eng 125:70.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.interpolate import BPoly, CubicHermiteSpline

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.files.interchange.osim_document import Element
from pftwin.files.interchange.osim_joints import Function, continued

_SAMPLES = 201  # per corner; the error of interpolation is below 1e-7 of the maximum isometric force
_LEAST_ACTIVE = 0.1  # smallest active force of a fibre without damping, whose velocity would be infinite without force
_MOST = 500.0  # largest exponent, to prevent overflow at absurd lengths


class Curves(NamedTuple):
    """Forces divided by the maximum isometric force, as functions of normalised lengths."""

    active: Function  # of the fibre's length, at full activation
    passive: Function  # of the fibre's length, without activation
    tendon: Function  # of the tendon's length
    shortest: float  # normalised fibre length below which the active curve is not defined


class _CurvePoint(NamedTuple):
    """A point at which two corners meet."""

    x: float
    y: float
    slope: float


def millard(held: Sequence[Element], *, damped: bool) -> Curves:
    """The curves of a Millard2012EquilibriumMuscle; raises InputError for invalid parameters.

    Args:
        held: elements with the curves' properties, the muscle first, then its defaults.
        damped: whether the fibre is damped; then the active curve ends at 0, else at `_LEAST_ACTIVE` or more.
    """
    a = Properties(held, "ActiveForceLengthCurve")
    low, shoulder, high, slope, least = a.numbers(
        min_norm_active_fiber_length=0.4441,
        transition_norm_fiber_length=0.73,
        max_norm_active_fiber_length=1.8123,
        shallow_ascending_slope=0.8616,
        minimum_value=0.1,
    )
    floor = 0.0 if damped else max(least, _LEAST_ACTIVE)
    a.expect(0 <= low < shoulder < 0.95 < 1.05 < high, "ascending lengths around 1")
    a.expect(0 <= floor < 1 and 0 <= slope < (1 - floor) / (1 - shoulder), "a plateau that rises to 1")
    p = Properties(held, "FiberForceLengthCurve")
    zero, one = p.numbers(strain_at_zero_force=0.0, strain_at_one_norm_force=0.7)
    p.expect(-1 < zero < one, "a strain at one normalised force beyond that at none")
    soft, stiff, bend = p.all_or_none(
        stiffness_at_low_force=0.2, stiffness_at_one_norm_force=2 / (one - zero), curviness=0.75
    )
    p.expect(0 < soft < 1 / (one - zero) < stiff and 0 <= bend <= 1, "stiffnesses below and above the mean one")
    t = Properties(held, "TendonForceLengthCurve")
    (strain,) = t.numbers(strain_at_one_norm_force=0.049)
    t.expect(strain > 0, "a positive strain at one normalised force")
    end, toe, round_ = t.all_or_none(
        stiffness_at_one_norm_force=1.375 / strain, norm_force_at_toe_end=2 / 3, curviness=0.5
    )
    t.expect(end * strain > 1 and 0 < toe < 1 and 0 <= round_ <= 1, "a toe region before a stiffer one")
    return Curves(
        _curve(_active_corners(low, shoulder, high, floor, slope), 1.0, a),
        _curve(_passive_corners(zero, one, soft, stiff), bend, p),
        _curve(_tendon_corners(strain, end, toe), round_, t),
        low,
    )


def _active_corners(low: float, shoulder: float, high: float, floor: float, slope: float) -> list[_CurvePoint]:
    """Points of five corners: foot, shoulder, top (at the optimal length), descent, and the other foot."""
    width = 0.05  # half that of the top
    rise = 1 - slope * (1 - width - shoulder)  # at the shoulder
    down = -1 / ((high - width) - (1 + width))
    return [
        _CurvePoint(low, floor, 0.0),
        _CurvePoint(0.5 * (low + shoulder), 0.5 * rise, 1.25 * rise / (shoulder - low)),
        _CurvePoint(0.5 * (shoulder + 1 - width), 0.5 * (rise + 1), slope),
        _CurvePoint(1.0, 1.0, 0.0),
        _CurvePoint(0.5 * (1 + width + high), 0.5, down),
        _CurvePoint(high, floor, 0.0),
    ]


def _passive_corners(zero: float, one: float, soft: float, stiff: float) -> list[_CurvePoint]:
    """Points of a short foot of a tenth of the strain, then the rise to a normalised force of 1."""
    foot = 0.1 * min(1 / stiff, one - zero)
    return [
        _CurvePoint(1 + zero, 0.0, 0.0),
        _CurvePoint(1 + zero + foot, 0.5 * foot * soft, soft),
        _CurvePoint(1 + one, 1.0, stiff),
    ]


def _tendon_corners(strain: float, stiffness: float, toe: float) -> list[_CurvePoint]:
    """Points of two corners up to the end of the toe region, beyond which the curve is straight."""
    end, middle = (1 + strain + (force - 1) / stiffness for force in (toe, 0.5 * toe))
    foot = 1 + (end - 1) / 10
    slope = 0.5 * toe / (middle - foot)
    at = 0.5 * (foot + middle)
    return [_CurvePoint(1.0, 0.0, 0.0), _CurvePoint(at, slope * (at - foot), slope), _CurvePoint(end, toe, stiffness)]


def _curve(points: Sequence[_CurvePoint], curviness: float, said: Properties) -> Function:
    """The curve of corners, continued along the tangents at its ends."""
    share = 0.1 + 0.8 * curviness
    u = np.linspace(0, 1, _SAMPLES)
    pieces = []
    for a, b in pairwise(points):
        turn = b.slope - a.slope
        along = (a.y - b.y + b.x * b.slope - a.x * a.slope) / turn if abs(turn) > 1e-8 else 0.5 * (a.x + b.x)
        crossing = np.array([along, b.y + (along - b.x) * b.slope])
        ends = [np.array([p.x, p.y]) for p in (a, b)]
        span = np.linalg.norm(ends[1] - ends[0])
        said.expect(all(np.linalg.norm(crossing - e) < span for e in ends), "corners that bend one way")
        first, last = (e + share * (crossing - e) for e in ends)
        bezier = BPoly(np.array([ends[0], first, first, last, last, ends[1]])[:, None], [0.0, 1.0])
        place, way = bezier(u), bezier.derivative()(u)
        rows = slice(0 if a is points[0] else 1, None)  # do not repeat the end of the corner before
        pieces.append(np.column_stack([place, way[:, 1] / way[:, 0]])[rows])
    at, height, slope = np.concatenate(pieces).T
    said.expect(bool((np.diff(at) > 0).all()), "corners that follow one another")
    return continued(CubicHermiteSpline(at, height, slope), at)


def thelen(held: Sequence[Element]) -> Curves:
    """The curves of a Thelen2003Muscle; raises InputError for strains or shape factors that are not positive."""
    said = Properties(held)
    tendon, fiber, active, passive = said.numbers(
        FmaxTendonStrain=0.04, FmaxMuscleStrain=0.6, KshapeActive=0.45, KshapePassive=5.0
    )
    said.expect(min(tendon, fiber, active, passive) > 0, "positive strains and shape factors")
    toe, bend = 0.33, 3.0  # force at the end of the toe region, and its shape factor
    # End of the toe region, such that the slope is continuous there and the force is 1 at the strain `tendon`.
    end = tendon * 99 * np.exp(3.0) / (166 * np.exp(3.0) - 67)
    slope = (1 - toe) / (tendon - end)

    def exponential(share: Floats, k: float) -> Floats:
        return np.expm1(np.clip(k * share, 0.0, _MOST)) / np.expm1(k)

    def pull(length: Floats) -> Floats:
        strain = np.asarray(length) - 1
        return np.where(
            strain > end, toe + slope * (strain - end), toe * exponential(np.minimum(strain / end, 1), bend)
        )

    return Curves(
        lambda x: np.exp(-((x - 1) ** 2) / active), lambda x: exponential((x - 1) / fiber, passive), pull, 0.0
    )


class Properties:
    """Numbers in elements, or in their children of a tag; the first element that has a number is used."""

    def __init__(self, held: Sequence[Element], tag: str | None = None) -> None:
        self.where = held[0].where
        self.what = f"<{held[0].tag}> {held[0].name!r}" + ("" if tag is None else f", <{tag}>")
        self.holders = [h if tag is None else h.child(tag) for h in held]

    def find(self, tag: str) -> float | None:
        """The number of a tag; None if no element has it."""
        found = (h.child(tag) for h in self.holders if h is not None)
        first = next((f for f in found if f is not None and f.text.strip()), None)
        return None if first is None else float(first.numbers(1)[0])

    def numbers(self, **defaults: float) -> list[float]:
        """The numbers of these tags, or their defaults."""
        found = ((self.find(tag), default) for tag, default in defaults.items())
        return [default if value is None else value for value, default in found]

    def all_or_none(self, **defaults: float) -> list[float]:
        """The numbers of these tags, of which OpenSim reads either all or none from the file."""
        given = [value for value in map(self.find, defaults) if value is not None]
        self.expect(len(given) in (0, len(defaults)), f"all of {', '.join(defaults)}, or none")
        return given or [*defaults.values()]

    def flag(self, tag: str) -> bool:
        """Value of a boolean tag in the first element that has it; false if none has it."""
        found = (h.child(tag) for h in self.holders if h is not None)
        return next((f.text.strip().lower() for f in found if f is not None), "") in ("true", "1")

    def expect(self, met: bool, expected: str) -> None:
        """Raises InputError if a condition on the numbers is not met."""
        if not met:
            raise InputError(f"{self.what} has impossible shape parameters", where=self.where, expected=expected)
