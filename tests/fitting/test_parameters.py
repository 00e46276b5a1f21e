from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_scene import small_scene

from fitting import free_parameters
from pftwin.base.errors import InputError

SPRINGS = ("K1", "L1", "K2", "L2")


@pytest.fixture(scope="module")
def scene():
    return small_scene(6)


def test_short_names_are_the_tendons_in_their_order(scene):
    p = free_parameters(scene, SPRINGS)
    np.testing.assert_allclose(p.nominal, [156.0, 0.1432, 629.0, 0.0714])
    np.testing.assert_allclose(p.lower, 0.7 * p.nominal)
    assert [q.unit for q in p.items] == ["N/m", "m", "N/m", "m"]
    assert (
        p.places
        == free_parameters(
            scene,
            [
                "quadriceps.stiffness",
                "quadriceps.slack_length",
                "patellar_tendon.stiffness",
                "patellar_tendon.slack_length",
            ],
        ).places
    )


@pytest.mark.parametrize(
    "name",
    [
        "K1",
        "L2",
        "L2.strain",
        "L2.force",
        "patellar_tendon.origin.y",
        "contact.radius",
        "contact.law.contact_stiffness",
        "contact.surface.coefficients[2]",
        "patella.center_of_mass.x",
        "quadriceps.damping",
    ],
)
def test_a_written_value_is_read(scene, name):
    p = free_parameters(scene, [name], {name: (-1e12, 1e12)})
    changed = p.apply(scene, 1.1 * p.nominal)
    np.testing.assert_allclose(p.vector(changed), 1.1 * p.nominal, rtol=1e-12)
    one, other = jax.tree.leaves(scene), jax.tree.leaves(changed)
    assert sum(not np.array_equal(a, b) for a, b in zip(one, other, strict=True)) == 1


def test_a_whole_vector_becomes_its_elements(scene):
    p = free_parameters(scene, ["contact.surface.coefficients"], {"contact.surface.coefficients": (-1.0, 1.0)})
    n = scene.effect("contact").surface.coefficients.size
    assert len(p) == n
    assert p.names[1] == "contact.surface.coefficients[1]"


def test_a_force_sees_the_stiffness_that_is_free_with_it(scene):
    p = free_parameters(scene, ["L2.force", "K2"])
    changed = p.apply(scene, jnp.asarray([5.0, 400.0]))
    np.testing.assert_allclose(p.vector(changed), [5.0, 400.0], rtol=1e-12)


def test_apply_is_traceable(scene):
    p = free_parameters(scene, SPRINGS)
    slope = jax.jacfwd(lambda t: p.apply(scene, t).effect("quadriceps").stiffness)(jnp.asarray(p.nominal))
    np.testing.assert_allclose(slope, [1, 0, 0, 0])


@settings(max_examples=100, deadline=None)
@given(st.lists(st.floats(-1e3, 1e3), min_size=4, max_size=4))
def test_iterates_stay_inside_the_bounds(u):
    p = free_parameters(small_scene(6), SPRINGS)
    theta = p.to_bounded(u)
    assert (theta > p.lower).all()
    assert (theta < p.upper).all()


@settings(max_examples=100, deadline=None)
@given(st.lists(st.floats(-8, 8), min_size=4, max_size=4))
def test_the_transform_has_an_inverse_and_a_slope(u):
    p = free_parameters(small_scene(6), SPRINGS)
    u = np.array(u)
    theta = p.to_bounded(u)
    np.testing.assert_allclose(p.to_unbounded(theta), u, atol=1e-6)
    numeric = (p.to_bounded(u + 1e-5) - p.to_bounded(u - 1e-5)) / 2e-5
    np.testing.assert_allclose(p.slope(theta), numeric, rtol=1e-5)


def test_spread_points_fill_every_stratum():
    p = free_parameters(small_scene(6), SPRINGS)
    share = (p.latin_hypercube(16, np.random.default_rng(3)) - p.lower) / (p.upper - p.lower)
    for column in share.T:
        assert sorted(np.floor(16 * column).astype(int)) == list(range(16))


@pytest.mark.parametrize(
    ("names", "bounds", "said"),
    [
        (["K3"], 0.3, "K1, L1, K2, L2"),
        (["quadricep.stifness"], 0.3, "'quadriceps.stiffness'"),
        (["K1", "quadriceps.stiffness"], 0.3, "twice"),
        (["L2", "L2.force"], 0.3, "'L2.force' is named twice"),
        (["K1.force"], 0.3, "no parameter"),
        (["contact.surface.coefficients[99]"], 0.3, "coefficients[0]"),
        (["K1"], {"K1": (200.0, 100.0)}, "empty"),
        (["K1"], {"K1": (200.0, 300.0)}, "exclude"),
        (["K1"], {"K2": 0.1}, "'K2' is not free"),
        (["K1"], {"K1[3]": (1.0, 2.0)}, "'K1[3]' is not free"),
        (["K1"], -0.3, "positive share"),
        (["K1"], {"K1": "wide"}, "a share or"),
        (["contact.center.x"], 0.3, "is nothing"),
        ([], 0.3, "names of parameters"),
        ("K1", 0.3, "names of parameters"),
    ],
)
def test_mistakes_are_named(scene, names, bounds, said):
    with pytest.raises(InputError, match=said.replace("[", r"\[")):
        free_parameters(scene, names, bounds)


def test_a_prior_without_width_is_refused(scene):
    with pytest.raises(InputError, match="positive standard deviation"):
        free_parameters(scene, ["K1"], priors={"K1": (150.0, 0.0)})


@pytest.mark.parametrize("prior", [(1560.0, 5.0), (-300.0, 1.0)])
def test_a_prior_that_excludes_the_bounds_is_refused(scene, prior):
    with pytest.raises(
        InputError, match=r"K1: the prior -?\d+ \+- \d excludes the bounds .* within 3 standard deviations"
    ):
        free_parameters(scene, ["K1"], priors={"K1": prior})
    assert free_parameters(scene, ["K1"], priors={"K1": (250.0, 20.0)}).items[0].prior == (250.0, 20.0)


def test_a_prior_is_a_mean_and_a_standard_deviation(scene):
    (k1, k2) = free_parameters(scene, ["K1", "K2"], priors={"K2": (600.0, 31.0)}).items
    assert (k1.prior, k2.prior) == (None, (600.0, 31.0))
    with pytest.raises(InputError, match="a mean and a positive standard deviation"):
        free_parameters(scene, ["K1"], priors={"K1": (150.0, 10.0, 1.0)})
