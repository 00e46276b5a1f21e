"""Scene files with contact of meshes: what they build, from which files, and what that does."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from toy_mesh_scenes import BALL, FEMUR, NO_CONTACT, SCENES, SPHERE, foundation, mesh_contact
from toy_scene_files import LIGHT, SCENE, changed, load, same, write_toy
from typer.testing import CliRunner

import pftwin
from pftwin.base import cache_folder
from pftwin.cli.program import app
from pftwin.files.scene_file import load_scene_file
from pftwin.geometry.mesh.icosphere import icosphere
from pftwin.geometry.mesh.mesh import SurfaceMesh, load_mesh, save_mesh
from pftwin.geometry.patch.spline import SplinePatch
from pftwin.model.effects.contact_law import Flores
from pftwin.model.effects.elastic_foundation import ElasticFoundation
from pftwin.model.effects.foundation_law import LinearFoundation, LogarithmicFoundation
from pftwin.model.effects.mesh_contact import MeshContact
from pftwin.model.effects.mesh_sphere_contact import MeshSphereContact
from pftwin.model.effects.mesh_volume_contact import MeshVolumeContact
from pftwin.model.scene import Scene

COARSE = BALL.replace("0.1", "0.3")


def the(scene: Scene):
    return scene.effects[-1]


def corners(rows, index=None) -> np.ndarray:
    """Triangles' corners in an order that does not depend on how a tree puts them."""
    rows = np.asarray(rows).reshape(-1, 3, 3)
    rows = rows if index is None else rows[np.asarray(index).ravel() >= 0]
    return rows[np.lexsort(np.round(rows.mean(axis=1) / 1e-7).T)].mean(axis=1)


def test_contours_of_two_meshes(toy: Path) -> None:
    effect = the(load(toy, SCENES["contours"]))
    assert isinstance(effect, MeshContact)
    assert effect.name == "mesh_contact"
    assert (effect.femur.facets, effect.patella.facets) == (2, 1)
    assert isinstance(effect.law, Flores)
    assert float(effect.law.restitution) == 0.6
    assert effect.surface is None
    np.testing.assert_array_equal(effect.origin.array(), 0)
    radii = np.linalg.norm(np.asarray(effect.patella.tree.triangles).reshape(-1, 3), axis=1)
    np.testing.assert_allclose(radii, 0.022, rtol=1e-12)


def test_the_nearest_points_to_a_sphere(toy: Path) -> None:
    text = changed(SPHERE, "{ radius_mm = 21, center_mm = [1, 2, 3] }", SCENES["nearest"])
    effect = the(load(toy, changed("[mesh_contact]", '[mesh_contact]\nname = "button"', text)))
    assert isinstance(effect, MeshSphereContact)
    assert effect.name == "button"
    assert effect.facets.count == 2
    assert float(effect.radius) == 0.021
    np.testing.assert_allclose(effect.center.array(), [0.001, 0.002, 0.003])


def test_the_volume_of_a_sphere_in_a_mesh(toy: Path) -> None:
    effect = the(load(toy, SCENES["volume"]))
    assert isinstance(effect, MeshVolumeContact)
    assert float(effect.effective_radius) == 0.0125
    measured = the(load(toy, mesh_contact("volume")))
    assert 0.005 < float(measured.effective_radius) < 0.022  # the groove's sides are convex, its bottom concave


def lateral_triangles(effect: ElasticFoundation) -> int:
    """Number of the femur's triangles on the lateral side of the facets' border."""
    femur = effect.femur.exact
    assert femur.border is not None
    first = np.unique(femur.triangle, return_index=True)[1]  # places also hold copies
    return int(np.count_nonzero(np.asarray(femur.border)[first].sum(axis=1) > 0))


def test_layers_between_meshes(toy: Path) -> None:
    effect = the(load(toy, foundation(more='law = "logarithmic"\ndamping_time_s = 0.003\n')))
    assert isinstance(effect, ElasticFoundation)
    assert isinstance(effect.law, LogarithmicFoundation)
    assert isinstance(the(load(toy, SCENES["foundation"])).law, LinearFoundation)
    assert float(effect.damping_time) == 0.003
    layer = effect.law.femur
    assert (float(layer.modulus), float(layer.poisson), float(layer.thickness)) == (46.3e6, 0.46, 0.005)
    assert 0.2 < lateral_triangles(effect) / (effect.femur.triangle.max() + 1) < 0.8


