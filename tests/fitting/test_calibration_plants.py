"""Plants that a posterior is tried on: how their numbers spread, springs that stiffen, what a fit should find."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_scene import small_scene

from fitting.calibration.plants import (
    Knee,
    PlantMotion,
    check_truth,
    misplaced,
    reshaped,
    sliding,
    stiffening,
    truth_of,
    twin,
)
from fitting.nuisance import Nuisance
from fitting.parameters import with_nuisance
from pftwin.base.errors import InputError

FREE = ("K1", "L1", "K2", "L2")
BOUNDS = {"K1": 0.5, "L1": 0.3, "K2": 0.4, "L2": 0.2}


def knee() -> Knee:
    return Knee(*with_nuisance(small_scene(), FREE, BOUNDS, None, Nuisance(attachments=1e-3, friction=0.02)))


def drawn(make, count: int = 300) -> np.ndarray:
    """Parameters (count, p) of plants."""
    own, random = knee(), np.random.default_rng(1)
    return np.array([own.parameters.vector(make(own, random).scene) for _ in range(count)])


@pytest.mark.slow
def test_twins_come_from_the_priors():
    found, p = drawn(twin), knee().parameters
    assert np.ptp(p.share(found)[:, :4], axis=0).min() > 0.97
    at = p.names.index("quadriceps.origin.y")
    mean, sd = p.items[at].prior
    assert found[:, at].mean() == pytest.approx(mean, abs=3 * sd / np.sqrt(300))
    assert found[:, at].std() == pytest.approx(sd, rel=0.12)


def test_misplaced_plants_are_uniform_and_vary_less_than_their_priors():
    """0.6 of the priors' deviations, none beyond the square root of 3 times that; of friction as well."""
    found, p = drawn(misplaced), knee().parameters
    share = p.share(found)[:, :4]
    assert 0.25 <= share.min() < 0.27
    assert 0.73 < share.max() <= 0.75
    for name in ("patellar_tendon.insertion.x", "contact.friction.coefficient"):
        at = p.names.index(name)
        mean, sd = p.items[at].prior
        off = (found[:, at] - mean) / sd
        assert off.std() == pytest.approx(0.6, rel=0.1)
        assert 1.0 < np.abs(off).max() < 0.6 * np.sqrt(3)


def test_plants_slide_otherwise_than_the_twin():
    own, random = knee(), np.random.default_rng(2)
    laws = [sliding(own, random).scene.contact.friction for _ in range(100)]
    coefficients, speeds = np.array([[float(f.coefficient), float(f.slip_speed)] for f in laws]).T
    assert 0 < coefficients.min() < 0.01
    assert 0.09 < coefficients.max() < 0.1
    assert speeds.min() < 3e-4
    assert speeds.max() > 4e-3
    bare = Knee(*with_nuisance(small_scene().without("contact"), FREE, 0.3, None, Nuisance()))
    with pytest.raises(InputError, match="friction without a contact"):
        sliding(bare, random)


def test_another_trochlea_is_the_twins_with_waves_of_a_tenth_of_a_millimetre_at_most():
    """Root mean squares over the patch, by Gauss's quadrature; anew for each plant."""
    own, random = knee(), np.random.default_rng(4)
    flat = own.scene.contact.fitted_surface()
    nodes, weights = np.polynomial.legendre.leggauss(8)
    u, v = (c + h * nodes for c, h in zip(flat.center, flat.half_size, strict=True))
    height = jax.jit(
        lambda patch: jax.vmap(jax.vmap(patch.height, (None, 0)), (0, None))(jnp.asarray(u), jnp.asarray(v))
    )
    waves = [height(reshaped(own, random).scene.contact.fitted_surface()) - height(flat) for _ in range(60)]
    sizes = np.sqrt([np.einsum("ij,i,j->", w**2, weights, weights) / 4 for w in waves])
    assert sizes.min() < 8e-6
    assert 9e-5 < sizes.max() <= 1e-4
    assert np.corrcoef(np.reshape(waves, (60, -1)))[0, 1:].max() < 0.999
    bare = Knee(*with_nuisance(small_scene().without("contact"), FREE, 0.3, None, Nuisance()))
    with pytest.raises(InputError, match="no patch to reshape"):
        reshaped(bare, random)


@pytest.mark.slow
def test_the_truth_of_a_stiffening_tendon_is_the_line_nearest_to_it():
    own, random = knee(), np.random.default_rng(3)
    plant = stiffening(own, random)
    assert plant.curved == ("quadriceps", "patellar_tendon")
    lengths = {}
    expected = []
    for name, stretch in (("quadriceps", 0.05), ("patellar_tendon", 0.012)):
        t = plant.scene.effect(name)
        k, rest, more = (float(x) for x in (t.law.stiffness, t.rest_length, t.law.more))
        lengths[name] = rest + stretch * np.linspace(0.5, 1.0, 30) ** 2
        s = lengths[name] - rest
        slope, offset = np.polyfit(lengths[name], k * s * (1 + more * s), 1)
        expected += [slope, -offset / slope]
        assert slope > k
    motion = PlantMotion(np.zeros((30, 3)), np.zeros((30, 4)), {name: {"length": x} for name, x in lengths.items()})
    np.testing.assert_allclose(truth_of(plant, [motion], own.parameters), expected, rtol=1e-9)
    straight = misplaced(own, random)
    np.testing.assert_array_equal(
        truth_of(straight, [motion], own.parameters), own.parameters.vector(straight.scene)[:4]
    )


def test_a_curved_tendon_has_its_true_attachment_and_no_true_strain():
    random = np.random.default_rng(3)
    for name, has_truth in (("quadriceps.origin.x", True), ("L1.strain", False)):
        own = Knee(*with_nuisance(small_scene(), (name,), {name: (-1.0, 1.0)}, None, Nuisance()))
        plant = stiffening(own, random)
        if has_truth:
            check_truth(plant, own.parameters)
            motion = PlantMotion(np.zeros((2, 3)), np.zeros((2, 4)), {})
            expected = float(plant.scene.effect("quadriceps").origin.x)
            assert truth_of(plant, [motion], own.parameters) == pytest.approx(expected)
        else:
            with pytest.raises(InputError, match=r"L1\.strain has no true value"):
                check_truth(plant, own.parameters)
