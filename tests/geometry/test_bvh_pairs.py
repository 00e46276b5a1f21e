"""Pairs of triangles that meet, by two trees and by brute force."""

from __future__ import annotations

from functools import partial
from itertools import pairwise

import brute_force
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mesh_contacts import RADIUS, member, on_the_groove
from mesh_samples import corners_of, random_poses, soup

from pftwin.base.spatial import Pose, Quaternion, Vec3
from pftwin.geometry.bvh.descent import steps_down
from pftwin.geometry.bvh.loops import pushed_where, queue_of
from pftwin.geometry.bvh.pairs import PairListLengths, Pairs, PairSearch, pair_search
from pftwin.geometry.bvh.tree import build_tree
from pftwin.geometry.mesh.icosphere import icosphere
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.rig.contacts import implant_mesh

BUTTON = icosphere(RADIUS, 16)


@eqx.filter_jit
def one_by_one(search: PairSearch, poses: Pose) -> Pairs:
    return jax.lax.map(search.meeting, poses)


@eqx.filter_jit
def at_once(search: PairSearch, poses: Pose) -> Pairs:
    return jax.vmap(search.meeting)(poses)


def met(search: PairSearch, pairs: Pairs, k: int) -> np.ndarray:
    """The triangles that meet at the k-th pose, (n, 2) ascending."""
    n = int(pairs.count[k])
    found = [np.asarray(t.index)[np.asarray(p[k])[:n]] for t, p in ((search.a, pairs.a), (search.b, pairs.b))]
    return np.stack(found, axis=1)[np.lexsort(found[::-1])]


def test_queue_takes_what_is_true_in_order_and_counts_what_it_loses():
    rng = np.random.default_rng(0)
    masks = rng.random((40, 16)) < rng.random((40, 1))

    @partial(jax.jit, static_argnums=0)
    def fill(width: int):
        def push(queue, given):
            k, mask = given
            return pushed_where(queue, mask, lambda lane: 16 * k + lane), None

        return jax.lax.scan(push, queue_of(width), (jnp.arange(40, dtype=jnp.int32), jnp.asarray(masks)))[0]

    wide, narrow = fill(640), fill(50)
    expected = np.flatnonzero(masks.ravel())
    assert int(wide.count) == len(expected) == int(narrow.count)
    np.testing.assert_array_equal(wide.entries[: len(expected)], expected)
    np.testing.assert_array_equal(narrow.entries[:50], expected[:50])
    assert bool(narrow.overflow)
    assert not bool(wide.overflow)


@pytest.mark.parametrize("depths", [(0, 0), (1, 0), (3, 1), (13, 11), (12, 13), (15, 3), (2, 14)])
def test_steps_lead_from_few_pairs_to_all_leaves(depths):
    alone, together = steps_down(depths)
    steps = [*alone, *together]
    assert (steps[-1].end if steps else depths) == depths
    assert all(s.end == t.start for s, t in pairwise(steps))
    assert all(s.many[0] * s.many[1] == 16 for s in steps)
    assert sum(steps[0].start if steps else depths) <= 6


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**31), sizes=st.sampled_from([(60, 40), (9, 60), (60, 2)]))
@example(seed=651, sizes=(60, 40))  # a needle whose plane single precision does not know
@pytest.mark.slow
def test_random_triangles_at_random_poses(seed, sizes):
    # The last triangle of a soup has no area, and meets by chance only.
    flat = [SurfaceMesh(m.vertices, m.faces[:-1]) for m in (soup(seed, sizes[0]), soup(seed + 1, sizes[1]))]
    search = pair_search(*(build_tree(m) for m in flat), PairListLengths(1024, 1536))
    poses = random_poses(6, seed, 0.05)
    pairs = one_by_one(search, poses)
    assert not pairs.overflow.any()
    for k in range(6):
        expected = brute_force.intersecting(corners_of(flat[0]), corners_of(flat[1], member(poses, k)))
        np.testing.assert_array_equal(met(search, pairs, k), expected)


@pytest.fixture(scope="module")
def search() -> PairSearch:
    return eqx.filter_jit(pair_search)(build_tree(implant_mesh()), build_tree(BUTTON))


@pytest.mark.slow
def test_a_button_in_the_groove(search):
    poses = on_the_groove(6, 0.3e-3)
    pairs = one_by_one(search, poses)
    assert not pairs.overflow.any()
    counts = []
    for k in range(6):
        expected = brute_force.intersecting(corners_of(implant_mesh()), corners_of(BUTTON, member(poses, k)))
        np.testing.assert_array_equal(met(search, pairs, k), expected)
        counts.append(len(expected))
    assert min(counts) > 20


def test_a_batch_is_what_its_members_are(search):
    poses = on_the_groove(6, 0.3e-3, seed=1)  # as many as above: one program
    for a, b in zip(*(jax.tree.leaves(f(search, poses)) for f in (one_by_one, at_once)), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("room", [PairListLengths(8, 8192), PairListLengths(2048, 16), PairListLengths(2048, 8192, 8)])
def test_overflow_is_flagged_where_room_is_short(search, room):
    search = PairSearch(search.a, search.b, search.descent, search.triangles, search.near, room)
    assert one_by_one(search, on_the_groove(4, 0.3e-3)).overflow.all()


def test_a_clear_pose_has_no_pairs(search):
    far = Pose(
        Vec3(*(jnp.full(6, x) for x in (0.0, 0.0, 0.2))), Quaternion(*(jnp.full(6, x) for x in (1.0, 0.0, 0.0, 0.0)))
    )
    pairs = one_by_one(search, far)
    assert pairs.count.tolist() == [0] * 6
    assert not pairs.overflow.any()


@pytest.mark.slow
def test_a_thousand_poses(search):
    poses = on_the_groove(1000, 0.5e-3, seed=7)
    pairs = one_by_one(search, poses)
    assert not pairs.overflow.any()
    for k in range(1000):
        expected = brute_force.intersecting(corners_of(implant_mesh()), corners_of(BUTTON, member(poses, k)))
        np.testing.assert_array_equal(met(search, pairs, k), expected)


def test_trees_that_do_not_go_together_are_refused(search):
    with pytest.raises(TypeError, match="leaves of 4 and 8"):
        pair_search(search.a, build_tree(BUTTON, leaf=8))
