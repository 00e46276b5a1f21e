"""Bones that a scene has surfaces of are drawn as they are; others are schematic, and the page says so."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from small_scene import small_result

from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.model.drawn_bones import DrawnBones
from pftwin.results.viewer import view
from pftwin.results.viewer.bones import femoral_component, femur, patella_parts, tibia
from pftwin.results.viewer.recorded import Recorded

pytest.importorskip("k3d", reason="the viewer needs the extra `viewer`")
PLACES = {"femur": (0.01, 0.0, -0.02), "patella": (0.0, 0.002, 0.01), "tibia": (-0.09, 0.004, 0.02)}


def ball(body: str) -> SurfaceMesh:
    from trimesh.creation import icosphere

    made = icosphere(subdivisions=2, radius=0.02)
    return SurfaceMesh(made.vertices + PLACES[body], made.faces, body)


def result_with(*bodies: str):
    result = small_result()
    bones = DrawnBones({body: ball(body) for body in bodies})
    return dataclasses.replace(result, scene=dataclasses.replace(result.scene, bones=bones))


def named(drawn, name: str):
    return next(o for o in drawn.objects if o.name == name)


def test_a_bone_is_drawn_where_its_body_is():
    result = result_with(*PLACES)
    drawn = view(result)
    for body, place in PLACES.items():
        part = named(drawn, body)
        np.testing.assert_allclose(part.vertices.mean(axis=0), 1e3 * np.array(place), atol=1e-3)
        assert part.opacity == 1
    matrix = named(drawn, "patella").model_matrix[f"{result.times[7]:.4f}"]
    np.testing.assert_allclose(matrix[:3, 3], 1e3 * result.position[7], atol=1e-4)
    assert not [o.name for o in drawn.objects if "schematic" in o.name or "origin" in o.name]
    assert "schematic" not in named(drawn, "legend").text


def test_the_page_says_which_bones_are_schematic():
    drawn = view(result_with("femur"))
    assert {"femur", "patella (schematic)", "tibia (schematic)"} <= {o.name for o in drawn.objects}
    assert "Tibia, patella: schematic, for want of a mesh." in named(drawn, "legend").text


def test_bones_come_back_from_a_file(tmp_path):
    result_with("tibia").save(tmp_path / "knee.nc")
    vertices, triangles = Recorded.of(tmp_path / "knee.nc").mesh("tibia_bone")
    np.testing.assert_allclose(vertices, ball("tibia").vertices, atol=1e-8)
    np.testing.assert_array_equal(triangles, ball("tibia").faces)


def test_cartilage_that_is_part_of_the_bone_is_not_drawn_twice():
    recorded = Recorded.of(result_with("femur", "patella"))
    geometry = recorded.geometry.drop_vars([n for n in recorded.geometry if n.startswith(("surface", "button"))])
    for name, body in (("femur", "femur"), ("button", "patella")):
        surface = ball(body)
        half = surface.faces[surface.vertices[surface.faces].mean(axis=1)[:, 2] < PLACES[body][2]]
        geometry[f"{name}_vertices"] = ((f"{name}_vertex", "axis"), surface.vertices.astype(np.float32))
        geometry[f"{name}_triangles"] = ((f"{name}_triangle", "corner"), half)
    part = dataclasses.replace(recorded, geometry=geometry)
    assert femoral_component(part) == []
    assert [p.name for p in patella_parts(part)] == ["patella"]
    geometry["femur_vertices"] = geometry["femur_vertices"] + np.float32(1e-4)  # a component on the bone
    geometry["button_vertices"] = geometry["button_vertices"] + np.float32(1e-4)
    assert [p.name for p in femoral_component(part)] == ["femoral mesh"]
    assert [p.name for p in patella_parts(part)] == ["patella", "button"]


def test_results_laid_over_each_other_have_their_own_bones_where_these_differ():
    one, same, moved = result_with("femur", "tibia"), result_with("femur", "tibia"), result_with("femur", "tibia")
    bones = moved.scene.bones.surfaces
    other = DrawnBones({body: SurfaceMesh(m.vertices + 0.001, m.faces) for body, m in bones.items()})
    moved = dataclasses.replace(moved, scene=dataclasses.replace(moved.scene, bones=other))
    names = [o.name for o in view({"one": one, "same": same, "moved": moved}).objects]
    assert names.count("femur") == names.count("tibia") == 2


def test_bones_are_no_part_of_any_program():
    scene = result_with(*PLACES).scene
    assert scene.unnamed().bones is None
    assert scene.set("K1", 200.0).bones is scene.bones


def test_scenes_with_the_same_bones_have_one_structure():
    import jax

    one, two = result_with(*PLACES).scene, result_with(*PLACES).scene.set("K1", 200.0)
    assert one.bones is not two.bones
    assert jax.tree.structure(one) == jax.tree.structure(two)
    assert jax.tree.structure(one) != jax.tree.structure(result_with("femur").scene)


def test_schematic_bones_hide_nothing_that_touches_and_reach_their_tendon():
    """The patch and the cap of the button lie outside the bones, the patellar tendon ends on the tibia."""
    from scipy.spatial import KDTree
    from trimesh import Trimesh

    recorded = Recorded.of(small_result())
    shaft = femur(recorded).shape
    bone, tree = Trimesh(*shaft, process=False), KDTree(shaft.vertices)
    assert bone.is_watertight
    patch = 1e3 * recorded.mesh("surface")[0]
    distance, nearest = tree.query(patch)
    outward = np.einsum("ij,ij->i", patch - shaft.vertices[nearest], bone.vertex_normals[nearest])
    assert outward.min() > 0.5
    assert np.median(distance) < 5.0  # and it lies on the bone
    patella, cap = (part.shape.vertices for part in patella_parts(recorded))
    assert patella[:, 2].min() > cap[:, 2].max() - 1e-3
    origin = 1e3 * recorded.lines["patellar_tendon"].origin
    assert KDTree(tibia(recorded).shape.vertices).query(origin)[0].max() < 6.0
