"""A prediction as figures, tables and sentences."""

from __future__ import annotations

import warnings
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fitting.coverage import NOT_KNOWN
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.quantities import as_read
from pftwin.base.sheet import Sheet
from pftwin.results.verdict import INVALID

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from xarray import DataArray, Dataset

BAND = (0.025, 0.975)  # quantiles over samples: 95 %
MOST_FAILED = 0.1  # share of failed draws beyond which a band must not be used
PANELS = (
    ("largest_offset", 1e3, "largest distance off\nthe groove's bottom [mm]"),
    ("peak_contact_force", 1.0, "peak contact force [N]"),
    ("mean_tilt", 1.0, "mean tilt,\nlateral positive [deg]"),
    ("medial_share", 100.0, "share of force on\nthe medial facet [%]"),
)
_MOST_LINES = 6


def central_and_range(values: DataArray) -> tuple[Floats, Floats, Floats]:
    """Values of an outcome over variants: sample 0, and the 2.5 and 97.5 % quantiles over the draws that did not fail.

    Quantiles are NaN if there are no draws.
    """
    if "sample" not in values.dims:
        none = np.full(values.shape, np.nan)
        return np.asarray(values.values, dtype=np.float64), none, none
    drawn = values.isel(sample=slice(1, None))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of variants without any value
        low, high = np.nanquantile(drawn.values, BAND, axis=drawn.get_axis_num("sample"))
    return values.isel(sample=0).values, low, high


def amount_names(data: Dataset) -> list[str]:
    """The amounts that vary, in order; all of them if none does."""
    names = _amounts(data)
    return [n for n in names if np.ptp(data[n].values) > 0] or names


def _amounts(data: Dataset) -> list[str]:
    fixed = ("variant", "scene", "treatment", "verdict")
    return [str(n) for n, c in data.coords.items() if c.dims == ("variant",) and n not in fixed]


def _by_estimate(data: Dataset) -> Dataset:
    """The prediction at the estimate, without the draws."""
    return data.isel(sample=0) if "sample" in data.dims else data


def short_name(data: Dataset, name: str) -> str:
    """An amount's name, without the treatment's if that is unambiguous."""
    short = name.rpartition("_")[2]
    alike = [n for n in amount_names(data) if n.endswith(f"_{short}")]
    return short if len(alike) == 1 else name.replace("_", " ")


def in_shown_unit(data: Dataset, name: str) -> tuple[Floats, str]:
    """An amount in the unit shown to readers, and that unit: lengths in mm, shares in percent."""
    values, unit = data[name].values, data[name].attrs["units"]
    scale, unit = as_read(unit, percent=True)
    return scale * values, unit


def outcome_figure(data: Dataset, title: str | None = None, *, axes: Any = None, columns: int = 2) -> Figure:
    """Draws four outcomes against the first amount that varies; a line for each combination of other amounts and scene.

    Args:
        data: result of `fitting.predict`.
        title: replaces the prediction's own title.
        axes: four axes to draw into; by default a new figure.
        columns: panels next to each other in a new figure; one makes it as narrow as a phone or a journal's column.

    Raises:
        InputError: a prediction in which no amount varies; another number of axes.
    """
    from pftwin.results.plots import style

    names = amount_names(data)
    if not names or np.ptp(data[names[0]].values) == 0:
        raise InputError("no amount varies", where="outcome_figure", expected="a grid of amounts")
    own = style.given_axes(axes, len(PANELS), "one for each of " + ", ".join(p[0] for p in PANELS))
    axis = f"{names[0].replace('_', ' ')} [{in_shown_unit(data, names[0])[1]}]"
    with style.house_style():
        if own is None:
            figure, own = style.panels_in_rows(len(PANELS), columns, height=2.45 if columns > 1 else 1.75)
            style.title(figure, title or data.attrs["title"])
            style.footer(figure, _note(data) or None)
        for ax, (outcome, scale, label) in zip(own, PANELS, strict=True):
            for i, (name, rows) in enumerate(_lines(data, names)):
                _draw(ax, data, names[0], outcome, scale, rows, name, i)
            ax.set_ylabel(label, fontsize=style.SMALL)
            ax.set_xlabel(axis, fontsize=style.SMALL)
        threshold = 1e3 * data.attrs["threshold"]
        own[0].axhline(threshold, color="black", linewidth=0.8, linestyle=":")
        own[0].annotate(
            "dislocated above", (0.99, threshold), xycoords=("axes fraction", "data"), xytext=(0, 2),
            textcoords="offset points", ha="right", fontsize=style.TINY,
        )  # fmt: skip
        handles, labels = own[0].get_legend_handles_labels()
        if axes is None and len(labels) > 1:
            style.legend_below(style.figure_of(own[0]), handles, labels, most=3)
    return style.figure_of(own[0])


