"""Scene files with contact of meshes: what they say about mistakes and about meshes that are no good."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from toy_mesh_scenes import BALL, FEMUR, FLORES, LAYER, NO_CONTACT, REGION, SPHERE, foundation, mesh_contact
from toy_scene_files import changed, load, refused

from pftwin.files.scene_file import load_scene_file
from pftwin.geometry.mesh.icosphere import icosphere
from pftwin.geometry.mesh.mesh import SurfaceMesh, load_mesh, save_mesh
from pftwin.geometry.mesh.topology import adjacent

CONTOURS, NEAREST, VOLUME = mesh_contact("contours", button=BALL), mesh_contact("nearest"), mesh_contact("volume")
MESH = '{ mesh = "ball.stl", units = "mm" }'
LAYERS = foundation()

FIELDS = [
    (CONTOURS, 'method = "contours"', 'method = "contour"', "[mesh_contact] method: found 'contour'; expected: one of"),
    (CONTOURS, 'method = "contours"\n', "", "[mesh_contact] method: is missing; expected: source of the indentation"),
    (CONTOURS, f"law = {FLORES}\n", "", "[mesh_contact] law: is missing; expected: table: the normal force's law"),
    (CONTOURS, "[mesh_contact]", "[mesh_contct]", "[mesh_contct]: unknown field; expected: did you mean mesh_contact"),
    (CONTOURS, f"femur = {FEMUR}\n", "", "[mesh_contact] femur: is missing; expected: table: the femur's mesh"),
    (CONTOURS, f"button = {BALL}\n", "", "[mesh_contact] button: is missing; expected: table: the button"),
    (CONTOURS, BALL, "{}", "[mesh_contact] button.mesh: is missing"),
    (CONTOURS, BALL, "{ radius_mm = 0 }", "button.radius_mm: found 0; expected: a positive number"),
    (CONTOURS, BALL, "{ radius_mm = 22, deviation_mm = -1 }", "button.deviation_mm: found -1"),
    (CONTOURS, BALL, "{ radius_mm = 22, deviation_mm = 1e-9 }", "button.deviation_mm: deviation: more than"),
    (CONTOURS, BALL, "{ radius_mm = 22, tolerance_mm = 1 }", "button.tolerance_mm: unknown field"),
    (CONTOURS, BALL, '{ mesh = "ball.stl" }', "button.units: is missing; expected: unit of the mesh's coordinates"),
    (CONTOURS, BALL, '{ mesh = "ball.stl", units = "inch" }', "button.units: found 'inch'; expected: one of 'm', 'dm'"),
    (CONTOURS, BALL, '{ mesh = "ball.stl", units = "mm", radius_mm = 22 }', "button.radius_mm: unknown field"),
    (CONTOURS, BALL, MESH.replace(" }", ", tolerance_mm = 1 }"), "button.tolerance_mm: there is no sphere to fit"),
    (NEAREST, SPHERE, BALL, "button.deviation_mm: the sphere is exact: it has no triangles; try: leave it out"),
    (
        VOLUME,
        SPHERE,
        MESH.replace(" }", ", center_mm = [0, 0, 0] }"),
        "button.center_mm: the fitted sphere has its own",
    ),
    (
        NEAREST,
        "[mesh_contact]\n",
        "[mesh_contact]\neffective_radius_mm = 9\n",
        'effective_radius_m with method = "near',
    ),
    (NEAREST, '"femur.stl"', '"femurs.stl"', "[mesh_contact] femur.mesh: femurs.stl: no such file"),
    (NEAREST, 'units = "m", ', 'units = "m", facets = "two", ', "femur.facets: found 'two'; expected: one of"),
    (
        NEAREST,
        'units = "m", ',
        'units = "m", facets = "one", ',
        'femur: a region with facets = "one"; expected: one of',
    ),
    (NEAREST, "axis_radius_mm = 24.8, ", "", "femur.region: only one of axis_origin_m and axis_radius_m is given"),
    (NEAREST, "axis_origin_m = [0, 0, 0]", "axis_origin_m = [0, 0.2, 0]", "[mesh_contact] femur.region: "),
    (LAYERS, "modulus_MPa = 46.3", "modulus_MPa = 0", "femur_layer.modulus_MPa: found 0; expected: a positive number"),
    (LAYERS, "poisson_ratio = 0.46", "poisson_ratio = 0.5", "poisson_ratio: found 0.5; expected: a number below 0.5"),
    (
        LAYERS,
        "thickness_mm = 5",
        "thickness_mm = -5",
        "femur_layer.thickness_mm: found -5; expected: a positive number",
    ),
    (LAYERS, f"button_layer = {LAYER}\n", "", "[elastic_foundation] button_layer: is missing"),
    (LAYERS, "damping_time_s = 0.002", "damping_time_s = -1", "damping_time_s: found -1; expected: zero or a positive"),
    (LAYERS, "damping_time_s = 0.002", 'law = "log"', "law: found 'log'; expected: one of 'linear' or 'logarithmic'"),
    (LAYERS, "damping_time_s = 0.002", "modulus_MPa = 9", "[elastic_foundation] modulus_MPa: unknown field"),
]


@pytest.fixture(scope="module")
def meshes(toy: Path) -> Path:
    """Beside the toy's files, meshes with everything that the mesh doctor knows of."""
    save_mesh(icosphere(0.022, 8), toy / "ball.stl", units="mm")
    ball, femur = icosphere(0.022, 6), load_mesh(toy / "femur.stl", units="m")

    def save(name: str, vertices: np.ndarray, faces: np.ndarray) -> None:
        save_mesh(SurfaceMesh(vertices, faces), toy / f"{name}.stl")

    for kind, (v, f) in {"ball": (ball.vertices, ball.faces), "femur": (femur.vertices, femur.faces)}.items():
        some = np.arange(len(f)) % 7 == 0
        save(f"{kind}_mixed", v, np.where(some[:, None], f[:, ::-1], f))
        save(f"{kind}_flipped", v, f[:, ::-1])
        save(f"{kind}_doubled", v, np.concatenate([f, f[:5]]))
        save(f"{kind}_two_faced", v, np.concatenate([f, f[:5, ::-1]]))
        apex = len(v)
        one, other = (pair[0] for pair in adjacent(f)[:2])
        edge = np.intersect1d(f[one], f[other])
        fin = np.concatenate([f, [[*edge, apex]]])
        save(f"{kind}_fin", np.concatenate([v, 1.2 * v[edge].mean(axis=0, keepdims=True)]), fin)
        flat = [[f[0, 0], f[0, 1], f[0, 1]]]
        save(f"{kind}_sliver", v, np.concatenate([f, flat]))
        save(
            f"{kind}_debris",
            np.concatenate([v, 1e-3 * ball.vertices / 0.022]),
            np.concatenate([f, ball.faces + len(v)]),
        )
    save("ball_hole", ball.vertices, ball.faces[1:])
    (toy / "cut.stl").write_bytes((toy / "ball.stl").read_bytes()[:-70])
    (toy / "nothing.stl").write_bytes(b"")
    (toy / "words.obj").write_text("these are no vertices\n")
    save("plate", 0.03 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))
    return toy


