"""What was fitted, with 95 % intervals and the plain sentence."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fitting.cli.report.html import PageSection, bullets, drawn, number, paragraph, subtitle, table
from fitting.cli.report.material import Material

if TYPE_CHECKING:
    from fitting.estimate import Estimate
    from pftwin.model.scene import Scene


def section(material: Material) -> PageSection:
    """A table and a sentence for every estimate."""
    if not material.estimates:
        words = "This is a simulation: nothing was fitted. `pftwin fit` fits tendons to recorded motion."
        return PageSection("fit", "Fit", paragraph(words, "missing"))
    scene = None if material.chosen is None else material.chosen.scene
    parts = []
    for name, estimate in material.estimates.items():
        if len(material.estimates) > 1:
            parts.append(subtitle(f"By {name}"))
        parts += [
            paragraph(sentence(estimate), "finding"),
            _table(estimate, scene),
            bullets([*doubts(estimate, scene), *estimate.remarks()]),
        ]
        about = f"fitted by {estimate.method} to {estimate.source}; stopped: {estimate.reason}"
        parts.append(paragraph(f"Scene {estimate.scene_name}, {about}.", "small"))
        parts.append(_correlation(estimate))
    return PageSection("fit", "Fit", "".join(parts))


def sentence(estimate: Estimate) -> str:
    """What the data can tell, as a sentence."""
    words = estimate.sentence()
    return f"{words[:1].upper()}{words[1:]}."


def doubts(e: Estimate, scene: Scene | None) -> list[str]:
    """Where the scene's numbers are not those that the fit began from: it may be another scene of the same name."""
    if scene is None:
        return []
    from pftwin.model.scene_parameters import find

    here = [float(find(scene, name)[0].read(scene)) for name in e.names]
    off = [n for n, x, began in zip(e.names, here, e.nominal, strict=True) if abs(x - began) > 1e-6 * abs(began)]
    if not off:
        return []
    return [f"This scene has other values of {', '.join(off)} than the fit began from: is it the one that was fitted?"]


def _table(e: Estimate, scene: Scene | None) -> str:
    from pftwin.results.plots.quantities import as_read

    rows = []
    for i, name in enumerate(e.names):
        scale, unit = as_read(e.units[i])
        value, sd, nominal = (scale * float(a[i]) for a in (e.values, e.standard_deviations, e.nominal))
        low, high = scale * e.intervals[i]
        interval = f"{number(low)} to {number(high)}"
        rows.append((name, meaning(scene, name), number(value), interval, number(sd, 3), number(nominal), unit))
    measured = "synthetic measurements" if e.synthetic else "measurements"
    headings = ("parameter", "what it is", "estimate", "95 % interval", "standard deviation", "nominal", "unit")
    return table(f"Fitted to {measured}", headings, rows)


def meaning(scene: Scene | None, name: str) -> str:
    """A parameter in words; its name where the scene is not known."""
    if scene is None:
        return name
    from pftwin.model.scene_parameters import find

    found = find(scene, name)[0]
    return found.name.replace("_", " ").replace(".", ", ", 1)


def _correlation(e: Estimate) -> str:
    import numpy as np

    strongest = ""
    if len(e.names) > 1:
        off = np.abs(e.correlation - np.eye(len(e.names)))
        i, j = np.unravel_index(int(np.argmax(off)), off.shape)
        strongest = f" The strongest: {e.names[i]} and {e.names[j]}, {e.correlation[i, j]:.2f}."
    alternative = (
        f"Left: correlation of the errors of {', '.join(e.names)}.{strongest} Right: estimates with 95 % intervals "
        "in percent of the nominal values; the numbers are in the table above."
    )
    caption = "Errors that hang together (left); estimates against nominal values (right)."
    return drawn(e.plot.correlation(), alternative, caption)