def _note(data: Dataset) -> str:
    parts = ["crosses: dislocated"] if (_by_estimate(data)["dislocations"] > 0).any() else []
    if "sample" in data.dims:
        lost = int(draws_failed(data).sum())
        without = f", less {lost} of all variants together that did not run" if lost else ""
        parts.append(f"bands: 95 % of {data.sizes['sample'] - 1} draws from the estimate{without}")
        parts.append(str(data.attrs.get("coverage_briefly", NOT_KNOWN.briefly)))
    if data.attrs.get("note"):
        parts.append(data.attrs["note"])
    return "; ".join(parts)


def _lines(data: Dataset, names: list[str]) -> list[tuple[str, NDArray[np.int64]]]:
    """Label and rows of each line: variants that share the scene and all amounts but the first."""
    others = {n: in_shown_unit(data, n) for n in names[1:]}
    scenes = list(dict.fromkeys(data["scene"].values))
    lines = []
    for scene, *values in product(scenes, *(np.unique(data[n].values) for n in others)):
        same = data["scene"].values == scene
        for name, value in zip(others, values, strict=True):
            same = same & (data[name].values == value)
        if same.any():
            said = [f"{n.rpartition('_')[2]} {shown[same][0]:g} {unit}" for n, (shown, unit) in others.items()]
            label = ", ".join([str(scene), *said] if len(scenes) > 1 else said) or str(scene)
            lines.append((label, np.flatnonzero(same)))
    if len(lines) > _MOST_LINES:  # a few, spread over the range
        lines = [lines[i] for i in np.linspace(0, len(lines) - 1, _MOST_LINES).round().astype(int)]
    return lines


def _draw(
    axes: Axes, data: Dataset, amount: str, outcome: str, scale: float, rows: Any, label: str, which: int
) -> None:
    from pftwin.results.plots.style import BAND, COLOURS

    x = in_shown_unit(data, amount)[0][rows]
    rows, x = rows[np.argsort(x, kind="stable")], np.sort(x)
    part, colour = data.isel(variant=rows), COLOURS[which % len(COLOURS)]
    value, low, high = central_and_range(scale * part[outcome])
    axes.plot(x, value, color=colour, label=label, marker=".", markersize=4)
    if np.isfinite(low).any():
        axes.fill_between(x, low, high, color=colour, **BAND)
    out = central_and_range(part["dislocations"])[0] > 0
    axes.plot(x[out], value[out], linestyle="none", marker="x", markersize=7, color=colour)


_COLUMNS = (
    ("largest_offset", 1e3, "lateral of groove [mm]", ".1f"),
    ("mean_tilt", 1.0, "tilt [deg]", ".1f"),
    ("mean_shift", 1e3, "shift [mm]", ".1f"),
    ("peak_contact_force", 1.0, "peak force [N]", ".1f"),
    ("medial_share", 100.0, "medial [%]", ".0f"),
)


