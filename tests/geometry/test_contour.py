"""Contacts of two meshes: closed forms, both facets, gradients."""

from __future__ import annotations

import brute_force
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from height_meshes import grid, plate
from mesh_contacts import RADIUS, at, lateral, member, mesh_pair, on_the_groove

from pftwin.base.spatial import Pose, Quaternion, Vec3
from pftwin.geometry.bvh.triangle import Triangle, crossing
from pftwin.geometry.contact.contact_mesh import contact_mesh
from pftwin.geometry.contact.contour import Contacts, MeshPair
from pftwin.geometry.mesh.icosphere import icosphere
from pftwin.geometry.mesh.mesh import SurfaceMesh


@eqx.filter_jit
def contacts(pair: MeshPair, X: Pose) -> Contacts:
    return pair.contacts(X)


def beyond_middle(mesh: SurfaceMesh) -> np.ndarray:
    """Which triangles are at y > 0."""
    return mesh.vertices[mesh.faces].mean(axis=1)[:, 1] > 0


def array(v: Vec3) -> np.ndarray:
    return np.asarray(v.array())


@pytest.fixture(scope="module")
def on_a_plate() -> MeshPair:
    return mesh_pair(contact_mesh(plate()), contact_mesh(icosphere(RADIUS, 60)))


def test_a_sphere_in_a_plate(on_a_plate):
    depth = 0.4e-3
    found = contacts(on_a_plate, at(1e-3, 2e-3, RADIUS - depth))
    (c,) = found.each
    deviation = 1e-5  # of the icosphere from the sphere, generously
    np.testing.assert_allclose(c.indentation, depth, atol=deviation)
    np.testing.assert_allclose(c.area, np.pi * (2 * RADIUS * depth - depth**2), rtol=0.02)
    np.testing.assert_allclose(array(c.normal), [0, 0, 1], atol=1e-9)
    np.testing.assert_allclose(array(c.point), [1e-3, 2e-3, 0], atol=5e-5)
    assert not found.overflow
    assert not found.too_deep
    assert not found.merged


def test_without_contact_contours_and_their_gradients_are_zero(on_a_plate):
    def some(z):
        (c,) = on_a_plate.contacts(_lifted(z)).each
        return c.indentation + c.area + c.normal.z + c.point.x

    value, slope = jax.jit(jax.value_and_grad(some))(jnp.asarray(RADIUS + 1e-3))
    assert float(value) == 0
    assert float(slope) == 0


triangles_cross = jax.jit(lambda a, b: crossing(*(Triangle.of_rows(x) for x in (a, b))))


def _lifted(z) -> Pose:
    return Pose(Vec3(jnp.asarray(0.0), jnp.asarray(0.0), z), Quaternion.identity())


@pytest.mark.parametrize("mode", [jax.jacfwd, pytest.param(jax.jacrev, marks=pytest.mark.slow)])
def test_gradients_are_those_of_finite_differences(mode):
    """In the middle of a saddle, and on its rim at x = 30 mm, where the contour is cut."""
    mesh = grid(lambda x, y: 8.0 * (y * y) - 3.0 * x * x, 21)
    pair = mesh_pair(contact_mesh(mesh), contact_mesh(icosphere(RADIUS, 18)))

    def look(d, place):
        turn = Quaternion.from_rotation_vector(Vec3(0.1 + d[3], 0.2 + d[4], 0.3 + d[5]))
        found = pair.contacts(Pose(Vec3.from_array(place + d[:3]), turn))
        (c,) = found.each
        numbers = jnp.concatenate(
            [jnp.stack([c.indentation * 1e3, c.area * 1e6]), c.normal.array(), c.point.array() * 1e3]
        )
        return numbers, (numbers, found.at_rim)

    slopes_and_values = jax.jit(mode(look, has_aux=True))  # one program for both: compiling it takes longest
    upright = np.array([6 * 0.0295, 0.0, 1.0]) / np.hypot(6 * 0.0295, 1.0)
    on_rim = np.array([0.0295, 0.4e-3, -3.0 * 0.0295**2]) + (RADIUS - 0.33e-3) * upright
    for place, cut in (((0.7e-3, 0.4e-3, RADIUS - 0.33e-3), False), (on_rim, True)):
        place = jnp.asarray(place)
        slopes, (_, at_rim) = slopes_and_values(jnp.zeros(6), place)
        assert bool(at_rim) is cut
        looked = [slopes_and_values(jnp.asarray(s * step), place)[1][0] for s in (1, -1) for step in 1e-8 * np.eye(6)]
        differences = (np.stack(looked[:6]) - np.stack(looked[6:])).T / 2e-8
        assert np.isfinite(slopes).all()
        np.testing.assert_allclose(slopes, differences, rtol=1e-5, atol=1e-5 * float(np.abs(differences).max()))


