"""What acts on the patella: parameters of the scene with their units, and what a run's forces came to."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from fitting.cli.report.html import PageSection, bullets, number, paragraph, table
from fitting.cli.report.material import Material

if TYPE_CHECKING:
    from fitting.cli.report.run import ReportedRun
    from pftwin.model.scene import Scene

# Fields of effects: words, what the number is multiplied by, and the unit then.
_FIELDS: dict[str, tuple[str, float, str]] = {
    "mass": ("mass", 1e3, "g"),
    "acceleration": ("acceleration of gravity (x, y, z)", 1.0, "m/s²"),
    "stiffness": ("stiffness", 1.0, "N/m"),
    "maxwell_stiffness": ("stiffer when pulled at once, by", 1.0, "N/m"),
    "slack_length": ("slack length", 1e3, "mm"),
    "damping": ("damping", 1.0, "N s/m"),
    "damping_time": ("damping time", 1e3, "ms"),
    "relaxation_time": ("relaxation time", 1.0, "s"),
    "toe_strain": ("strain at the end of the toe region", 100.0, "%"),
    "insertion": ("insertion on the patella (x, y, z)", 1e3, "mm"),
    "origin": ("origin (x, y, z)", 1e3, "mm"),
    "tension": ("prescribed tension", 1.0, "N"),
    "radius": ("radius of the button", 1e3, "mm"),
    "effective_radius": ("radius that the law belongs to", 1e3, "mm"),
    "center": ("centre of the button, patella frame (x, y, z)", 1e3, "mm"),
    "contact_stiffness": ("contact stiffness, p the exponent", 1.0, "N/m^p"),
    "hertz_exponent": ("exponent of the law", 1.0, ""),
    "restitution": ("coefficient of restitution", 1.0, ""),
    "dissipation": ("dissipation", 1.0, "s/m"),
    "approach_speed_floor": ("least approach speed of the law", 1e3, "mm/s"),
    "coefficient": ("coefficient of friction", 1.0, ""),
    "slip_speed": ("slip speed", 1e3, "mm/s"),
    "modulus": ("Young's modulus of the layer", 1e-6, "MPa"),
    "poisson": ("Poisson's ratio of the layer", 1.0, ""),
    "thickness": ("thickness of the layer", 1e3, "mm"),
    "translational": ("drag on translation", 1.0, "N s/m"),
    "rotational": ("drag on rotation", 1.0, "N m s/rad"),
}
_GEOMETRY = ("surface", "femur", "patella", "mesh", "button")  # parts that are shapes, not parameters to read
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


def parameters(effect: Any) -> Iterator[tuple[str, str, str]]:
    """Quantity, value and unit of every parameter of an effect; shapes in a word."""
    import jax

    from pftwin.base.spatial import Vec3
    from pftwin.geometry.patch.spline_or_polynomial import name_of

    if (patch := name_of(getattr(effect, "surface", None))) is not None:
        yield ("surface of the trochlea", f"fitted patch {patch}", "")
    elif any(getattr(effect, part, None) is not None for part in _GEOMETRY):
        yield ("surface of the trochlea", "mesh", "")
    for path, leaf in jax.tree_util.tree_leaves_with_path(effect, is_leaf=lambda v: isinstance(v, Vec3)):
        names = [str(getattr(k, "name", getattr(k, "idx", k))) for k in path]
        if names[0] in _GEOMETRY:
            continue
        words, scale, unit = _FIELDS.get(names[-1], (_words(".".join(names)), 1.0, "SI units"))
        if names[-1] == "origin" and (body := getattr(effect, "body", None)):
            words = f"origin on the {body} (x, y, z)"
        if names[-1] == "stiffness" and type(effect).__name__ == "Strands":
            unit = "N per unit strain"
        yield (words, _value(leaf, scale), unit)


def _value(leaf: Any, scale: float) -> str:
    """One number; three of a point; the range of many."""
    if hasattr(leaf, "x"):
        return ", ".join(_value(c, scale) for c in (leaf.x, leaf.y, leaf.z))
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