@pytest.mark.parametrize(("text", "old", "new", "message"), FIELDS, ids=[m[3][:50] for m in FIELDS])
def test_a_mistake_is_named_with_file_table_and_field(
    meshes: Path, text: str, old: str, new: str, message: str
) -> None:
    assert message in refused(meshes, changed(old, new, text))


DOCTOR = [
    ("mixed", "triangles face the other side than their neighbours; try: repair = true"),
    ("doubled", "duplicate: 5 triangles are there more than once; contact would count them twice; try: repair = true"),
    ("two_faced", "triangles lie on their own reverse: a sheet without thickness has no outside"),
    ("fin", "non manifold edge: 1 edges border more than two triangles"),
]


def femur_of(name: str, more: str = "") -> str:
    return FEMUR.replace('"femur.stl"', f'"{name}.stl"').replace('units = "m"', f'units = "m"{more}')


def button_of(name: str, more: str = "") -> str:
    return f'{{ mesh = "{name}.stl", units = "m"{more} }}'


@pytest.mark.parametrize(("kind", "message"), DOCTOR, ids=[d[0] for d in DOCTOR])
def test_what_the_mesh_doctor_refuses_the_scene_refuses(meshes: Path, kind: str, message: str) -> None:
    on_femur = refused(meshes, mesh_contact("nearest", femur=femur_of(f"femur_{kind}")))
    assert f"[mesh_contact] femur.mesh: femur_{kind}.stl: " in on_femur
    assert message in on_femur
    on_button = refused(meshes, foundation(button=button_of(f"ball_{kind}")))
    assert f"[elastic_foundation] button.mesh: ball_{kind}.stl: " in on_button
    assert message in on_button


