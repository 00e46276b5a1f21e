"""Trees of triangles: how they are built, and their searches against the brute force."""

from __future__ import annotations

import brute_force
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mesh_samples import corners_of, point, soup

from pftwin.base import cache_folder
from pftwin.base.errors import InputError
from pftwin.geometry.bvh import tree
from pftwin.geometry.bvh.tree import MeshTree, build_tree, joined_tree, tree_arrays
from pftwin.geometry.bvh.wide import NearestTriangle, nearest_wide, wide_tree
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.rig.contacts import implant_mesh


def searched(t: MeshTree, points: np.ndarray, half: int | None = None) -> NearestTriangle:
    return _searched(wide_tree(t), t.triangles, jnp.asarray(points), half)


@eqx.filter_jit
def _searched(wide, triangles, points, half):
    return jax.vmap(lambda p: nearest_wide(wide, triangles, point(p), half))(points)


@pytest.mark.parametrize("n", [1, 3, 4, 5, 63, 300])
def test_every_triangle_has_one_place_and_every_node_holds_its_own(n):
    mesh = soup(n, n)
    t = build_tree(mesh)
    index, corners = np.asarray(t.index), corners_of(mesh)
    assert sorted(index[index >= 0]) == list(range(n))
    np.testing.assert_array_equal(np.asarray(t.triangles).reshape(-1, 3, 3), corners[np.asarray(t.source_index())])
    for level, rows in enumerate(np.asarray(x, dtype=float) for x in t.levels):
        p = np.asarray(t.triangles).reshape(2**level, -1, 3) - rows[:, None, :3]
        height = np.einsum("nki,ni->nk", p, rows[:, 3:6])
        beside = np.linalg.norm(p - height[:, :, None] * rows[:, None, 3:6], axis=2)
        assert (np.abs(height) <= rows[:, 7:]).all()
        assert (beside <= rows[:, 6:7]).all()


def above_the_groove(n: int) -> np.ndarray:
    """Centres of a button of 25 mm, up to 0.2 mm deep in the rig's implant."""
    mesh, rng = implant_mesh(), np.random.default_rng(3)
    middles, normals = corners_of(mesh).mean(axis=1), mesh.area_vectors / mesh.face_areas[:, None]
    near = np.flatnonzero((np.abs(middles[:, 1]) < 0.015) & (normals[:, 2] > 0))
    which = rng.choice(near, n)
    return middles[which] + rng.uniform(0.0248, 0.025, (n, 1)) * normals[which]


def test_the_nearest_on_an_implant():
    mesh, points = implant_mesh(), above_the_groove(200)
    t = build_tree(mesh, leaf=1)
    found = searched(t, points)
    assert not found.overflow.any()
    triangles = t.source_index()[found.place]
    for p, own in zip(points[:50], np.asarray(triangles), strict=False):
        distances = brute_force.distances(corners_of(mesh), p)
        assert distances[own] <= distances.min() + 1e-12


def test_a_search_without_room_says_so(monkeypatch):
    monkeypatch.setattr("pftwin.geometry.bvh.wide.WIDTH", 2)
    tree = build_tree(implant_mesh(), leaf=1)
    wide = wide_tree(tree)
    found = jax.jit(jax.vmap(lambda p: nearest_wide(wide, tree.triangles, point(p))))  # a program of its own
    assert found(jnp.asarray(above_the_groove(50))).overflow.all()


def test_one_program_serves_moved_meshes_and_maps_over_them():
    mesh = soup(5)
    moved = [build_tree(SurfaceMesh(mesh.vertices + shift, mesh.faces), leaf=1) for shift in (0.0, 0.004)]
    stacked = jax.tree.map(lambda *a: jnp.stack(a), *((wide_tree(t), t.triangles) for t in moved))
    p = jnp.array([0.01, 0.02, 0.0])
    mapped = jax.jit(jax.vmap(lambda wide, triangles: nearest_wide(wide, triangles, point(p)).place))
    places = mapped(*stacked)
    for tree_of, place in zip(moved, places, strict=True):
        assert int(place) == int(searched(tree_of, p[None]).place[0])
    assert jax.tree.structure(moved[0]) == jax.tree.structure(moved[1])


def test_a_tree_is_built_once_and_then_read_from_the_cache(tmp_path, monkeypatch):
    mesh = implant_mesh()
    calls = []

    def counted(*args):
        calls.append(args)
        return tree_arrays(*args)

    monkeypatch.setattr(tree, "cached", lambda f, *args, files: counted(*args))
    build_tree(mesh)
    assert len(calls) == 1
    monkeypatch.undo()
    before = cache_folder.chosen()
    try:
        cache_folder.use_cache_folder(tmp_path)
        first = build_tree(mesh)
        assert len(list((tmp_path / "values").iterdir())) == 1
        again = build_tree(mesh)
        build_tree(mesh, leaf=8)
        assert len(list((tmp_path / "values").iterdir())) == 2
    finally:
        cache_folder.use_cache_folder(before)
    for a, b in zip(jax.tree.leaves(first), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(a, b)


def test_meshes_without_a_tree():
    with pytest.raises(InputError, match="0 triangles"):
        build_tree(SurfaceMesh(np.zeros((0, 3)), np.zeros((0, 3), int)))
    with pytest.raises(InputError, match="not finite"):
        build_tree(SurfaceMesh(np.full((3, 3), np.nan), np.arange(3)[None]))


def test_two_trees_under_one_root_are_searched_one_at_a_time():
    meshes = soup(1, 60), soup(2, 9)  # the second has leaves without triangles of their own
    trees = [build_tree(m, leaf=1, depth=6) for m in meshes]
    both = joined_tree(trees)
    points = np.random.default_rng(0).uniform(-0.07, 0.07, (20, 3))
    for k in range(2):
        found = searched(both, points, half=k)
        assert not found.overflow.any()
        for p, place in zip(points, np.asarray(found.place), strict=True):
            distances = brute_force.distances(corners_of(meshes[k]), p)
            own = trees[k].source_index()[int(place) - k * trees[0].index.shape[0]]
            assert distances[int(own)] <= distances.min() + 1e-15


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"leaf": 0}, "leaves of 0 triangles"),
        ({"depth": 2}, "a depth of 2; expected: 4 or more"),
    ],
)
def test_trees_that_cannot_be(arguments, message):
    with pytest.raises(InputError, match=message):
        build_tree(soup(1), **arguments)
