"""Depths of one mesh's triangles in another, against the brute force."""

from __future__ import annotations

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mesh_samples import random_poses
from scenes import OPTIMISED

from pftwin.base.errors import InputError
from pftwin.base.spatial import Pose, Quaternion, Vec3
from pftwin.geometry.bvh.triangle import Triangle, closest_on_triangle
from pftwin.geometry.contact.contact_mesh import features_of
from pftwin.geometry.contact.depth_sides import pressed_surface, pressing_surface
from pftwin.geometry.contact.depths import depths
from pftwin.geometry.mesh.icosphere import icosphere
from pftwin.geometry.mesh.mesh import SurfaceMesh

RADIUS = 0.025


@pytest.fixture(scope="module")
def femur() -> SurfaceMesh:
    """An open saddle like a groove: convex along it, concave across, less than the button."""
    n = 41
    x, y = np.meshgrid(np.linspace(-0.02, 0.02, n), np.linspace(-0.02, 0.02, n), indexing="ij")
    z = y**2 / (2 * 0.035) - x**2 / (2 * 0.026)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(n - 1), np.arange(n - 1), indexing="ij"))
    a, b, c, d = i * n + j, (i + 1) * n + j, (i + 1) * n + j + 1, i * n + j + 1
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return SurfaceMesh(np.stack([x, y, z], axis=-1).reshape(-1, 3), faces, "saddle")


@pytest.fixture(scope="module")
def button() -> SurfaceMesh:
    return icosphere(RADIUS, 24)


@eqx.filter_jit
def listed(button, femur, pose: Pose, band=0.0):
    return depths(button, femur, pose.position, pose.orientation.rotation(), band=band)


@partial(jax.jit, compiler_options=OPTIMISED)
def _every(rows, points):
    def one(p):
        same = jax.tree.map(lambda a: jnp.broadcast_to(a, rows.shape[:1]), Vec3.from_array(p))
        on = closest_on_triangle(Triangle.of_rows(rows), same)
        k = jnp.argmin(on.square)
        return jnp.sqrt(on.square[k]), k, on.feature[k], jax.tree.map(lambda a: a[k], on.point).array()

    return jax.lax.map(one, points)


def brute_force(femur: SurfaceMesh, button: SurfaceMesh, pose: Pose) -> np.ndarray:
    """Depth of every triangle; NaN at the rim."""
    features = features_of(femur, np.zeros(len(femur.faces), dtype=np.int64))
    middles = button.vertices[button.faces].mean(axis=1)
    points = np.asarray(jax.vmap(lambda p: pose.apply(Vec3.from_array(p)).array())(jnp.asarray(middles)))
    rows = jnp.asarray(femur.vertices[femur.faces].reshape(-1, 9))
    size, k, feature, foot = (np.asarray(a) for a in _every(rows, jnp.asarray(points)))
    inside = np.einsum("ij,ij->i", points - foot, features.outward[k, feature]) <= 0
    return np.where(features.rim[k, feature], np.nan, np.where(inside, size, -size))


def touching_poses(femur: SurfaceMesh, n: int, seed: int) -> list[Pose]:
    """The button's sphere 0.05 to 0.5 mm deep somewhere on the femur, turned anyhow."""
    rng = np.random.default_rng(seed)
    inner = np.flatnonzero(~features_of(femur, np.zeros(len(femur.faces), dtype=np.int64)).rim.any(axis=1))
    turns = random_poses(n, seed, 0.0).orientation
    poses = []
    for i, face in enumerate(rng.choice(inner, n)):
        normal = femur.area_vectors[face] / femur.face_areas[face]
        at = femur.vertices[femur.faces[face]].mean(axis=0) + (RADIUS - rng.uniform(5e-5, 5e-4)) * normal
        poses.append(Pose(Vec3.from_array(jnp.asarray(at)), jax.tree.map(lambda a, i=i: a[i], turns)))
    return poses


def check(femur, button, poses, band=0.0) -> int:
    sides = pressing_surface(button), pressed_surface(femur)
    total = 0
    for pose in poses:
        found = listed(*sides, pose, band=band)
        expected = brute_force(femur, button, pose)
        where = np.asarray(found.triangle)[np.asarray(found.listed)]
        wanted = np.flatnonzero((expected >= -band) & (expected <= 0.01))
        near_the_edge = np.abs(expected + band) < 1e-13  # whichever way it is rounded
        assert set(where) ^ set(wanted) <= set(np.flatnonzero(near_the_edge))
        np.testing.assert_allclose(np.asarray(found.depth)[np.asarray(found.listed)], expected[where], atol=1e-12)
        assert len(where) == len(set(where))
        total += len(where)
    return total


