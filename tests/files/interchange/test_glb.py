"""Animated scenes, read back by parsers that share nothing with the writer."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from other_readers import Glb
from scipy.spatial.transform import Rotation
from small_scene import small_result
from wrapped_scene import wrapped_result

from pftwin.files.interchange import export
from pftwin.files.interchange.glb import rod
from pftwin.geometry.mesh.icosphere import icosphere


@pytest.fixture(scope="module")
def result():
    return small_result()


@pytest.fixture(scope="module")
def file(result, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("result") / "knee.nc"
    result.save(path)
    return path


@pytest.fixture(scope="module")
def glb(file) -> Path:
    export(file, file.with_suffix(".glb"))
    return file.with_suffix(".glb")


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


def test_glb_lines_run_over_their_obstacles(tmp_path):
    """A chain of rods from the insertion to the origin, each from where the one before ends."""
    result = wrapped_result()
    export(result, tmp_path / "wrapped.glb")
    read, line = Glb(tmp_path / "wrapped.glb"), result.scene.effect("patellar_tendon")
    for k in (0, 20, -1):
        rods = [read.matrix(f"patellar tendon, part {j + 1}", k) for j in range(9)]
        first, last = (np.array([r @ [0, 0, end, 1.0] for r in rods])[:, :3] for end in (0.5, -0.5))
        np.testing.assert_allclose(first[1:], last[:-1], atol=2e-7)
        for point, at, body in ((line.insertion, first[0], "patella"), (line.origin, last[-1], "tibia")):
            expected = read.matrix(body, k) @ [float(point.x), float(point.y), float(point.z), 1.0]
            np.testing.assert_allclose(at, expected[:3], atol=2e-7)
        length = np.linalg.norm(first - last, axis=1).sum()
        assert length == pytest.approx(result.effects["patellar_tendon"]["length"][k], abs=1e-6)
        assert length > np.linalg.norm(first[0] - last[-1]) + 2e-4
    assert "mpfl 3, part 9" in {n.get("name") for n in read.tree["nodes"]}


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
