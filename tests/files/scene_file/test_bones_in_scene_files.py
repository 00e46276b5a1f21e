"""[bones]: surfaces that a scene is drawn with, in their bodies' frames, and what is refused of them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from toy_scene_files import LIGHT, load, refused, same, write_toy

from pftwin.geometry.mesh.icosphere import icosphere
from pftwin.geometry.mesh.mesh import SurfaceMesh, save_mesh
from pftwin.results.scene_geometry import geometry

AT = np.array([0.04, 0.012, -0.003])  # of the ball in its file [m]
BONE = '\n[bones.tibia]\nmesh = "bone.stl"\nunits = "mm"\n'
PLACED = "mesh_pose = { position_mm = [-90, 5, 0], quaternion_wxyz = [0.7071067811865476, 0, 0, 0.7071067811865476] }\n"


@pytest.fixture(scope="module")
def toy(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("bones")
    write_toy(folder)
    ball = icosphere(0.02, 6)
    save_mesh(SurfaceMesh(ball.vertices + AT, ball.faces), folder / "bone.stl", units="mm")
    return folder


def middle(mesh: SurfaceMesh) -> np.ndarray:
    return 0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0))


@pytest.mark.parametrize(
    ("before", "after", "place"),
    [
        ("", "", AT),
        ("", PLACED, (-0.09 - 0.012, 0.005 + 0.04, -0.003)),  # a quarter turn about z: x to y, y to -x
        ('side = "left"\n', "", AT),  # the file's y is medial, the scene's lateral
    ],
)
def test_a_bone_is_in_the_frame_of_its_body(toy, before, after, place):
    mirrored = np.array([1.0, -1.0 if before else 1.0, 1.0])
    scene = load(toy, before + LIGHT + BONE + after)
    assert scene.left == bool(before)
    assert list(scene.bones.surfaces) == ["tibia"]
    bone = scene.bones.surfaces["tibia"]
    np.testing.assert_allclose(middle(bone), mirrored * place, atol=1e-6)
    np.testing.assert_allclose(bone.volume, 4 / 3 * np.pi * 0.02**3, rtol=0.05)  # positive: outside is outside
    drawn = geometry(scene)
    np.testing.assert_allclose(drawn["tibia_bone_vertices"], bone.vertices, atol=1e-6)
    assert "femur_bone_vertices" not in drawn


def test_forces_know_nothing_of_it(toy):
    bare, scene = load(toy, LIGHT), load(toy, LIGHT + BONE)
    assert bare.bones is None
    same(dataclasses.replace(scene, bones=None), bare)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[bones]\n", "[bones]: no bone; expected: femur, patella or tibia"),
        (BONE.replace("tibia", "fibula"), "[bones] fibula: unknown field"),
        (BONE.replace('units = "mm"\n', ""), "[bones] tibia.units: is missing"),
        (BONE.replace("bone.stl", "none.stl"), "[bones] tibia.mesh: none.stl"),
        (BONE.replace('"mm"', '"m"'), "[bones] tibia.mesh: bone.stl: a longest side of 40 m"),
        (BONE + "mesh_pose = { position_m = [0, 0.9, 0] }\n", "all of it is 893 mm or farther from the origin"),
    ],
)
def test_what_is_refused(toy, text, said):
    assert said in refused(toy, LIGHT + text)
