"""Whether a point is behind a surface, by the solid angle under which its back is seen."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from mesh_samples import point

from pftwin.geometry.bvh.tree import build_tree
from pftwin.geometry.contact.behind import Behind, _back_solid_angle, behind
from pftwin.geometry.contact.contact_mesh import features_of
from pftwin.geometry.mesh.icosphere import icosphere
from pftwin.geometry.mesh.mesh import SurfaceMesh

J = jnp.asarray
BALL = icosphere(0.02, 6)


def square(half: float = 0.1) -> SurfaceMesh:
    corners = half * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    return SurfaceMesh(corners, np.array([[0, 1, 2], [0, 2, 3]]))


def surface(mesh: SurfaceMesh) -> tuple[Array, Array, Array]:
    """What `behind` asks of a surface."""
    tree = build_tree(mesh)  # whose empty places hold copies
    assert (np.asarray(tree.index) < 0).any()
    rim = features_of(mesh, np.zeros(len(mesh.faces), int)).rim[:, 1:4] @ np.array([1, 2, 4])
    source = tree.source_index()
    return tree.triangles, source, J(rim)[source]


def looks(mesh: SurfaceMesh, points: list[list[float]], wanted: bool = True) -> list[Behind]:
    whole = surface(mesh)
    return [_look(whole, point(J(p, dtype=float)), jnp.asarray(wanted)) for p in points]


@jax.jit
def _look(whole, p, wanted):
    return behind(*whole, p, wanted)


def are_behind(mesh: SurfaceMesh, points: list[list[float]], wanted: bool = True) -> list[bool]:
    return [bool(found.there) for found in looks(mesh, points, wanted)]


def test_inside_a_closed_mesh_and_outside():
    assert are_behind(BALL, [[0, 0, 0], [0.018, 0, 0], [0, -0.0195, 0]]) == [True] * 3
    assert are_behind(BALL, [[0.0205, 0, 0], [0, 0, 1], [0.03, 0.03, 0]]) == [False] * 3


def test_a_hollow_part_inside_is_outside():
    hollow = icosphere(0.01, 3).flipped()
    faces = np.concatenate([BALL.faces, hollow.faces + len(BALL.vertices)])
    bone = SurfaceMesh(np.concatenate([BALL.vertices, hollow.vertices]), faces)
    assert are_behind(bone, [[0, 0, 0], [0.015, 0, 0], [0.03, 0, 0]]) == [False, True, False]


def test_an_open_mesh_has_a_front_and_a_back():
    assert are_behind(square(), [[0, 0, -0.01], [0.02, -0.03, -0.04]]) == [True] * 2
    assert are_behind(square(), [[0, 0, 0.01], [0.02, -0.03, 0.04], [0.2, 0, -0.01], [0, 0, 1.0]]) == [False] * 4


def test_far_behind_an_open_mesh_is_behind_but_not_past_its_rim():
    """A patella that hangs 75 mm below a femur's surface of 50 mm sees little of its back, and is not free of it."""
    below, past = [[0, 0, -1.0], [0.09, -0.09, -0.3]], [[0.11, 0, -1.0], [0.11, 0.2, -0.3], [0.11, 0.11, -0.05]]
    assert are_behind(square(), below) == [True] * 2
    assert are_behind(square(), past) == [False] * 3


def test_it_says_how_far():
    found = looks(square(), [[0, 0.01, -0.04], [0.0, 0, -1.0]]) + looks(BALL, [[0, 0, 0]])
    assert [float(f.depth) for f in found[:2]] == pytest.approx([0.04, 1.0])
    assert 0.018 < float(found[2].depth) < 0.02


def test_the_solid_angle_of_a_square():
    tree = build_tree(square())
    share = _back_solid_angle(tree.triangles, tree.source_index(), point(J([0.0, 0.0, -0.05])))
    alpha = 0.1 / 0.05  # half side over height: 4 asin(alpha^2 / (1 + alpha^2))
    assert float(share) == pytest.approx(np.arcsin(alpha**2 / (1 + alpha**2)) / np.pi, rel=1e-12)


def test_what_is_not_asked_for_is_no():
    assert are_behind(BALL, [[0, 0, 0]], wanted=False) == [False]


def test_a_batch_is_its_members():
    points, wanted = point(J([[0.0, 0, 0], [0.03, 0, 0], [0.0, 0, 0]])), J([True, True, False])
    of_ball = surface(BALL)
    batch = jax.jit(jax.vmap(lambda p, w: behind(*of_ball, p, w).there))
    np.testing.assert_array_equal(batch(points, wanted), [True, False, False])
