"""A sphere on a mesh by the volume of their overlap: closed forms, seams, energy, the smooth surface."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from height_meshes import grid, lateral, level
from mesh_volumes import K, contact
from scenes import RADIUS, J, look

from pftwin.base.spatial import Vec3
from pftwin.geometry.mesh.icosphere import icosphere
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.model.effects.mesh_volume_contact import MeshVolumeContact

SLOPE = np.radians(20)


FLAT = grid(level)
PLATE, HALVED = contact(FLAT), contact(FLAT, labels=lateral(FLAT))
VEE_MESH = grid(lambda u, v: np.abs(v) * np.tan(SLOPE))
VEE = contact(VEE_MESH, labels=lateral(VEE_MESH))
GROOVE_DEPTH = 0.004 * np.tan(np.radians(12))
GROOVE_MESH = grid(lambda u, v: 0.004 * np.sqrt(1 + (v / 0.004) ** 2) * np.tan(np.radians(12)))
GROOVE = contact(GROOVE_MESH, labels=lateral(GROOVE_MESH), effective=0.03)


@eqx.filter_jit
def loaded(effect, now):
    load, _ = effect.load(now, effect.remember(now))
    return load, load.total(), effect.observe(now, effect.remember(now))


@pytest.mark.parametrize("depth", [1e-6, 1e-4, 1e-3])
def test_on_a_plate_the_indentation_is_the_depth_itself(depth):
    _, total, shown = loaded(PLATE, look((0.0012, 0.0031, RADIUS - depth)))
    np.testing.assert_allclose(shown["indentation_medial"], depth, rtol=2e-5)
    np.testing.assert_allclose(total.force.array(), [0, 0, K * depth**1.5], rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(shown["area_medial"], np.pi * (2 * RADIUS * depth - depth**2), rtol=1e-8)
    np.testing.assert_allclose(shown["point_medial"], [0.0012, 0.0031, 0], atol=1e-9)
    assert set(shown) == set(MeshVolumeContact.observables)
    assert float(shown["overflow"]) == float(shown["off_patch"]) == 0


@pytest.mark.slow
def test_a_plate_of_two_triangles_holds_a_sphere_as_well():
    corners = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0.0]])
    plate = contact(SurfaceMesh(corners, np.array([[0, 1, 2], [0, 2, 3]])))
    _, total, _ = loaded(plate, look((0.2, 0.01, RADIUS - 1e-4)))
    np.testing.assert_allclose(total.force.z, K * 1e-6, rtol=1e-4)


def test_both_sides_of_a_vee_are_separate_volumes():
    depth, aside = 1e-4, 2e-5
    _, total, shown = loaded(VEE, look((0.001, aside, (RADIUS - depth) / np.cos(SLOPE))))
    for facet, side in (("medial", -1), ("lateral", 1)):
        expected = depth + side * aside * np.sin(SLOPE)
        np.testing.assert_allclose(shown[f"indentation_{facet}"], expected, rtol=1e-4)
        np.testing.assert_allclose(shown[f"force_{facet}"], K * expected**1.5, rtol=1e-4)
        assert np.sign(shown[f"point_{facet}"][1]) == side
    np.testing.assert_allclose(total.force.array(), [shown["force_x"], shown["force_y"], shown["force_z"]], atol=1e-9)


@pytest.mark.slow
def test_a_contact_across_the_seam_of_a_plain_surface_is_one():
    """Wherever it lies: labels do not change the force."""
    for y in (-0.004, -2e-3, -1e-3, -1e-9, 0.0, 4e-4, 1.9e-3):
        now = look((0.001, y, RADIUS - 1e-4))
        one, two = loaded(PLATE, now), loaded(HALVED, now)
        np.testing.assert_allclose(two[1].force.array(), one[1].force.array(), rtol=1e-7, atol=1e-6)
        np.testing.assert_allclose(two[0].energy, one[0].energy, rtol=1e-9)
        np.testing.assert_allclose(two[2]["force"], one[2]["force"], rtol=1e-7)


@pytest.mark.parametrize("y", [0.0, 4e-4, -1.1e-3, 4e-3])
def test_one_contact_across_the_border_has_the_plates_closed_form(y):
    """Force and energy of the whole cap, its area cut in two by the border's chord; far from it one facet's alone."""
    depth = 1e-4
    load, total, shown = loaded(HALVED, look((0.001, y, RADIUS - depth)))
    cap = 2 * RADIUS * depth - depth**2  # square of the circle's radius
    beyond = np.clip(y / np.sqrt(cap), -1, 1)
    share = (np.arccos(-beyond) + beyond * np.sqrt(1 - beyond**2)) / np.pi
    np.testing.assert_allclose(total.force.array(), [0, 0, K * depth**1.5], rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(total.moment.array(), 0, atol=1e-7)
    np.testing.assert_allclose(load.energy, K * depth**2.5 / 2.5, rtol=1e-4)
    for facet, part in (("medial", 1 - share), ("lateral", share)):
        np.testing.assert_allclose(shown[f"area_{facet}"], part * np.pi * cap, rtol=1e-6, atol=1e-12)
        expected = depth if part > 0 else np.nan
        np.testing.assert_allclose(shown[f"indentation_{facet}"], expected, rtol=1e-4)
    np.testing.assert_allclose(shown["force_medial"] + shown["force_lateral"], K * depth**1.5, rtol=1e-4)


def test_half_the_rims_length_inside_the_sphere_is_said():
    """The plate ends at x = 30 mm: a chord of the sphere, as far from its centre as the edge is."""
    depth, short = 1e-3, 2e-3
    shown = loaded(PLATE, look((0.03 - short, 0.0031, RADIUS - depth)))[2]
    half = np.sqrt(RADIUS**2 - (RADIUS - depth) ** 2 - short**2)
    np.testing.assert_allclose(shown["off_patch"], half, rtol=1e-9)
    shown = loaded(PLATE, look((0.03 - 8e-3, 0.0031, RADIUS - depth)))[2]  # the cap's circle is 6.6 mm wide
    assert float(shown["off_patch"]) == 0


def test_on_the_edge_of_a_plate_the_force_leans_as_the_volume_falls():
    """By the depth over half a circle: pi r^2 / 2 for a step down, 2 r^3 / 3R for one past the edge."""
    depth = 4e-4
    push = np.asarray(loaded(PLATE, look((0.03, 0.0031, RADIUS - depth)))[1].force.array())
    r = np.sqrt(2 * RADIUS * depth - depth**2)
    lean = np.arctan2(push[0], push[2])
    np.testing.assert_allclose(lean, np.arctan(4 * r / (3 * np.pi * RADIUS)), rtol=0.02)
    assert np.degrees(lean) < 5
    np.testing.assert_allclose(push[1], 0, atol=1e-9 * push[2])


@pytest.mark.parametrize("height", [0.0, -1e-4, -3e-4])
def test_between_two_contacts_and_one_the_force_is_the_energys_slope(height):
    """In a groove that the sphere fills more and more: by differences of the energy, in every direction."""
    place, h = np.array([1e-4, 3e-4, RADIUS + GROOVE_DEPTH + height]), 1e-8
    at = [place] + [place + s * h * e for e in np.eye(3) for s in (1, -1)]
    found = [loaded(GROOVE, look(p)) for p in at]
    stored = [float(f[0].energy) for f in found]
    slope = [(stored[1 + 2 * k] - stored[2 + 2 * k]) / (2 * h) for k in range(3)]
    force = np.asarray(found[0][1].force.array())
    np.testing.assert_allclose(force, -np.array(slope), rtol=1e-5, atol=1e-5 * np.abs(force).max())
    assert force[2] > 50
    assert (0.1 < float(_merged(GROOVE, J(place))) < 0.9) is (height < 0)


def energy_and_force(effect, p):
    """In one array."""
    now = eqx.tree_at(lambda n: n.patella.position, look(), Vec3.from_array(p))
    load = effect.load(now, effect.remember(now))[0]
    return jnp.concatenate([load.energy[None], load.total().force.array()])


@pytest.fixture(scope="module")
def rates():
    """By mode: energy and force, and their slopes by the place."""

    def program(mode):
        def both(effect, p):
            found = energy_and_force(effect, p)
            return found, found

        return eqx.filter_jit(lambda e, p: mode(lambda q: both(e, q), has_aux=True)(p))

    return program(jax.jacfwd), program(jax.jacrev)


@pytest.mark.slow
def test_force_and_energy_go_on_smoothly_while_two_contacts_become_one(rates):
    """Down into a rounded groove: two contacts, then one across its bottom; the force stays the energy's slope."""
    groove = grid(lambda u, v: 0.004 * np.sqrt(1 + (v / 0.004) ** 2) * np.tan(np.radians(12)), 81, (0.012, 0.012))
    effect = contact(groove, labels=lateral(groove), effective=0.03)
    heights = RADIUS + np.linspace(1.2e-3, -0.6e-3, 46)
    path = [J([1e-4, 2e-5, z]) for z in heights]
    merged = np.array([float(_merged(effect, p)) for p in path])
    assert merged.min() == 0
    assert merged.max() == 1
    assert ((merged > 0.02) & (merged < 0.98)).sum() >= 3
    _, reverse = rates
    found = [reverse(effect, p) for p in path]
    forces = np.array([values[1:] for _, values in found])
    np.testing.assert_allclose(forces, [-slopes[0] for slopes, _ in found], rtol=1e-7, atol=1e-6)
    # Continuous: halving the step halves the largest jump.
    finer = np.linspace(heights[0], heights[-1], 91)
    fine = np.array([reverse(effect, J([1e-4, 2e-5, z]))[1][1:] for z in finer])
    jumps = [np.abs(np.diff(f[:, 2])).max() for f in (forces, fine)]
    assert jumps[1] < 0.62 * jumps[0]


