"""Figures of a report, and its view of the knee in three dimensions."""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fitting.cli.pages import sentence
from fitting.cli.report.material import NOMINAL, Material
from pftwin.base.errors import InputError
from pftwin.base.text_files import read_bytes

if TYPE_CHECKING:
    from xarray import Dataset

    from fitting.estimate import Estimate

_PNG = b"\x89PNG\r\n\x1a\n"


@dataclass(frozen=True, eq=False)
class Picture:
    """A matplotlib figure or the bytes of a PNG file, with its alternative text and caption."""

    figure: Any
    alternative: str
    caption: str
    narrow: Any = None  # a figure that takes its place on a phone, whose width makes the letters of a wide one tiny

    @property
    def source(self) -> str:
        """The picture as a data URL; in an `img` element, even an SVG runs no scripts."""
        return _data_url(self.figure)

    @property
    def narrow_source(self) -> str:
        """The narrow figure as a data URL; empty without one."""
        return "" if self.narrow is None else _data_url(self.narrow)


def _data_url(figure: Any) -> str:
    kind, data = "png", figure
    if not isinstance(data, bytes):
        from pftwin.results.plots import house_style

        kind, target = "svg+xml", io.BytesIO()
        with house_style():
            figure.savefig(target, format="svg", metadata={"Date": None})
        data = target.getvalue()
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"


def case(material: Material) -> Picture:
    """Path, tilt and contact force of all runs over time."""
    from pftwin.results.plots import case_figure

    measured = None if material.demo is not None else material.measured
    figure = case_figure({r.name: r.result for r in material.runs}, measured, material.names)
    what = material.names if measured is None else f"{material.names}, with {measured.label}"
    becomes = " ".join(f"{r.name}: {r.tracking}." for r in material.runs)
    alternative = (
        f"{what}: path of the button's centre in the coronal and the sagittal plane, patellar tilt and normal contact "
        f"force over time. {becomes}"
    )
    return Picture(figure, alternative, f"Path, tilt and contact force: {what}.")


def courses(material: Material) -> Picture | str:
    """Tilt, shift, rotation and force against knee flexion; the reason as text if the knee does not bend."""
    from pftwin.results.plots import against_flexion

    names, results = material.names, {r.name: r.result for r in material.runs}
    try:
        figure, narrow = (against_flexion(results, title=names, columns=columns) for columns in (2, 1))
    except InputError as error:
        return f"No courses against knee flexion: {error}"
    alternative = f"Tilt, shift, rotation and contact force against knee flexion: {names}. Ranges are under Scene."
    lines = "Bending solid, straightening dashed, dotted while the patella is out of its groove."
    return Picture(figure, alternative, f"Against knee flexion: {names}. {lines}", narrow)


def over_the_trochlea(material: Material) -> list[Picture]:
    """Path of the last simulated run over the trochlea; empty if all runs are from files, which lack the surface."""
    from pftwin.results.result import Result

    simulated = [r for r in material.runs if isinstance(r.source, Result) and r.source.surface is not None]
    if not simulated:
        return []
    last = simulated[-1]
    words = f"Path of the button and of the contact points over the trochlea's contours: {last.name}."
    return [Picture(last.result.plot.trajectory(measured=material.measured), words, words)]


def histories(material: Material) -> list[Picture]:
    """Best objective against number of evaluations, for every fit with more than one step."""
    found = []
    for name, estimate in material.estimates.items():
        if len({h["evaluations"] for h in estimate.history}) > 1:
            words = f"Best objective against evaluations, {name}."
            alternative = f"{words} It ends at {estimate.objective_value:.6g}."
            found.append(Picture(estimate.plot.history(), alternative, words))
    return found


def correlation(e: Estimate) -> Picture:
    """Correlation of a fit's errors, and its estimates compared with the nominal values."""
    strongest = ""
    if e.asked > 1:
        off = np.abs(e.correlation - np.eye(len(e.names)))[: e.asked, : e.asked]
        i, j = np.unravel_index(int(np.argmax(off)), off.shape)
        strongest = f" The strongest: {e.names[i]} and {e.names[j]}, {e.correlation[i, j]:.2f}."
    alternative = (
        f"Left: correlation of the errors of {', '.join(e.names[: e.asked])}.{strongest} Right: estimates with 95 % "
        "intervals in percent of the nominal values; the numbers are in the table above."
    )
    caption = "Correlation of the errors (left); estimates against nominal values (right)."
    return Picture(e.plot.correlation(), alternative, caption)


def outcomes(data: Dataset) -> list[Picture]:
    """Outcomes of a prediction against the amount of the treatment; empty if no amount varies."""
    from fitting.prediction.plots import amount_names, main_finding, outcome_figure

    names = amount_names(data)
    if not names or np.ptp(data[names[0]].values) == 0:
        return []
    what = names[0].replace("_", " ")
    alternative = (
        "Four outcomes (largest offset from the groove, peak contact force, mean tilt, share of force on the "
        f"medial facet) against {what}. {sentence(main_finding(data))} "
        "The numbers are in the appendix, under Treatment prediction."
    )
    figure = outcome_figure(data)
    figure.set_size_inches(figure.get_figwidth(), 4.8)  # leaves room for the text on the first printed sheet
    return [Picture(figure, alternative, f"Predicted outcomes against {what}.", outcome_figure(data, columns=1))]


def of_demo(folder: Path) -> list[Picture]:
    """Figures of the pathology and the treatment in the demo's folder; InputError for a file that is no PNG picture."""
    captions = {
        "pathology_fitted": "Case 2, the pathology: measured (synthetic) and simulated with fitted springs",
        "treatment_predicted": "Case 1, the treatment: predicted with the springs fitted to case 2",
    }
    found = []
    for stem, words in captions.items():
        file = folder / f"{stem}.png"
        if file.is_file():
            data = read_bytes(file)
            if not data.startswith(_PNG):
                raise InputError("is no PNG picture", where=file, expected="the folder as `pftwin demo` wrote it")
            alternative = f"{words}: path of the button in two planes, tilt and contact force over time."
            found.append(Picture(data, alternative, f"{words}."))
    return found


def viewer(material: Material) -> str:
    """The viewer's page for a frame of the report; MissingExtraError without k3d, InputError if it cannot be drawn.

    A nominal knee is hidden at first beside the fitted one: their bones nearly coincide and would cover each other.
    Its base URL is invalid on purpose: browsers would otherwise request the fonts that k3d's style sheet names.
    """
    from pftwin.results.viewer import view
    from pftwin.results.viewer.page import page

    hidden = [NOMINAL] if material.has_nominal else []
    inside = page(view([(r.name, r.source) for r in material.runs], hidden=hidden))
    return inside.replace("<head>", '<head><base href="about:invalid">', 1)
