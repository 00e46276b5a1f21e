"""Sums over the part of a mesh inside a ball: closed forms, the brute force, derivatives, lists too short."""

from __future__ import annotations

from dataclasses import replace

import brute_force
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mesh_samples import corners_of, point, soup
from scenes import OPTIMISED

from pftwin.base.errors import InputError
from pftwin.base.spatial import Vec3
from pftwin.geometry.bvh.tree import build_tree
from pftwin.geometry.bvh.triangle import Triangle
from pftwin.geometry.bvh.wide import BallListLengths, nearest_wide, wide_tree
from pftwin.geometry.contact.ball_cut import angle, ball_cut
from pftwin.geometry.contact.patch_mesh import PatchMesh, patch_mesh
from pftwin.geometry.contact.sphere_patch import sphere_patch
from pftwin.geometry.mesh.icosphere import icosphere
from pftwin.geometry.mesh.mesh import SurfaceMesh

J = jnp.asarray
R = 0.025
cut_by_ball = jax.jit(lambda rows, radius: ball_cut(Triangle.of_rows(rows), radius))
LARGE = np.array([-1.0, -1.0, 0.0, 2.0, -1.0, 0.0, -1.0, 2.0, 0.0])  # a triangle far larger than the ball


def test_the_angle_is_that_of_the_c_library():
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(2, 4000)) * 10.0 ** rng.uniform(-9, 9, (2, 4000))
    np.testing.assert_allclose(jax.jit(angle)(x, y), np.arctan2(y, x), rtol=4e-16)
    value_and_slope = jax.jit(jax.value_and_grad(angle))
    at = ((0.0, 0.0), (-1.0, 0.0), (0.0, -1.0), (1.0, 2.0))
    values, slopes = zip(*(map(float, value_and_slope(J(a), J(b))) for a, b in at), strict=True)
    assert values[:3] == (0, np.pi, -np.pi / 2)
    np.testing.assert_allclose(slopes[3], -0.4)
    assert slopes[0] == 0


@pytest.mark.parametrize("depth", [1e-6, 1e-4, 5e-3, 0.02, 0.03])
def test_a_ball_in_the_middle_of_a_large_triangle_cuts_a_circle(depth):
    """The integral of (R^2 - q^2) / (2 R) over a circle of radius rho is pi rho^4 / (4 R)."""
    cut = cut_by_ball(J((LARGE - np.array([0.0, 0.0, R - depth] * 3))[None]), J(R))
    rho = R**2 - (R - depth) ** 2
    np.testing.assert_allclose(cut.area, np.pi * rho, rtol=1e-9)
    np.testing.assert_allclose(cut.doubled, np.pi * rho**2 / 2, rtol=1e-9)
    np.testing.assert_allclose(cut.moment.z, -np.pi * rho * (R - depth), rtol=1e-9)
    np.testing.assert_allclose(cut.flux, -np.pi * rho * (R - depth), rtol=1e-9)


