"""Both facets where the fan across the groove ends before the contact does: on steep walls, and at a patch's edge."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import RADIUS, contact, fitted, flat_patch, look, patch_of, vec

from pftwin.geometry.contact.facets import FAN, scan_facets
from pftwin.geometry.patch.polynomial import exponents
from pftwin.model.effects.contact_law import Flores, Hertz

J = jnp.asarray
LAW = Hertz(J(2e8))


@eqx.filter_jit
def observed(button, now):
    return button.observe(now, button.remember(now))


def nearest(patch, center):
    """Distance from a point to the patch at u = 0 and the coordinate v of the nearest point, by samples."""
    v = np.linspace(-0.05, 0.05, 200_001)
    height = np.asarray(jax.vmap(patch.height, (None, 0))(J(0.0), J(v)))
    distance = np.hypot(v - center[1], height - center[2])
    return float(distance.min()), float(abs(v[np.argmin(distance)]))


@pytest.mark.parametrize(
    ("angle", "half"),
    [(60, 0.03), *(pytest.param(*p, marks=pytest.mark.slow) for p in ((48, 0.02), (55, 0.02), (60, 0.02), (70, 0.03)))],
)
def test_walls_steeper_than_the_fan_is_wide(angle, half):
    """A button wedged 0.1 mm deep between walls that it touches farther out than the fan's last sample."""
    patch = fitted(lambda u, v: np.sqrt(v**2 + 0.006**2) * np.tan(np.radians(angle)), 4, (0.024, half))
    low, high = -0.05, 0.3
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if nearest(patch, (0, 0, middle))[0] < RADIUS - 1e-4 else (low, middle)
    distance, place = nearest(patch, (0, 0, high))
    assert place > FAN[-1] * RADIUS  # or this shows nothing
    seen = observed(contact(LAW, patch), look((0, 0, high)))
    for side, sign in (("medial", -1), ("lateral", 1)):
        assert float(seen[f"indentation_{side}"]) == pytest.approx(RADIUS - distance, abs=1e-8)
        assert float(seen[f"point_{side}"][1]) == pytest.approx(sign * place, abs=2e-6)


@pytest.mark.parametrize("half", [0.006, 0.010, 0.012])
@pytest.mark.parametrize("beside", [-0.004, 0.0, 0.004])
def test_a_patch_narrower_than_the_fan_is_one_contact(half, beside):
    """The button on a flat patch, where several of the fan's samples lie on its edge: the force of a wide one, once."""
    here = look((0, beside, RADIUS - 1e-4))
    narrow, wide = (observed(contact(LAW, p), here) for p in (patch_of([0.0] * 15, 4, (0.024, half)), flat_patch()))
    assert float(narrow["force"]) == pytest.approx(float(wide["force"]), rel=1e-9)
    np.testing.assert_array_equal(np.isnan(narrow["point_medial"]), np.isnan(wide["point_medial"]))


@pytest.mark.parametrize(("along", "twist", "across"), [(0.0, 25.0, 25.0), (0.0, 20.0, 20.0), (-10.0, 25.0, 20.0)])
@pytest.mark.parametrize("astray", [0.0, 0.004, 0.008])
def test_the_fan_finds_the_bottom_from_a_wrong_place_along_the_groove(along, twist, across, astray):
    """Below the centre of a twisted valley, f = a u^2 / 2 + b u v + c v^2 / 2, whose bottom across turns with u."""
    half = (0.024, 0.02)
    second = {(2, 0): along / 2 * half[0] ** 2, (1, 1): twist * half[0] * half[1], (0, 2): across / 2 * half[1] ** 2}
    valley = patch_of([second.get(ij, 0.0) for ij in exponents(2)], 2, half)
    found = scan_facets(valley, vec(0, 0, RADIUS - 1e-4), J(RADIUS), J(astray))
    np.testing.assert_allclose(found, 0.0, atol=1e-12)


def test_a_frame_shows_the_contact_that_the_step_has_had():
    """A button that the last step held on its medial facet alone, and that has come to touch the lateral one too: the
    velocity is the medial contact's doing, so the force seen is the law's there, not that of a blow on the other facet.
    """
    stiffness, restitution, floor = 2e8, 0.6, 0.01
    button = contact(Flores(J(stiffness), J(restitution)), fitted(lambda u, v: 25 * v**2, 2, (0.024, 0.02)))
    height = next(z for z in np.linspace(0.02, 0.03, 1001) if nearest(button.surface, (0, 0, z))[0] > RADIUS - 3e-5)
    velocity = (0.0, 0.02, 0.0)  # away from the medial facet, into the lateral one
    now = look((0, 0, height), velocity)

    @eqx.filter_jit
    def seen(button, now):
        memory = button.remember(now)
        on_medial = memory._replace(places=(memory.places[0], memory.places[0]))
        load, _ = button.load(now, on_medial)
        return button.observe(now, on_medial), sum(term.force for term in load.stiff)

    distance, place = nearest(button.surface, (0, 0, height))
    assert place > 0.004  # two facets, or this shows nothing
    depth = RADIUS - distance
    rate = -velocity[1] * place / distance  # the normal leans from the medial facet to the lateral one
    damping = 8 * (1 - restitution) / (5 * restitution * floor)
    alone = stiffness * depth**1.5 * (1 + damping * rate)
    report, next_step = seen(button, now)
    assert float(next_step) > 2 * alone  # or there is no other contact to find
    assert float(report["force"]) == pytest.approx(alone, rel=1e-4)
