"""Derivatives of contacts by the meshes' own corners, and of second order."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from height_meshes import plate
from mesh_contacts import RADIUS, at, mesh_pair

from pftwin.base.spatial import Pose, Vec3
from pftwin.geometry.bvh.pairs import PairListLengths
from pftwin.geometry.contact.contact_mesh import contact_mesh
from pftwin.geometry.contact.contour import MeshPair
from pftwin.geometry.mesh.icosphere import icosphere


@pytest.fixture(scope="module")
def coarse() -> tuple[MeshPair, Pose]:
    pair = mesh_pair(contact_mesh(plate(9)), contact_mesh(icosphere(RADIUS, 9)), room=PairListLengths(1024, 1024, 64))
    return pair, at(0.7e-3, 0.4e-3, RADIUS - 0.4e-3)


def _numbers(pair: MeshPair, X: Pose) -> jax.Array:
    (c,) = pair.contacts(X).each
    return jnp.concatenate([jnp.stack([c.indentation, c.area]), c.normal.array(), c.point.array()])


@pytest.mark.parametrize("differentiated", [jax.jacfwd, jax.jacrev], ids=["forward", "reverse"])
@pytest.mark.slow
def test_a_mesh_that_moves_by_its_corners_is_one_at_another_pose(coarse, differentiated):
    pair, X = coarse

    def by_corners(shift):
        moved = eqx.tree_at(lambda p: p.a.tree.triangles, pair, pair.a.tree.triangles + jnp.tile(shift, 3)[None])
        return _numbers(moved, X)

    def by_pose(shift):
        back = Pose(X.position - Vec3.from_array(shift), X.orientation)
        return _numbers(pair, back).at[5:].add(shift)

    slopes, expected = (jax.jit(differentiated(f))(jnp.zeros(3)) for f in (by_corners, by_pose))
    np.testing.assert_allclose(slopes, expected, rtol=1e-9, atol=1e-9 * float(np.abs(expected).max()))
    assert (np.abs(expected) > 0).any(axis=0).all()


@pytest.mark.slow
def test_second_derivatives_are_those_of_the_first(coarse):
    pair, X = coarse

    def area(d):
        (c,) = pair.contacts(Pose(X.position + Vec3.from_array(d), X.orientation)).each
        return c.area * 1e6

    slope = jax.jacrev(area)
    curvature = jax.jit(jax.jacfwd(slope))(jnp.zeros(3))
    steps = 1e-8 * jnp.eye(3)
    sloped = jax.jit(jax.vmap(slope))(jnp.concatenate([steps, -steps]))
    differences = (sloped[:3] - sloped[3:]) / 2e-8
    np.testing.assert_allclose(curvature, differences, rtol=1e-4, atol=1e-4 * float(np.abs(differences).max()))