def by_points(t: np.ndarray, n: int = 400) -> tuple[float, float, np.ndarray]:
    """Area, integral of R^2 - q^2 and of q over the part of a triangle (3, 3) in the ball, by many small triangles."""
    i, j = (g.ravel() for g in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
    up, down = i + j < n, i + j < n - 1
    s = np.concatenate([(i[up] + 1 / 3) / n, (i[down] + 2 / 3) / n])[:, None]
    u = np.concatenate([(j[up] + 1 / 3) / n, (j[down] + 2 / 3) / n])[:, None]
    q = t[0] + s * (t[1] - t[0]) + u * (t[2] - t[0])
    area = 0.5 * np.linalg.norm(np.cross(t[1] - t[0], t[2] - t[0])) / n**2
    depth = R**2 - (q**2).sum(axis=1)
    inside = depth > 0
    return area * inside.sum(), area * depth[inside].sum(), area * q[inside].sum(axis=0)


@pytest.mark.parametrize("seed", range(20))
def test_a_triangle_anywhere_is_cut_as_by_counting_points(seed):
    rng = np.random.default_rng(seed)
    way = rng.normal(size=3)
    size = 10 ** rng.uniform(-3.5, -1)
    t = rng.uniform(0, 1) * R * way / np.linalg.norm(way) + rng.normal(size=(3, 3)) * size
    cut = cut_by_ball(J(t.reshape(1, 9)), J(R))
    area, doubled, moment = by_points(t)
    whole = min(0.5 * np.linalg.norm(np.cross(t[1] - t[0], t[2] - t[0])), np.pi * R**2)
    assert abs(float(cut.area[0]) - area) < 2e-3 * whole
    assert abs(float(cut.doubled[0]) - doubled) < 5e-5 * whole * R**2
    np.testing.assert_allclose(cut.moment.array()[0], moment, atol=2e-3 * whole * R)


prepared = eqx.filter_jit(lambda mesh: mesh.prepared())


@eqx.filter_jit
def patch_of(mesh: PatchMesh, centers, radius):
    return jax.lax.map(lambda c: sphere_patch(mesh, point(c), radius), centers)


@eqx.filter_jit
def every_triangle(triangles, centers, radius):
    return jax.lax.map(lambda c: ball_cut(Triangle.of_rows(triangles - jnp.tile(c, 3)[None]), radius), centers)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_random_triangles_by_the_tree_are_those_of_the_brute_force(seed):
    mesh = soup(seed)
    rng = np.random.default_rng(seed + 1)
    lateral = np.arange(len(mesh.faces)) % 2 == 1
    made = prepared(replace(patch_mesh(mesh, R, lateral), room=BallListLengths(64, 65)))
    centers = J(rng.uniform(-0.06, 0.06, (20, 3)))
    found = patch_of(made, centers, J(R))
    every = every_triangle(J(corners_of(mesh).reshape(-1, 9)), centers, J(R))
    assert not np.asarray(found.overflow).any()
    for side, on in zip(found.sums.facets, (~lateral, lateral), strict=True):
        for fast, slow in zip(jax.tree.leaves(side), jax.tree.leaves(every), strict=True):
            scale = np.abs(np.asarray(slow)).sum(axis=1).max()
            np.testing.assert_allclose(fast, np.asarray(slow)[:, on].sum(axis=1), atol=1e-11 * scale)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_the_nearest_triangle_is_that_of_the_brute_force(seed):
    mesh = soup(seed)
    tree = build_tree(mesh, leaf=1)
    wide = wide_tree(tree)
    points = np.random.default_rng(seed + 1).uniform(-0.07, 0.07, (10, 3))
    found = _nearest(wide, tree.triangles, J(points))
    assert not np.asarray(found.overflow).any()
    for p, place in zip(points, np.asarray(found.place), strict=True):
        distances = brute_force.distances(corners_of(mesh), p)
        assert distances[int(tree.index[place])] <= distances.min() * (1 + 1e-12) + 1e-15


@eqx.filter_jit
def _nearest(wide, triangles, points):
    return jax.vmap(lambda p: nearest_wide(wide, triangles, point(p)))(points)


BALL = icosphere(0.03, 24)
HALVES = BALL.vertices[BALL.faces].mean(axis=1)[:, 1] > 0
READY = patch_mesh(BALL, R, HALVES)
PLACES = {
    "face": BALL.vertices[BALL.faces[100]].mean(axis=0) / 0.03,
    "edge": BALL.vertices[BALL.faces[100, :2]].mean(axis=0) / 0.03,
    "vertex": BALL.vertices[BALL.faces[100, 0]] / 0.03,
    "seam": np.array([0.3, 0.0, 0.954]),
}


def _sums(c, radius, mesh=READY):
    patch = sphere_patch(mesh, Vec3.from_array(c), radius)
    cuts, seam = patch.sums.facets, patch.sums.seam
    values = [x for k in cuts for x in (k.area, k.doubled, k.moment.x, k.moment.y, k.moment.z)]
    return jnp.stack([*values, seam.depth, seam.square, seam.square_slope.x])


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("depth", [-1e-4, 0.0, 1e-7, 2e-4, 2e-3])
@pytest.mark.slow
def test_derivatives_are_those_of_differences_in_both_modes(place, depth):
    c, radius = J(PLACES[place] / np.linalg.norm(PLACES[place]) * (0.03 + R - depth)), J(R)
    forward, reverse, plain = _derivatives()
    slopes = forward(c, radius)
    assert all(np.isfinite(x).all() for x in slopes)
    for a, b in zip(slopes, reverse(c, radius), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-15)
    if depth >= 2e-4:  # far from the touch, where the area jumps off zero
        step = 1e-7
        for k in range(3):
            e = step * np.eye(3)[k]
            difference = (plain(c + e, radius) - plain(c - e, radius)) / (2 * step)
            scale = np.abs(np.asarray(slopes[0])).max(axis=1) + 1e-12
            np.testing.assert_allclose((slopes[0][:, k] - difference) / scale, 0, atol=5e-4)
        difference = (plain(c, radius + step) - plain(c, radius - step)) / (2 * step)
        np.testing.assert_allclose((slopes[1] - difference) / (np.abs(slopes[1]) + 1e-9), 0, atol=5e-4)


_KEPT: list = []


def _derivatives():
    """Compiled once for all places."""
    if not _KEPT:
        _KEPT.extend([jax.jit(mode(_sums, argnums=(0, 1))) for mode in (jax.jacfwd, jax.jacrev)] + [jax.jit(_sums)])
    return _KEPT


@pytest.mark.slow
def test_the_slope_by_the_mesh_is_that_of_moving_all_of_it():
    """Moving the mesh one way is moving the ball the other way."""
    c = J(PLACES["face"] / np.linalg.norm(PLACES["face"]) * (0.03 + R - 3e-4))

    def moved(shift):
        return _sums(c, J(R), eqx.tree_at(lambda m: m.facets.triangles, READY, READY.facets.triangles + shift))[1]

    along_z = jnp.tile(J([0.0, 0.0, 1.0]), 3)[None]
    by_mesh = jax.jit(jax.grad(lambda s: moved(s * along_z)), compiler_options=OPTIMISED)(J(0.0))
    np.testing.assert_allclose(by_mesh, -_derivatives()[0](c, J(R))[0][1, 2], rtol=1e-8)


def test_a_batch_is_its_members_and_a_list_that_is_too_short_says_so():
    way = np.array([0.1, 0.2, 1.0])
    centers = J(way / np.linalg.norm(way) * (0.03 + R - np.array([[-1e-3], [1e-4], [1e-3], [5e-3]])))
    single = patch_of(READY, centers, J(R))
    batch = eqx.filter_jit(jax.vmap(lambda c: sphere_patch(READY, point(c), J(R))))(centers)
    for a, b in zip(jax.tree.leaves(single), jax.tree.leaves(batch), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-20)
    assert not np.asarray(single.overflow)[:3].any()
    for room in (BallListLengths(16, 200), BallListLengths(700, 3)):
        short = patch_of(replace(READY, room=room), centers, J(R))
        np.testing.assert_array_equal(short.overflow, [False, room.cut < 50, True, True])


def test_a_radius_and_labels_must_make_sense():
    with pytest.raises(InputError, match="radius"):
        patch_mesh(BALL, -1.0)
    with pytest.raises(InputError, match="lateral"):
        patch_mesh(SurfaceMesh(BALL.vertices, BALL.faces), R, np.zeros(len(BALL.faces), bool))
