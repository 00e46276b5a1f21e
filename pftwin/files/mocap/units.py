"""Units in files and their conversion to SI; units are never guessed."""

from __future__ import annotations

import math
import re
import warnings

from pftwin.base.errors import InputError, PftwinWarning
from pftwin.files.mocap.tables import unknown_name

# For each SI unit: the units that are converted to it, with their factors.
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
SI_UNITS = frozenset(_OF_SI)  # all SI units to which units of files are converted
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
# Units that are recognized in brackets only, since "strand_1" and "zoom_in" are names.
_BRACKETS_ONLY = {"1", "-", "in"}
_DIMENSIONLESS = re.compile(r"(^|_)q[wxyz]$|^frame#?$|^status$", re.IGNORECASE)


def to_si(unit: str, *, where: object) -> tuple[str, float]:
    """SI unit and the factor that converts to it. Raises InputError for an unknown unit."""
    known = known_unit(unit)
    if known is None:
        raise unknown_name("unit", unit, _UNITS, where=where)
    return known


def known_unit(unit: str) -> tuple[str, float] | None:
    """Like `to_si`, but None for an unknown unit."""
    text = unit.strip()
    spelled = (text, _LONG_NAMES.get(text.lower(), ""), text.lower())
    return next((_UNITS[candidate] for candidate in spelled if candidate in _UNITS), None)


def length_factor(header: str | None, argument: str | None, *, where: object) -> float:
    """Metres per unit of length, from a file's header or the caller's argument.

    The argument overrides the header (in case the header is wrong), with a warning if they differ. Raises InputError if
    neither gives a unit, or it is not a unit of length.
    """
    if not (argument or header):
        found = "no unit of length in the file, and none given"
        remedy = "units='mm' (or 'm', 'cm'): as an argument, in [motion] of a scene file, as --units of a command"
        raise InputError(found, where=where, expected="a unit in the header (m, cm, mm)", remedy=remedy)
    factors = []
    for text in filter(None, (argument, header)):
        si, factor = to_si(text, where=where)
        if si != "m":
            raise InputError(f"the unit {text!r} is not a length", where=where, expected="m, cm or mm")
        factors.append(factor)
    if factors[0] != factors[-1]:
        warnings.warn(f"{where}: the file says {header!r}; {argument!r} is used as given", PftwinWarning, stacklevel=3)
    return factors[0]


def split_unit(column: str) -> tuple[str, str | None]:
    """Splits a column's header, such as "Fz_N", "Fz (N)", "Fz [N]", into name and unit; None if it has no unit.

    Quaternion components (..._qw, _qx, _qy, _qz), "frame" and "status" are dimensionless: their unit is "1".
    """
    column = column.strip()
    if column.endswith(("]", ")")):  # no regular expression, which would take quadratic time
        opening = max(column.rfind("["), column.rfind("("))
        name, unit = column[: max(opening, 0)].strip(), column[opening + 1 : -1].strip()
        if name and not set(unit) & set(")]"):
            return name, unit or "1"
    if _DIMENSIONLESS.search(column):
        return column, "1"
    name, _, unit = column.rpartition("_")
    return (name, unit) if name and unit in _UNITS and unit not in _BRACKETS_ONLY else (column, None)
