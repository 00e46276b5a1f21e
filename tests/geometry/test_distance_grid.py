"""Depths from a table, against planes, spheres and the triangles themselves; triangles that are taken together."""

from __future__ import annotations

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from height_meshes import plate
from mesh_samples import random_poses

from pftwin.base.errors import InputError
from pftwin.base.spatial import Pose, Vec3
from pftwin.geometry.contact.depth_sides import pressed_surface, pressing_surface
from pftwin.geometry.contact.depths import depths
from pftwin.geometry.contact.distance_grid import DistanceGrid, distance_grid
from pftwin.geometry.mesh.icosphere import icosphere
from pftwin.geometry.mesh.mesh import SurfaceMesh

RADIUS, CENTER = 0.021, np.array([0.003, -0.002, 0.005])
BUTTON = 0.017


@cache
def ball() -> SurfaceMesh:
    """Of 32,000 triangles, 4 um off a sphere at most."""
    mesh = icosphere(RADIUS, 40)
    return SurfaceMesh(mesh.vertices + CENTER, mesh.faces, "ball")


@cache
def grid(spacing: float) -> DistanceGrid:
    return distance_grid(ball(), spacing, ball().vertices[ball().faces][:, :, 0].mean(axis=1) > CENTER[0])


def near_the_ball(count: int = 2000) -> tuple[np.ndarray, np.ndarray]:
    """Points up to 2 mm off the sphere on either side, and the directions outward there."""
    random = np.random.default_rng(5)
    outward = random.normal(size=(count, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    return CENTER + outward * (RADIUS + random.uniform(-2e-3, 2e-3, (count, 1))), outward


@eqx.filter_jit
def _below(grid, points):
    points = Vec3.from_array(points)
    found = grid.below(None, points, points)
    return found.depth, found.normal.array(), found.rim, found.lateral


MOST = 9000  # points: the places of other numbers of them are filled, so that one program serves each table


def below(grid, points):
    found = _below(grid, jnp.asarray(np.resize(points, (MOST, 3))))
    return tuple(None if a is None else np.asarray(a)[: len(points)] for a in found)


@pytest.mark.slow
def test_depths_below_a_sphere():
    points, outward = near_the_ball()
    depth, normal, rim, lateral = below(grid(1e-3), points)
    np.testing.assert_allclose(depth, RADIUS - np.linalg.norm(points - CENTER, axis=1), atol=12e-6)
    assert np.degrees(np.arccos(np.clip(np.sum(normal * outward, axis=1), -1, 1))).max() < 1.0
    assert not np.asarray(rim).any()
    # The border is a great circle, as far as the triangles' edges can follow it.
    aside = 2 * RADIUS * np.sin(0.5 * np.arcsin(outward[:, 0]))
    np.testing.assert_allclose(lateral, aside, atol=5e-4)


@pytest.mark.slow
def test_a_table_twice_as_coarse_is_off_by_more_than_four_times_as_much():
    """Right to second order; beside the triangles, which are off by their own sags whatever the table."""
    points, _ = near_the_ball()
    coarse, middling, fine = (np.asarray(below(grid(h), points)[0]) for h in (6e-3, 3e-3, 1e-3))
    assert np.std(coarse - fine) > 4 * np.std(middling - fine)


def test_derivatives_are_those_of_a_sphere():
    """Depth falls along the normal; the normal turns by one over the distance from the middle."""
    points, outward = near_the_ball(400)
    aside = np.cross(outward, [0.3, -0.5, 0.8])
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    look = eqx.filter_jit(lambda g, p, v: jax.jvp(lambda x: _below(g, x)[:2], (p,), (v,))[1])
    falls, _ = look(grid(1e-3), jnp.asarray(points), jnp.asarray(outward))
    flat, turns = look(grid(1e-3), jnp.asarray(points), jnp.asarray(aside))
    np.testing.assert_allclose(falls, -1.0, atol=0.02)
    np.testing.assert_allclose(flat, 0.0, atol=0.02)
    curvature = np.sum(np.asarray(turns) * aside, axis=1) * np.linalg.norm(points - CENTER, axis=1)
    assert curvature.mean() == pytest.approx(1.0, abs=0.02)
    assert curvature.std() < 0.15
    back = eqx.filter_jit(lambda g, p: jax.grad(lambda x: jnp.sum(_below(g, x)[0]))(p))(grid(1e-3), jnp.asarray(points))
    np.testing.assert_allclose(np.sum(np.asarray(back) * outward, axis=1), falls, rtol=1e-9)


def test_the_surface_bends_as_its_normals_turn():
    """The normal's component along a vector, differentiated twice as finely as the cubes are large."""
    points, _ = near_the_ball(300)
    at = (points - np.asarray(grid(3e-3).low)) / 3e-3
    points = points[np.abs(at - np.floor(at) - 0.5).min(axis=1) > 0.02]  # differences must not cross a cube's face
    vector = np.random.default_rng(8).normal(size=points.shape)

    def along(at):
        return np.sum(below(grid(3e-3), at)[1] * vector, axis=1)

    here = [Vec3.from_array(jnp.asarray(a)) for a in (points, vector)]
    bend = eqx.filter_jit(lambda g, p, v: g.below(None, p, v).bend.array())(grid(3e-3), *here)
    steps = 1e-6 * np.eye(3)
    slopes = np.stack([(along(points + d) - along(points - d)) / 2e-6 for d in steps], axis=1)
    assert np.abs(slopes).max() > 30.0  # about one over the radius
    np.testing.assert_allclose(bend, slopes, atol=1e-5 * np.abs(slopes).max())


def test_a_plane_is_exact_up_to_its_rim():
    """The plate's top is at z = 0, its edge 20 mm from the middle."""
    table = distance_grid(plate(8, 0.02), 1.5e-3)
    random = np.random.default_rng(2)
    points = np.concatenate([random.uniform(-0.0185, 0.0185, (500, 2)), random.uniform(-2e-3, 2e-3, (500, 1))], axis=1)
    depth, normal, rim, lateral = below(table, points)
    np.testing.assert_allclose(depth, -points[:, 2], atol=1e-9)
    np.testing.assert_allclose(normal, np.tile([0.0, 0, 1], (500, 1)), atol=1e-6)
    assert not np.asarray(rim).any()
    assert lateral is None
    across = np.stack([np.linspace(0.017, 0.0235, 40), np.full(40, 1e-3), np.full(40, -2e-4)], axis=1)
    depth, _, rim, _ = below(table, across)
    np.testing.assert_allclose(np.asarray(depth)[across[:, 0] < 0.021], 2e-4, atol=1e-7)
    border = across[np.argmax(np.asarray(rim)), 0]
    assert 0.02 - 0.75e-3 - 2e-4 <= border <= 0.02 + 0.75e-3 + 2e-4  # half a cube, and the places that were tried
    assert np.asarray(rim)[across[:, 0] > border].all()


def test_deep_below_an_open_surface_it_is_as_deep_as_the_triangles_say():
    """A wrong pose must not be taken for a light touch."""
    table, deep = distance_grid(plate(8, 0.02), 1.5e-3), np.arange(1, 10) * 1e-3
    points = np.stack([np.full(9, 2e-3), np.full(9, -3e-3), -deep], axis=1)
    depth, _, rim, _ = below(table, points)
    np.testing.assert_allclose(depth, deep, atol=1e-7)
    assert not np.asarray(rim).any()


def test_far_outside_the_table_there_is_no_contact():
    points = CENTER + np.array([[0.2, 0, 0], [0, -0.3, 0.1], [0.03, 0.03, 0.03]])
    assert (np.asarray(below(grid(1e-3), points)[0]) < -5e-3).all()


@eqx.filter_jit
def listed(button, femur, pose: Pose):
    return depths(button, femur, pose.position, pose.orientation.rotation())


def test_no_triangle_in_contact_is_left_out():
    button = pressing_surface(icosphere(BUTTON, 20))
    exact = pressed_surface(ball())
    poses, count = random_poses(12, 3, 0.0), 0
    for k in range(12):
        turn = jax.tree.map(lambda a, k=k: a[k], poses.orientation)
        away = turn.rotation().ex.array()  # another direction each time
        deep = jnp.asarray(CENTER) + (RADIUS + BUTTON - 1e-4 * (k + 1)) * away
        pose = Pose(Vec3.from_array(deep), turn)
        ours, theirs = (listed(button, surface, pose) for surface in (grid(1e-3), exact))
        deeper = np.asarray(theirs.triangle)[np.asarray(theirs.listed & (theirs.depth > 15e-6))]
        assert set(deeper) <= set(np.asarray(ours.triangle)[np.asarray(ours.listed)])
        count += len(deeper)
    assert count > 200


def test_triangles_taken_together_bear_the_same_linear_pressure():
    """On a plane, whose pressure is linear in the place: force and moment by the triangles themselves."""
    mesh, spring, pose = icosphere(BUTTON, 20), 2e9, np.array([0.001, -0.002, BUTTON - 3e-3])
    corners = mesh.vertices[mesh.faces]
    vectors = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    for together in (1, 3, 8):
        button = pressing_surface(mesh, together)
        own = np.asarray(button.index) >= 0
        merged = np.asarray(button.corners).swapaxes(1, 2).reshape(*own.shape, 3, 3)[own]
        area = 0.5 * np.cross(merged[:, 1] - merged[:, 0], merged[:, 2] - merged[:, 0])
        np.testing.assert_allclose(area.sum(axis=0), vectors.sum(axis=0), atol=1e-15)
        fewer = len(corners) / len(merged)
        assert 0.5 * together < fewer <= together
        # A plane far above everything: each triangle is in contact, so that the sums are those of a linear field.
        force, moment = _of_plane(merged, area, spring, pose)
        wanted_force, wanted_moment = _of_plane(corners, vectors, spring, pose)
        np.testing.assert_allclose(force, wanted_force, rtol=2e-3)
        np.testing.assert_allclose(moment, wanted_moment, rtol=2e-3, atol=2e-3 * abs(wanted_force) * BUTTON)
    np.testing.assert_allclose(np.asarray(button.mesh).reshape(-1, 3, 3), corners)


def test_any_number_of_triangles_is_taken_together():
    """One without an area stays where it is."""
    random = np.random.default_rng(8)
    for n in range(9, 40):
        corners = random.uniform(size=(3 * n, 3)) + 1.0
        corners[-3:] = corners[-3]
        mesh = SurfaceMesh(corners, np.arange(3 * n).reshape(n, 3), "soup")
        for most in (2, 3, 5):
            button = pressing_surface(mesh, most)
            merged = np.asarray(button.corners).swapaxes(1, 2).reshape(-1, 3, 3)
            assert (merged.mean(axis=1) > 1).all()


def _of_plane(triangles, vectors, spring, pose):
    middle = triangles.mean(axis=1) + pose
    pressure = spring * (0.05 - middle[:, 2])
    upward = np.maximum(-vectors[:, 2], 0) * pressure
    return upward.sum(), np.array([(middle[:, 1] * upward).sum(), -(middle[:, 0] * upward).sum()])


@pytest.mark.parametrize(
    ("spacing", "words"),
    [
        (0.0, "above 0"),
        (1e-300, "nodes about ball"),
        (1e-4, r"0.1 mm: [\d,]+ nodes about ball.*at least 0\.3"),
        (0.012, "depths have an error of .* mm \\(rms\\) on ball.*at most 0.05 mm"),
    ],
)
def test_a_table_that_is_no_use_is_refused(spacing, words):
    with pytest.raises(InputError, match=words):
        distance_grid(ball(), spacing)


def test_slopes_are_continuous_from_cube_to_cube():
    """Along a line through cubes of a coarse table, in steps of 1 um: slopes that jumped would jump by degrees."""
    table, start = grid(3e-3), CENTER + np.array([-0.006, 0.004, RADIUS - 3e-3])
    along = start + np.arange(9000)[:, None] * 1e-6 * np.array([0.8, -0.5, 0.33])
    depth, normal, *_ = below(table, along)
    assert np.abs(np.diff(np.asarray(depth), n=2)).max() < 2e-9
    turned = np.linalg.norm(np.diff(np.asarray(normal), axis=0), axis=1)
    assert turned.max() < 3e-4
