"""Springs that stiffen: the rig's own law, and the straight lines nearest to them."""

from __future__ import annotations

import json
from dataclasses import asdict

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_scene import small_scene

import pftwin
from fitting.nuisance import Nuisance
from fitting.parameters import Applied, with_nuisance
from fitting.stiffening import StiffeningSpring, Working, linear_tendons, stiffened, stiffening_tendons, working_of
from tests.verification.rig_plant.plant_parts import Spring


def test_a_stiffening_spring_is_the_rigs_own():
    """Against the plant of the rig, which shares no code with it; slope and energy by derivatives."""
    k, length, e = 173.0, 0.14, 0.08
    law = StiffeningSpring(jnp.asarray(k), jnp.asarray(4 * e / length))
    other = Spring(k, length, 0.0, np.zeros(3), np.zeros(3), e)
    for s in (0.004, 0.05, 0.12):
        at = law.at(jnp.asarray(s))
        assert float(at.force) == pytest.approx(other.force(length + s, 0.0), rel=1e-12)
        assert float(at.energy) == pytest.approx(other.energy(length + s), rel=1e-12)
        assert float(at.slope) == pytest.approx(float(jax.grad(lambda x: law.at(x).force)(jnp.asarray(s))), rel=1e-12)


def test_linear_tendons_offer_a_toe_region_and_others_do_not():
    scene = small_scene()
    assert linear_tendons(scene) == ("quadriceps", "patellar_tendon")
    some = {"quadriceps": Working(0.2, 1e-4, 0.0)}
    assert linear_tendons(stiffened(scene, some, {"quadriceps": 0.05})) == ("patellar_tendon",)


@pytest.mark.slow
def test_without_stiffening_the_scene_is_what_it_was():
    scene, same = bent_knee(0.0)
    one, other = (pftwin.simulate(s, dt=2e-3) for s in (scene, same))
    np.testing.assert_allclose(other.center, one.center, atol=1e-12)


@given(st.floats(0.02, 0.2), st.floats(0.1, 0.4), st.floats(0.0, 0.15), st.floats(0.05, 0.4), st.integers(0, 1000))
def test_the_line_nearest_to_a_bent_spring_is_the_one_asked_for(reach, rest, share, spread, seed):
    """By polynomial regression of the forces of the rig's own spring at uneven lengths."""
    random = np.random.default_rng(seed)
    lengths = rest + reach * (1 + spread * (random.uniform(size=60) ** 2 - 0.3))
    law, own = Working.of(lengths).bent(*(jnp.asarray(x) for x in (173.0, rest, share)))
    spring = Spring(float(law.stiffness), float(own), 0.0, np.zeros(3), np.zeros(3), float(law.more * own / 4))
    slope, offset = np.polyfit(lengths, [spring.force(x, 0.0) for x in lengths], 1)
    assert slope == pytest.approx(173.0, rel=1e-6)
    assert -offset / slope == pytest.approx(rest, rel=1e-6)


@given(st.floats(0.05, 0.2), st.floats(0.0, 0.12), st.floats(0.9, 1.3), st.integers(0, 1000))
def test_a_spring_converted_to_other_lengths_is_the_same_spring(reach, share, longer, seed):
    """And the line there is the nearest, by polynomial regression."""
    random = np.random.default_rng(seed)
    lengths = 0.15 + reach * (1 + 0.1 * random.uniform(size=40) ** 2)
    there = 0.15 + longer * reach * (1 + 0.08 * random.uniform(size=40) ** 3)
    old, new = Working.of(lengths), Working.of(there)
    converted = old.converted_to(new, *(jnp.asarray(x) for x in (173.0, 0.15, share)))
    (law, own), (same_law, same_own) = old.bent(*(jnp.asarray(x) for x in (173.0, 0.15, share))), new.bent(*converted)
    np.testing.assert_allclose([*same_law, same_own], [*law, own], rtol=1e-9, atol=1e-12)
    stretch = there - float(own)
    slope, offset = np.polyfit(there, float(law.stiffness) * stretch * (1 + float(law.more) * stretch), 1)
    np.testing.assert_allclose([float(x) for x in converted[:2]], [slope, -offset / slope], rtol=1e-6)


def test_a_tendon_that_hangs_slack_at_times_stays_straight():
    working = Working.of(np.linspace(0.10, 0.14, 20))
    for slack, straight in ((0.11, True), (0.09, False)):
        law, own = working.bent(*(jnp.asarray(x) for x in (173.0, slack, 0.1)))
        assert (float(law.more) == 0) is straight
        assert (float(law.stiffness) == 173.0) is straight
        assert (float(own) == pytest.approx(slack, abs=1e-15)) is straight


