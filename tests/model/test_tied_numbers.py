"""Numbers of a scene that go together."""

from __future__ import annotations

import jax
import numpy as np
import pytest
from small_scene import small_scene

from fitting.nuisance import EXACT, Nuisance
from fitting.parameters import Applied, applied, free_parameters, with_nuisance
from fitting.trials import free_in_trials
from pftwin.base.errors import InputError

DAMPING = "quadriceps.damping~patellar_tendon.damping"
HEIGHT = "quadriceps.insertion.y~patellar_tendon.insertion.y"


@pytest.fixture(scope="module")
def scene():
    return (
        small_scene()
        .set("quadriceps.damping", 1.5)
        .set("patellar_tendon.damping", 6.0)
        .set("quadriceps.insertion.y", 0.002)
        .set("patellar_tendon.insertion.y", -0.001)
    )


def test_what_is_tied_keeps_its_proportion_and_coordinates_their_distance(scene):
    assert scene.get(DAMPING) == 1.5
    there = scene.set(DAMPING, 2.5).set(HEIGHT, 0.0035)
    found = [float(there.get(name)) for name in (*DAMPING.split("~"), *HEIGHT.split("~"))]
    np.testing.assert_allclose(found, [2.5, 10.0, 0.0035, 0.0005], rtol=1e-6)
    assert float(there.get("K1")) == float(scene.get("K1"))


def test_in_another_scene_proportions_are_its_own(scene):
    """A treatment that doubles one damping is not undone by what a fit has found of both."""
    treated = scene.set("patellar_tendon.damping", 12.0)
    assert float(treated.set(DAMPING, 3.0).get("patellar_tendon.damping")) == pytest.approx(24.0, rel=1e-6)


def test_a_derivative_is_that_of_all_that_is_tied(scene):
    """d/dv (a b) with a = v and b = 4 v is 8 v."""
    places = free_parameters(scene, (DAMPING,)).places

    def product(v):
        there = applied(places, scene, [v])
        return there.get("quadriceps.damping") * there.get("patellar_tendon.damping")

    assert jax.grad(product)(2.0) == pytest.approx(16.0, rel=1e-6)


def test_nuisance_leaves_alone_what_is_tied_to_something_that_was_asked_for(scene):
    _, alone = with_nuisance(scene, ("K1",), 0.3, None, Nuisance(damping=0.5))
    _, tied = with_nuisance(scene, ("K1", DAMPING), 0.3, None, Nuisance(damping=0.5))
    both = {*DAMPING.split("~")}
    assert both <= {*alone.names}
    assert not both & {*tied.names}
    assert {*tied.names} == {*alone.names} - both | {DAMPING}


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (("K1~L1",), "ties unlike numbers: N/m, m"),
        (("K1~quadriceps.stiffness",), "ties a number to itself"),
        (("L1~L2.strain",), "single numbers"),
        (("K1~nothing",), "no parameter 'nothing'"),
        (("K1", "K2~K1"), "'K2~K1' is named twice"),
        ((DAMPING, "patellar_tendon.damping"), "is named twice"),
    ],
)
def test_ties_that_cannot_be_are_refused(scene, names, said):
    with pytest.raises(InputError, match=said):
        free_parameters(scene, names)


def test_nothing_is_in_proportion_to_nothing(scene):
    with pytest.raises(InputError, match="one of them is 0"):
        free_parameters(scene.set("quadriceps.damping", 0.0), (DAMPING,), {DAMPING: (0.0, 1.0)})


def test_an_estimate_carries_what_is_tied(scene):
    """By its names, as a file holds them; to a knee whose proportion is another."""
    estimate = Applied((DAMPING, HEIGHT), [3.0, 0.004], origins=((HEIGHT, 0.002),))
    there = estimate(scene.set("patellar_tendon.damping", 12.0))
    found = [float(there.get(name)) for name in (*DAMPING.split("~"), *HEIGHT.split("~"))]
    np.testing.assert_allclose(found, [3.0, 24.0, 0.004, 0.001], rtol=1e-6)


def test_trials_share_proportions(scene):
    """6 to 1.5 in one trial, 9 to 1.5 in the other."""
    both = [scene, scene.set("patellar_tendon.damping", 9.0)]
    with pytest.raises(InputError, match="has other proportions in small knee than in small knee"):
        free_in_trials(both, ("K1", DAMPING), 0.3, None, EXACT)