@pytest.mark.slow
def test_listed_triangles_and_depths_are_those_of_the_brute_force(femur, button):
    assert check(femur, button, touching_poses(femur, 12, 0)) > 100
    assert check(femur, button, touching_poses(femur, 4, 1), band=1e-3) > 100


@pytest.mark.slow
def test_on_many_poses(femur, button):
    assert check(femur, button, touching_poses(femur, 300, 2)) > 3000


@pytest.mark.slow
def test_derivatives_by_the_pose_are_those_of_differences(femur, button):
    sides = pressing_surface(button), pressed_surface(femur)
    (pose,) = touching_poses(femur, 1, 3)

    @jax.jit
    def at(move, sides):
        moved = pose.position + Vec3(move[0], move[1], move[2])
        turn = pose.orientation * Quaternion.from_rotation_vector(Vec3(move[3], move[4], move[5]))
        d = depths(*sides, moved, turn.rotation())
        return jnp.sum(jnp.where(d.listed, d.area * d.depth**2, 0.0))

    def pressed(move):
        return at(move, sides)

    zero = jnp.zeros(6)
    forward, reverse = jax.jacfwd(pressed)(zero), jax.grad(pressed)(zero)
    np.testing.assert_allclose(forward, reverse, rtol=1e-9, atol=1e-20)
    steps = [1e-8 * jnp.eye(6)[k] for k in range(6)]
    differences = [(pressed(s) - pressed(-s)) / 2e-8 for s in steps]
    np.testing.assert_allclose(forward, differences, rtol=1e-4, atol=1e-6 * float(jnp.abs(forward).max()))


@pytest.mark.slow
def test_batches_are_their_members(femur, button):
    sides = pressing_surface(button), pressed_surface(femur)
    poses = touching_poses(femur, 3, 4)
    batch = jax.tree.map(lambda *a: jnp.stack(a), *poses)
    many = jax.jit(jax.vmap(lambda p, s: listed(*s, p).depth, (0, None)))(batch, sides)
    for k, pose in enumerate(poses):
        np.testing.assert_allclose(many[k], listed(*sides, pose).depth, atol=1e-15)


@pytest.mark.slow
def test_a_clear_pose_is_empty(femur, button):
    sides = pressing_surface(button), pressed_surface(femur)
    away = Pose(Vec3(*(jnp.asarray(x) for x in (1.0, 0.0, 0.0))), Quaternion.identity())
    assert not listed(*sides, away).listed.any()


def test_on_the_surface_itself_depths_have_derivatives():
    corners = np.array([[0.0, 0, 0], [0.01, 0, 0], [0, 0.01, 0], [0.01, 0.01, 0]])
    plate = SurfaceMesh(3 * (corners - np.array([0.005, 0.005, 0.0])), np.array([[0, 1, 2], [1, 3, 2]]), "plate")
    small = SurfaceMesh(1e-3 * np.array([[1.0, 0, 0], [-0.5, 0.8, 0], [-0.5, -0.8, 0]]), np.array([[0, 2, 1]]), "one")
    sides = pressing_surface(small), pressed_surface(plate)

    @jax.jit
    def at_height(z, sides):  # the centroid lies on the plate's inner edge
        at = Vec3(jnp.zeros(()), jnp.zeros(()), z)
        return depths(*sides, at, Quaternion.identity().rotation(), band=1e-6).depth[0]

    for z in (0.0, 1e-12, -1e-7, 1e-7):
        value, slope = jax.value_and_grad(at_height)(jnp.asarray(z), sides)
        assert float(value) == pytest.approx(-z, abs=1e-15)
        assert float(slope) == pytest.approx(-1.0)


@pytest.mark.parametrize("x", [0.0, 0.0075, 0.0095])
def test_what_is_nearest_to_the_rim_has_no_depth(x):
    """Two small triangles 3 mm apart, a millimetre below a plate that ends at x = 10 mm: inside up to its edge."""
    corners = 0.01 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    plate = SurfaceMesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), "plate")
    small = 1e-4 * np.array([[1.0, 0, 0], [-0.5, 0.8, 0], [-0.5, -0.8, 0]])
    pair = SurfaceMesh(np.concatenate([small, small + np.array([3e-3, 0, 0])]), np.array([[0, 2, 1], [3, 5, 4]]), "two")
    at = Pose(Vec3(*(jnp.asarray(c) for c in (x, 0.002, -1e-3))), Quaternion.identity())
    found = listed(pressing_surface(pair), pressed_surface(plate), at)
    inside = [k for k, place in enumerate((x, x + 3e-3)) if place < 0.01]
    assert sorted(found.triangle[found.listed].tolist()) == inside
    np.testing.assert_allclose(found.depth[found.listed], 1e-3)


def test_labels_must_fit(femur):
    with pytest.raises(InputError, match="labels of shape"):
        pressed_surface(femur, labels=[0, 1])
