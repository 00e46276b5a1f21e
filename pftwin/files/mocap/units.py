"""Units of files, converted to SI at the edge; never guessed."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.files.mocap.tables import unknown_name

# SI unit: units as written, with their factors to it
_OF_SI: dict[str, dict[str, float]] = {
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254},
    "s": {"s": 1.0, "ms": 1e-3},
    "rad": {"rad": 1.0, "deg": math.pi / 180},
    "N": {"N": 1.0, "kN": 1e3},
    "N m": {"Nm": 1.0, "N m": 1.0, "N*m": 1.0, "Nmm": 1e-3},
    "m/s": {"m/s": 1.0, "mm/s": 1e-3},
    "rad/s": {"rad/s": 1.0, "deg/s": math.pi / 180},
    "J": {"J": 1.0, "mJ": 1e-3},
    "kg": {"kg": 1.0},
    "Pa": {"Pa": 1.0, "MPa": 1e6},
    "Hz": {"Hz": 1.0},
    "m^2": {"m^2": 1.0, "cm^2": 1e-4, "mm^2": 1e-6},
    "V": {"V": 1.0, "mV": 1e-3},
    "1": {"1": 1.0, "-": 1.0},
}
SI_UNITS = frozenset(_OF_SI)  # that files can have
_UNITS = {unit: (si, factor) for si, units in _OF_SI.items() for unit, factor in units.items()}
_WORDS = {
    "m": ("meter", "metre"),
    "mm": ("millimeter", "millimetre"),
    "cm": ("centimeter", "centimetre"),
    "deg": ("degree",),
    "rad": ("radian",),
    "s": ("second",),
    "N": ("newton",),
}
_LONG_NAMES = {name: unit for unit, words in _WORDS.items() for word in words for name in (word, f"{word}s")}
# "strand_1" and "zoom_in" are names, not quantities: these units count in brackets only.
_BRACKETS_ONLY = {"1", "-", "in"}
_DIMENSIONLESS = re.compile(r"(^|_)q[wxyz]$|^frame#?$|^status$", re.IGNORECASE)

# Motion capture of a person or a rig: between a marker cluster's size and a large laboratory's.
_SMALLEST_SPREAD, _LARGEST_SPREAD = 0.01, 50.0
# Markers are balls of 6 to 14 mm, and cameras merge two that nearly touch; six of them are on two segments at least. Of
# rigs and persons in centimetres that are labelled millimetres, nearest neighbours are 4 to 9 "mm" apart.
_NEAREST, _SMALLEST_OF_SIX = 0.012, 0.1
_FASTEST = 100.0  # [m/s]; markers on limbs reach 10, on a golf club 50


def to_si(unit: str, *, where: object) -> tuple[str, float]:
    """SI unit and the factor that converts to it.

    Raises:
        InputError: a unit that is not known.
    """
    known = known_unit(unit)
    if known is None:
        raise unknown_name("unit", unit, _UNITS, where=where)
    return known


def known_unit(unit: str) -> tuple[str, float] | None:
    """As `to_si`; None for a unit that is not known."""
    text = unit.strip()
    spelled = (text, _LONG_NAMES.get(text.lower(), ""), text.lower())
    return next((_UNITS[candidate] for candidate in spelled if candidate in _UNITS), None)


def length_factor(header: str | None, argument: str | None, *, where: object) -> tuple[float, bool]:
    """Metres per unit of length, from a file's header or the caller's argument; and whether the two disagree.

    The argument wins over the header (the way out when a header is wrong).

    Raises:
        InputError: neither gives a unit, or it is not a length.
    """
    if not (argument or header):
        raise InputError(
            "no unit of length in the file, and none given",
            where=where,
            expected="a unit in the header (m, cm, mm)",
            remedy="units='mm' (or 'm', 'cm'): as an argument, in [motion] of a scene file, as --units of a command",
        )
    factors = []
    for text in (argument, header):
        if text:
            si, factor = to_si(text, where=where)
            if si != "m":
                raise InputError(f"the unit {text!r} is not a length", where=where, expected="m, cm or mm")
            factors.append(factor)
    return factors[0], len(factors) == 2 and factors[0] != factors[1]


def split_unit(column: str) -> tuple[str, str | None]:
    """Name and unit of a column: "Fz_N", "Fz (N)", "Fz [N]"; (name, None) where the header gives no unit.

    Components of quaternions (..._qw, _qx, _qy, _qz), "frame" and "status" have no dimension: their unit is "1".
    """
    column = column.strip()
    if column.endswith(("]", ")")):  # by hand: a pattern would take the square of the length
        opening = max(column.rfind("["), column.rfind("("))
        name, unit = column[: max(opening, 0)].strip(), column[opening + 1 : -1].strip()
        if name and not set(unit) & set(")]"):
            return name, unit or "1"
    if _DIMENSIONLESS.search(column):
        return column, "1"
    name, _, unit = column.rpartition("_")
    return (name, unit) if name and unit in _UNITS and unit not in _BRACKETS_ONLY else (column, None)


def check_spread(positions: NDArray[np.float64], *, where: object, told: bool) -> None:
    """Refuse marker positions (n, m, 3) in metres whose spread says that the unit is wrong.

    Args:
        positions: NaN where missing.
        where: the file, for messages.
        told: whether the caller gave the unit; then what is merely unusual is believed.

    Raises:
        InputError: all markers together span more than 50 m, or two or more of them less than 10 mm. Unless told: most
            markers are less than 12 mm from the nearest other one, or six or more span less than 100 mm in most frames.
    """
    present = positions[np.isfinite(positions).all(axis=-1)]
    if not len(present):
        return
    spread = float(np.max(present.max(axis=0) - present.min(axis=0)))
    several = positions.shape[1] > 1
    if spread > _LARGEST_SPREAD or (several and spread < _SMALLEST_SPREAD):
        raise InputError(
            f"the markers span {spread:.4g} m in the file's unit: that unit looks wrong",
            where=where,
            expected=f"a spread between {_SMALLEST_SPREAD} m and {_LARGEST_SPREAD:g} m",
            remedy="the true unit as argument: units='mm' (or 'm', 'cm')",
        )
    if not told and several:
        _check_distances(positions, where)


def _check_distances(positions: NDArray[np.float64], where: object) -> None:
    some = positions[:: max(1, len(positions) // 20)]  # some twenty frames
    distances = np.linalg.norm(some[:, :, None] - some[:, None], axis=-1)
    apart = distances[np.isfinite(distances) & (distances > 0)]  # virtual markers may lie in one place
    if not apart.size:
        return
    distances[~(distances > 0)] = np.inf
    nearest = distances.min(axis=2)
    near = float(np.median(nearest[np.isfinite(nearest)]))
    seen = np.asarray(np.isfinite(some).all(axis=2), dtype=np.bool_)
    across = [float(np.ptp(p[s], axis=0).max()) for p, s in zip(some, seen, strict=True) if s.sum() >= 6]
    size = float(np.median(across)) if across else np.inf
    if near >= _NEAREST and size >= _SMALLEST_OF_SIX:
        return
    found = f"markers are {near * 1e3:.3g} mm from the nearest other one"
    if near >= _NEAREST:
        found = f"six markers or more span {size * 1e3:.3g} mm"
    raise InputError(
        f"{found} in the file's unit: that unit looks wrong",
        where=where,
        expected=f"{_NEAREST * 1e3:g} mm or more between markers, {_SMALLEST_OF_SIX * 1e3:g} mm across six of them",
        remedy="the true unit as argument, the file's own too if it is right: units='cm' (or 'mm', 'm')",
    )


def check_jumps(
    positions: NDArray[np.float64], times: NDArray[np.float64], names: Sequence[str], *, where: object
) -> None:
    """Refuse markers (n, m, 3) [m] that jump, as where a number stands for "not seen" in a few rows.

    Args:
        positions: NaN where missing.
        times: (n,) seconds, increasing.
        names: m markers.
        where: the file, for messages.

    Raises:
        InputError: a marker moves faster than 100 m/s between two frames in which it is seen (naming it and the row).
    """
    for i, name in enumerate(names):
        rows = np.flatnonzero(np.isfinite(positions[:, i]).all(axis=1))
        steps = np.linalg.norm(np.diff(positions[rows, i], axis=0), axis=1)
        fast = np.flatnonzero(steps > _FASTEST * np.diff(times[rows]))
        if fast.size:
            first, row = fast[0], rows[fast[0] + 1]
            x, y, z = positions[row, i]
            raise InputError(
                f"marker {name!r} jumps by {steps[first]:.3g} m to ({x:.4g}, {y:.4g}, {z:.4g}) m on row {row + 1}",
                where=where,
                expected=f"at most {_FASTEST:g} m/s",
                remedy="empty cells where a marker was not seen; else check the unit and the times",
            )