@eqx.filter_jit
def _merged(effect, p):
    from pftwin.geometry.contact.overlap import overlap
    from pftwin.geometry.contact.sphere_patch import sphere_patch

    return overlap(sphere_patch(effect.mesh, Vec3.from_array(p), effect.radius), J(RADIUS), J(0.03)).merged


@pytest.mark.slow
@pytest.mark.parametrize("spot", ["face", "edge", "vertex", "touch", "clear", "deep", "inside", "rim"])
def test_derivatives_are_finite_and_those_of_differences(spot, rates):
    bumps = grid(lambda u, v: 1e-3 * np.cos(300 * u) * np.cos(300 * v))
    effect = contact(bumps, labels=lateral(bumps))
    step, top = 0.06 / 40, float(bumps.vertices[:, 2].max())
    place = {
        "face": (0.0004, 0.0002, top + RADIUS - 2e-4),
        "edge": (0.5 * step, 0.0, top + RADIUS - 2e-4),
        "vertex": (0.0, 0.0, top + RADIUS - 2e-4),
        "touch": (0.0, 0.0, top + RADIUS),
        "clear": (0.0004, 0.0002, top + RADIUS + 1e-3),
        "deep": (0.0004, 0.0002, top + RADIUS - 5e-3),
        "inside": (0.0004, 0.0002, -0.004),
        "rim": (0.035, 0.0002, top + RADIUS - 3e-3),
    }[spot]
    forward, reverse = rates
    p = J(place)
    slopes, found = forward(effect, p)
    assert np.isfinite(slopes).all()
    backward, _ = reverse(effect, p)
    np.testing.assert_allclose(backward[1:], slopes[1:], rtol=1e-8, atol=1e-6)
    np.testing.assert_allclose(backward[0], -found[1:], rtol=1e-8, atol=1e-7)
    if spot not in ("touch", "clear"):
        sides = [[forward(effect, p + s * h)[1][1:] for s in (1, -1)] for h in 1e-9 * np.eye(3)]
        difference = np.stack([(high - low) / 2e-9 for high, low in sides], axis=1)
        np.testing.assert_allclose(slopes[1:], difference, atol=2e-4 * np.abs(slopes[1:]).max())
        assert float(found[3]) > 0


def test_deep_inside_is_pushed_out_or_flagged():
    """A sphere whose centre is behind a plate goes the long way; one that has no surface in it is at least seen."""
    _, total, shown = loaded(PLATE, look((0.0, 0.0, -0.018)))
    assert float(total.force.z) > 0
    assert float(shown["indentation_medial"]) > RADIUS
    ball = contact(icosphere(0.03, 16))
    _, total, shown = loaded(ball, look((0.001, 0.0, 0.0)))
    assert float(shown["force"]) == 0
    np.testing.assert_allclose(shown["indentation_medial"], RADIUS + 0.029, atol=2e-4)
