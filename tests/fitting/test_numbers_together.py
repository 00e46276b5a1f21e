"""All numbers of a field as one: a ligament's strands by one length, a muscle's tension over time by one size."""

from __future__ import annotations

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_scene import small_scene

import fitting
import pftwin
from fitting.nuisance import Nuisance
from fitting.parameters import Applied, applied, free_parameters, with_nuisance
from fitting.trials import free_in_trials
from pftwin.base.errors import InputError
from pftwin.base.spatial import Vec3
from pftwin.model.effects.tendon import StrandGroup
from pftwin.model.effects.tension import PrescribedTension
from pftwin.model.measured import Measured
from pftwin.model.scene import Scene

LENGTHS = np.array([0.066, 0.069, 0.0711])
SLACK, TENSION, PLACE = "patellar_tendon.slack_length[:]", "quadriceps.tension[:]", "patellar_tendon.insertion.y[:]"
FRAMES = 41


def points(*rows: tuple[float, float, float]) -> Vec3:
    return Vec3.from_array(jnp.asarray(rows, float))


@cache
def scene() -> Scene:
    """The small knee with three strands and a muscle of two lines, whose tensions change over time."""
    like = jnp.ones(3)
    strands = StrandGroup(
        jnp.asarray([900.0, 700.0, 1100.0]),
        jnp.asarray(LENGTHS),
        0.06 * like,
        3e-3 * like,
        points((-0.02, 0.003, -0.008), (-0.02, 0.0, -0.0082), (-0.021, -0.004, -0.008)),
        points((-0.07, 0.008, 0.045), (-0.07, 0.004, 0.0452), (-0.071, -0.001, 0.045)),
        "tibia",
        name="patellar_tendon",
    )
    share = np.linspace(0, 1, FRAMES)[:, None]
    muscle = PrescribedTension(
        jnp.asarray(np.array([9.0, 6.0]) + share * np.array([3.0, -1.0])),
        jax.tree.map(lambda a: jnp.tile(a, (FRAMES, 1)), points((0.22, 0.0, 0.035), (0.21, 0.012, 0.04))),
        points((0.02, 0.0, -0.008), (0.02, 0.002, -0.007)),
        start_time=0.0,
        interval=0.01,
        body="femur",
        name="quadriceps",
    )
    return small_scene(FRAMES).with_effect(strands).with_effect(muscle)


def test_they_keep_their_proportions_and_coordinates_their_distances():
    there = scene().set(SLACK, 0.07).set(TENSION, 4.0).set(PLACE, 0.001)
    np.testing.assert_allclose(there.get("patellar_tendon.slack_length"), LENGTHS * 0.07 / LENGTHS.mean(), rtol=1e-12)
    size = 4.0 / np.mean(np.asarray(scene().get("quadriceps.tension")))
    np.testing.assert_allclose(
        there.get("quadriceps.tension"), size * np.asarray(scene().get("quadriceps.tension")), rtol=1e-12
    )
    places = np.array([0.003, 0.0, -0.004])
    np.testing.assert_allclose(there.get("patellar_tendon.insertion.y"), places - places.mean() + 0.001, atol=1e-12)
    assert float(there.get(SLACK)) == pytest.approx(0.07)
    np.testing.assert_array_equal(there.get("patellar_tendon.stiffness"), scene().get("patellar_tendon.stiffness"))


def test_the_mean_is_reported_with_its_unit():
    parameters = free_parameters(scene(), (SLACK, TENSION, PLACE), {PLACE: 0.5, SLACK: 0.1})
    assert parameters.names == (SLACK, TENSION, PLACE)
    assert [p.unit for p in parameters.items] == ["m", "N", "m"]
    assert parameters.coordinates == (PLACE,)
    np.testing.assert_allclose(parameters.nominal, [LENGTHS.mean(), (10.5 + 5.5) / 2, -0.001 / 3], rtol=1e-12)
    assert parameters.lower[0] == pytest.approx(0.9 * LENGTHS.mean())


def test_a_derivative_is_that_of_all_of_them():
    """The second strand's length by the mean is the proportion of both."""
    places = free_parameters(scene(), (SLACK,)).places
    slope = jax.grad(lambda v: applied(places, scene(), [v]).get("patellar_tendon.slack_length")[1])(0.07)
    assert slope == pytest.approx(LENGTHS[1] / LENGTHS.mean(), rel=1e-12)