@pytest.mark.slow
def test_a_groove_is_touched_on_both_facets():
    # A groove of 14 mm radius under a button of 25 mm: two contacts, mirror images of each other.
    mesh = grid(lambda x, y: 0.6 * np.abs(y) - 2.0 * x * x, 81, (0.02, 0.02))
    pair = mesh_pair(
        contact_mesh(mesh, mesh.vertices[mesh.faces].mean(axis=1)[:, 1] > 0), contact_mesh(icosphere(RADIUS, 40))
    )
    height = RADIUS * np.sqrt(1 + 0.6**2)
    found = contacts(pair, at(0.0, 0.0, height - 0.3e-3, (0.0, 0.0, 0.0)))
    medial, side = found.each
    assert not found.merged
    steep = np.arctan(0.6)
    np.testing.assert_allclose(array(medial.normal), [0, np.sin(steep), np.cos(steep)], atol=2e-3)
    np.testing.assert_allclose(array(side.normal), [0, -np.sin(steep), np.cos(steep)], atol=2e-3)
    np.testing.assert_allclose([float(medial.indentation), float(side.indentation)], 0.3e-3 * np.cos(steep), rtol=0.05)
    np.testing.assert_allclose(array(medial.point), array(side.point) * [1, -1, 1], atol=1e-4)


@pytest.mark.slow
def test_a_contact_across_the_border_of_the_facets_is_one():
    mesh = plate()
    pair = mesh_pair(
        contact_mesh(mesh, mesh.vertices[mesh.faces].mean(axis=1)[:, 1] > 0), contact_mesh(icosphere(RADIUS, 60))
    )
    whole = mesh_pair(contact_mesh(mesh), contact_mesh(icosphere(RADIUS, 60)))
    X = at(1e-3, 0.5e-3, RADIUS - 0.4e-3)
    found, (alone,) = contacts(pair, X), contacts(whole, X).each
    assert found.merged
    one, other = found.each
    assert float(other.indentation) == 0
    assert float(other.area) == 0
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(alone), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12)


def test_deeper_than_the_search_is_flagged(on_a_plate):
    assert contacts(on_a_plate, at(0.0, 0.0, RADIUS - 8e-3)).too_deep
    assert not contacts(on_a_plate, at(0.0, 0.0, RADIUS - 1e-3)).too_deep


@pytest.mark.slow
def test_a_surface_that_is_wholly_behind_another_is_flagged():
    pair = mesh_pair(contact_mesh(plate()), contact_mesh(plate(8, 0.01).flipped()))
    found = contacts(pair, at(0.0, 0.0, -1e-3, (0.0, 0.0, 0.0)))
    assert int(found.pairs) == 0
    assert found.too_deep
    assert not contacts(pair, at(0.0, 0.0, 1e-3, (0.0, 0.0, 0.0))).too_deep


def test_a_contour_that_ends_on_a_rim_is_flagged(on_a_plate):
    edge = 0.03
    for place, expected in ((edge - 0.01, False), (edge - 1e-3, True), (edge + 1e-3, True)):
        assert bool(contacts(on_a_plate, at(place, 0.0, RADIUS - 0.4e-3)).at_rim) is expected
    dome = icosphere(RADIUS, 30)
    bottom = dome.vertices[dome.faces].mean(axis=1)[:, 2] < -0.9 * RADIUS
    pair = mesh_pair(contact_mesh(plate()), contact_mesh(SurfaceMesh(dome.vertices, dome.faces[bottom])))
    for tilt, expected in ((0.0, False), (0.45, True)):
        assert bool(contacts(pair, at(0.0, 0.0, RADIUS - 0.4e-3, (tilt, 0.0, 0.0))).at_rim) is expected


