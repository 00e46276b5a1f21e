"""What a treatment is predicted to do: of `pftwin treat`, or what the demo's folder holds."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fitting.cli.report.html import PageSection, bullets, drawn, number, paragraph, picture, subtitle, table
from fitting.cli.report.material import Material
from pftwin.base.errors import InputError
from pftwin.base.text_files import read_bytes, read_lines

if TYPE_CHECKING:
    from xarray import Dataset

_MOST_ROWS = 60
_TITLE = "Treatment prediction"
_PNG = b"\x89PNG\r\n\x1a\n"


def section(material: Material) -> PageSection:
    """The prediction that was given; without one, the demo's; without that, how to make one."""
    parts = []
    if material.treatment is not None:
        parts.append(_given(material.treatment, doubts(material, material.treatment)))
    if material.demo is not None:
        parts.append(_of_demo(material, material.demo))
    if not parts:
        words = "No prediction was given. `pftwin treat -o variants.nc` makes one, --treatment variants.nc adds it."
        parts.append(paragraph(words, "missing"))
    return PageSection("treatment", _TITLE, "".join(parts))


def finding_of(data: Dataset) -> str:
    """What the prediction comes to, as a sentence."""
    from fitting.prediction.plots import finding

    words = finding(data)
    return f"{words[:1].upper()}{words[1:]}."


def doubts(material: Material, data: Dataset) -> list[str]:
    """Where the prediction is not of the knee that the rest of the report is about."""
    out, estimate = [], material.estimate
    own = {str(run.data.attrs.get("scene", run.name)) for run in material.runs}
    if others := sorted(set(map(str, data["scene"].values)) - own):
        out.append(f"The prediction is of {', '.join(others)}; this report is of {', '.join(sorted(own))}.")
    if estimate is None:
        return out
    if "parameters" not in data:
        return [*out, "The prediction was made with the scene's own parameters, not with the fitted ones."]
    used = data["parameters"].values.reshape(-1, data.sizes["parameter"])[0]
    names = tuple(map(str, data["parameter"].values))
    if names != estimate.names or not np.allclose(used, estimate.values, rtol=1e-9, atol=0):
        out.append("The prediction was made with other parameters than those under Fit.")
    return out


def _given(data: Dataset, said: list[str]) -> str:
    from fitting.prediction.plots import amount_names, outcome_figure, rows

    headings, lines = rows(data)
    own = data["failed"].isel(sample=0) if "sample" in data.dims else data["failed"]
    said = [*said, f"Parameters: {data.attrs.get('parameters', 'not in the file')}."]
    if "sample" in data.dims:
        said.append(f"In brackets: 95 % of {data.sizes['sample'] - 1} draws from the fit's uncertainty.")
    if failed := int(own.sum()):
        said.append(f"{failed} of {own.size} variants could not be simulated: their rows are empty.")
    if left := data.attrs.get("variants_missing"):
        said.append(f"The prediction was interrupted: {int(left)} variants are missing.")
    shown = lines[:_MOST_ROWS]
    if len(shown) < len(lines):
        said.append(f"{len(lines) - len(shown)} of {len(lines)} variants are not shown in the table.")
    parts = [paragraph(finding_of(data), "finding"), table(str(data.attrs.get("title", _TITLE)), headings, shown)]
    parts.append(bullets(said))
    names = amount_names(data)
    if names and np.ptp(data[names[0]].values) > 0:
        what = names[0].replace("_", " ")
        alternative = (
            "Four outcomes (largest offset from the groove, peak contact force, mean tilt, share of force on the "
            f"medial facet) against {what}. {finding_of(data)} The numbers are in the table above."
        )
        parts.append(drawn(outcome_figure(data), alternative, f"Predicted outcomes against {what}."))
    return "".join(parts)


def _of_demo(material: Material, folder: Path) -> str:
    """Before and after in the runs' own words; the table of errors, and the figures of the folder."""
    rows = [(run.name, run.tracking) for run in material.runs]
    parts = [subtitle("The treatment of the demo")]
    if rows:
        parts.append(table("What becomes of the patella, with nominal springs", ("case", "simulated"), rows))
    if (folder / "table2.csv").is_file():
        parts.append(_errors(folder / "table2.csv"))
    figures = {
        "pathology_fitted": "Case 2, the pathology: measured (synthetic) and simulated with fitted springs",
        "treatment_predicted": "Case 1, the treatment: predicted with the springs fitted to case 2",
    }
    for stem, words in figures.items():
        file = folder / f"{stem}.png"
        if file.is_file():
            data = read_bytes(file)
            if not data.startswith(_PNG):
                raise InputError("is no PNG picture", where=file, expected="the folder as `pftwin demo` wrote it")
            alternative = f"{words}: path of the button in two planes, tilt and contact force over time."
            parts.append(picture(data, "png", alternative, f"{words}."))
    return "".join(parts)


def _errors(path: Path) -> str:
    """The study's Table 2 as the folder holds it."""
    lines = list(csv.reader(read_lines(path)[0]))
    lines = [line for line in lines if line]
    if not lines or lines[0][:2] != ["row", "unit"] or any(len(line) != len(lines[0]) for line in lines):
        raise InputError("is not the demo's table", where=path, expected="the folder as `pftwin demo` wrote it")
    headings = ["", "unit", *(_heading(h) for h in lines[0][2:])]
    rows = [(line[0], line[1], *(_cell(c) for c in line[2:])) for line in lines[1:]]
    caption = (
        "Errors of the fitted (case 2) and of the predicted motion (case 1) against the virtual rig's synthetic "
        "measurements; published: Table 2 of Michaud et al. 2024, on their rig"
    )
    return table(caption, headings, rows)


def _heading(name: str) -> str:
    case, _, rest = name.partition("_")
    return f"{case.replace('case', 'case ')}, {rest.replace('_', ' ')}"


def _cell(text: str) -> str:
    try:
        return number(float(text), 3) if text else "–"
    except ValueError:
        return text