@pytest.mark.parametrize("kind", ["mixed", "doubled"])
def test_what_can_be_repaired_is_on_request_and_said(meshes: Path, kind: str) -> None:
    text = foundation(femur_of(f"femur_{kind}", ", repair = true"), button_of(f"ball_{kind}", ", repair = true"))
    (meshes / "repaired.toml").write_text(text)
    loaded = load_scene_file(meshes / "repaired.toml")
    assert sum("repaired: " in note for note in loaded.notes) == 2
    whole = load(meshes, foundation(button=button_of("ball_sliver")))
    middles = []
    for scene in (loaded.scene, whole):
        button = scene.effect("elastic_foundation").button  # type: ignore[attr-defined]
        corners = np.asarray(button.corners).swapaxes(1, 2)[np.asarray(button.index) >= 0].reshape(-1, 3, 3)
        middles.append(np.sort(corners.mean(axis=1) @ [1.0, 2.0, 3.0]))
    np.testing.assert_allclose(*middles, atol=1e-7)


def test_an_inside_out_button_is_refused(meshes: Path) -> None:
    message = refused(meshes, foundation(button=button_of("ball_flipped")))
    assert (
        "button.mesh: ball_flipped.stl: flipped: a closed part of 720 triangles is inside out; try: repair" in message
    )
    load(meshes, foundation(button=button_of("ball_flipped", ", repair = true")))


def test_an_open_femur_that_looks_inward_is_refused(meshes: Path) -> None:
    message = refused(meshes, mesh_contact("nearest", femur=femur_of("femur_flipped")))
    assert (
        "[mesh_contact] femur.region: femur_flipped.stl: the normals of the foremost vertices point backward" in message
    )
    assert "flip = true" in message
    load(meshes, mesh_contact("nearest", femur=femur_of("femur_flipped", ", flip = true")))


def test_without_a_groove_the_start_tells_that_a_femur_looks_inward(meshes: Path) -> None:
    femur = '{ mesh = "femur_flipped.stl", units = "m", facets = "one" }'
    message = refused(meshes, mesh_contact("nearest", femur=femur))
    assert "[mesh_contact]: at the first frame" in message
    assert "of the button are inside the femur" in message
    assert "flip = true" in message


@pytest.mark.parametrize(
    ("kind", "note"),
    [("sliver", None), ("debris", "parts with"), ("hole", "1 holes, ")],
)
def test_what_does_no_harm_is_said_and_used(meshes: Path, kind: str, note: str | None) -> None:
    (meshes / "odd.toml").write_text(foundation(button=button_of(f"ball_{kind}")))
    loaded = load_scene_file(meshes / "odd.toml")
    said = [n for n in loaded.notes if f"ball_{kind}.stl" in n]
    assert len(said) == (note is not None) or note is None
    assert note is None or note in said[0]


@pytest.mark.parametrize("table", ["mesh_contact", "elastic_foundation"])
def test_units_that_cannot_be_are_named_with_those_that_can(meshes: Path, table: str) -> None:
    make = foundation if table == "elastic_foundation" else lambda f, b: mesh_contact("contours", f, b)
    message = refused(meshes, make(FEMUR.replace('units = "m"', 'units = "mm"'), BALL))
    assert f"[{table}] femur.mesh: femur.stl: a longest side of 0.064 mm is implausible" in message
    assert "try: units='m'" in message
    message = refused(meshes, make(FEMUR, MESH.replace('"mm"', '"m"')))  # the femur's is right, the button's is not
    assert f"[{table}] button.mesh: ball.stl: a longest side of 44 m = 4.4e+04 mm is implausible" in message
    assert "try: units='mm'" in message


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("cut.stl", "cut.stl: a truncated or damaged binary STL"),
        ("nothing.stl", "nothing.stl: the file is empty"),
        ("poses.csv", "poses.csv: unknown mesh format .csv"),
        ("words.obj", "words.obj: "),
        ("lost.ply", "lost.ply: no such file"),
    ],
)
def test_a_file_that_is_no_mesh(meshes: Path, name: str, message: str) -> None:
    assert f"button.mesh: {message}" in refused(meshes, foundation(button=f'{{ mesh = "{name}", units = "m" }}'))