def test_a_surface_without_a_groove_is_one_facet(toy: Path) -> None:
    one = '{ mesh = "femur.stl", units = "m", facets = "one" }'
    assert the(load(toy, mesh_contact("contours", one, COARSE))).femur.facets == 1
    assert the(load(toy, mesh_contact("nearest", one))).facets.count == 1
    assert the(load(toy, foundation(one, COARSE))).femur.border is None


def test_a_buttons_mesh_anywhere_in_any_unit_is_the_same_button(toy: Path) -> None:
    ball = icosphere(0.022, 9)
    save_mesh(ball, toy / "here.ply")
    turn, place = Rotation.from_quat([0.5, -0.5, 0.5, 0.5], scalar_first=True), np.array([0.01, -0.02, 0.03])
    away = SurfaceMesh(turn.inv().apply(ball.vertices - place), ball.faces)
    save_mesh(away, toy / "away.ply", units="mm")
    pose = "{ position_mm = [10, -20, 30], quaternion_wxyz = [0.5, -0.5, 0.5, 0.5] }"
    here = the(load(toy, foundation(button='{ mesh = "here.ply", units = "m" }')))
    there = '{ mesh = "away.ply", units = "mm", center_mm = [0, 0, 0], mesh_pose = POSE }'.replace("POSE", pose)
    other = the(load(toy, foundation(button=there)))
    np.testing.assert_array_equal(other.origin.array(), 0)
    one, two = (corners(e.button.corners.swapaxes(1, 2), e.button.index) for e in (here, other))
    np.testing.assert_allclose(one, two, atol=1e-7)
    without = the(load(toy, foundation(button=there.replace("center_mm = [0, 0, 0], ", ""))))
    np.testing.assert_allclose(without.origin.array(), place)  # the mesh frame's own origin
    two = corners(without.button.corners.swapaxes(1, 2), without.button.index)
    np.testing.assert_allclose(one.mean(axis=0), two.mean(axis=0) + place, atol=1e-7)


def test_a_sphere_is_fitted_to_a_buttons_mesh_where_a_method_takes_spheres(toy: Path) -> None:
    ball = icosphere(0.022, 24)
    save_mesh(SurfaceMesh(ball.vertices + np.array([0.001, 0.002, 0.003]), ball.faces), toy / "fine.stl", units="mm")
    (toy / "fitted.toml").write_text(mesh_contact("nearest", button='{ mesh = "fine.stl", units = "mm" }'))
    loaded = load_scene_file(toy / "fitted.toml")
    effect = the(loaded.scene)
    assert float(effect.radius) == pytest.approx(0.022, abs=2e-6)
    np.testing.assert_allclose(effect.center.array(), [0.001, 0.002, 0.003], atol=2e-6)
    assert any("fine.stl: sphere of radius 2" in note for note in loaded.notes)
    assert loaded.button is not None
    np.testing.assert_allclose(loaded.button.center, effect.center.array())


def test_a_femurs_mesh_in_its_own_frame_is_the_same_femur(toy: Path) -> None:
    mesh = load_mesh(toy / "femur.stl", units="m")
    turn, place = Rotation.from_euler("xyz", [0.1, -0.2, 0.3]), np.array([0.003, 0.002, -0.001])
    save_mesh(SurfaceMesh(turn.inv().apply(mesh.vertices - place), mesh.faces), toy / "own.ply", units="mm")
    q = turn.as_quat(scalar_first=True).tolist()
    pose = f"{{ position_m = {place.tolist()}, quaternion_wxyz = {q} }}"
    # the region's axis is in the mesh's own frame
    axis, (front, up) = turn.inv().apply(-place), (turn.inv().apply(e) for e in ([0, 0, 1], [1, 0, 0]))
    region = f"axis_origin_m = {axis.tolist()}, axis_radius_mm = 24.8, anterior = {front.tolist()}"
    region += f", proximal = {up.tolist()}, angles_deg = [-75, 30], half_width_mm = 20"
    text = foundation(f'{{ mesh = "own.ply", units = "mm", mesh_pose = {pose}, region = {{ {region} }} }}')
    own, plain = the(load(toy, text)), the(load(toy, SCENES["foundation"]))
    one, two = (
        corners(np.asarray(e.femur.corners)[np.unique(e.femur.triangle, return_index=True)[1]]) for e in (own, plain)
    )
    np.testing.assert_allclose(one, two, atol=2e-7)
    assert abs(lateral_triangles(own) - lateral_triangles(plain)) <= 2  # of triangles on the groove line