def outcome_sheet(data: Dataset, most: int) -> Sheet:
    """A table of the first variants; with draws, each outcome has its 95 % band."""
    names = amount_names(data)
    headings = [f"{short_name(data, n)} [{in_shown_unit(data, n)[1]}]" for n in names]
    several = len(set(data["scene"].values)) > 1
    headings = [*(["scene"] if several else []), *headings, "dislocation", *(c[2] for c in _COLUMNS)]
    amounts = [in_shown_unit(data, n)[0] for n in names]
    farthest = data["largest_offset"]
    signed = data.assign(largest_offset=farthest.where(data["largest_lateral_offset"] >= farthest, -farthest))
    outcomes = [(central_and_range(scale * signed[name]), form) for name, scale, _, form in _COLUMNS]
    lines, count = [], data.sizes["variant"]
    for i in range(min(count, most)):
        cells = [_band(found, i, form) for found, form in outcomes]
        scene = [str(data["scene"].values[i])] if several else []
        lines.append((*scene, *(f"{a[i]:.4g}" for a in amounts), _dislocation(data, i), *cells))
    title = str(data.attrs.get("title", "Treatment prediction"))
    title += f" ({count - most} of {count} variants not shown)" if count > most else ""
    brackets = f"in brackets: 95 % interval over the draws, without those that failed; {coverage_in(data)}"
    notes = (brackets,) if "sample" in data.dims else ()
    keys = headings.index("dislocation")
    return Sheet(title, tuple(headings), tuple(lines), words=(), notes=notes, keys=keys)


def _band(found: tuple[Floats, Floats, Floats], i: int, form: str) -> str:
    value, low, high = (numbers[i] for numbers in found)
    band = f" ({low:{form}} to {high:{form}})" if np.isfinite(low) else ""
    return f"{value:{form}}{band}" if np.isfinite(value) else "-"


def _dislocation(data: Dataset, i: int) -> str:
    """Whether and when the patella leaves its groove, and in which share of the draws."""
    one = data.isel(variant=i)
    first = _by_estimate(one)
    if bool(first["failed"]):
        said = INVALID
    elif float(first["dislocations"]) == 0:
        said = "none"
    else:
        side = "lateral" if float(first["dislocation_side"]) > 0 else "medial"
        back = float(first["re_engagement_flexion"])
        said = f"{side} at {float(first['dislocation_flexion']):.0f} deg"
        said += "" if np.isnan(back) else f", back at {back:.0f} deg"
    if "sample" in data.dims:
        drawn = one["dislocations"].isel(sample=slice(1, None)).values
        rest = drawn[np.isfinite(drawn)]
        of = "draws" if rest.size == drawn.size else f"the {rest.size} of {drawn.size} draws that did not fail"
        said += f"; {100 * np.mean(rest > 0):.0f} % of {of}" if rest.size else "; no draw ran"
    return said


def main_finding(data: Dataset) -> str:
    """The main finding, in a sentence or two; it begins with "INVALID" if the estimate or motions must not be used."""
    if objection := data.attrs.get("objection"):
        return "\n".join(why for why in (objection, invalid_variants(data)) if why)
    first = _by_estimate(data)
    failed, out = first["failed"].values, first["dislocations"].values > 0
    fine = ~failed & ~out
    parts = [invalid_variants(data)] if failed.any() else []
    if failed.all():
        return parts[0]
    names = amount_names(data)
    one = len(names) == 1 and len(set(data["scene"].values)) == 1 and _one_sign(data[names[0]].values)
    if failed.any():
        parts.append(f"{np.count_nonzero(fine)} of the other {np.count_nonzero(~failed)} track without dislocation")
    elif fine.all():
        parts.append("no variant dislocates")
    elif not fine.any():
        parts.append("no variant tracks")
    elif one:
        amount, unit = in_shown_unit(data, names[0])
        order = np.argsort(np.abs(amount), kind="stable")
        last_out = np.flatnonzero(~fine[order]).max()
        what = names[0].replace("_", " ")
        if last_out + 1 < len(order):
            parts.append(f"without dislocation from {amount[order][last_out + 1]:.4g} {unit} of {what} on")
        else:
            parts.append(f"dislocates at {amount[order][last_out]:.4g} {unit} of {what}, the largest amount, too")
    else:
        parts.append(f"{np.count_nonzero(fine)} of {fine.size} variants track without dislocation")
    return "; ".join(parts)


