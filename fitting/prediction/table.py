"""A prediction in figures and words: one row per variant, and what it comes to."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from fitting.prediction.plots import amount_names, called, shown, spread

if TYPE_CHECKING:
    from xarray import Dataset

_COLUMNS = (
    ("largest_offset", 1e3, "off groove [mm]", ".1f"),
    ("mean_tilt", 1.0, "tilt [deg]", ".1f"),
    ("mean_shift", 1e3, "shift [mm]", ".1f"),
    ("peak_contact_force", 1.0, "peak force [N]", ".1f"),
    ("medial_share", 100.0, "medial [%]", ".0f"),
)


def rows(data: Dataset) -> tuple[list[str], list[list[str]]]:
    """Headings and cells; with samples, each outcome with its 95 % band."""
    names = amount_names(data)
    headings = [f"{called(data, n)} [{shown(data, n)[1]}]" for n in names]
    several = len(set(data["scene"].values)) > 1
    headings = [*(["scene"] if several else []), *headings, "dislocation", *(c[2] for c in _COLUMNS)]
    amounts = [shown(data, n)[0] for n in names]
    outcomes = [(spread(scale * data[name]), form) for name, scale, _, form in _COLUMNS]
    lines = []
    for i in range(data.sizes["variant"]):
        cells = [_band(found, i, form) for found, form in outcomes]
        scene = [str(data["scene"].values[i])] if several else []
        lines.append([*scene, *(f"{a[i]:.4g}" for a in amounts), _dislocation(data, i), *cells])
    return headings, lines


def _band(found: Any, i: int, form: str) -> str:
    value = found.value[i]
    if not np.isfinite(value):
        return "-"
    if found.low is None or not np.isfinite(found.low[i]):
        return f"{value:{form}}"
    return f"{value:{form}} ({found.low[i]:{form}} to {found.high[i]:{form}})"


def _dislocation(data: Dataset, i: int) -> str:
    """Whether and when the patella leaves its groove, and in how many of the draws."""
    one = data.isel(variant=i)
    drawn = "sample" in data.dims
    first = one.isel(sample=0) if drawn else one
    if bool(first["failed"]):
        said = "failed"
    elif float(first["dislocations"]) == 0:
        said = "none"
    else:
        side = "lateral" if float(first["dislocation_side"]) > 0 else "medial"
        back = float(first["re_engagement_flexion"])
        said = f"{side} at {float(first['dislocation_flexion']):.0f} deg"
        said += "" if np.isnan(back) else f", back at {back:.0f} deg"
    if drawn:
        rest = one["dislocations"].isel(sample=slice(1, None)).values
        rest = rest[np.isfinite(rest)]
        said += f"; {100 * np.mean(rest > 0):.0f} % of draws" if rest.size else ""
    return said


def finding(data: Dataset) -> str:
    """What the whole comes to, in a sentence or two."""
    first = data.isel(sample=0) if "sample" in data.dims else data
    failed, out = first["failed"].values, first["dislocations"].values > 0
    fine = ~failed & ~out
    parts = []
    names = amount_names(data)
    one = len(names) == 1 and len(set(data["scene"].values)) == 1
    if fine.all():
        parts.append("no variant dislocates")
    elif not fine.any():
        parts.append("no variant tracks")
    elif one:
        amount, unit = shown(data, names[0])
        order = np.argsort(np.abs(amount), kind="stable")
        last_out = np.flatnonzero(~fine[order]).max()
        what = names[0].replace("_", " ")
        if last_out + 1 < len(order):
            parts.append(f"without dislocation from {amount[order][last_out + 1]:.4g} {unit} of {what} on")
        else:
            parts.append(f"dislocates at {amount[order][last_out]:.4g} {unit} of {what}, the largest amount, too")
    else:
        parts.append(f"{np.count_nonzero(fine)} of {fine.size} variants track without dislocation")
    if failed.any():
        parts.append(f"{np.count_nonzero(failed)} of {failed.size} variants could not be simulated")
    return "; ".join(parts)


def facts(data: Dataset) -> dict[str, Any]:
    """Plain values for JSON: per variant its treatment, amounts (SI units and degrees) and outcomes."""
    first = data.isel(sample=0) if "sample" in data.dims else data
    fixed = ("variant", "scene", "treatment")
    amounts = [str(n) for n, c in data.coords.items() if c.dims == ("variant",) and n not in fixed]
    outcomes = [str(n) for n, v in first.data_vars.items() if v.dims == ("variant",)]
    units = {n: str(data[n].attrs["units"]) for n in [*amounts, *outcomes]}
    columns = {n: first[n].values.tolist() for n in [*fixed[1:], *amounts, *outcomes]}
    bands = {}
    if "sample" in data.dims:
        for name in outcomes:
            if name != "failed":
                _, low, high = spread(data[name])
                bands[name] = [low, high]
    variants = [{n: values[i] for n, values in columns.items()} for i in range(data.sizes["variant"])]
    return {"attributes": dict(data.attrs), "units": units, "variants": variants, "bands_95": bands}
