"""The example that `pftwin init` writes: a commented scene file beside the files of the virtual rig's laboratory."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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
    from pftwin.model.effects.contact_law import Flores
    from pftwin.model.effects.damping import LinearDamping
    from pftwin.model.effects.gravity import Gravity
    from pftwin.model.effects.tendon import Tendon

    contact: Any = scene.contact
    assert isinstance(contact.law, Flores)
    law = contact.law
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
        "gravity": "\n".join(
            f"[gravity]\nacceleration_m_per_s2 = {_point(e.acceleration)}"
            for e in scene.effects
            if isinstance(e, Gravity)
        ),
        "tendons": "\n\n".join(_tendon(e) for e in scene.effects if isinstance(e, Tendon)),
        "center": _point(contact.center, 1e3),
        "radius": _number(1e3 * float(contact.radius)),
        "law": f'{{ type = "flores", contact_stiffness = {_number(law.contact_stiffness)}, '
        f"hertz_exponent = {_number(law.hertz_exponent)}, restitution = {_number(law.restitution)}, "
        f"approach_speed_floor_m_per_s = {_number(law.approach_speed_floor)} }}",
        "mesh": files.mesh,
        "patch": _patch(contact.surface),
        "chart": "cylinder" if hasattr(getattr(contact.surface, "chart", None), "radius") else "plane",
        "axis_radius": _number(1e3 * files.axis_radius),
        "damping": "\n\n".join(_damping(e) for e in scene.effects if isinstance(e, LinearDamping)),
        "synthetic": "true" if files.synthetic else "false",
        "measured": "" if files.forces is None else _measured(files),
    }
    return Template(_TEMPLATE).substitute(values)


def _tendon(tendon: Any) -> str:
    return "\n".join(
        [
            "[[tendon]]",
            f'name = "{tendon.name}"',
            f'body = "{tendon.body}"              # the other end: femur, tibia or ground',
            f"stiffness_N_per_m = {_number(tendon.stiffness)}",
            f"slack_length_mm = {_number(1e3 * float(tendon.slack_length))}",
            f"damping_N_s_per_m = {_number(tendon.damping)}  # or damping_time_s = damping / stiffness",
            f"insertion_mm = {_point(tendon.insertion, 1e3)}  # patella frame",
            f"origin_mm = {_point(tendon.origin, 1e3)}  # {tendon.body}'s frame",
        ]
    )


def _damping(damping: Any) -> str:
    return "\n".join(
        [
            "[damping]             # viscous, of the motion relative to a body",
            f'body = "{damping.body}"',
            f"translational_N_s_per_m = {_number(damping.translational)}",
            f"rotational_N_m_s_per_rad = {_number(damping.rotational)}",
        ]
    )


def _patch(surface: Any) -> str:
    """Which patch is fitted to the mesh."""
    if type(surface).__name__ == "SplinePatch":
        return 'kind = "spline"       # bicubic, within 0.02 mm rms; or degree = "P5", a polynomial'
    return f'degree = "P{getattr(surface, "degree", 5)}"         # total degree: P2, P4, P5, ...; or kind = "spline"'


def _measured(files: LaboratoryFiles) -> str:
    contact, tibial, femoral = files.columns
    return Template(_MEASURED).substitute(
        forces=files.forces,
        contact=contact,
        tibial=tibial,
        femoral=femoral,
        window=files.window,
        patella=_cluster(files.patella),
        synthetic="true" if files.synthetic else "false",
    )


def _number(value: Any) -> str:
    return f"{float(value):.10g}"


def _point(v: Vec3, scale: float = 1.0) -> str:
    return "[" + ", ".join(_number(scale * float(c)) for c in np.asarray(v.array())) + "]"


def _cluster(places: Cluster) -> str:
    return (
        "{ " + ", ".join(f"{n} = [{', '.join(_number(1e3 * float(c)) for c in p)}]" for n, p in places.items()) + " }"
    )


_FIXED_FEMUR = "fixed = { position_m = [0, 0, 0], quaternion_wxyz = [1, 0, 0, 0] }  # pose in the world"

_TEMPLATE = """\
# A scene for pftwin: everything that a simulation needs. Relative paths start at this file's folder.
# Units stand in the names: SI; a length NAME_m may be written NAME_mm. Quaternions are (w, x, y, z).
# Frames: femur x proximal, y medial-lateral (lateral for a right knee), z anterior; the patella alike.

