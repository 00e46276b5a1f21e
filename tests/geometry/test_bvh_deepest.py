"""The deepest corner of a mesh inside another, by trees and by trying all rays on all triangles."""

from __future__ import annotations

import brute_force
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mesh_contacts import RADIUS, lateral, member, on_the_groove
from mesh_samples import corners_of, random_poses, soup

from pftwin.base.spatial import Pose, Vec3
from pftwin.geometry.bvh.corners import corner_tree, ray_depth
from pftwin.geometry.bvh.deepest import DepthSearch, depth_search
from pftwin.geometry.bvh.triangle import Triangle
from pftwin.geometry.contact.contact_mesh import ContactMesh, contact_mesh
from pftwin.geometry.mesh.icosphere import icosphere
from pftwin.rig.contacts import implant_mesh
from pftwin.studies.hard_cases.ground import lateral_of, mesh_on
from pftwin.studies.hard_cases.knee import TROCHLEA

BUTTON = icosphere(RADIUS, 16)
LIMIT = 5e-3


@eqx.filter_jit
def searched(search: DepthSearch, poses: Pose):
    """The deepest corners and their depths (poses, facets), -1 where there is none."""

    def at(X: Pose):
        found = search(X)
        t = Triangle.of_rows(search.onto.tree.triangles[found.place])
        p = X.apply(Vec3.from_array(search.corners.points[found.corner]))
        n = X.orientation.rotate(Vec3.from_array(search.corners.normals[found.corner]))
        depth, hit = ray_depth(p, n, t)
        return found, jnp.where(found.found, jnp.where(hit, depth, jnp.nan), -1.0)

    return jax.lax.map(at, poses)


def expected(
    onto: ContactMesh, corners: np.ndarray, points: np.ndarray, normals: np.ndarray, pose: Pose
) -> list[float]:
    """Of every facet the depth of the deepest corner."""
    p = np.asarray(pose.apply(Vec3.from_array(points)).array())
    n = np.asarray(pose.orientation.rotate(Vec3.from_array(normals)).array())
    facet = np.asarray(onto.facet(jnp.arange(len(onto.source), dtype=jnp.int32)))
    own = [np.unique(np.asarray(onto.source)[facet == k]) for k in range(onto.facets)]
    return [float(brute_force.ray_depths(p, n, corners[which], LIMIT).max()) for which in own]


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_random_rays_through_random_triangles(seed):
    mesh, rng = soup(seed), np.random.default_rng(seed)
    onto = contact_mesh(mesh, rng.random(len(mesh.faces)) < 0.5)
    points, normals = rng.uniform(-0.05, 0.05, (50, 3)), rng.normal(size=(50, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    search = depth_search(onto, corner_tree(points, normals), LIMIT)
    poses = random_poses(4, seed, 0.02)
    found, depths = searched(search, poses)
    assert not found.overflow.any()
    for k in range(4):
        np.testing.assert_allclose(
            depths[k], expected(onto, corners_of(mesh), points, normals, member(poses, k)), rtol=0, atol=1e-12
        )


@pytest.fixture(scope="module")
def groove() -> tuple[ContactMesh, ContactMesh]:
    mesh = implant_mesh()
    return contact_mesh(mesh, lateral(mesh)), contact_mesh(BUTTON)


def _compare(groove: tuple[ContactMesh, ContactMesh], n: int, seed: int) -> None:
    onto, button = groove
    search = depth_search(onto, button.corners, LIMIT)
    poses = on_the_groove(n, 0.5e-3, seed)
    found, depths = searched(search, poses)
    assert not found.overflow.any()
    points, normals = np.asarray(button.corners.points), np.asarray(button.corners.normals)
    triangles = corners_of(implant_mesh())
    for k in range(n):
        pose = member(poses, k)
        want = expected(onto, triangles, points, normals, pose)
        np.testing.assert_allclose(depths[k], want, rtol=0, atol=1e-12)


@pytest.mark.slow
def test_a_button_in_the_groove(groove):
    _compare(groove, 6, seed=3)


@pytest.mark.slow
def test_a_thousand_poses(groove):
    _compare(groove, 1000, seed=8)


@pytest.mark.slow
def test_a_batch_is_what_its_members_are(groove):
    search = depth_search(groove[0], groove[1].corners, LIMIT)
    poses = on_the_groove(4, 0.3e-3, seed=1)
    alone = searched(search, poses)[0]
    together = eqx.filter_jit(lambda some: jax.vmap(search)(some))(poses)
    for a, b in zip(jax.tree.leaves(alone), jax.tree.leaves(together), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.slow
def test_nothing_is_found_if_the_meshes_do_not_touch(groove):
    search = depth_search(groove[0], groove[1].corners, LIMIT)
    found, depths = searched(search, on_the_groove(4, -0.5e-3, seed=1))
    assert not found.found.any()
    assert (np.asarray(depths) == -1).all()


@pytest.mark.slow
def test_a_mesh_of_few_large_triangles_has_room_for_all_corners():
    """A coarse ground and a fine button that is deep in it: nearly every corner may be over every triangle."""
    mesh = mesh_on(TROCHLEA)
    onto, button = contact_mesh(mesh, lateral_of(mesh)), contact_mesh(BUTTON)
    rng = np.random.default_rng(2)
    middles = np.array([0.0, 0.0, 0.033]) + rng.uniform(-0.012, 0.012, (8, 3))
    turns = random_poses(8, 2, 0.0).orientation
    poses = Pose(Vec3.from_array(jnp.asarray(middles)), turns)
    found, depths = searched(depth_search(onto, button.corners, LIMIT), poses)
    assert not found.overflow.any()
    points, normals = np.asarray(button.corners.points), np.asarray(button.corners.normals)
    for k in range(8):
        want = expected(onto, corners_of(mesh), points, normals, member(poses, k))
        np.testing.assert_allclose(depths[k], want, rtol=0, atol=1e-12)
