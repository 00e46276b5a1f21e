"""The example that `pftwin init` writes: a commented scene file beside the files of the virtual rig's laboratory."""

from __future__ import annotations

import math
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pftwin.base.errors import OutputError

if TYPE_CHECKING:
    from pftwin.base.spatial import Vec3
    from pftwin.geometry.patch.emphasis import WeightedPart
    from pftwin.model.scene import Scene

Cluster = Mapping[str, Sequence[float]]


@dataclass(frozen=True)
class LaboratoryFiles:
    """Names of the files that the example refers to, and what has to be known to read them."""

    markers: str  # TRC
    mesh: str  # STL, metres
    forces: str | None  # CSV
    femur: Cluster | None  # marker places in the femur's frame [m]; None: the femur is fixed at the world's origin
    tibia: Cluster
    patella: Cluster
    fixed_points: Cluster  # in the world [m]
    columns: tuple[str, str, str] = ("contact", "tibial_spring", "femoral_spring")  # of the forces
    cutoff_hz: float = 12.0
    window: int = 30
    axis_radius: float = 0.0248  # of the groove about the implant's axis [m]
    angles_deg: tuple[float, float] = (-75.0, 30.0)  # of the region that the patch is fitted to
    half_width: float = 0.020  # of that region [m]
    parts: tuple[WeightedPart, ...] = ()  # of it that count more, or less
    tolerance: float = 0.02e-3  # of a spline, rms [m]
    synthetic: bool = True


def rig_laboratory(case: int, contact: str = "P5") -> LaboratoryFiles:
    """The files of the virtual rig's laboratory for a case, and the region that a patch of that name is fitted to."""
    from pftwin.geometry.patch.fit import SPLINE
    from pftwin.geometry.patch.implant import RIG_ANGLES, RIG_HALF_WIDTH, RIG_PARTS, RIG_RIM, RIG_TOLERANCE, rig_implant
    from pftwin.rig import geometry, recording

    low, high = RIG_ANGLES

    return LaboratoryFiles(
        markers=f"case{case}_markers.trc",
        mesh="femoral_component.stl",
        forces=f"case{case}_forces.csv",
        femur={**geometry.FEMUR_MARKERS, "HIP": geometry.HIP},
        tibia=geometry.TIBIA_MARKERS,
        patella=geometry.PATELLA_MARKERS,
        fixed_points={"HIP": geometry.HIP},
        columns=recording.FORCES,
        cutoff_hz=recording.CUTOFF,
        window=recording.WINDOW,
        axis_radius=float(rig_implant().trochlear_radius),
        angles_deg=(math.degrees(low), math.degrees(high)),
        half_width=RIG_RIM if contact == SPLINE else RIG_HALF_WIDTH,
        parts=() if contact == SPLINE else RIG_PARTS,
        tolerance=RIG_TOLERANCE,
    )


def write_example(folder: Path, case: int = 1) -> list[Path]:
    """Write scene.toml and its files; the folder is made if it is not there.

    Raises:
        OutputError: a file of the same name is there already (nothing is written), or the folder cannot be written to.
    """
    from pftwin import rig

    made = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder, prefix=".example.") as name:
            built = Path(name)
            files = [Path(p) for p in rig.write_files(case, built)]
            scene = built / "scene.toml"
            scene.write_text(scene_text(rig.case(case), rig_laboratory(case)), encoding="utf-8")
            targets = [folder / p.relative_to(built) for p in (scene, *files)]
            if there := [t for t in targets if t.exists()]:
                raise OutputError(f"{there[0]}: is there already; try: another folder, or remove it first")
            for source, target in zip((scene, *files), targets, strict=True):
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.move(source, target)
            return targets
    except OutputError:
        raise
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written: {error.strerror or error}") from error
    finally:
        if made and folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()


def scene_text(scene: Scene, files: LaboratoryFiles) -> str:
    """The scene file of one of the rig's cases, with comments."""
    from jinja2 import Environment, PackageLoader

    from pftwin.geometry.patch.charts import CylindricalChart
    from pftwin.geometry.patch.fit import name_of

    contact: Any = scene.contact
    surface, others = contact.fitted_surface(), {e.name: e for e in scene.effects}
    environment = Environment(loader=PackageLoader("pftwin.rig", ""), keep_trailing_newline=True, autoescape=False)
    environment.filters |= {"number": _number, "point": _point, "cluster": _cluster, "part": _part}
    return environment.get_template("scene.toml.jinja").render(
        name=f"example, after {scene.name}",  # not that of a case: an edited copy is none
        files=files,
        scene=scene,
        contact=contact,
        law=contact.law,
        patch=name_of(surface),
        chart="cylinder" if isinstance(surface.chart, CylindricalChart) else "plane",
        tendons=[e for e in scene.effects if e.line_element() is not None],
        gravity=others.get("gravity"),
        damping=others.get("damping"),
    )


def _number(value: Any, scale: float = 1.0) -> str:
    return f"{scale * float(value):.10g}"


def _point(v: Vec3 | Sequence[float], scale: float = 1.0) -> str:
    values = v if isinstance(v, Sequence) else np.asarray(v.array())
    return "[" + ", ".join(_number(c, scale) for c in values) + "]"


def _part(part: WeightedPart) -> str:
    limits = ""
    if math.isfinite(part.across[0]):
        limits += f", across_mm = {_point(part.across, 1e3)}"
    if part.angles[1] < math.pi:
        limits += f", angles_deg = {_point(part.angles, 180 / math.pi)}"
    return f"{{ weight = {_number(part.weight)}{limits} }}"


def _cluster(places: Cluster) -> str:
    return "{ " + ", ".join(f"{n} = {_point(p, 1e3)}" for n, p in places.items()) + " }" if places else "{}"
