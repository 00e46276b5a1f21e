"""Figures of the runs, drawn anew from what their files hold; and the knee in three dimensions."""

from __future__ import annotations

from fitting.cli.report.html import PageSection, drawn, frame, paragraph
from fitting.cli.report.material import Material
from pftwin.base.errors import InputError, MissingExtraError


def section(material: Material) -> PageSection:
    """Path, tilt and force; courses against knee flexion; the path over the trochlea; the way of the fit."""
    parts = [_case(material), _against_flexion(material), _over_the_trochlea(material)]
    for name, estimate in material.estimates.items():
        if len({h["evaluations"] for h in estimate.history}) > 1:
            words = f"Best objective against evaluations, {name}."
            parts.append(drawn(estimate.plot.history(), f"{words} It ends at {estimate.objective_value:.6g}.", words))
    return PageSection("figures", "Figures", "".join(parts))


def view(material: Material) -> PageSection:
    """The page of the viewer within the page; without its extra, how to install it."""
    title = "In three dimensions"
    try:
        from pftwin.results.viewer import view as draw
        from pftwin.results.viewer.page import page

        inside = page(draw([(r.name, r.source) for r in material.runs]))
    except (MissingExtraError, InputError) as error:
        return PageSection("view", title, paragraph(f"Not drawn: {error}", "missing"))
    names = " and ".join(r.name for r in material.runs)
    words = "Drag to turn, wheel to zoom; play and the slider move the knee. Bones are schematic."
    return PageSection(
        "view", title, paragraph(words, "on-screen") + frame(inside, f"The moving knee in three dimensions: {names}")
    )


def _case(material: Material) -> str:
    from pftwin.results.plots import case_figure
    from pftwin.results.plots.quantities import provenance

    measured = None if material.demo is not None or material.chosen is None else material.chosen.measured
    names = " and ".join(r.name for r in material.runs)
    said = provenance(*(r.result for r in material.runs))
    title = names if said is None else f"{names}\n{said}"
    figure = case_figure({r.name: r.result for r in material.runs}, measured, title)
    what = names if measured is None else f"{names}, with {measured.label}"
    becomes = " ".join(f"{r.name}: {r.tracking}." for r in material.runs)
    alternative = (
        f"{what}: path of the button's centre in the coronal and the sagittal plane, patellar tilt and normal contact "
        f"force over time. {becomes}"
    )
    return drawn(figure, alternative, f"Path, tilt and contact force: {what}.")


def _against_flexion(material: Material) -> str:
    from pftwin.results.plots import against_flexion

    names = " and ".join(r.name for r in material.runs)
    try:
        figure = against_flexion({r.name: r.result for r in material.runs}, title=names)
    except InputError as error:  # a knee that does not bend
        return paragraph(f"No courses against knee flexion: {error}", "missing")
    alternative = f"Tilt, shift, rotation and contact force against knee flexion: {names}. Ranges are under Scene."
    return drawn(figure, alternative, f"Against knee flexion: {names}. Bending solid, straightening dashed.")


def _over_the_trochlea(material: Material) -> str:
    """Of the last run that is in memory: files do not keep the surface as a function."""
    from pftwin.results.result import Result

    here = [r for r in material.runs if isinstance(r.source, Result) and r.source.surface is not None]
    if not here:
        return ""
    run = here[-1]
    measured = None if material.chosen is None else material.chosen.measured
    words = f"Path of the button and of the contact points over the trochlea's contours: {run.name}."
    return drawn(run.result.plot.trajectory(measured=measured), words, words)
