"""Pairs of triangles that meet, by two trees and by brute force."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mesh_samples import corners_of, point, random_poses, soup

from pftwin.rig.cases import implant_mesh
from pftwin.spatial import Pose, Quaternion, Vec3
from pftwin.surfaces.bvh import brute_force
from pftwin.surfaces.bvh.nearest import nearest
from pftwin.surfaces.bvh.pairs import Pairs, candidate_pairs
from pftwin.surfaces.bvh.tree import MeshTree, build_tree
from pftwin.surfaces.icosphere import icosphere
from pftwin.surfaces.mesh import SurfaceMesh
from pftwin.surfaces.triangle import Triangle, closest_on_triangle
from pftwin.surfaces.triangle_pairs import meet

KINDS = ["disc", "box"]
BUTTON = icosphere(0.025, 16)


@eqx.filter_jit
def searched(a: MeshTree, b: MeshTree, poses: Pose, chunk: int | None = None, **room: int):
    """Candidates at a batch of poses, and which of them meet."""

    def at(pose: Pose) -> tuple[Pairs, jax.Array]:
        pairs = candidate_pairs(a, b, pose, chunk=chunk, **room)
        second = Triangle.of_rows(b.triangles[pairs.b])
        moved = jax.tree.map(pose.apply, second, is_leaf=lambda x: isinstance(x, Vec3))
        return pairs, meet(Triangle.of_rows(a.triangles[pairs.a]), moved) & pairs.valid()

    one_by_one = chunk is not None
    return jax.lax.map(at, poses) if one_by_one else jax.vmap(at)(poses)


def met(a: MeshTree, b: MeshTree, pairs: Pairs, hits, k: int) -> np.ndarray:
    """The triangles that meet at the k-th pose, (n, 2) ascending."""
    own = np.asarray(hits[k])
    found = np.stack([np.asarray(t.index)[np.asarray(p[k])[own]] for t, p in ((a, pairs.a), (b, pairs.b))], axis=1)
    return found[np.lexsort((found[:, 1], found[:, 0]))]


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**31), kind=st.sampled_from(KINDS))
def test_random_triangles_at_random_poses(seed, kind):
    meshes = soup(seed), soup(seed + 1, 40)
    flat = [SurfaceMesh(m.vertices, m.faces[:-1]) for m in meshes]  # the last has no area, and meets by chance only
    a, b = (build_tree(m, kind=kind, leaf=leaf) for m, leaf in zip(flat, (4, 3), strict=True))
    poses = random_poses(6, seed, 0.05)
    pairs, hits = searched(a, b, poses, nodes=1024, triangles=1536)
    assert not pairs.overflow.any()
    for k in range(6):
        pose = jax.tree.map(lambda x, k=k: x[k], poses)
        expected = brute_force.intersecting(corners_of(flat[0]), corners_of(flat[1], pose))
        np.testing.assert_array_equal(met(a, b, pairs, hits, k), expected)


def _foot(corners: jax.Array, p: jax.Array) -> jax.Array:
    """The point of a triangle nearest to p."""
    return closest_on_triangle(Triangle.of_rows(corners.reshape(9)), point(p)).point.array()


def on_the_groove(n: int, depth: float, seed: int = 0) -> Pose:
    """Poses of the button, turned anyhow, deep in the rig's implant by up to some depth [m]."""
    mesh, rng = implant_mesh(), np.random.default_rng(seed)
    middles, normals = corners_of(mesh).mean(axis=1), mesh.area_vectors / mesh.face_areas[:, None]
    near = np.flatnonzero((np.abs(middles[:, 1]) < 0.012) & (normals[:, 2] > 0.2))
    which = rng.choice(near, n)
    place = middles[which] + 0.025 * normals[which]
    wanted, corners = 0.025 - rng.uniform(0.2, 1, n) * depth, corners_of(mesh)
    tree, foot = build_tree(mesh), jax.jit(jax.vmap(_foot))
    find = jax.jit(jax.vmap(lambda p: nearest(tree, point(p)).place))
    for _ in range(4):  # off the facet that is nearest, until that is as deep as wanted
        on = np.asarray(foot(corners[tree.source_index()[find(place)]], place))
        away = place - on
        place = on + (wanted / np.linalg.norm(away, axis=1))[:, None] * away
    return Pose(Vec3.from_array(place), random_poses(n, seed, 0.0).orientation)


@pytest.fixture(scope="module")
def trees() -> dict[str, tuple[MeshTree, MeshTree]]:
    return {
        kind: (build_tree(implant_mesh(), kind=kind, leaf=4), build_tree(BUTTON, kind=kind, leaf=3)) for kind in KINDS
    }


@pytest.mark.parametrize("kind", KINDS)
def test_a_button_in_the_groove(trees, kind):
    poses = on_the_groove(6, 0.3e-3)
    a, b = trees[kind]
    pairs, hits = searched(a, b, poses)
    assert not pairs.overflow.any()
    counts = []
    for k in range(6):
        pose = jax.tree.map(lambda x, k=k: x[k], poses)
        expected = brute_force.intersecting(corners_of(implant_mesh()), corners_of(BUTTON, pose))
        np.testing.assert_array_equal(met(a, b, pairs, hits, k), expected)
        counts.append(len(expected))
    assert min(counts) > 20


def test_pieces_of_a_list_and_the_whole_list_give_the_same(trees):
    poses = on_the_groove(4, 0.3e-3, seed=1)
    whole, pieces = searched(*trees["disc"], poses), searched(*trees["disc"], poses, chunk=32)
    for a, b in zip(jax.tree.leaves(whole), jax.tree.leaves(pieces), strict=True):
        np.testing.assert_array_equal(a, b)
    with pytest.raises(ValueError, match="no multiple of the chunk"):
        searched(*trees["disc"], poses, chunk=33)


def test_overflow_is_flagged_where_room_is_short(trees):
    poses = on_the_groove(4, 0.3e-3)
    for room in ({"nodes": 8}, {"triangles": 16}):
        pairs, _ = searched(*trees["disc"], poses, **room)
        assert pairs.overflow.all()


def test_a_clear_pose_has_no_pairs(trees):
    far = Pose(
        Vec3(*(jnp.array([x]) for x in (0.0, 0.0, 0.2))), Quaternion(*(jnp.array([x]) for x in (1.0, 0.0, 0.0, 0.0)))
    )
    pairs, _ = searched(*trees["disc"], far)
    assert pairs.count.tolist() == [0]
    assert not pairs.overflow.any()


def test_trees_of_different_kinds_do_not_mix(trees):
    with pytest.raises(TypeError, match="disc and box"):
        searched(trees["disc"][0], trees["box"][1], on_the_groove(1, 1e-4))


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_thousand_poses(trees, kind):
    poses = on_the_groove(1000, 0.5e-3, seed=7)
    a, b = trees[kind]
    pairs, hits = searched(a, b, poses, chunk=64)
    checked = 0
    for k in range(1000):
        if bool(pairs.overflow[k]):
            continue
        pose = jax.tree.map(lambda x, k=k: x[k], poses)
        expected = brute_force.intersecting(corners_of(implant_mesh()), corners_of(BUTTON, pose))
        np.testing.assert_array_equal(met(a, b, pairs, hits, k), expected)
        checked += 1
    assert checked > 950