def test_a_left_knee_is_the_mirror_image(toy: Path) -> None:
    left = NO_CONTACT.replace('name = "toy"', 'name = "toy"\nside = "left"\n[axes]\nworld_medial_lateral = "y"')
    for name in ("femur", "ball"):
        mesh = load_mesh(toy / "femur.stl", units="m") if name == "femur" else icosphere(0.022, 9)
        vertices = mesh.vertices + (0 if name == "femur" else np.array([0, 0.003, 0]))
        save_mesh(SurfaceMesh(vertices, mesh.faces), toy / f"right_{name}.ply")
        save_mesh(SurfaceMesh(vertices * [1, -1, 1], mesh.faces[:, ::-1].copy()), toy / f"left_{name}.ply")
    made = []
    for side, head in (("right", NO_CONTACT), ("left", left)):
        femur = FEMUR.replace("femur.stl", f"{side}_femur.ply")
        text = foundation(femur, f'{{ mesh = "{side}_ball.ply", units = "m" }}').replace(NO_CONTACT, head)
        made.append(the(load(toy, text)))
    one, two = made
    np.testing.assert_allclose(
        corners(one.button.corners.swapaxes(1, 2), one.button.index),
        corners(two.button.corners.swapaxes(1, 2), two.button.index),
        atol=1e-9,
    )
    normals = [np.asarray(e.femur.outward)[np.asarray(e.femur.triangle)[:50] * 7] for e in made]
    places = [np.asarray(e.femur.corners)[:50].reshape(-1, 3, 3) for e in made]
    for n, p in zip(normals, places, strict=True):  # out is still out
        area = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        assert (np.einsum("ij,ij->i", n, area) > 0).all()
    assert lateral_triangles(one) == lateral_triangles(two)


def test_a_turn_of_the_buttons_mesh_is_mirrored_for_a_left_knee(toy: Path) -> None:
    """In the mirror of a sagittal plane a rotation about an axis in it turns the other way, one about y does not."""
    save_mesh(icosphere(0.022, 9), toy / "ball_to_turn.ply")
    text = foundation(button='{ mesh = "ball_to_turn.ply", units = "m" }')
    head = NO_CONTACT.replace('name = "toy"', 'name = "toy"\nside = "left"\n[axes]\nworld_medial_lateral = "y"')
    right = the(load(toy, text + "\nbutton_turn_deg = [1, 2, 3]\n"))
    left = the(load(toy, text.replace(NO_CONTACT, head) + "\nbutton_turn_deg = [1, 2, 3]\n"))
    np.testing.assert_allclose(np.degrees(right.turn.array()), [1, 2, 3], rtol=1e-12)
    np.testing.assert_allclose(np.degrees(left.turn.array()), [-1, 2, -3], rtol=1e-12)
    assert the(load(toy, text)).turn is None


def test_a_smooth_surface_tells_results_where_the_groove_is(toy: Path) -> None:
    stand_in = SCENE[SCENE.index("mesh = ") :].replace('degree = "P5"', 'kind = "spline"')
    for table, text in (("mesh_contact", SCENES["nearest"]), ("elastic_foundation", SCENES["foundation"])):
        scene = load(toy, f"{text}\n[{table}.surface]\n{stand_in}")
        assert isinstance(scene.surface, SplinePatch)
        assert scene.contact is the(scene)


