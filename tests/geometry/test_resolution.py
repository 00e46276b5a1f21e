"""Meshes of stated fineness: the paper's resolutions, and spheres of triangles."""

from __future__ import annotations

import numpy as np
import pytest

from pftwin.base.errors import InputError
from pftwin.geometry.mesh.icosphere import RESOLUTIONS, button_mesh, icosphere, icosphere_deviation
from pftwin.geometry.mesh.mesh import check_mesh

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
    assert depth.max() <= R * icosphere_deviation(frequency)


@pytest.mark.parametrize("deviation", RESOLUTIONS.values())
def test_a_button_keeps_to_the_papers_deviations_and_no_coarser_one_does(deviation):
    ball = button_mesh(R, deviation)
    frequency = round((len(ball.faces) / 20) ** 0.5)
    assert R * icosphere_deviation(frequency) <= deviation < R * icosphere_deviation(frequency - 1)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: button_mesh(R, 1e-9), "deviation: more than 1800000 triangles; try: a coarser one"),
        (lambda: button_mesh(-R, 1e-4), "radius: found -0.025"),
        (lambda: button_mesh(R, 0.0), "deviation: found 0.0"),
        (lambda: icosphere(R, 0), "frequency: found 0"),
        (lambda: icosphere(float("nan"), 2), "radius: found nan"),
    ],
)
def test_impossible_wishes(call, message):
    with pytest.raises(InputError, match=message):
        call()
