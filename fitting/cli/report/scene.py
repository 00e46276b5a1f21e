"""What acts on the patella: parameters of the scene with their units, and what a run's forces came to."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from fitting.cli.report.html import PageSection, bullets, number, paragraph, table
from fitting.cli.report.material import Material

if TYPE_CHECKING:
    from fitting.cli.report.run import ReportedRun
    from pftwin.model.effects.base import Effect
    from pftwin.model.scene import Scene

# As people read declared quantities: what the number is multiplied by, and the unit then.
_SHOWN = {"m": (1e3, "mm"), "kg": (1e3, "g"), "m/s": (1e3, "mm/s"), "Pa": (1e-6, "MPa"), "m/s^2": (1.0, "m/s²")}
_UNITS = {"m": (1e3, "mm"), "1": (1.0, "")}


def section(material: Material) -> PageSection:
    """The scene's parameters, where it is known, and the forces of every run."""
    parts = []
    if material.chosen is not None:
        scene = material.chosen.scene
        parts += [paragraph(f"Scene: {scene.name}. {motion(scene)}"), _parameters(scene)]
        if material.estimates:
            parts.append(paragraph("These are the values before the fit; fitted ones are under Fit.", "small"))
    else:
        words = "The file holds no parameters of the scene; --scene or --case adds them."
        parts.append(paragraph(words, "missing"))
    parts += [_forces(run) for run in material.runs]
    parts.append(bullets(["x points proximally, y laterally, z anteriorly; a left knee is mirrored to a right one."]))
    return PageSection("scene", "Scene: what acts on the patella", "".join(parts))


def motion(scene: Scene) -> str:
    """How long the recorded motion is."""
    times = scene.motion.times
    return f"Recorded motion: {times.size} frames in {times[-1] - times[0]:.2f} s."


def _parameters(scene: Scene) -> str:
    rows = [("patella", "mass", number(1e3 * float(scene.patella.mass)), "g")]
    for effect in scene.effects:
        rows += [(_words(effect.name), *row) for row in parameters(effect)]
    return table("Parameters of the scene", ("effect", "quantity", "value", "unit"), rows)


def parameters(effect: Effect) -> Iterator[tuple[str, str, str]]:
    """Quantity, value and unit of every number that an effect declares; of a surface, what it is in a word."""
    from pftwin.base.quantities import declarations
    from pftwin.geometry.patch.fit import name_of

    surface = None
    if (contact := effect.contact_role()) is not None:
        surface, fitted = contact.groove_surface(), contact.fitted_surface()
        yield ("surface of the trochlea", "mesh" if fitted is None else f"fitted patch {name_of(fitted) or ''}", "")
    line = effect.line_element()
    points: dict[tuple[str, ...], list[Any]] = {}
    for path, leaf, declared in declarations(effect):
        if declared is None or (surface is not None and getattr(effect, path[0]) is surface):
            continue
        scale, unit = _SHOWN.get(declared.unit, (1.0, declared.unit))
        if not declared.frame:
            yield (declared.words or _words(", ".join(path)), _value(leaf, scale), unit)
            continue
        point = points.setdefault(path[:-1], [])
        point.append(leaf)
        if len(point) == 3:
            frame = line.line_ends[1] if declared.frame == "body" and line is not None else declared.frame
            words = f"{declared.words or _words(', '.join(path[:-1]))} ({frame}; x, y, z)"
            yield (words, ", ".join(_value(c, scale) for c in point), unit)


def _value(leaf: Any, scale: float) -> str:
    """One number; the range of many."""
    values = scale * np.asarray(leaf, dtype=np.float64).ravel()
    if values.size == 1 or np.ptp(values) == 0:
        return number(values[0])
    return f"{number(values.min())} to {number(values.max())}"


def _forces(run: ReportedRun) -> str:
    """What the run's tendons and contacts came to: smallest, mean and largest over the frames."""
    rows = []
    for name, variable in run.data.data_vars.items():
        unit = str(variable.attrs.get("units", ""))
        shown = unit == "N" and not str(name).endswith(("_x", "_y", "_z"))
        shown = shown or str(name) in ("knee_flexion", "patella_flexion", "patella_tilt", "groove_offset")
        if not shown or "time" not in variable.dims:
            continue
        values = np.asarray(variable.values, dtype=np.float64)
        values = values[np.isfinite(values)]
        scale, unit = _UNITS.get(unit, (1.0, unit))
        three = ("–",) * 3
        if values.size:
            three = tuple(number(scale * v) for v in (values.min(), values.mean(), values.max()))
        rows.append((str(variable.attrs.get("long_name", name)), *three, unit))
    return table(f"Over the motion: {run.name}", ("quantity", "smallest", "mean", "largest", "unit"), rows)


def _words(name: str) -> str:
    return name.replace("_", " ")
