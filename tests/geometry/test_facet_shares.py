"""How two facets share a contact's force: on a patch by the ridge between them, on a mesh by their separation."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import RADIUS, J, contact, look, patch_of, vec

from pftwin.base.spatial import Vec3
from pftwin.geometry.contact.patch_mesh import FacetPoint
from pftwin.geometry.patch.polynomial import PolynomialPatch, exponents
from pftwin.model.effects.contact_law import Hertz
from pftwin.model.effects.mesh_sphere_contact import _load_shares

K = 2e8
HALF = (0.024, 0.02)
DEEP = 1e-4  # indentation of both facets [m]
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


def two_humps(separation: float, ridge: float) -> tuple[np.ndarray, float]:
    """A groove z = b v^2 + a v^4 as (b, a), and the height of a sphere's centre: 0.1 mm deep at v = +- half of a
    separation (radii), and `ridge` deep between, at v = 0.

    The normal there leads to the centre, on the axis: the slope is v over what is left of the distance.
    """
    v, height = 0.5 * separation * RADIUS, RADIUS - ridge
    up = np.sqrt((RADIUS - DEEP) ** 2 - v**2)
    quartic = 0.5 * v**2 / up - (height - up)
    return np.array([(height - up - quartic) / v**2, quartic / v**4]), height


def groove(terms: np.ndarray) -> PolynomialPatch:
    coefficients = np.zeros(len(exponents(4)))
    for power, term in zip((2, 4), terms, strict=True):
        coefficients[exponents(4).index((0, power))] = term * HALF[1] ** power
    return patch_of(coefficients, 4, HALF)


@pytest.mark.parametrize("ridge", [9e-5, 5e-5, 1e-6, -2e-5])
def test_on_a_patch_what_both_facets_have_in_common_counts_once(ridge):
    separation = 0.22
    terms, height = two_humps(separation, ridge)
    report, load = seen(contact(Hertz(J(K)), groove(terms)), look((0, 0, height)))
    common = max(ridge, 0) / DEEP
    for facet, side in (("medial", -1), ("lateral", 1)):
        assert float(report[f"point_{facet}"][1]) == pytest.approx(side * 0.5 * separation * RADIUS, rel=1e-4)
        assert float(report[f"indentation_{facet}"]) == pytest.approx(DEEP, rel=1e-5)
        assert float(report[f"force_{facet}"]) == pytest.approx((1 - 0.5 * common**1.5) * K * DEEP**1.5, rel=1e-4)
    assert float(load.energy) == pytest.approx((2 - common**2.5) * K * DEEP**2.5 / 2.5, rel=1e-4)


@pytest.mark.parametrize("beside", [-1e-5, 3e-6, 2e-5, 6e-5])
def test_facets_of_different_depth_store_what_the_section_says(beside):
    """Minima and the ridge by samples of numpy's: V(medial) + V(lateral) - V(ridge), its slope the force."""
    terms, height = two_humps(0.2, 8e-5)
    v = np.linspace(-0.25 * RADIUS, 0.25 * RADIUS, 200001)

    def stored(y: float, z: float) -> float:
        d = RADIUS - np.hypot(v - y, z - terms[0] * v**2 - terms[1] * v**4)
        inner = slice(1, -1)
        tops = d[inner][(d[inner] > d[:-2]) & (d[inner] >= d[2:])]
        between = d[inner][(d[inner] < d[:-2]) & (d[inner] <= d[2:])]
        assert (len(tops), len(between)) == (2, 1)
        return K / 2.5 * float(sum(np.maximum(tops, 0) ** 2.5) - np.maximum(between[0], 0) ** 2.5)

    report, load = seen(contact(Hertz(J(K)), groove(terms)), look((0, beside, height)))
    assert float(load.energy) == pytest.approx(stored(beside, height), rel=2e-3)
    step = 1e-6
    across = (stored(beside - step, height) - stored(beside + step, height)) / (2 * step)
    up = (stored(beside, height - step) - stored(beside, height + step)) / (2 * step)
    assert float(report["force_z"]) == pytest.approx(up, rel=3e-3)
    assert float(report["force_y"]) == pytest.approx(across, abs=0.02 * up)


def forces(place, effect):
    now = eqx.tree_at(lambda n: n.patella.position, look(), Vec3(place[0], place[1], place[2]))
    report = effect.observe(now, effect.remember(now))
    found = jnp.stack([report[f"force_{part}"] for part in ("x", "y", "z", "medial", "lateral")])
    return found, found


FORCES, BACKWARDS = (eqx.filter_jit(mode(forces, has_aux=True)) for mode in (jax.jacfwd, jax.jacrev))


@pytest.mark.slow
@pytest.mark.parametrize("beside", [3e-6, 2e-5, 3e-4], ids=["both_alike", "one_deeper", "one_alone"])
def test_forces_have_their_derivatives(beside):
    terms, height = two_humps(0.2, 8e-5)
    effect = contact(Hertz(J(K)), groove(terms))
    place, step = np.array([0.0, beside, height]), 1e-9 * np.eye(3)[1:]
    sides = [[np.asarray(FORCES(J(place + d), effect)[1]) for d in (s, -s)] for s in step]
    expected = np.stack([(ahead - behind) / 2e-9 for ahead, behind in sides], axis=1)
    for derivatives in (FORCES, BACKWARDS):
        found = derivatives(J(place), effect)[0][:, 1:]
        np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


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


@jax.jit
def shares_of(one, two):
    return _load_shares([one, two], J(RADIUS))


@pytest.mark.parametrize("separation", [0.0, 0.015, 0.05, 0.11, 0.17, 0.21])
def test_on_a_mesh_they_bear_the_same(separation):
    half = 0.5 * separation * RADIUS
    shares = shares_of(point(-half), point(half))
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
        assert [float(s) for s in shares_of(one, two)] == expected
