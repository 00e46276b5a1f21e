"""The small knee of `toy_scene_files` with its contact between meshes, as text."""

from __future__ import annotations

from toy_scene_files import SCENE

NO_CONTACT = SCENE[: SCENE.index("[contact]")]
FLORES = '{ type = "flores", contact_stiffness = 2e8, restitution = 0.6 }'
REGION = "{ axis_origin_m = [0, 0, 0], axis_radius_mm = 24.8, angles_deg = [-75, 30], half_width_mm = 20 }"
FEMUR = f'{{ mesh = "femur.stl", units = "m", region = {REGION} }}'
SPHERE = "{ radius_mm = 22 }"
BALL = "{ radius_mm = 22, deviation_mm = 0.1 }"
LAYER = "{ modulus_MPa = 46.3, poisson_ratio = 0.46, thickness_mm = 5 }"


def mesh_contact(method: str, femur: str = FEMUR, button: str = SPHERE, more: str = "") -> str:
    """A scene with a contact law on meshes."""
    table = f'[mesh_contact]\nmethod = "{method}"\nlaw = {FLORES}\nfemur = {femur}\nbutton = {button}\n'
    return f"{NO_CONTACT}{table}{more}"


def foundation(femur: str = FEMUR, button: str = BALL, more: str = "damping_time_s = 0.002") -> str:
    """A scene with elastic layers between meshes."""
    layers = f"femur_layer = {LAYER}\nbutton_layer = {LAYER}\n"
    return f"{NO_CONTACT}[elastic_foundation]\nfemur = {femur}\nbutton = {button}\n{layers}{more}\n"


CONTOURS = mesh_contact("contours", button=BALL)
SCENES = {
    "contours": CONTOURS,
    "volume": mesh_contact("volume", more="effective_radius_mm = 12.5\n"),
    "nearest": mesh_contact("nearest"),
    "foundation": foundation(),
}
