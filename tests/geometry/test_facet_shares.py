"""How two facets share a contact's force: by their separation, on a patch and on a mesh."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import RADIUS, J, contact, look, patch_of, vec

from pftwin.geometry.contact.mesh_facets import FacetPoint
from pftwin.geometry.patch.polynomial import exponents
from pftwin.model.effects.contact_law import Hertz
from pftwin.model.effects.mesh_sphere_contact import _shares

K = 2e8
HALF = (0.024, 0.02)
ONE, TWO = 0.02, 0.20  # separations, in radii, up to which two contacts are one and from which on they are two


def share_at(separation: float) -> float:
    """The cubic from 1/2 to 1 that is flat at both ends."""
    t = np.clip((separation - ONE) / (TWO - ONE), 0, 1)
    return 0.5 + 0.5 * (3 * t**2 - 2 * t**3)


def test_the_blend_is_half_then_three_quarters_then_all():
    """The very numbers: symmetric about the middle, where both bear three quarters."""
    assert [share_at(x) for x in (0.0, 0.02, 0.11, 0.2, 0.5)] == pytest.approx([0.5, 0.5, 0.75, 1, 1])


@eqx.filter_jit
def seen(effect, now):
    return effect.observe(now, effect.remember(now)), effect.load(now, effect.remember(now))[0]


def two_humps(separation: float) -> tuple[float, float, float]:
    """A groove z = b v^2 + a v^4, and the height of a sphere's centre that is 0.1 mm deep at v = +- half of it.

    The normal there leads to the centre, on the axis: the slope is v over what is left of the distance.
    """
    v, distance = 0.5 * separation * RADIUS, RADIUS - 1e-4
    up = np.sqrt(distance**2 - v**2)
    a = -1 / (8 * v**2 * RADIUS)  # the walls bend away from the sphere, by as much for every separation
    b = (v / up - 4 * a * v**3) / (2 * v)
    return a, b, a * v**4 + b * v**2 + up


@pytest.mark.parametrize("separation", [0.06, 0.11, 0.16, 0.24])
def test_on_a_patch_facets_bear_what_their_separation_says(separation):
    a, b, height = two_humps(separation)
    coefficients = np.zeros(len(exponents(4)))
    for k, powers in enumerate(exponents(4)):
        if powers == (0, 4):
            coefficients[k] = a * HALF[1] ** 4
        if powers == (0, 2):
            coefficients[k] = b * HALF[1] ** 2
    report, load = seen(contact(Hertz(J(K)), patch_of(coefficients, 4, HALF)), look((0, 0, height)))
    law = K * 1e-4**1.5
    for facet, side in (("medial", -1), ("lateral", 1)):
        assert float(report[f"point_{facet}"][1]) == pytest.approx(side * 0.5 * separation * RADIUS, rel=1e-5)
        assert float(report[f"indentation_{facet}"]) == pytest.approx(1e-4, rel=1e-6)
        assert float(report[f"force_{facet}"]) == pytest.approx(share_at(separation) * law, rel=1e-4)
    assert float(load.energy) == pytest.approx(2 * share_at(separation) * K * 1e-4**2.5 / 2.5, rel=1e-4)


def point(y: float, distance: float = RADIUS, on_seam: bool = False) -> FacetPoint:
    yes, no, zero = jnp.asarray(True), jnp.asarray(False), J(0.0)
    values = {
        "point": vec(0, y, 0),
        "normal": vec(0, 0, 1),
        "distance": J(distance),
        "on_seam": yes if on_seam else no,
        "beyond_rim": zero,
        "overflow": no,
    }
    return FacetPoint(**{name: values[name] for name in FacetPoint._fields})


@pytest.mark.parametrize("separation", [0.0, 0.015, 0.05, 0.11, 0.17, 0.21])
def test_on_a_mesh_they_bear_the_same(separation):
    half = 0.5 * separation * RADIUS
    shares = _shares([point(-half), point(half)], J(RADIUS))
    assert [float(s) for s in shares] == pytest.approx([share_at(separation)] * 2, rel=1e-9)


def test_a_point_on_the_seam_that_is_not_the_nearest_is_no_contact():
    near, far = 0.9 * RADIUS, 0.95 * RADIUS
    seam = {"on_seam": True}
    for one, two, expected in (
        (point(0.0, far, **seam), point(0.003, near), [0, 1]),
        (point(-0.003, near), point(0.0, far, **seam), [1, 0]),
        (point(0.0, near, **seam), point(0.0, near, **seam), [1, 0]),  # one point of both facets counts once
        (point(0.0, near, **seam), point(0.01, far), [1, 1]),  # on the seam, but the nearest
    ):
        assert [float(s) for s in _shares([one, two], J(RADIUS))] == expected
