"""What is exported, read back by others: OpenSim's own package, glTF readers, and parsers written for these tests."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from knee_models import model
from opensim_process import TABLE, ask
from opensim_process import poses as opensim_poses
from other_readers import Glb, read_table
from scipy.spatial.transform import Rotation
from small_scene import small_result
from typer.testing import CliRunner

from pftwin.cli import app
from pftwin.errors import InputError, OutputError, PftwinWarning
from pftwin.interchange import export
from pftwin.interchange.moving_parts import rod
from pftwin.result_files import load_dataset
from pftwin.surfaces.icosphere import icosphere

LABELS = [
    "time",
    *(f"knee_{k}_r" for k in ("flex", "add", "rot", "tx", "ty", "tz")),
    *(f"pf_{k}_r" for k in ("flex", "rot", "tilt", "tx", "ty", "tz")),
]
OSIM = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # x anterior, y proximal, z lateral


@pytest.fixture(scope="module")
def result():
    return small_result()


@pytest.fixture(scope="module")
def file(result, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("result") / "knee.nc"
    result.save(path)
    return path


@pytest.fixture(scope="module")
def mot(file) -> Path:
    export(file, file.with_suffix(".mot"))
    return file.with_suffix(".mot")


@pytest.fixture(scope="module")
def glb(file) -> Path:
    export(file, file.with_suffix(".glb"))
    return file.with_suffix(".glb")


def poses_in(result, body: str, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Turn and place in OpenSim's axes."""
    position, quaternion = (result.position, result.quaternion) if body == "patella" else result.tibia
    turn = Rotation.from_quat(quaternion[k], scalar_first=True).as_matrix()
    return OSIM @ turn @ OSIM.T, OSIM @ position[k]


