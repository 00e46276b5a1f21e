"""Both facets where the fan across the groove ends before the contact does: on steep walls, and at a patch's edge."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import RADIUS, contact, fitted, flat_patch, look, patch_of

from pftwin.geometry.contact.facets import FAN
from pftwin.model.effects.contact_law import Hertz

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


@pytest.mark.parametrize(("angle", "half"), [(48, 0.02), (55, 0.02), (60, 0.02), (60, 0.03), (70, 0.03)])
@pytest.mark.slow
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
