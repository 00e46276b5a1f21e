"""Small knee models in OpenSim's format, written for these tests from its public schema."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from pftwin.geometry.mesh.icosphere import icosphere
from pftwin.geometry.mesh.mesh import SurfaceMesh, save_mesh
from pftwin.geometry.patch.implant import rig_implant

# Rows: OpenSim's x (anterior), y (proximal), z (lateral) in proximal, lateral, anterior axes.
OSIM = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
BUTTON_RADIUS, BUTTON_AT = 0.022, (0.0, 0.0, 0.0)
FEMUR_AT = (0.01, 0.45, 0.02)  # of the femur's weld in ground, turned by 0.1 about y
PT = ((-0.008, -0.02, 0.0), (0.045, -0.07, 0.0))  # of the first strand: on the patella, on the tibia


def function(kind: str, *numbers: object) -> str:
    if kind == "Constant":
        return f'<Constant name="function"><value>{numbers[0]}</value></Constant>'
    if kind == "LinearFunction":
        return (
            f'<LinearFunction name="function"><coefficients>{numbers[0]} {numbers[1]}</coefficients></LinearFunction>'
        )
    x, y = numbers
    return f'<{kind} name="function"><x>{x}</x><y>{y}</y></{kind}>'


def axis(name: str, direction: str, coordinate: str, body: str) -> str:
    return (
        f'<TransformAxis name="{name}"><coordinates>{coordinate}</coordinates>'
        f"<axis>{direction}</axis>{body}</TransformAxis>"
    )


def coordinate(name: str, value: float, low: float, high: float) -> str:
    return f'<Coordinate name="{name}"><default_value>{value}</default_value><range>{low} {high}</range></Coordinate>'


def joint(
    name: str, parent: str, child: str, rotations: tuple[str, str, str], start: dict[str, float], extra=""
) -> str:
    """Six degrees of freedom, as in the knee models of OpenSim JAM."""
    names = [f"{name}_{k}_r" for k in (*rotations, "tx", "ty", "tz")]
    axes = ("0 0 1", "1 0 0", "0 1 0", "1 0 0", "0 1 0", "0 0 1")
    labels = [f"rotation{k}" for k in (1, 2, 3)] + [f"translation{k}" for k in (1, 2, 3)]
    coordinates = "".join(coordinate(n, start.get(n, 0.0), -0.2, 1.5 if "flex" in n else 0.2) for n in names)
    transform = "".join(
        axis(label, direction, n, function("LinearFunction", -1 if k == 0 else 1, 0))
        for k, (label, direction, n) in enumerate(zip(labels, axes, names, strict=True))
    )
    return (
        f'<CustomJoint name="{name}_r"><socket_parent_frame>{parent}</socket_parent_frame>'
        f"<socket_child_frame>{child}</socket_child_frame><coordinates>{coordinates}</coordinates>{extra}"
        f"<SpatialTransform>{transform}</SpatialTransform></CustomJoint>"
    )


def body(name: str, mass: float, mesh: str | None = None, scale: str = "1 1 1") -> str:
    drawn = ""
    if mesh is not None:
        drawn = (
            f'<attached_geometry><Mesh name="{name}_bone"><socket_frame>..</socket_frame>'
            f"<scale_factors>{scale}</scale_factors><mesh_file>{mesh}</mesh_file></Mesh></attached_geometry>"
        )
    return (
        f'<Body name="{name}">{drawn}<mass>{mass}</mass><mass_center>0 0 0</mass_center>'
        f"<inertia>3e-05 4e-05 3.5e-05 0 0 0</inertia></Body>"
    )


def point(name: str, frame: str, location: tuple[float, ...]) -> str:
    place = " ".join(f"{v:.17g}" for v in location)
    return (
        f'<PathPoint name="{name}"><socket_parent_frame>{frame}</socket_parent_frame>'
        f"<location>{place}</location></PathPoint>"
    )


def ligament(name: str, *points: tuple[str, tuple[float, ...]], k: float, slack: float, more: str = "") -> str:
    path = "".join(point(f"{name}-P{i}", frame, place) for i, (frame, place) in enumerate(points, start=1))
    return (
        f'<Blankevoort1991Ligament name="{name}"><GeometryPath name="geometrypath"><PathPointSet><objects>{path}'
        f"</objects></PathPointSet></GeometryPath><linear_stiffness>{k}</linear_stiffness>"
        f"<slack_length>{slack}</slack_length>{more}</Blankevoort1991Ligament>"
    )


def contact_mesh(name: str, frame: str, file: str, modulus: float, scale: str = "1 1 1", more: str = "") -> str:
    return (
        f'<Smith2018ContactMesh name="{name}"><socket_frame>{frame}</socket_frame>'
        f"<mesh_file>{file}</mesh_file><elastic_modulus>{modulus}</elastic_modulus>"
        f"<poissons_ratio>0.45</poissons_ratio><thickness>0.005</thickness>{more}"
        f"<scale_factors>{scale}</scale_factors></Smith2018ContactMesh>"
    )


FEMUR, TIBIA, PATELLA = (f"/bodyset/{b}" for b in ("femur_r", "tibia_r", "patella_r"))
START = {"knee_flex_r": 0.8, "pf_flex_r": 0.3, "pf_tx_r": 0.0499, "pf_ty_r": -0.005, "pf_tz_r": 0.001}
WELD = (
    '<WeldJoint name="hip"><socket_parent_frame>ground_offset</socket_parent_frame>'
    "<socket_child_frame>/bodyset/femur_r</socket_child_frame>"
    '<frames><PhysicalOffsetFrame name="ground_offset"><socket_parent>/ground</socket_parent>'
    f"<translation>{' '.join(map(str, FEMUR_AT))}</translation><orientation>0 0.1 0</orientation>"
    "</PhysicalOffsetFrame></frames></WeldJoint>"
)
FIBULA = (
    '<WeldJoint name="fibula"><socket_parent_frame>/bodyset/tibia_r</socket_parent_frame>'
    "<socket_child_frame>fibula_offset</socket_child_frame>"
    '<frames><PhysicalOffsetFrame name="fibula_offset"><socket_parent>/bodyset/shank_r</socket_parent>'
    "<translation>0 0.05 0</translation><orientation>0 0 0</orientation></PhysicalOffsetFrame></frames></WeldJoint>"
)
DEFAULTS = (
    '<defaults><Blankevoort1991Ligament name="default"><transition_strain>0.05</transition_strain>'
    "</Blankevoort1991Ligament></defaults>"
)
MUSCLE = (
    '<Millard2012EquilibriumMuscle name="vasint_r"><GeometryPath name="geometrypath"><PathPointSet><objects>'
    + point("v1", FEMUR, (0.035, 0.22, 0.012))
    + point("v2", PATELLA, (-0.008, 0.02, 0.0))
    + "</objects></PathPointSet></GeometryPath><max_isometric_force>5000</max_isometric_force>"
    "</Millard2012EquilibriumMuscle>"
)


def ligaments() -> str:
    """A patellar tendon of two strands, one from a bone welded to the tibia; a retinaculum; two that cannot go in."""
    return (
        ligament("PT1", (PATELLA, PT[0]), (TIBIA, PT[1]), k=3000, slack=0.06)
        + ligament(
            "PT2",
            (PATELLA, (-0.008, -0.02, 0.004)),
            ("/bodyset/shank_r", (0.045, -0.02, 0.004)),  # the shank's origin is 50 mm below the tibia's
            k=3100,
            slack=0.061,
            more="<transition_strain>0.03</transition_strain><damping_coefficient>0.004</damping_coefficient>",
        )
        + ligament("MPFL1", (FEMUR, (-0.005, 0.0, -0.03)), (PATELLA, (-0.01, 0.0, -0.02)), k=1000, slack=0.05)
        + ligament("MCL1", (FEMUR, (0, 0, -0.03)), (TIBIA, (0, -0.05, -0.03)), k=2000, slack=0.05)
        + ligament("LPFL1", (FEMUR, (0, 0, 0.03)), (FEMUR, (0.01, 0, 0.03)), (PATELLA, (0, 0, 0.02)), k=900, slack=0.05)
    )


def contact() -> str:
    return (
        '<Smith2018ArticularContactForce name="pf_contact">'
        "<socket_target_mesh>/contactgeometryset/femur_cartilage</socket_target_mesh>"
        "<socket_casting_mesh>/contactgeometryset/patella_button</socket_casting_mesh>"
        "<elastic_foundation_formulation>linear</elastic_foundation_formulation>"
        "<use_lumped_contact_model>true</use_lumped_contact_model></Smith2018ArticularContactForce>"
    )


def model(forces: str | None = None, joints: str = "", meshes: bool = True, head: str = "") -> str:
    """The whole file."""
    forces = ligaments() + MUSCLE + contact() if forces is None else forces
    bodies = (
        body("femur_r", 3.0, "femur.stl" if meshes else None)
        + body("tibia_r", 2.0)
        + body("shank_r", 1.0)
        + body("patella_r", 0.12, "button.stl" if meshes else None)
    )
    all_joints = (
        WELD
        + joint("knee", FEMUR, TIBIA, ("flex", "add", "rot"), START)
        + joint("pf", FEMUR, PATELLA, ("flex", "rot", "tilt"), START)
        + FIBULA
        + joints
    )
    surfaces = contact_mesh("femur_cartilage", FEMUR, "femur.stl", 4.0e6) + contact_mesh(
        "patella_button", PATELLA, "button_mm.stl", 5.0e6, scale="0.001 0.001 0.001"
    )
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>\n{head}<OpenSimDocument Version="40000"><Model name="small_knee">\n'
        f'{DEFAULTS}\n<gravity>0 -9.80665 0</gravity>\n<BodySet name="bodyset"><objects>{bodies}</objects></BodySet>\n'
        f'<JointSet name="jointset"><objects>{all_joints}</objects></JointSet>\n'
        f'<ForceSet name="forceset"><objects>{forces}</objects></ForceSet>\n'
        + (
            f'<ContactGeometrySet name="contactgeometryset"><objects>{surfaces}</objects></ContactGeometrySet>\n'
            if meshes
            else ""
        )
        + "</Model></OpenSimDocument>\n"
    )


def as_left(text: str) -> str:
    """A model's text with the knee's bodies named as those of the left side."""
    return re.sub(r"(femur|tibia|patella|shank)_r\b", r"\1_l", text)


def write_knee(folder: Path, text: str | None = None) -> Path:
    """The model beside its meshes; the button's is in millimetres, as the model's scale factors say."""
    folder.mkdir(parents=True, exist_ok=True)
    femur = rig_implant().mesh(deviation=0.1e-3)
    save_mesh(SurfaceMesh(femur.vertices @ OSIM.T, femur.faces), folder / "femur.stl")
    ball = icosphere(BUTTON_RADIUS, 12)
    save_mesh(SurfaceMesh(ball.vertices @ OSIM.T, ball.faces), folder / "button.stl")
    save_mesh(SurfaceMesh(1e3 * ball.vertices @ OSIM.T, ball.faces), folder / "button_mm.stl")
    path = folder / "knee.osim"
    path.write_text(model() if text is None else text)
    return path