@pytest.mark.parametrize("past", [-2e-3, 0.0, 2e-3])
def test_on_the_edge_of_a_plate_a_contour_is_closed_along_it(on_a_plate, past):
    """A circle's part on one side of a chord: its area, and the middle of arc and chord by their lengths."""
    depth, edge = 0.4e-3, 0.03
    found = contacts(on_a_plate, at(edge + past, 2e-3, RADIUS - depth))
    (c,) = found.each
    r = np.sqrt(2 * RADIUS * depth - depth**2)
    half = np.arccos(past / r)  # of the arc's angle
    arc, chord = 2 * half * r, 2 * r * np.sin(half)
    middle = arc * (past - r * np.sin(half) / half) / (arc + chord)
    assert found.at_rim
    np.testing.assert_allclose(array(c.normal), [0, 0, 1], atol=1e-9)
    np.testing.assert_allclose(c.area, r * r * (half - np.sin(half) * np.cos(half)), rtol=0.02)
    np.testing.assert_allclose(array(c.point), [edge + middle, 2e-3, 0], atol=5e-5)


def test_over_a_corner_of_a_plate_and_on_its_own_rim_the_direction_is_the_plates(on_a_plate):
    corner = contacts(on_a_plate, at(0.029, 0.0285, RADIUS - 0.4e-3))
    dome = icosphere(RADIUS, 30)
    bottom = dome.vertices[dome.faces].mean(axis=1)[:, 2] < -0.9 * RADIUS
    cap = mesh_pair(contact_mesh(plate()), contact_mesh(SurfaceMesh(dome.vertices, dome.faces[bottom])))
    tilted = contacts(cap, at(0.0, 0.0, RADIUS - 0.4e-3, (0.45, 0.0, 0.0)))
    for found in (corner, tilted):
        assert found.at_rim
        np.testing.assert_allclose(array(found.each[0].normal), [0, 0, 1], atol=1e-9)


@pytest.mark.slow
def test_a_batch_is_what_its_members_are(on_a_plate):
    heights = RADIUS - jnp.array([-1e-3, 0.1e-3, 0.3e-3])
    together = jax.jit(jax.vmap(lambda z: on_a_plate.contacts(_lifted(z))))(heights)
    for k in range(3):
        for a, b in zip(*map(jax.tree.leaves, (contacts(on_a_plate, _lifted(heights[k])), together)), strict=True):
            np.testing.assert_allclose(a, b[k], rtol=1e-12, atol=1e-18)


@pytest.mark.slow
def test_on_the_implant_the_indentation_is_the_spheres():
    from pftwin.rig.contacts import implant_mesh

    mesh = implant_mesh()
    pair = mesh_pair(contact_mesh(mesh, lateral(mesh)), contact_mesh(icosphere(RADIUS, 35)))
    poses = on_the_groove(8, 0.3e-3, seed=5)
    for k in range(8):
        X = member(poses, k)
        found = contacts(pair, X)
        p = mesh.vertices - np.asarray(X.position.array())
        deepest = max(float(c.indentation) for c in found.each)
        np.testing.assert_allclose(deepest, RADIUS - np.linalg.norm(p, axis=1).min(), atol=2e-5)
        for c in found.each:
            if float(c.area) > 0:  # towards the sphere's middle
                arm = array(X.position) - array(c.point)
                assert arm @ array(c.normal) / np.linalg.norm(arm) > 0.998


def test_crossings_of_random_triangles_lie_on_both():
    rng = np.random.default_rng(4)
    rows = rng.normal(size=(2, 2000, 9))
    segment = jax.tree.map(np.asarray, triangles_cross(*(jnp.asarray(x) for x in rows)))
    np.testing.assert_array_equal(segment.crossing, brute_force.meet(*rows.reshape(2, -1, 3, 3)))
    assert 100 < segment.crossing.sum() < 1900
    for end in (segment.start, segment.end):
        for corner, one, two in (x.reshape(-1, 3, 3).swapaxes(0, 1) for x in rows):
            normal = np.cross(one - corner, two - corner)
            away = np.stack([end.x, end.y, end.z], axis=1) - corner
            off = np.abs(np.sum(away * normal, axis=1)) / np.linalg.norm(normal, axis=1)
            np.testing.assert_array_less(np.where(segment.crossing, off, 0.0), 1e-10)
