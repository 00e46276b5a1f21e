"""Units of mesh files, which do not carry any, and the sizes that parts of a knee have."""

from __future__ import annotations

from pftwin.base.errors import InputError

# In metres; what meshes are exported in, most often first.
UNITS = {"mm": 1e-3, "m": 1.0, "cm": 1e-2, "in": 25.4e-3, "um": 1e-6, "dm": 1e-1}
PLAUSIBLE = (0.02, 0.2)  # longest side of a femoral component or a button [m]


def plausible_units(longest_side: float, size: tuple[float, float] = PLAUSIBLE) -> list[str]:
    """The units in which a longest side (a bare number) is as long as a part of the knee should be, likeliest first."""
    low, high = size
    return [name for name, unit in UNITS.items() if low <= longest_side * unit <= high]


def check_size(longest_side: float, source: str, size: tuple[float, float], units: str) -> None:
    """Refuse a longest side [m] outside of `size` [m]; the error names the unit that would suit."""
    low, high = size
    if low <= longest_side <= high:
        return
    raw = longest_side / UNITS[units]
    found = f"{longest_side * 1e3:.4g} mm" if units == "mm" else f"{raw:.4g} {units} = {longest_side * 1e3:.4g} mm"
    fitting = plausible_units(raw, size)
    raise InputError(
        f"a longest side of {found} is implausible",
        where=source,
        expected=f"between {low * 1e3:g} and {high * 1e3:g} mm",
        remedy=f"units={fitting[0]!r}" if fitting else "check the units, or pass size= for an unusual part",
    )