def test_cached_scenes_are_read_anew_if_a_mesh_has_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pftwin, "imported_at", np.inf)  # whoever edits the source while this runs
    before = cache_folder.chosen()
    cache_folder.use_cache_folder(tmp_path / "kept")
    written: list[str] = []
    write = cache_folder.write
    monkeypatch.setattr(cache_folder, "write", lambda kind, key, body: written.append(key) or write(kind, key, body))
    try:
        write_toy(tmp_path)
        save_mesh(icosphere(0.022, 9), tmp_path / "ball.stl", units="mm")
        path = tmp_path / "meshes.toml"
        path.write_text(foundation(button='{ mesh = "ball.stl", units = "mm" }'))
        first = load_scene_file(path).scene
        count = len(written)
        assert count
        same(load_scene_file(path).scene, first)
        assert len(written) == count
        for name, other in (("ball.stl", icosphere(0.021, 9)), ("femur.stl", None)):
            mesh = load_mesh(tmp_path / name, units="mm" if name == "ball.stl" else "m")
            changed_mesh = other or SurfaceMesh(mesh.vertices * [1, 1, 0.999], mesh.faces)
            save_mesh(changed_mesh, tmp_path / name, units="mm" if name == "ball.stl" else "m")
            again = load_scene_file(path).scene
            pairs = zip(jax.tree.leaves(first), jax.tree.leaves(again), strict=True)
            assert any(a.shape != b.shape or not np.array_equal(a, b) for a, b in pairs)
            first = again
    finally:
        cache_folder.use_cache_folder(before)


def test_a_scene_without_meshes_imports_nothing_of_them(toy: Path) -> None:
    (toy / "light.toml").write_text(LIGHT)
    code = (
        "import sys, pftwin\n"
        f"pftwin.simulate, pftwin.load_scene({str(toy / 'light.toml')!r})\n"
        "surfaces = ('bvh', 'mesh.checked', 'mesh.doctor')\n"
        "surfaces += ('contact.contact_mesh', 'contact.contour', 'contact.depth', 'contact.patch_mesh')\n"
        "effects = ('mesh', 'elastic_foundation', 'foundation_law', 'foundation_sums')\n"
        "odd = [f'pftwin.geometry.{m}' for m in surfaces]\n"
        "odd += [f'pftwin.model.effects.{m}' for m in effects] + ['trimesh']\n"
        "print(sorted(m for m in sys.modules if m.startswith(tuple(odd))))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout.strip() == "[]"


def test_the_documented_example_loads(tmp_path: Path) -> None:
    """Every table that the page shows, on the toy's files."""
    page = (Path(__file__).parents[3] / "docs" / "mesh_contact.md").read_text()
    section = page[page.index("## In a scene file") : page.index("## Contact at recorded poses")]
    blocks = [b.split("```")[0] for b in section.split("```toml\n")[1:]]
    assert len(blocks) >= 3
    write_toy(tmp_path)
    save_mesh(load_mesh(tmp_path / "femur.stl", units="m"), tmp_path / "femur.stl", units="mm")
    save_mesh(icosphere(0.022, 16), tmp_path / "button.stl", units="mm")
    for number, block in enumerate(blocks):
        text = block if "schema = 1" in block else f"{NO_CONTACT}{block}"
        assert the(load(tmp_path, text, f"page{number}.toml")).name in ("mesh_contact", "elastic_foundation")


COMMANDS = {
    "nearest": SCENES["nearest"],
    "contours": mesh_contact("contours", button=COARSE),
    "volume": SCENES["volume"],
    "foundation": foundation(more="damping_time_s = 0.002\n"),
}
SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in COMMANDS if name != "nearest"]


@pytest.mark.parametrize("name", ["nearest", *SLOW])
@pytest.mark.slow
def test_the_command_line_simulates_and_balances(toy: Path, tmp_path: Path, name: str) -> None:
    scene = tmp_path / "scene.toml"
    text = changed('poses = "poses.csv"', 'poses = "poses.csv"\nend_time_s = 0.1', COMMANDS[name])
    scene.write_text(text.replace('"poses.csv"', f'"{toy}/poses.csv"').replace('"femur.stl"', f'"{toy}/femur.stl"'))
    rest = CliRunner().invoke(app, ["--allow-outside", "equilibrium", str(scene), "--json", "-"])
    assert rest.exit_code == 0, rest.output
    report = json.loads(rest.stdout)
    assert report["converged"]
    assert report["status"] == "ok"
    contact = report["effects"]["elastic_foundation" if name == "foundation" else "mesh_contact"]
    assert contact["force"] > 1
    command = ["--allow-outside", "simulate", str(scene), "-o", str(tmp_path / "out.nc"), "--json", "-"]
    run = CliRunner().invoke(app, command)
    assert run.exit_code == 0, run.output
    facts = json.loads(run.stdout)
    assert facts["status"] == "ok"
    assert facts["contact"] == name
    assert 0 < facts["largest_indentation_m"] < 1e-3