def about(axis: int, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    a, b = (axis + 1) % 3, (axis + 2) % 3
    out = np.eye(3)
    out[a, a], out[b, b], out[a, b], out[b, a] = c, c, -s, s
    return out


def test_mot_says_what_it_holds(result, mot):
    header, labels, rows = read_table(mot)
    assert header == {"version": "1", "nRows": str(result.times.size), "nColumns": "13", "inDegrees": "yes"}
    assert mot.read_text().startswith("Coordinates\n")
    assert labels == LABELS
    assert rows.shape == (result.times.size, 13)
    np.testing.assert_allclose(rows[:, 0], result.times, atol=1e-12)


def test_mot_gives_the_poses_back(result, mot):
    """By three turns about z, x and y of OpenSim's axes, flexion backwards, and places along the femur's."""
    _, labels, rows = read_table(mot)
    for body, joint, second, third in (("tibia", "knee", "add", "rot"), ("patella", "pf", "rot", "tilt")):
        columns = [rows[:, labels.index(f"{joint}_{k}_r")] for k in ("flex", second, third, "tx", "ty", "tz")]
        for k in (0, 7, -1):
            flex, b, c = (np.radians(v[k]) for v in columns[:3])
            turn, place = poses_in(result, body, k)
            np.testing.assert_allclose(about(2, -flex) @ about(0, b) @ about(1, c), turn, atol=1e-10)
            np.testing.assert_allclose([v[k] for v in columns[3:]], place, atol=1e-12)


def test_mot_angles_are_the_results_own(result, mot):
    _, labels, rows = read_table(mot)
    flexion = rows[:, labels.index("knee_flex_r")]
    np.testing.assert_allclose(flexion, np.degrees(result.knee.flexion), atol=0.5)  # other sequence, same knee
    assert flexion.max() > 1


def test_opensim_reads_mot_and_sto(result, mot, file):
    table = ask(TABLE, mot)
    assert table["degrees"]
    assert table["rows"] == result.times.size
    assert ["time", *table["columns"]] == LABELS
    export(file, file.with_suffix(".sto"))
    everything = ask(TABLE, file.with_suffix(".sto"))
    assert everything["rows"] == result.times.size
    np.testing.assert_allclose(everything["columns"]["knee_flexion"], np.degrees(result.knee.flexion), atol=1e-9)


def test_opensims_bodies_move_as_the_results_do(result, mot, tmp_path):
    """A model with the joints of OpenSim JAM, posed by the file."""
    (tmp_path / "knee.osim").write_text(model(forces="", meshes=False))
    _, labels, rows = read_table(mot)
    chosen = (0, 11, result.times.size - 1)
    values = [
        {n: float(v if n[:-3].endswith("_t") else np.radians(v)) for n, v in zip(labels[1:], rows[k, 1:], strict=True)}
        for k in chosen
    ]
    found = opensim_poses(tmp_path / "knee.osim", values, ("femur_r", "tibia_r", "patella_r"))
    for k, at in zip(chosen, found, strict=True):
        femur, place = (np.array(v) for v in at["femur_r"])
        for body in ("tibia", "patella"):
            turn, origin = (np.array(v) for v in at[f"{body}_r"])
            expected = poses_in(result, body, k)
            np.testing.assert_allclose(femur.T @ turn, expected[0], atol=1e-9)
            np.testing.assert_allclose(femur.T @ (origin - place), expected[1], atol=1e-9)


def test_glb_nodes_have_the_results_poses(result, glb):
    """At every frame, to single precision; time begins at nought."""
    read = Glb(glb)
    for body, (position, quaternion) in (("patella", (result.position, result.quaternion)), ("tibia", result.tibia)):
        tracks = read.tracks(body)
        np.testing.assert_allclose(tracks["times"], result.times - result.times[0], atol=1e-6)
        np.testing.assert_allclose(tracks["translation"], position, atol=1e-8)
        np.testing.assert_allclose(tracks["rotation"][:, [3, 0, 1, 2]], quaternion, atol=1e-7)
        first = read.node(body)
        assert "matrix" not in first
        np.testing.assert_allclose(first["translation"], position[0], atol=1e-8)
    for k in (0, 5, -1):
        np.testing.assert_allclose(read.matrix("patella", k)[:3, 3], result.position[k], atol=1e-8)


def test_glb_stands_upright(glb):
    """glTF's y is up and z to the front: proximal and anterior; a right knee's lateral is the viewer's left."""
    upright = np.array(Glb(glb).node("femur")["matrix"]).reshape(4, 4).T
    np.testing.assert_array_equal(upright[:3, :3] @ np.eye(3), [[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    assert np.linalg.det(upright) == 1


def test_glb_tendons_reach_from_end_to_end(result, glb):
    """The ends of a rod are the insertion on the moving patella and the origin on the moving tibia."""
    read, geometry = Glb(glb), result.geometry()
    insertion, origin = (geometry[f"patellar_tendon_{k}"].values[0] for k in ("insertion", "origin"))
    for k in (0, 9, -1):
        rod_now = read.matrix("patellar tendon", k)
        for end, point, body in ((0.5, insertion, "patella"), (-0.5, origin, "tibia")):
            expected = read.matrix(body, k) @ [*point, 1.0]
            np.testing.assert_allclose(rod_now @ [0, 0, end, 1.0], expected, atol=2e-7)
        length = np.linalg.norm(rod_now[:3, 2])
        assert length == pytest.approx(result.effects["patellar_tendon"]["length"][k], abs=1e-6)


def test_glb_has_the_meshes_of_a_contact_of_meshes(result, tmp_path):
    """As they are, however fine; of the button the part behind the patella's middle, on the patella."""
    from xarray import Dataset

    lines = {n: v for n, v in result.geometry().data_vars.items() if n.endswith(("_insertion", "_origin"))}
    ball = icosphere(0.02, 40)  # 32,000 triangles: above what a drawing is thinned from
    meshes = {
        f"{name}_{kind}": ((f"{name}_{kind}", last), values)
        for name in ("femur", "button")
        for kind, last, values in (("vertices", "axis", ball.vertices), ("triangles", "corner", ball.faces))
    }
    source = SimpleNamespace(
        scene_name="meshes", to_dataset=result.to_dataset, geometry=lambda: Dataset({**lines, **meshes})
    )
    export(source, tmp_path / "a.glb")
    read = Glb(tmp_path / "a.glb")

    def triangles(node: str) -> int:
        (primitive,) = read.tree["meshes"][read.node(node)["mesh"]]["primitives"]
        return read.rows(primitive["indices"]).size // 3

    assert triangles("femoral mesh") == len(ball.faces) > 30_000
    assert 0.2 < triangles("button") / len(ball.faces) < 0.9
    assert read.tree["nodes"].index(read.node("button")) in read.node("patella")["children"]


def test_glb_says_what_is_schematic_and_has_the_button_on_the_patella(glb):
    read = Glb(glb)
    names = {n.get("name") for n in read.tree["nodes"]}
    assert {"femoral surface", "button", "patella (schematic)", "tibia (schematic)", "quadriceps"} <= names
    children = [read.tree["nodes"][k]["name"] for k in read.node("patella")["children"]]
    assert sorted(children) == ["button", "patella (schematic)"]


def test_another_library_reads_the_glb(result, glb):
    gltf = pytest.importorskip("pygltflib", reason="pygltflib is not installed: pip install pygltflib")
    read = gltf.GLTF2().load(str(glb))
    (animation,) = read.animations
    node = next(k for k, n in enumerate(read.nodes) if n.name == "patella")
    channel = next(c for c in animation.channels if c.target.node == node and c.target.path == "translation")
    accessor = read.accessors[animation.samplers[channel.sampler].output]
    view = read.bufferViews[accessor.bufferView]
    blob = read.binary_blob()[view.byteOffset : view.byteOffset + view.byteLength]
    np.testing.assert_allclose(np.frombuffer(blob, "<f4").reshape(-1, 3), result.position, atol=1e-8)


def test_trimesh_sees_the_first_frame(result, glb):
    import trimesh

    scene = trimesh.load(glb)
    found, _ = scene.graph.get("patella", "femur")
    turn = Rotation.from_quat(result.quaternion[0], scalar_first=True).as_matrix()
    np.testing.assert_allclose(found[:3, :3], turn, atol=1e-6)
    assert not scene.is_empty


def test_a_rod_that_points_backwards_is_whole():
    """From z to its opposite there is no shortest way: any will do, but none may be NaN."""
    ends = np.array([[0, 0, 0.1], [0, 0, -0.1], [0, 1e-9, -0.1], [0, 0.1, 0]])
    track = rod(np.zeros((4, 3)), ends, 1e-3)
    turned = Rotation.from_quat(track.rotation, scalar_first=True).apply([0, 0, 0.1])
    np.testing.assert_allclose(turned, ends, atol=1e-8)


def test_frames_that_are_not_finite_are_left_out(result, tmp_path):
    position = result.position.copy()
    position[-3:] = np.nan
    broken = dataclasses.replace(result, position=position)
    with pytest.warns(PftwinWarning, match="3 of .* frames are not finite"):
        export(broken, tmp_path / "a.mot")
    assert len(read_table(tmp_path / "a.mot")[2]) == result.times.size - 3
    export(broken, tmp_path / "a.glb")
    assert len(Glb(tmp_path / "a.glb").tracks("patella")["times"]) == result.times.size - 3
    with pytest.raises(InputError, match="no frame with a finite pose"):
        export(dataclasses.replace(result, position=result.position * np.nan), tmp_path / "b.mot")


def test_the_command(file, tmp_path):
    outputs = [tmp_path / f"knee.{kind}" for kind in ("mot", "sto", "glb", "csv")]
    options = [part for path in outputs for part in ("-o", str(path))]
    done = CliRunner().invoke(app, ["export", str(file), *options, "--json", "-"])
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["files"] == {str(p): p.stat().st_size for p in outputs}
    assert len(load_dataset(file)["time"]) == len(read_table(outputs[1])[2])


def test_the_command_refuses(file, tmp_path):
    for arguments, words in (
        ([str(file), "-o", str(tmp_path / "a.fbx")], "unknown format '.fbx'; expected: .mot, .sto, .glb, .csv"),
        ([str(tmp_path / "none.nc"), "-o", str(tmp_path / "a.mot")], "no such file"),
        ([str(file), "-o", str(tmp_path / "missing" / "a.mot")], "there is no folder"),
    ):
        done = CliRunner().invoke(app, ["export", *arguments])
        assert done.exit_code == 2, done.output
        assert words in done.stderr
    assert not list(tmp_path.iterdir())
    with pytest.raises(OutputError):
        export(file, tmp_path / "a.txt")
