"""Meshes of stated fineness: the paper's resolutions, and spheres of triangles."""

from __future__ import annotations

import numpy as np
import pytest

from pftwin.base.errors import InputError
from pftwin.geometry.mesh.icosphere import icosphere, icosphere_deviation
from pftwin.geometry.mesh.mesh import check_mesh
from pftwin.geometry.mesh.resolution import Resolution, button_mesh, button_of_like_size, implant_mesh, resolution
from pftwin.geometry.mesh.topology import adjacent

R = 0.025


@pytest.mark.parametrize("frequency", [1, 3, 16])
def test_icospheres_are_closed_round_and_outward(frequency):
    ball = icosphere(R, frequency)
    assert len(ball.faces) == 20 * frequency**2
    assert len(ball.vertices) == 10 * frequency**2 + 2
    assert check_mesh(ball.vertices, ball.faces).is_closed
    assert ball.volume > 0
    np.testing.assert_allclose(np.linalg.norm(ball.vertices, axis=1), R)
    share = np.random.default_rng(0).dirichlet(np.ones(3), len(ball.faces))
    inside = np.einsum("ij,ijk->ik", share, ball.vertices[ball.faces])
    depth = R - np.linalg.norm(inside, axis=1)
    assert depth.max() <= R * icosphere_deviation(frequency).deviation


@pytest.mark.parametrize("name", ["CM", "FM", "CM-angle", "FM-angle"])
@pytest.mark.slow
def test_a_button_keeps_to_the_papers_tolerances_and_no_coarser_one_does(name):
    fineness = resolution(name)
    ball = button_mesh(R, fineness)
    frequency = round((len(ball.faces) / 20) ** 0.5)
    angle = np.inf if fineness.angle is None else fineness.angle
    normals = ball.area_vectors / ball.face_areas[:, None]
    a, b, _ = adjacent(ball.faces)
    turn = np.arccos(np.clip(np.einsum("ij,ij->i", normals[a], normals[b]), -1, 1))
    assert turn.max() <= angle
    coarser = icosphere_deviation(frequency - 1)
    assert coarser.angle > angle or R * coarser.deviation > fineness.deviation


def test_the_deviation_governs_where_no_angle_is_asked_for():
    ball = button_mesh(R, Resolution(0.006e-3))
    frequency = round((len(ball.faces) / 20) ** 0.5)
    assert R * icosphere_deviation(frequency).deviation <= 0.006e-3 < R * icosphere_deviation(frequency - 1).deviation


@pytest.mark.slow
def test_the_coarse_mesh_keeps_to_its_angle_along_the_grid():
    mesh = implant_mesh(resolution("cm-angle"))
    normals = mesh.area_vectors / mesh.face_areas[:, None]
    a, b, _ = adjacent(mesh.faces)
    turn = np.degrees(np.arccos(np.clip(np.einsum("ij,ij->i", normals[a], normals[b]), -1, 1)))
    assert np.quantile(turn, 0.99) < 1.0
    assert turn.max() < 1.25  # across the diagonals
    ball = button_of_like_size(R, mesh)
    np.testing.assert_allclose(ball.area / len(ball.faces), mesh.area / len(mesh.faces), rtol=0.05)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: resolution("XM"), "no mesh 'XM'; expected: one of CM, FM, CM-angle, FM-angle"),
        (lambda: button_mesh(R, Resolution(1e-9)), "coarser tolerances"),
        (lambda: button_mesh(-R, Resolution(1e-4)), "radius: found -0.025"),
        (lambda: button_mesh(R, Resolution(1e-4, 0.0)), "angle: found 0.0"),
        (lambda: icosphere(R, 0), "frequency: found 0"),
        (lambda: icosphere(float("nan"), 2), "radius: found nan"),
    ],
)
def test_impossible_wishes(call, message):
    with pytest.raises(InputError, match=message):
        call()