def _one_sign(amounts: Floats) -> bool:
    return bool((amounts >= 0).all() or (amounts <= 0).all())


def invalid_variants(data: Dataset) -> str:
    """How many variants have an INVALID motion, and why the first; empty if none."""
    failed = _by_estimate(data)["failed"].values
    if not failed.any():
        return ""
    why = str(data["verdict"].values[failed][0]) if "verdict" in data.coords else "an older file does not say why"
    return f"{INVALID}: {np.count_nonzero(failed)} of {failed.size} variants ({why.removeprefix(f'{INVALID}: ')})"


def draws_failed(data: Dataset) -> NDArray[np.int64]:
    """Number of draws of each variant with an INVALID motion, (variants,); bands are of the others."""
    failed = data["failed"]
    if "sample" not in failed.dims:
        return np.zeros(data.sizes["variant"], dtype=np.int64)
    return np.count_nonzero(failed.isel(sample=slice(1, None)).transpose("variant", "sample").values, axis=1)


def narrow_bands(data: Dataset) -> str:
    """A sentence if too many draws of a variant failed for its band to be used; otherwise empty."""
    lost, draws = draws_failed(data), data.sizes.get("sample", 1) - 1
    few = lost > MOST_FAILED * draws
    if not few.any():
        return ""
    said = f"{np.count_nonzero(few)} of {few.size} variants have bands of too few draws"
    return f"{said} (up to {lost.max()} of {draws} failed)"


def coverage_in(data: Dataset) -> str:
    """Measured coverage of the prediction's bands, in words."""
    return str(data.attrs.get("coverage", NOT_KNOWN.bands))


def facts(data: Dataset) -> dict[str, Any]:
    """Plain values for JSON: treatment, amounts (SI units and degrees) and outcomes of each variant."""
    first, amounts = _by_estimate(data), _amounts(data)
    outcomes = [str(n) for n, v in first.data_vars.items() if v.dims == ("variant",)]
    units = {n: str(data[n].attrs["units"]) for n in [*amounts, *outcomes]}
    words = [n for n in ("scene", "treatment", "verdict") if n in data.coords]
    columns = {n: first[n].values.tolist() for n in [*words, *amounts, *outcomes]}
    drawn = [n for n in outcomes if n != "failed"] if "sample" in data.dims else []
    bands = {name: list(central_and_range(data[name])[1:]) for name in drawn}
    variants = [{n: values[i] for n, values in columns.items()} for i in range(data.sizes["variant"])]
    if "status_frames" in first:
        statuses = (_status_facts(first["status_frames"].isel(variant=i)) for i in range(data.sizes["variant"]))
        variants = [{**variant, **said} for variant, said in zip(variants, statuses, strict=True)]
    coverage = {"coverage": coverage_in(data), "draws_failed": draws_failed(data).tolist()} if drawn else {}
    return {"attributes": dict(data.attrs), "units": units, "variants": variants, "bands_95": bands, **coverage}


def _status_facts(frames: DataArray) -> dict[str, Any]:
    """As `pftwin.dynamics.status.status_facts`, with the flags that the data name: other versions have others."""
    counts = {str(name): int(n) for name, n in zip(frames["flag"].values, frames.values, strict=True)}
    words = [str(w) for w, n in zip(frames.attrs["flags"], counts.values(), strict=True) if n]
    return {"status": "; ".join(words) or "ok", "status_frames": counts}