ALL = [("contours", BALL), ("volume", SPHERE), ("nearest", SPHERE), ("foundation", BALL)]


def scene_at(method: str, button: str, position_mm: tuple[float, float, float], femur: str = FEMUR) -> str:
    """The patella starts somewhere else."""
    text = foundation(femur, button) if method == "foundation" else mesh_contact(method, femur, button, _RADIUS[method])
    return changed("position_m = [-0.005, 0.001, 0.05]", f"position_mm = {list(position_mm)}", text)


_RADIUS = {"contours": "", "nearest": "", "volume": "effective_radius_mm = 12.5\n"}


@pytest.mark.parametrize(("method", "button"), ALL, ids=[m for m, _ in ALL])
def test_a_button_that_starts_inside_the_bone_is_refused(meshes: Path, method: str, button: str) -> None:
    message = refused(meshes, scene_at(method, button, (-5, 1, 20)))
    assert "at the first frame" in message
    assert "of the button are inside the femur; expected: a start at which they hardly touch; try: check" in message


@pytest.mark.parametrize(("method", "button"), ALL, ids=[m for m, _ in ALL])
def test_a_button_wholly_inside_a_closed_bone_is_refused(meshes: Path, method: str, button: str) -> None:
    save_mesh(icosphere(0.08, 10), meshes / "bone.stl")
    femur = '{ mesh = "bone.stl", units = "m", facets = "one" }'
    message = refused(meshes, scene_at(method, button, (5, 0, 10), femur))
    assert "at the first frame 100% of the button are inside the femur" in message


@pytest.mark.parametrize(("method", "button"), ALL, ids=[m for m, _ in ALL])
def test_a_button_that_starts_a_knees_width_away_is_refused(meshes: Path, method: str, button: str) -> None:
    message = refused(meshes, scene_at(method, button, (-5, 1, 350)))
    assert "mm apart; expected: less than 200 mm; try: check [patella] start" in message


def test_a_start_that_is_deep_is_said(meshes: Path) -> None:
    save_mesh(icosphere(0.04, 10), meshes / "bone.stl")
    femur = '{ mesh = "bone.stl", units = "m", facets = "one" }'
    for height, deep in ((54, True), (61, False), (75, False)):  # 8 mm deep, 1 mm deep, apart
        (meshes / "deep.toml").write_text(scene_at("nearest", SPHERE, (0, 0, height), femur))
        said = [n for n in load_scene_file(meshes / "deep.toml").notes if "mm deep in the femur" in n]
        assert len(said) == deep


def test_a_side_without_triangles_is_refused(meshes: Path) -> None:
    """The groove line runs beside the mesh."""
    region = REGION.replace("axis_origin_m = [0, 0, 0]", "axis_origin_m = [0, 0.019, 0]")
    text = mesh_contact("nearest", femur=FEMUR.replace(REGION, region))
    assert "[mesh_contact] femur" in refused(meshes, text.replace("half_width_mm = 20", "half_width_mm = 1"))


def test_two_contacts_of_one_name_are_refused(meshes: Path) -> None:
    one = mesh_contact("nearest", more='name = "button"\n')
    two = foundation(more='name = "button"').removeprefix(NO_CONTACT)
    assert "two effects are named 'button'" in refused(meshes, one + two)


def test_a_patch_cannot_be_asked_for_on_meshes(meshes: Path) -> None:
    for text in (NEAREST, LAYERS):
        (meshes / "named.toml").write_text(text)
        with pytest.raises(ValueError, match="P4 was requested, but this contact is of meshes"):
            load_scene_file(meshes / "named.toml", contact="P4")
