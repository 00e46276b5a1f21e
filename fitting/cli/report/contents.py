"""The report as a whole: labels above all, what it comes to, then the parts in their order."""

from __future__ import annotations

from typing import NamedTuple

from fitting.cli.report import figures, fit, html, prediction, quality, scene, settings
from fitting.cli.report.html import PageSection
from fitting.cli.report.material import Material

MOST_BYTES = 12_000_000  # of a page
RESEARCH = ("Research use, not a medical device.", "No treatment should be decided by this report alone.")


class ReportPage(NamedTuple):
    """The page, and whether the knee in three dimensions is in it."""

    page: str
    viewer: bool


def report(material: Material, command: str) -> ReportPage:
    """The page of a report.

    Args:
        material: what there is to tell.
        command: what the report was asked for with, for its settings.
    """
    drawing = figures.view(material)
    inside = "<iframe" in drawing.body
    text = _page(material, command, drawing)
    size = len(text.encode("utf-8"))
    if inside and size > MOST_BYTES:
        words = (
            f"Left out: with it this page would have {size / 1e6:.0f} MB, more than the {MOST_BYTES / 1e6:.0f} MB that "
            "mail lets through. `pftwin view` draws it as a page of its own."
        )
        inside, text = False, _page(material, command, drawing._replace(body=html.paragraph(words, "missing")))
    return ReportPage(text, inside)


def _page(material: Material, command: str, drawing: PageSection) -> str:
    labels: list[tuple[str, str]] = [RESEARCH]
    if said := material.synthetic():
        labels.append(("Synthetic data:", f"{'; '.join(said)}."))
    sections = [
        PageSection("short", "In short", _short(material)),
        scene.section(material),
        quality.section(material),
        fit.section(material),
        prediction.section(material),
        figures.section(material),
        drawing,
        settings.section(material, command),
    ]
    ending = f"Made by pftwin on {settings.now()}. {' '.join(RESEARCH)}"
    return html.page(material.title, labels, sections, ending)


def _short(material: Material) -> str:
    """What was simulated, fitted and predicted, a sentence each, and what to keep in mind."""
    lines = [f"{run.name}: {run.tracking}." for run in material.runs]
    if material.estimate is not None:
        known = None if material.chosen is None else material.chosen.scene
        names = "; ".join(f"{n}: {fit.meaning(known, n)}" for n in material.estimate.names)
        lines.append(f"{fit.sentence(material.estimate)} ({names}.)")
    if material.treatment is not None:
        lines.append(f"Treatment: {prediction.finding_of(material.treatment)}")
    flagged = [run.name for run in material.runs if run.marks]
    if flagged:
        lines.append(f"Some frames of {' and '.join(flagged)} are flagged: see Data quality.")
    return html.bullets(lines)