def test_applied_to_another_knee_proportions_are_its_own():
    other = scene().set("patellar_tendon.slack_length", jnp.asarray([0.06, 0.08, 0.07]))
    found = Applied((SLACK,), [0.077])(other)
    np.testing.assert_allclose(found.get("patellar_tendon.slack_length"), [0.066, 0.088, 0.077], rtol=1e-12)


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ((SLACK, "patellar_tendon.slack_length[1]"), "is named twice"),
        (("patellar_tendon.slack_length", SLACK), "is named twice"),
        ((f"{SLACK}~patellar_tendon.stiffness[:]",), "ties unlike numbers: m, N per unit strain"),
        ((f"{SLACK}~patellar_tendon.slack_length[1]",), "ties a number to itself"),
        (("patella.mass[:]",), "is a single number"),
        (("patellar_tendon.slak_length[:]",), "no parameter"),
        (("L1",), r"or patellar_tendon\.slack_length\[:\] for all together"),
        (("quadriceps.tension",), r"expected: quadriceps\.tension\[:\] for all together"),
    ],
)
def test_what_cannot_go_together_is_refused(names, said):
    with pytest.raises(InputError, match=said):
        free_parameters(scene(), names)


def test_numbers_without_a_proportion_are_refused():
    still = scene().set("patellar_tendon.damping_time", jnp.zeros(3))
    with pytest.raises(InputError, match="their mean is 0"):
        free_parameters(still, ("patellar_tendon.damping_time[:]",))


def test_a_ligaments_attachment_shifts_with_all_its_strands():
    _, found = with_nuisance(scene(), (SLACK,), 0.3, None, Nuisance(attachments=1e-3))
    ends = [name for name in found.names if name.startswith("patellar_tendon.") and name != SLACK]
    assert sorted(ends) == [f"patellar_tendon.{end}.{axis}[:]" for end in ("insertion", "origin") for axis in "xyz"]
    assert found.items[found.names.index(PLACE)].nominal == pytest.approx(-0.001 / 3)


@pytest.mark.parametrize("asked", [PLACE, "patellar_tendon.insertion.y[2]"])
def test_nuisance_leaves_alone_an_attachment_that_is_requested(asked):
    _, found = with_nuisance(scene(), (asked,), {asked: 0.5}, None, Nuisance(attachments=1e-3))
    assert [name for name in found.names if ".insertion.y" in name and "patellar" in name] == [asked]


def test_nuisance_of_ones_own_takes_the_place_of_a_presets():
    """One strand's height in the place of all; and not where the field itself is asked for."""
    one = "patellar_tendon.insertion.y[1]"
    _, found = with_nuisance(scene(), ("patella.mass",), 0.3, None, Nuisance(attachments=1e-3, others={one: 2e-3}))
    assert one in found.names
    assert PLACE not in found.names
    _, asked = with_nuisance(scene(), ("patellar_tendon.slack_length[1]",), 0.3, None, Nuisance(others={SLACK: 1e-3}))
    assert asked.names == ("patellar_tendon.slack_length[1]",)


def test_bounds_of_all_together_are_not_those_of_each():
    with pytest.raises(InputError, match="is not free"):
        free_parameters(scene(), ("patellar_tendon.slack_length",), {SLACK: 0.05})


def test_trials_have_the_same_proportions():
    other = scene().set("patellar_tendon.slack_length", jnp.asarray(LENGTHS[::-1]))
    with pytest.raises(InputError, match="has other proportions"):
        free_in_trials([scene(), other], (SLACK,), 0.1, None, Nuisance())


@pytest.mark.slow
def test_a_ligaments_length_and_a_muscles_strength_are_found():
    """From positions and the contact force of a knee whose strands are 2 % longer, and whose muscle is weaker."""
    nominal = scene()
    truth = [1.02 * LENGTHS.mean(), 0.9 * 8.0]
    true = nominal.set(SLACK, truth[0]).set(TENSION, truth[1])
    result = pftwin.simulate(true, dt=1e-2 / 6, integrator=pftwin.LinearImplicit())
    measured = Measured(result.times, result.center, contact_force=np.asarray(result.effects["contact"]["force"]))
    found = fitting.fit_tendons(
        nominal,
        measured,
        free=(SLACK, TENSION),
        bounds={SLACK: 0.05, TENSION: 0.3},
        use=("position", "contact"),
        noise={"position": 1e-5, "contact": 1e-2},
        starts=4,
    )
    np.testing.assert_allclose(found.values, truth, rtol=2e-4)
    np.testing.assert_allclose(found.apply(nominal).get("patellar_tendon.slack_length"), 1.02 * LENGTHS, rtol=2e-4)