schema = 1            # version of this format
name = "$name"
side = "right"        # a "left" knee's data are mirrored on input

# [axes]              # needed where the files' frames are not proximal, lateral, anterior (left: ["+x", "-y", "+z"])
# femur = ["+x", "+y", "+z"]          # which of its own axes are proximal, lateral, anterior; tibia, patella alike
# world_medial_lateral = "y"          # of the laboratory; needed for a left knee

[motion]
markers = "$markers"  # TRC, C3D or CSV; or poses = "poses.csv" with columns time_s, BODY_px_m ... BODY_qz
# units = "mm"        # of the markers, where their file does not say
fixed_points_mm = $fixed_points  # count as markers: the hip's centre, where it does not move
max_gap_s = 0.1       # longest gap in a marker that is filled by a spline
cutoff_Hz = $cutoff        # zero-phase Butterworth low-pass; leave it out for no filter
filter_order = 2      # of one pass
correct_two_passes = false  # true: both passes together have -3 dB at the cut-off
synthetic = $synthetic     # a simulated motion: results and figures say so
# start_time_s = 0.0  # part of the recording, after filtering
# end_time_s = 7.2

# Where each segment is: one of
#   fixed = { position_m = [0, 0, 0], quaternion_wxyz = [1, 0, 0, 0] }    (femur, patella's start)
#   body = "femur"                                                        (a body of the file of poses)
#   cluster_mm = { M1 = [x, y, z], ... }    (three or more markers and their places in the segment's frame)
#   three_points = { markers = ["M1", "M2", "M3"], axes = "xy" }          (Vaughan's frame)
[femur]
$femur

[tibia]
cluster_mm = $tibia

[patella]
mass_kg = $mass
inertia_kg_m2 = $inertia   # principal moments about the centre of mass, patella axes
center_of_mass_mm = $center_of_mass     # patella frame

[patella.start]       # near which the static equilibrium at the first frame is looked for
cluster_mm = $patella

# What acts on the patella. Leave out what is not there; add as many as there are, each [[...]] with its own name.
$gravity

$tendons

[contact]             # the button's sphere on the trochlea
center_mm = $center      # of the sphere, patella frame
radius_mm = $radius
# button = { mesh = "button.stl", units = "m" }   # in place of both: a sphere fitted to a mesh
law = $law
# law = { type = "hunt_crossley", contact_stiffness = 2e8, dissipation_s_per_m = 0.5 }   # stiffness in N/m^exponent
# law = { type = "hertz", contact_stiffness = 2e8 }

[contact.surface]     # a patch fitted to the trochlear part of a mesh, normals out of the bone
mesh = "$mesh"
units = "m"           # of the mesh: its format does not say
$patch
chart = "$chart"       # heights over a "plane", or about the trochlear axis: "cylinder"
# Which vertices: a rectangle about the trochlear axis. Without axis_... the axis is looked for (anterior and proximal
# may then be given as directions in the mesh's frame): `pftwin fit-surface` draws what it finds.
region = { axis_origin_mm = [0, 0, 0], axis_radius_mm = $axis_radius, half_width_mm = 20, angles_deg = [-75, 30] }
# Meshes that touch as they are, in place of [contact]: [mesh_contact], [elastic_foundation]; see "Bring your own knee".
# surface = { implant = "rig" } is the virtual rig's smooth implant; coefficients_m, chart, half_size_m give a patch.

$damping

# Others:
# [[strands]]                         # ligaments with a toe region
# name = "mpfl"
# body = "femur"
# file = "ligaments.json"             # or CSV, or lists in place: stiffness_N_per_strain, slack_length_m, ...
# select = ["MPFL*"]
# toe_strain = 0.06
# [[prescribed_tension]]              # muscles of known tension: time_s, LINE_tension_N, ...
# name = "muscles"
# body = "femur"
# file = "tensions.csv"
# insertion_mm = [[20, 0, -8]]
# origin_mm = [[220, 10, 35]]
$measured"""

_MEASURED = """
[measured]            # what `pftwin validate` compares with
forces = "$forces"
contact_force = "$contact"
tibial_spring_force = "$tibial"
femoral_spring_force = "$femoral"
smoothing_window = $window # singular spectrum analysis; leave it out for none
synthetic = $synthetic      # simulated measurements: tables and figures say so
patella = { cluster_mm = $patella }
"""
