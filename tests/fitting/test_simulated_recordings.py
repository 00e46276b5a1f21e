"""Parts of learning from simulations: where parameters are drawn, what noise recordings get, and their summaries."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from linear_problems import NOMINAL, objective, parameters
from scipy.stats import norm, truncnorm

from fitting.inference.recordings import Noise, Summaries, SummaryNoise, Table
from fitting.inference.region import Ellipsoid, Region
from fitting.parameters import Parameters
from pftwin.base.errors import InputError


def test_an_ellipsoid_is_filled_evenly():
    """Of a ball of d dimensions the share s^d lies within s times its radius."""
    some = Ellipsoid(np.array([1.0, -2.0, 5.0]), np.array([[2.0, 0, 0], [0.5, 0.1, 0], [-1.0, 0.3, 4.0]]), 3.0)
    draws = some.drawn(20_000, np.random.default_rng(0))
    lengths = np.linalg.norm(some.coordinates(draws), axis=1) / some.radius
    assert lengths.max() < 1
    np.testing.assert_allclose([np.mean(lengths < s) for s in (0.5, 0.8)], [0.5**3, 0.8**3], atol=0.01)
    np.testing.assert_allclose(draws.mean(axis=0), some.mean, atol=0.1)


def test_the_ellipsoid_of_a_posterior_holds_nearly_all_of_it():
    random = np.random.default_rng(1)
    apart, mean = random.normal(size=(50_000, 2)) @ np.array([[3.0, 1.0], [0.0, 0.2]]), np.array([10.0, -4.0])
    region = Region(parameters(half_width=1e4), Ellipsoid.around(mean + apart))
    two = region._replace(parameters=Parameters(region.parameters.items[:2]))
    assert two.contains(mean + apart).all()
    within = 1 - 0.001 ** ((1.6 / 2) ** 2)  # of one twice as wide: of 1.6 times the ellipse that leaves out 0.001
    assert two.contains(mean + 2 * apart).mean() == pytest.approx(within, abs=0.002)


def test_coordinates_go_there_and_back():
    items = parameters(half_width=2.0).items
    theta = NOMINAL + np.random.default_rng(2).uniform(-1.9, 1.9, (50, 3))
    for region in (Region(Parameters(items)), Region(Parameters(items), Ellipsoid.around(theta))):
        u = region.coordinates(theta)
        np.testing.assert_allclose(region.from_coordinates(u), theta, rtol=1e-12)
        assert u.std() > 0.1


def test_priors_hold_within_the_region():
    """One parameter with a normal prior, within an interval: the truncated normal distribution."""
    mean, sd = 1.5, 0.4
    only = Region(Parameters(parameters(((mean, sd), None, None), half_width=1.0).items[:1]))
    region = only._replace(ellipsoid=Ellipsoid(np.array([1.1]), np.array([[0.2]]), 2.5))
    draws = region.drawn(20_000, np.random.default_rng(3))[:, 0]
    low, high = 0.6, min(1.6, 2.2)
    expected = truncnorm((low - mean) / sd, (high - mean) / sd, mean, sd)
    np.testing.assert_allclose([draws.mean(), draws.std()], [expected.mean(), expected.std()], rtol=0.02)
    assert low < draws.min() < draws.max() < high


def test_nuisance_is_drawn_from_its_prior_where_the_posterior_lies():
    """A normal prior cut off where a narrower posterior, off its mean, is as good as nothing."""
    items = parameters((None, None, (0.4, 0.5)), half_width=2.0).items
    whole = Region(Parameters((*items[:2], replace(items[2], kind="friction"))))
    random = np.random.default_rng(9)
    posterior = random.normal(size=(20_000, 3)) * [0.1, 0.2, 0.05] + NOMINAL + [0.0, 0.0, 0.3]
    region = whole.around(posterior)
    least, most = region.parameters.lower[2], region.parameters.upper[2]
    for reach in (0.7 - least, most - 0.7):
        assert reach / 0.05 == pytest.approx(1.6 * norm.isf(0.0005), rel=0.05)  # standard deviations of the posterior
    drawn = region.drawn(20_000, random)[:, 2]
    expected = truncnorm((least - 0.4) / 0.5, (most - 0.4) / 0.5, 0.4, 0.5)
    np.testing.assert_allclose([drawn.mean(), drawn.std()], [expected.mean(), expected.std()], rtol=0.02)
    beyond = whole.around(posterior + np.array([0, 0, 1.7])).parameters
    assert beyond.upper[2] == whole.parameters.upper[2]


@pytest.mark.parametrize(
    ("factor", "moved", "alike"),
    [(1.0, 0.0, True), (1.3, 0.3, True), (1.5, 0.0, False), (0.65, 0.0, False), (1.0, 0.4, False), (1.0, -0.4, False)],
)
def test_regions_are_alike_in_size_and_place(factor, moved, alike):
    """A posterior that keeps its width but moves by 0.4 of its deviations has not come to rest."""
    whole = Region(parameters(half_width=50.0))
    draws = np.random.default_rng(10).normal(size=(20_000, 3)) * [0.1, 3.0, 0.02]
    before, other = draws + NOMINAL, factor * draws + NOMINAL + [0.0, 3.0 * moved, 0.0]
    assert whole.around(other).like(whole.around(before), 0.35) is alike
    assert not whole.around(other).like(whole, 0.35)


def test_a_region_beyond_the_bounds_is_refused():
    region = Region(Parameters(parameters(half_width=1.0).items[:1]), Ellipsoid(np.array([99.0]), np.eye(1), 0.5))
    with pytest.raises(InputError, match="next to nothing of the bounds and priors"):
        region.drawn(100, np.random.default_rng(4))


def gappy() -> np.ndarray:
    measured = np.ones((3000, 4)) * [0.1, -0.2, 0.3, 20.0]
    measured[100:200, 3] = np.nan
    return measured


def test_noise_has_the_size_and_the_correlation_that_it_says():
    target = objective(gappy(), None)
    level = Noise(np.array([1e-3, 2e-3, 3e-3, 0.4]), np.array([0.9, 0.5, 0.0, 0.7]), 1.0)
    drawn = level.drawn(60, target, np.random.default_rng(5)).astype(float)
    assert (drawn[:, 100:200, 3] == 0).all()
    there = drawn[:, 200:]
    np.testing.assert_allclose(there.std(axis=(0, 1)), level.deviations, rtol=0.05)
    lagged = (there[:, 1:] * there[:, :-1]).mean(axis=(0, 1)) / (there**2).mean(axis=(0, 1))
    np.testing.assert_allclose(lagged, level.correlations, atol=0.02)
    np.testing.assert_allclose(drawn[:, 0].std(axis=0), level.deviations, rtol=0.4)  # from the first frame on


def test_noise_is_found_in_what_is_left():
    """Of measurements from which slow directions were taken, which take most of what slow noise has there."""
    target, random = objective(gappy(), None), np.random.default_rng(6)
    slow = np.cos(np.pi * np.arange(80)[:, None] * np.arange(3000) / 3000)
    basis = np.linalg.qr(slow.T)[0]  # (3000, 80)

    def left(noise: Noise, count: int) -> np.ndarray:
        drawn = noise.drawn(count, target, random).astype(float)
        return drawn - np.einsum("tk,nkm->ntm", basis, np.einsum("tk,ntm->nkm", basis, drawn))

    truth = Noise(np.array([1e-3, 2e-3, 3e-3, 0.4]), np.array([0.98, 0.5, 0.1, 0.9]), 1.0)
    measured, found = left(truth, 1), Noise.initial(target)
    for _ in range(4):
        found = found.like(target, measured, left(found, 40))
    np.testing.assert_allclose(found.deviations, truth.deviations, rtol=0.3)
    np.testing.assert_allclose(found.correlations, truth.correlations, atol=0.06)
    assert found.span > 1  # its size is not known
    stated = found.like(replace(target, noise={"position": 0.02, "contact": 0.5}), measured, left(found, 5))
    np.testing.assert_array_equal(stated.deviations, [0.02, 0.02, 0.02, 0.5])
    assert stated.span == 1


def test_a_force_that_is_never_there_has_some_noise():
    measured = gappy()
    measured[:, 3] = 0.0
    target = objective(measured, None)
    assert Noise.initial(target).deviations[3] > 0
    assert Noise.initial(target).like(target, np.zeros((1, 3000, 4)), np.ones((3, 3000, 4))).deviations[3] > 0


def test_noise_of_unknown_size_varies_between_recordings():
    target = objective(gappy(), None)
    drawn = Noise(np.full(4, 0.01), np.zeros(4), 2.0).drawn(400, target, np.random.default_rng(7))
    sizes = drawn[:, 200:, 0].std(axis=1)
    assert 0.0047 < sizes.min() < 0.0055
    assert 0.018 < sizes.max() < 0.0213
    assert np.median(sizes) == pytest.approx(0.01, rel=0.1)


def test_a_row_holds_means_of_blocks_in_units_of_the_noise():
    residuals = np.arange(2 * 7 * 3, dtype=np.float32).reshape(2, 7, 3)
    rows = Table(2, np.array([1.0, 2.0, 4.0])).rows(residuals)
    assert rows.shape == (2, 9)  # the seventh frame has no partner
    np.testing.assert_allclose(rows[0, :3], [1.5, 2.5 / 2, 3.5 / 4])
    np.testing.assert_allclose(rows[1, 3:6], [28.5, 29.5 / 2, 30.5 / 4])


@pytest.mark.parametrize("shape", [(40, 300), (300, 40)])
def test_summaries_of_few_directions_lose_nothing(shape):
    random = np.random.default_rng(8)
    rows = (random.normal(size=(shape[0], 5)) @ random.normal(size=(5, shape[1])) + 3).astype(np.float32)
    found = Summaries.of(rows, 20)
    assert found.directions.shape == (shape[1], 5)
    np.testing.assert_allclose(found.directions.T @ found.directions, np.eye(5), atol=1e-4)
    np.testing.assert_allclose(found(rows) @ found.directions.T + found.mean, rows, atol=1e-3)
    two = Summaries.of(rows, 2)(rows)
    assert two.var(axis=0).sum() > np.sort(rows.var(axis=0))[-2:].sum()  # more than any two columns


def test_noise_of_summaries_is_that_of_noisy_recordings():
    """Means of blocks of correlated noise of two trials, with a gap, along some directions: covariances of 20,000."""
    measured = np.ones((90, 4)) * [0.1, -0.2, 0.3, 20.0]
    measured[10:33, 3] = np.nan
    target = objective(measured, None, frames=(slice(0, 40), slice(41, 90)))
    noise = Noise(np.array([1e-3, 2e-3, 3e-3, 0.4]), np.array([0.9, 0.5, 0.0, 0.7]), 1.0)
    table, random = Table(4, np.array([2e-3, 1e-3, 4e-3, 0.3])), np.random.default_rng(11)
    summaries = Summaries(np.float32(0), np.linalg.qr(random.normal(size=(88, 5)))[0].astype(np.float32), np.ones(5))
    found = SummaryNoise.of(noise, target, table, summaries)
    sampled = np.concatenate([summaries(table.rows(noise.drawn(5000, target, random))) for _ in range(4)])
    np.testing.assert_allclose(found.root @ found.root.T, np.cov(sampled.T), atol=0.03 * sampled.var(axis=0).max())
    scale = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    drawn = found.scaled(scale).drawn(20_000, random)
    np.testing.assert_allclose(drawn.std(axis=0), sampled.std(axis=0) / scale, rtol=0.03)
    wide = found._replace(span=2.0).drawn(20_000, random)[:, 0] / sampled[:, 0].std()
    kurtosis = np.mean(wide**4) / np.mean(wide**2) ** 2  # of a normal distribution whose log size is uniform
    square, fourth = (0.5 * (4.0**k - 4.0**-k) / (k * np.log(4.0)) for k in (1, 2))
    assert kurtosis == pytest.approx(3 * fourth / square**2, rel=0.1)
