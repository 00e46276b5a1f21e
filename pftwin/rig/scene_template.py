"""The example that `pftwin init` writes: a commented scene file beside the files of the virtual rig's laboratory."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files as files_of
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

import numpy as np

from pftwin.base.errors import OutputError

if TYPE_CHECKING:
    from pftwin.base.spatial import Vec3
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
    synthetic: bool = True


def rig_laboratory(case: int) -> LaboratoryFiles:
    """What the virtual rig's laboratory knows of a case."""
    from pftwin.geometry.patch.implant import rig_implant
    from pftwin.rig import geometry, recording

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
    from pftwin.geometry.patch.charts import CylindricalChart
    from pftwin.geometry.patch.fit import SPLINE, name_of

    contact: Any = scene.contact
    law, surface = contact.law, contact.fitted_surface()
    others = {e.name: e for e in scene.effects}
    values = {
        "name": f"example, after {scene.name}",  # not that of a case: an edited copy is none
        "markers": files.markers,
        "cutoff": _number(files.cutoff_hz),
        "fixed_points": _cluster(files.fixed_points) if files.fixed_points else "{}",
        "femur": _FIXED_FEMUR if files.femur is None else f"cluster_mm = {_cluster(files.femur)}",
        "tibia": _cluster(files.tibia),
        "patella": _cluster(files.patella),
        "mass": _number(scene.patella.mass),
        "inertia": _point(scene.patella.inertia),
        "center_of_mass": _point(scene.patella.center_of_mass, 1e3),
        "gravity": _gravity(others["gravity"]) if "gravity" in others else "",
        "tendons": "\n\n".join(_tendon(e) for e in scene.effects if e.line_element() is not None),
        "center": _point(contact.tracked_point(), 1e3),
        "radius": _number(1e3 * float(contact.button_radius())),
        "law": f'{{ type = "flores", contact_stiffness = {_number(law.contact_stiffness)}, '
        f"hertz_exponent = {_number(law.hertz_exponent)}, restitution = {_number(law.restitution)}, "
        f"approach_speed_floor_m_per_s = {_number(law.approach_speed_floor)} }}",
        "mesh": files.mesh,
        "patch": _SPLINE if name_of(surface) == SPLINE else _POLYNOMIAL.format(name_of(surface)),
        "chart": "cylinder" if isinstance(surface.chart, CylindricalChart) else "plane",
        "axis_radius": _number(1e3 * files.axis_radius),
        "damping": _damping(others["damping"]) if "damping" in others else "",
        "synthetic": "true" if files.synthetic else "false",
        "measured": "",
    }
    if files.forces is not None:
        values |= dict(zip(("contact", "tibial", "femoral"), files.columns, strict=True))
        values |= {"forces": files.forces, "window": str(files.window)}
        values["measured"] = _template("measured").substitute(values)
    return _template("scene").substitute(values)


def _template(name: str) -> Template:
    return Template(files_of("pftwin.rig").joinpath(f"{name}.toml.template").read_text(encoding="utf-8"))


def _gravity(gravity: Any) -> str:
    return f"[gravity]\nacceleration_m_per_s2 = {_point(gravity.acceleration)}"


def _tendon(tendon: Any) -> str:
    return f"""\
[[tendon]]
name = "{tendon.name}"
body = "{tendon.body}"              # the other end: femur, tibia or ground
stiffness_N_per_m = {_number(tendon.stiffness)}
slack_length_mm = {_number(1e3 * float(tendon.slack_length))}
damping_N_s_per_m = {_number(tendon.damping)}  # or damping_time_s = damping / stiffness
insertion_mm = {_point(tendon.insertion, 1e3)}  # patella frame
origin_mm = {_point(tendon.origin, 1e3)}  # {tendon.body}'s frame"""


def _damping(damping: Any) -> str:
    return f"""\
[damping]             # viscous, of the motion relative to a body
body = "{damping.body}"
translational_N_s_per_m = {_number(damping.translational)}
rotational_N_m_s_per_rad = {_number(damping.rotational)}"""


def _number(value: Any) -> str:
    return f"{float(value):.10g}"


def _point(v: Vec3, scale: float = 1.0) -> str:
    return _list([float(c) for c in np.asarray(v.array())], scale)


def _list(numbers: Sequence[float], scale: float) -> str:
    return "[" + ", ".join(_number(scale * float(c)) for c in numbers) + "]"


def _cluster(places: Cluster) -> str:
    return "{ " + ", ".join(f"{n} = {_list(p, 1e3)}" for n, p in places.items()) + " }"


_FIXED_FEMUR = "fixed = { position_m = [0, 0, 0], quaternion_wxyz = [1, 0, 0, 0] }  # pose in the world"
_SPLINE = 'kind = "spline"       # bicubic, within 0.02 mm rms; or degree = "P5", a polynomial'
_POLYNOMIAL = 'degree = "{}"         # total degree: P2, P4, P5, ...; or kind = "spline"'
