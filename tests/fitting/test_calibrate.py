"""`calibrate`: verdicts on answers of known quality, and a posterior on plants of a small knee."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from lifted_fits import HELD, SPRINGS, noisy, scene
from lifting_scene import lifting_scene

import fitting
from fitting.calibration.laboratory import Laboratory
from fitting.calibration.plants import Knee, Plant, twin
from fitting.calibration.result import Answers, Calibration
from fitting.trained import TrainedPosterior
from pftwin.base.errors import InputError

NAMES = ("K1", "L2")
NOISE = 5e-4  # [m]; errors of the fit's steps are a fifth of it
LAB = Laboratory(marker_noise=NOISE, cutoff=None)


@cache
def trained() -> TrainedPosterior:
    known = {"position": NOISE}
    return fitting.train_posterior(scene(HELD), noisy(0, HELD), free=SPRINGS, noise=known, simulations=8000)


def answers(width: float, count: int = 200, doubted: int = 0) -> Answers:
    """Normal posteriors of two parameters whose means are off by one deviation, and as wide as that times a factor."""
    random, truth = np.random.default_rng(4), np.array([150.0, 0.07])
    deviation, rows = np.array([3.0, 7e-4]), []
    for i in range(count):
        mean = truth + deviation * random.standard_normal(2)
        rows.append((truth, mean + width * deviation * random.standard_normal((400, 2)), i < doubted))
    return Answers.of(rows, dropped=2, refused=1, asked=2)


def test_right_posteriors_hold_as_often_as_they_say():
    found = answers(1.0)
    for level, held in found.coverage.items():
        np.testing.assert_allclose(held, level, atol=3 * np.sqrt(level * (1 - level) / 200))
    np.testing.assert_allclose(found.rms, [0.02, 0.01], rtol=0.15)
    np.testing.assert_allclose(found.half_widths.mean(axis=0), [1.96 * 0.02, 1.96 * 0.01], rtol=0.05)
    assert found.verdict(NAMES) == "as stated"


@pytest.mark.parametrize(
    ("width", "said", "holds"), [(0.6, "too narrow: K1, L2", False), (2.0, "wider than necessary: K1, L2", True)]
)
def test_other_posteriors_get_other_verdicts(width, said, holds):
    found = Calibration(NAMES, {"twin": answers(1.0), "odd": answers(width)}, "a posterior", 0, 1.0)
    assert found.kinds["odd"].verdict(NAMES) == said
    assert found.holds is holds
    assert ("are NOT shown to be as reliable as stated" in found.sentence()) is not holds


def test_a_posterior_is_widened_until_its_intervals_would_have_held():
    """By 1 / 0.6 where all are too narrow by 0.6; those that are too wide are left as they are."""
    found = Calibration(NAMES, {"twin": answers(0.6, count=4000), "wide": answers(2.0)}, "a posterior", 0, 1.0)
    np.testing.assert_allclose(found.kinds["twin"].factors, 1 / 0.6, rtol=0.06)
    np.testing.assert_array_equal(found.kinds["wide"].factors, 1.0)
    bare = TrainedPosterior(*[None] * 9, widened=(1.0, 1.25))
    np.testing.assert_allclose(found.widened(bare).widened, np.array([1.0, 1.25]) * found.kinds["twin"].factors)


def test_few_plants_accuse_nobody():
    assert answers(0.8, count=8).verdict(NAMES) == "as stated"


def test_doubted_answers_are_counted_separately():
    found = answers(1.0, count=50, doubted=20)
    assert (len(found.ranks), found.doubted, found.refused, found.dropped) == (30, 20, 1, 2)
    whole = Calibration(NAMES, {"twin": found}, "a posterior", 0, 1.0)
    assert whole.rows()[0] == ("answered", "30 of 53")


def test_where_nothing_was_answered_nothing_holds(tmp_path):
    empty = Calibration(NAMES, {"twin": answers(1.0, count=3, doubted=3)}, "a posterior", 0, 1.0)
    assert not empty.holds
    assert "no valid answer for any plant" in empty.sentence()
    assert json.loads(empty.save(tmp_path / "c.json").read_text())["kinds"]["twin"]["answered"] == 0
    assert len(empty.plot.save(tmp_path / "c")) == 4


@pytest.mark.slow
def test_a_posterior_holds_on_its_own_twins_and_a_narrowed_one_does_not(tmp_path):
    one = {"twin": twin}
    found = fitting.calibrate(trained(), scene(HELD), plants=60, kinds=one, laboratory=LAB, seed=2)
    answered = found.kinds["twin"]
    assert len(answered.ranks) >= 45, found.sentence()
    assert found.holds, found.sentence()
    assert (answered.coverage[0.95] > 0.88).all()
    again = json.loads(found.save(tmp_path / "c.json").read_text())
    assert again["kinds"]["twin"]["coverage"]["0.95"] == answered.coverage[0.95].tolist()
    learned = trained().learned
    narrowed = replace(trained(), learned=learned._replace(networks=tuple(Narrowed(n) for n in learned.networks)))
    loose = {"set_up": (1e3, 1e4)}  # which counts in deviations, and they are smaller
    other = fitting.calibrate(narrowed, scene(HELD), plants=40, kinds=one, laboratory=LAB, seed=2, limits=loose)
    assert not other.holds
    assert "too narrow" in other.sentence()
    wider = other.widened(narrowed)
    assert "; widened by a calibration: " in wider.sentence()
    again = fitting.calibrate(wider, scene(HELD), plants=40, kinds=one, laboratory=LAB, seed=3, limits=loose)
    assert again.holds, again.sentence()


class Narrowed:
    """A network whose draws lie four times as near to their mean."""

    def __init__(self, net) -> None:
        self.net = net

    def draws(self, summaries, count, random):
        u = self.net.draws(summaries, count, random)
        return u.mean(axis=1, keepdims=True) + 0.25 * (u - u.mean(axis=1, keepdims=True))


@pytest.mark.slow
def test_recordings_too_loud_are_not_counted():
    def drawn(knee: Knee, random: np.random.Generator) -> Plant:
        return Plant(knee.drawn(random))

    reports = []
    found = fitting.calibrate(
        trained(), scene(HELD), plants=3, kinds={"mine": drawn}, laboratory=replace(LAB, marker_noise=30 * NOISE),
        progress=lambda *now: reports.append(now),
    )  # fmt: skip
    assert [now[:2] for now in reports] == [("mine", 0), ("mine", 1), ("mine", 2)]
    assert found.kinds["mine"].refused + found.kinds["mine"].doubted == 3


@pytest.mark.slow
def test_what_cannot_be_calibrated_is_refused():
    with pytest.raises(InputError, match="at least 1"):
        fitting.calibrate(trained(), scene(HELD), plants=0)
    with pytest.raises(InputError, match="no kind of plants"):
        fitting.calibrate(trained(), scene(HELD), kinds={})
    with pytest.raises(InputError, match="no limit 'sett_up'"):
        fitting.calibrate(trained(), scene(HELD), limits={"sett_up": (1.0, 2.0)})
    with pytest.raises(InputError, match="31 frames"):
        fitting.calibrate(trained(), lifting_scene(31, height=HELD))
    several = replace(trained(), set_up=trained().set_up._replace(frames=(41, 41)))
    with pytest.raises(InputError, match="41 frames; expected: 41, 41, as it was set up for"):
        fitting.calibrate(several, scene(HELD))


def test_too_few_plants_tell_nothing():
    """Of five that are held throughout, Clopper and Pearson's interval begins at 0.478, of six at 0.541."""
    few, enough = answers(1.0, count=5), answers(1.5, count=6)
    assert few.verdict(NAMES) == "too few plants to tell"
    assert few.column(NAMES, np.ones(2))[-1] == "too few plants to tell"
    assert enough.verdict(NAMES) == "as stated"
    whole = Calibration(NAMES, {"twin": few}, "a posterior", 0, 1.0)
    assert not whole.holds
    assert "too few plants to tell" in whole.sentence()