def bent_knee(share: float = 0.08):
    knee = small_scene()
    return knee, stiffened(
        knee, working_of([knee], linear_tendons(knee)), dict.fromkeys(("quadriceps", "patellar_tendon"), share)
    )


def test_tensions_in_the_motion_lie_about_the_springs_line():
    """Lines through what tendons pull in the motion have the stiffness and slack length that the scene tells."""
    _, bent = bent_knee()
    result = pftwin.simulate(bent.set("quadriceps.damping", 0.0).set("patellar_tendon.damping", 0.0), dt=2e-3)
    assert stiffening_tendons(bent) == ("quadriceps", "patellar_tendon")
    for name, other in (("quadriceps", 0.01), ("patellar_tendon", 0.02)):
        tendon, lengths = bent.effect(name), result.lengths[name]
        slope, offset = np.polyfit(lengths, result.tensions[name], 1)
        assert slope == pytest.approx(float(tendon.stiffness), rel=0.03)
        assert -offset / slope == pytest.approx(float(tendon.slack_length), rel=other)
        k, m = float(tendon.law.stiffness), float(tendon.law.more)
        stretch = lengths - float(tendon.rest_length)
        np.testing.assert_allclose(result.tensions[name], k * stretch * (1 + m * stretch), rtol=1e-9)
        assert k < 0.97 * slope


def test_slopes_by_all_of_its_numbers_are_those_of_differences():
    _, bent = bent_knee()
    tendon = bent.effect("quadriceps")

    def force(x):
        there = eqx.tree_at(lambda t: (t.stiffness, t.slack_length, t.stiffening), tendon, tuple(x))
        return there.held_tension(tendon.mean_length + 0.003)

    at = jnp.stack([tendon.stiffness, tendon.slack_length, tendon.stiffening])
    steps = np.array([1e-3, 1e-7, 1e-6])
    expected = [(force(at + s * e) - force(at - s * e)) / (2 * s) for s, e in zip(steps, np.eye(3), strict=True)]
    np.testing.assert_allclose(jax.grad(force)(at), expected, rtol=1e-6)
    straight = jax.grad(force)(at.at[2].set(0.0))
    assert np.isfinite(straight).all()


def test_a_longer_tendon_pulls_at_as_much_longer_lengths():
    _, bent = bent_knee()
    tendon, length = bent.effect("patellar_tendon"), bent.effect("patellar_tendon").mean_length
    shorter, longer = (t.held_tension(x) for t, x in ((tendon, length), (tendon.lengthened(0.004), length + 0.004)))
    assert float(longer) == pytest.approx(float(shorter), rel=0.01)  # it stiffens by the share of another length


@pytest.mark.parametrize("tension", [3.0, 20.0, 55.0])
def test_its_slack_length_follows_from_a_tension(tension):
    _, bent = bent_knee()
    tendon = bent.effect("quadriceps")
    found = tendon.slack_length_for(tendon.mean_length, jnp.asarray(tension))
    there = eqx.tree_at(lambda t: t.slack_length, tendon, found)
    assert float(there.held_tension(tendon.mean_length)) == pytest.approx(tension, rel=1e-8)


def test_a_treated_knee_is_given_the_same_springs():
    """Through `Applied`, traced: K and L of a fit are lines over the fitted knee's lengths in other scenes too."""
    knee, _ = bent_knee()
    nuisance = Nuisance(stiffening=0.1).at_work([knee])
    scene, free = with_nuisance(knee, ("K1", "L1"), 0.3, None, nuisance)
    assert free.names == ("K1", "L1", "quadriceps.stiffening", "patellar_tendon.stiffening")
    share = free.items[2]
    assert (share.lower, share.upper, share.nominal) == (0.0, 0.1, pytest.approx(0.05))
    assert share.prior == pytest.approx((0.05, 0.1 / np.sqrt(12)))
    theta = np.array([170.0, 0.14, 0.03, 0.07])
    apply = Applied(free.names, theta, (), nuisance)
    there = jax.jit(lambda s, x: apply(s, x).effect("quadriceps").held_tension(jnp.asarray(0.2)))(knee, theta)
    assert float(there) == pytest.approx(float(free.apply(scene, theta).effect("quadriceps").held_tension(0.2)))
    converted_law = Nuisance(**json.loads(json.dumps(asdict(nuisance))))
    assert converted_law == nuisance
    assert hash(converted_law) == hash(nuisance)


def test_without_lengths_at_work_tendons_stay_straight():
    """As in a search, which has no number for it."""
    knee = small_scene()
    prepared = Nuisance.of("rig").prepared(knee)
    assert linear_tendons(prepared) == ("quadriceps", "patellar_tendon")
    assert not any("stiffening" in name for name in Nuisance.of("rig").numbers(prepared).names)
    assert Nuisance(attachments=1e-3).at_work([knee]).working == ()
